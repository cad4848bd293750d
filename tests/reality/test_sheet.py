"""A cloth in MuJoCo: its triangles and their bending stiffness, and how it lies on a sphere."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.spatial import KDTree

from gendom.reality import OBJECTS, Layout, RealCloth, Reality
from gendom.reality.model import compiled, load_mujoco, rest_shape, row, scene_xml
from gendom.reality.objects import SHEET_NU
from gendom.sim import Physics, Simulator, Sphere, Table, cloth

CLOTH = replace(cast(RealCloth, OBJECTS["cloth-cotton"]), vertices=33)
RIGIDITY = CLOTH.material.E * CLOTH.thickness**3 / (12.0 * (1.0 - CLOTH.material.nu**2))


@pytest.fixture(scope="module")
def hinges():
    """Vertices [H, 4] and matrices [H, 4, 4] [N/m] of the inner edges."""
    model = Reality(CLOTH, Layout(origin=(0.0, 0.0, 0.5))).model
    matrices = model.flex_bending.reshape(-1, 17)[:, :16].reshape(-1, 4, 4)
    vertices = np.concatenate([model.flex_edge, model.flex_edgeflap], axis=1)
    inner = model.flex_edgeflap.min(axis=1) >= 0
    return model, vertices[inner], matrices[inner]


def stiffness(hinges):
    """K [V, V] [N/m] of lifts out of the plane."""
    _, vertices, matrices = hinges
    K = np.zeros((len(CLOTH.sheet[0]),) * 2)
    np.add.at(K, (vertices[:, :, None], vertices[:, None, :]), matrices)
    return K


def bent(hinges, xx, yy, xy):
    """Energy an area [J/m^2] of the middle of a sheet whose border follows curvatures [1/m]."""
    _, vertices, matrices = hinges
    points = CLOTH.sheet[0]
    x, y = (points - CLOTH.side / 2.0).T
    w = 0.5 * (xx * x**2 + yy * y**2) + xy * x * y
    # the border, too, with diagonals' ends lower by what costs least
    w -= (-1.0) ** np.indices((33, 33)).sum(axis=0).ravel() * (xx + yy) * CLOTH.spacing**2 / 16
    K = stiffness(hinges)
    free = np.maximum(np.abs(x), np.abs(y)) < CLOTH.side / 2.0 - 1.5 * CLOTH.spacing
    w[free] = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, ~free)] @ w[~free])
    # of the 16 x 16 squares in the middle; half of the edges on their border is of others
    middle = np.abs(points[vertices[:, :2]].mean(axis=1) - CLOTH.side / 2.0).max(axis=1)
    share = np.where(np.isclose(middle, 8.0 * CLOTH.spacing), 0.5, 1.0)
    share[middle > 8.25 * CLOTH.spacing] = 0.0
    lifts = w[vertices]
    energy = 0.5 * np.einsum("h,hi,hij,hj->", share, lifts, matrices, lifts)
    return energy / (16.0 * CLOTH.spacing) ** 2


@pytest.mark.parametrize("degrees", [0.0, 22.5, 45.0, 70.0, 90.0, 135.0])
def test_a_sheet_bends_alike_in_every_direction(hinges, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    energy = bent(hinges, c * c, s * s, c * s)
    assert energy == pytest.approx(0.5 * RIGIDITY, rel=1e-3)


def test_a_sheet_twists_and_bulges_with_one_poisson_s_ratio(hinges):
    assert bent(hinges, 0.0, 0.0, 1.0) == pytest.approx((1 - SHEET_NU) * RIGIDITY, rel=1e-3)
    assert bent(hinges, 1.0, 1.0, 0.0) == pytest.approx((1 + SHEET_NU) * RIGIDITY, rel=1e-3)


TIMES = np.array([0.1, 0.2, 0.3, 0.4, 0.6, 0.9, 1.2])
RADIUS, HEIGHT = 0.1, 0.25


def in_mujoco(item, layout, centre):
    """[T, V, 3] vertices of a cloth that is let go over a sphere."""
    hand = '<body name="hand" mocap="true" pos="0 0 -1"/>'
    sphere = (
        f'<geom type="sphere" size="{RADIUS}" pos="{row(centre)}" contype="2" conaffinity="1"'
        f' friction="{item.friction} 0.005 0.0001" priority="1" solimp="0.99 0.999 0.0005"'
        ' solref="0.004 1"/>'
    )
    model = compiled(item, scene_xml(item, layout, bodies=[hand, sphere], ties=[0], tied=False))
    mujoco = load_mujoco()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = []
    for t in TIMES:
        while data.time < t - 0.5 * model.opt.timestep:
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        found.append(data.flexvert_xpos.copy())
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cloth-rubber-200mm", "cloth-cotton-200mm"])
def test_a_cloth_on_a_sphere_lies_as_in_mujoco(name):
    """Not over its middle: there it may buckle to any side. Slippery, it comes off the sphere."""
    item = OBJECTS[name]
    assert isinstance(item, RealCloth)
    corner = (-item.side / 2.0 - 0.03, -item.side / 2.0 - 0.01, HEIGHT)
    layout = Layout(origin=corner)
    centre = (0.0, 0.0, HEIGHT - RADIUS - item.radius - 0.002)
    body = cloth(
        width=item.side, height=item.side, thickness=item.thickness, dx=item.side / 15,
        corner=corner, points=(item.vertices, item.vertices),
    )  # fmt: skip
    same = KDTree(rest_shape(item, layout)).query(body.points)[1]
    s = Simulator(
        body,
        [item.material] * 2,
        table=Table(height=0.0, friction=item.friction),
        obstacles=[
            [Sphere(radius=RADIUS, position=centre, friction=mu)] for mu in (item.friction, 0.05)
        ],
        physics=Physics(air_density=0.0, self_contact=True),
    )
    theirs = in_mujoco(item, layout, centre)[:, None, same]
    off = 1e3 * np.linalg.norm(s.run(TIMES) - theirs, axis=3).mean(axis=2)
    assert off[:, 0].max() < 8.0 and off[-1, 0] < 6.0
    assert off[-1, 1] > 20.0
