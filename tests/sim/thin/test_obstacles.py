"""Rigid obstacles that rods and shells meet: where they end, derivatives."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Capsule, Cuboid, Gripper, Simulator, Sphere, cloth, rope
from sim.thin import shared
from sim.thin import test_contact_derivatives as folded
from sim.thin.shared import check_derivatives, scene

ROPE = rope(diameter=0.012, length=0.24, start=(-0.12, 0, 0.1), direction=(1, 0.1, 0), points=17)
CLOTH = cloth(
    width=0.12, height=0.1, thickness=0.004, dx=0.02, corner=(-0.06, -0.05, 0.1), points=(9, 8)
)
TIMES = [0.01, 0.02, 0.03]
BODIES = pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])


def around(body, friction=(0.2, 0.4, 0.3)):
    """A box that comes from below and turns, a bar that stands askew, and a ball."""
    low = body.points[:, 2].min() - body.thickness / 2.0
    turned = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.4, 0.1, 0.2]]).as_quat()
    return [
        Cuboid(
            size=(0.07, 0.06, 0.05), rounding=0.008, friction=friction[0], quat_xyzw=turned,
            time=[0.0, 0.04], position=[[-0.06, 0.0, low - 0.033], [-0.05, 0.01, low - 0.012]],
        ),
        Capsule.between(
            [0.0, -0.1, low - 0.032], [0.02, 0.1, low - 0.021], radius=0.02, friction=friction[1]
        ),
        Sphere(radius=0.03, position=[0.07, 0.004, low - 0.034], friction=friction[2]),
    ]  # fmt: skip


def given(body, seed=0):
    end = body.points[0]
    p = shared.given(
        body, seed, obstacle_friction=np.array([0.2, 0.4, 0.3]), gripper_radius=np.array([0.02]),
        gripper_positions=np.array([[end, end + np.array([0.004, 0.006, 0.01])]]),
    )  # fmt: skip
    p["velocities"] -= [0, 0, 0.7]
    return p


def simulator(body, worlds, **options):
    def hands(p):
        path, radius = p["gripper_positions"][0], p["gripper_radius"][0]
        return [Gripper(time=[0, 0.05], position=path, radius=radius, hold_until=0.025)]

    obstacles = [around(body, world["obstacle_friction"]) for world in worlds]
    height = body.points[:, 2].min() - 0.02
    return scene(body, worlds, hands, height, obstacles=obstacles, substep=2e-4, **options)


def assert_meets(s, obstacles, times):
    """That a body touches each obstacle and is in none; steps along a tangent end outside."""
    x, radius = s.run(times)[:, 0], s.body.thickness / 2.0
    for of in obstacles:
        far = [of.distance(now, t).min() - radius for now, t in zip(x, times, strict=True)]
        assert -1e-9 < min(far) < 1e-6, of


@BODIES
def test_every_derivative_is_that_of_central_differences(body):
    p = given(body)
    made = partial(simulator, body)
    assert_meets(made([p]), around(body), np.linspace(0.001, 0.03, 30))
    # the others do not know of obstacles
    names = ("obstacle_friction", "velocities", "E", *shared.LENGTHS)
    check_derivatives(made, p, dict.fromkeys(names, 1e-5), TIMES, 2e-6)


@pytest.mark.parametrize("body", [folded.ROPE, folded.CLOTH], ids=["rope", "cloth"])
def test_derivatives_where_contact_with_itself_presses_on_an_obstacle(body):
    p = folded.given(body, 0.2)
    low = p["positions"][:, 2].min() - body.thickness / 2.0
    middle = p["positions"][:, :2].mean(axis=0)
    ball = Sphere(radius=0.2, position=[*(middle + 0.003), low - 0.2002], friction=0.3)
    names = ("positions", "E", "velocities")
    folded.check(body, p, names, obstacles=[ball])


SHAPES = {
    "ball": lambda **more: Sphere(radius=0.04, **more),
    "bar": lambda **more: Capsule(radius=0.03, length=0.08, **more),
    "box": lambda **more: Cuboid(size=(0.1, 0.06, 0.08), **more),
    "rounded box": lambda **more: Cuboid(size=(0.1, 0.06, 0.08), rounding=0.01, **more),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_no_place_of_the_surface_is_nearer_than_the_distance(shape):
    rng, centre = np.random.default_rng(2), np.array([0.1, 0.2, 0.3])
    of = SHAPES[shape](position=centre, quat_xyzw=Rotation.from_rotvec([0.7, -1.1, 0.4]).as_quat())
    ways = rng.normal(size=(30_000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    low, high = np.zeros(len(ways)), np.full(len(ways), 0.2)
    for _ in range(50):
        middle = (low + high) / 2.0
        out = of.distance(centre + middle[:, None] * ways) > 0.0
        low, high = np.where(out, low, middle), np.where(out, middle, high)
    assert of.inner_radius == pytest.approx(high.min(), abs=1e-5)
    x = centre + 0.035 * rng.normal(size=(100, 3))
    found, nearest = of.distance(x), KDTree(centre + high[:, None] * ways).query(x)[0]
    assert 10 < np.count_nonzero(found < 0.0) < 90
    assert np.all(np.abs(found) <= nearest + 1e-12)
    assert np.all(nearest - np.abs(found) < 2e-3)  # places are about 1 mm apart


def test_what_rests_on_a_box_moves_with_it():
    """A box that turns and goes aside carries a cloth, or leaves a slippery one behind."""
    sheet = cloth(
        width=0.1, height=0.1, thickness=0.002, dx=0.02, corner=(-0.05, -0.05, 0.001), points=(9, 9)
    )
    angle = 0.6
    turned = Rotation.from_rotvec([[0, 0, 0], [0, 0, angle]]).as_quat()

    def box(friction):
        return [Cuboid(size=(0.3, 0.3, 0.1), friction=friction, time=[0.1, 0.6], quat_xyzw=turned,
                    position=[[0.0, 0.0, -0.05], [0.05, 0.02, -0.05]])]  # fmt: skip

    s = Simulator(sheet, [Material(E=1e6, nu=0.3, density=500.0, damping=0.003)] * 2,
                  obstacles=[box(5.0), box(0.0)])  # fmt: skip
    x = s.run([0.7])[0]
    carried = Rotation.from_rotvec([0, 0, angle]).apply(sheet.points) + np.array([0.05, 0.02, 0])
    assert np.abs(x[0] - carried).max() < 2e-4
    assert np.abs(x[1] - sheet.points).max() < 2e-4


@pytest.mark.gpu
def test_cuda_meets_obstacles_as_the_cpu_does():
    p = given(CLOTH)
    x, y = (simulator(CLOTH, [p], self_contact=True, device=d).run(TIMES) for d in ("cpu", "cuda"))
    np.testing.assert_allclose(x, y, atol=1e-9)
