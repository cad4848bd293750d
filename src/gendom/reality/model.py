"""The model of the MuJoCo test scene: a table, one object as a MuJoCo flex, an arm and two cameras.

MuJoCo's models differ from those of `gendom.sim`: a rope is a discrete elastic rod and a cloth a
shell of triangles, both integrated implicitly, with MuJoCo's contact model. docs/reality.md
compares both with closed-form solutions; `gendom.reality.twist` describes what the rods lack.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from gendom.arrays import Array, rigid
from gendom.errors import ParameterError
from gendom.installation import load_mujoco
from gendom.materials import STANDARD_GRAVITY
from gendom.perception.camera import Camera
from gendom.reality.objects import RealCloth, RealObject, RealRope

ROPE_STEP, CLOTH_STEP = 0.00025, 0.004
"""Time steps [s]. In steps of 1 ms a rope of 2.5 ms is damped like one of 3.5 ms, in these like one
of 2.8 ms."""

SIDE_HINGES, DIAGONAL_HINGES = 4.0 / 3.0, 2.0 / 3.0
"""Factors on MuJoCo's bending stiffness across the edges of a sheet's squares and across their
diagonals, with which the sheet has a plate's rigidity in every direction
(`gendom.reality.objects`)."""

SHEET_STRETCH = 0.002
"""Largest relative stretch of a sheet by its own weight when it hangs by a side. Sheets with a
larger in-plane stiffness are softened to this value, because in-plane stiffness also resists
bending over a few triangles (docs/reality.md)."""

TABLE = (0.45, 0.0, 0.9, 1.4)
"""Centre x, y and sizes along x and y of the table [m]; its top is z = 0."""

CAMERA_SIZE, FOCAL = (640, 480), 385.0
"""Width, height and focal length of a D435i [pixels]."""

CAMERA_DISTANCE, CAMERA_ELEVATION = 0.8, 25.0
"""Of the default cameras from what they look at [m], and above the horizontal [degrees]."""

DEPTH_UNIT = 1e-4
"""Depth unit of simulated cameras [m a count]. The default of the D400 series, 1e-3, is coarser
than its noise within 0.5 m; the cameras can be set to this value, which reaches 6.5 m."""

# Contact bits, and a geom group that is not rendered.
_OBJECT, _FIXED, _UNSEEN = 1, 2, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """Initial placement of an object, straight or flat and stress-free."""

    origin: npt.ArrayLike
    """[3] a rope's first end, or a cloth's first corner [m]."""
    along: npt.ArrayLike = (1.0, 0.0, 0.0)
    """[3] unit vector along a rope, or a cloth's first side."""
    across: npt.ArrayLike = (0.0, 1.0, 0.0)
    """[3] unit vector along a cloth's second side; any at right angles to a rope."""
    clamped: float = 0.0
    """Length of its first end that a stand clamps [m]."""


def default_cameras(centre: npt.ArrayLike = (0.5, 0.0, 0.1)) -> list[Camera]:
    """Two D435i-like cameras of 640 x 480 pixels on opposite sides of a point [3] [m], looking at
    it: "left" (at positive y) and "right", with the true poses."""
    centre = np.asarray(centre, dtype=float)
    width, height = CAMERA_SIZE
    K = np.array([[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1.0]])
    tilt = np.radians(CAMERA_ELEVATION)
    sides = {"left": 1.0, "right": -1.0}
    at = {n: centre + CAMERA_DISTANCE * np.array([0.0, side * np.cos(tilt), np.sin(tilt)])
          for n, side in sides.items()}  # fmt: skip
    return [
        Camera(name=name, width=width, height=height, K=K, depth_unit=DEPTH_UNIT,
               T_world_camera=looking_at(place, centre))
        for name, place in at.items()
    ]  # fmt: skip


def looking_at(position: npt.ArrayLike, target: npt.ArrayLike) -> Array:
    """`T_world_camera` [4, 4] [m] of an upright camera at a position, looking at a target."""
    position = np.asarray(position, dtype=float)
    forward = np.asarray(target, dtype=float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return rigid(np.stack([right, np.cross(forward, right), forward], axis=1), position)


def scene_xml(
    item: RealObject,
    layout: Layout,
    *,
    bodies: Sequence[str],
    ties: Iterable[int],
    tied: bool,
    actuators: str = "",
    step: float | None = None,
    tolerance: float | None = None,
) -> str:
    """The scene as MJCF.

    Args:
        item: The object.
        layout: Its initial placement.
        bodies: Elements beside table and object, the body ``hand`` among them.
        ties: Vertices that can be tied to the hand, by constraints named hand_VERTEX.
        tied: Whether they are, at first.
        actuators: A robot's.
        step: Time step [s]; by default `ROPE_STEP` or `CLOTH_STEP`.
        tolerance: Of MuJoCo's solver; by default 1e-8 for ropes, 1e-6 for cloths.
    """
    # CG needs many iterations where a cloth lies on itself; with too few, vertices penetrate.
    rope = isinstance(item, RealRope)
    solver, usual, usual_step = ("Newton", 1e-8, ROPE_STEP) if rope else ("CG", 1e-6, CLOTH_STEP)
    step = step or usual_step
    connections = [_connection("hand", v, "hand", step, active=tied) for v in ties]
    connections += [
        _connection("stand", v, "world", step, active=True) for v in clamped_vertices(item, layout)
    ]
    x, y, wide, deep = TABLE
    return _SCENE.format(
        name=item.name,
        options=f'timestep="{step}" integrator="discrete" solver="{solver}" iterations="400"'
        f' tolerance="{usual if tolerance is None else tolerance}"'
        f' gravity="0.0 0.0 {-STANDARD_GRAVITY}"',
        table=f'pos="{x} {y} -0.02" size="{wide / 2} {deep / 2} 0.02"',
        # A plane makes one contact for each vertex, a box one for each corner of each triangle,
        # six times as many constraints, each of them softer. Its priority: its parameters apply.
        top=f'group="{_UNSEEN}" size="{wide / 2} {deep / 2} 0.1" pos="{x} {y} 0"'
        f' friction="{item.friction} 0.005 0.0001" solref="{2 * step} 1"',
        floor=f'contype="{_FIXED}" conaffinity="{_OBJECT}"',
        bodies="".join([*bodies, _flex(item, layout, step)]),
        actuators=actuators,
        connections="".join(connections),
    )


def compiled(item: RealObject, xml: str) -> Any:
    """The `mujoco.MjModel` of a scene, with what MJCF cannot say of its object.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: MuJoCo refuses the scene.
    """
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        what = f"MuJoCo refuses the scene ({error})"
        raise ParameterError(what, where=item.name, fix="check its sizes") from None
    # Each vertex has the mass of its share; flexcomp makes them all equal. The inertia of these
    # bodies has no effect: they translate and do not rotate.
    model.body_mass[model.flex_vertbodyid] = item.vertex_masses
    mujoco.mj_setConst(model, mujoco.MjData(model))
    if isinstance(item, RealCloth):  # a sheet, softened or not, bends alike in every direction
        length = np.linalg.norm(np.diff(item.sheet[0][model.flex_edge], axis=1), axis=(1, 2))
        hinges = model.flex_bending.reshape(len(length), -1)
        factor = np.where(length > 1.2 * item.spacing, DIAGONAL_HINGES, SIDE_HINGES)
        hinges *= factor[:, None] / softened(item)
    return model


_SCENE = """
<mujoco model="{name}">
  <option {options}/>
  <size memory="256M"/>
  <visual>
    <global offwidth="1280" offheight="960"/>
    <map znear="0.02" zfar="8"/>
    <quality offsamples="0" shadowsize="2048"/>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.35 0.35 0.35" specular="0 0 0"/>
  </visual>
  <statistic extent="1" center="0.4 0 0.2"/>
  <worldbody>
    <light pos="0.2 0.6 1.8" dir="0.1 -0.3 -1" diffuse="0.5 0.5 0.5" castshadow="true"/>
    <light pos="0.8 -0.8 1.6" dir="-0.2 0.4 -1" diffuse="0.3 0.3 0.3" castshadow="false"/>
    <geom name="floor" type="plane" size="4 4 0.1" pos="0 0 -0.75" rgba="0.35 0.37 0.4 1" {floor}/>
    <geom name="table" type="box" {table} rgba="0.62 0.58 0.52 1" contype="0" conaffinity="0"/>
    <geom name="top" type="plane" {top} {floor} solimp="0.99 0.999 0.0005" priority="1"/>
    {bodies}
  </worldbody>
  <actuator>{actuators}</actuator>
  <equality>
    {connections}
  </equality>
</mujoco>"""


def softened(cloth: RealCloth) -> float:
    """Factor by which a sheet's in-plane stiffness is reduced."""
    m = cloth.material
    return min(1.0, m.density * STANDARD_GRAVITY * cloth.side / (2.0 * SHEET_STRETCH * m.E))


def rest_shape(item: RealObject, layout: Layout) -> Array:
    """Initial positions of the vertices, [V, 3] [m]; for a cloth `across` varies fastest."""
    origin = np.asarray(layout.origin, dtype=np.float64)
    if isinstance(item, RealRope):
        along = np.linspace(0.0, item.length, item.vertices)
        return origin + along[:, None] * np.asarray(layout.along)
    points, _ = item.sheet
    return origin + points @ np.array([layout.along, layout.across], dtype=np.float64)


def _flex(item: RealObject, layout: Layout, step: float) -> str:
    """XML element of the object."""
    rope = isinstance(item, RealRope)
    E, nu, damping = item.material.E, item.material.nu, item.material.damping
    if rope:
        dx = item.spacing
        shape = f'type="grid" dim="1" count="{item.vertices} 1 1" spacing="{dx} {dx} {dx}"'
        # A rope hardly stretches: constraints, not springs, keep the length of its edges.
        inner = f'<edge equality="true" solref="{2 * step} 1" solimp="0.99 0.999 0.001"/>'
        section = 'section="circle"'
    else:
        # Implicit steps damp like a damping as long as they are: with 4 ms a sheet of 12 ms was
        # damped like one of 15.5 ms, one of 2 ms like one of 6.4 ms.
        damping = max(damping - step, 0.0)
        E = softened(item) * E
        points = rest_shape(item, Layout(origin=(0.0, 0.0, 0.0)))
        triangles = " ".join(map(str, item.sheet[1].ravel()))
        shape = f'type="direct" dim="2" point="{row(points - points.mean(axis=0))}"'
        shape += f' element="{triangles}"'
        inner, section = "", f'thickness="{float(item.thickness)!r}" elastic2d="both"'
    centre = rest_shape(item, layout).mean(axis=0)
    x, y = np.asarray(layout.along), np.asarray(layout.across)
    axes = Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=1))
    turned = axes.as_quat(scalar_first=True)
    colour = row([*(c / 255.0 for c in item.colour), 1.0])
    # Hard contact: two time steps to settle. The table's friction takes precedence. Cloths touch
    # themselves, too.
    touched = _FIXED if rope else _FIXED | _OBJECT
    return (
        f'<flexcomp name="object" {shape} pos="{row(centre)}" quat="{row(turned)}"'
        f' mass="{item.mass!r}" radius="{item.radius}" rgba="{colour}">{inner}'
        f'<elasticity young="{float(E)!r}" poisson="{nu}" damping="{damping}" {section}/>'
        f'<contact contype="{_OBJECT}" conaffinity="{touched}" selfcollide="auto"'
        f' friction="{item.friction} 0.005 0.0001" solref="{2 * step} 1"/></flexcomp>'
    )


def clamped_vertices(item: RealObject, layout: Layout) -> npt.NDArray[np.intp]:
    """Indices of the vertices clamped by the stand, in order."""
    if layout.clamped <= 0.0:
        return np.empty(0, dtype=np.intp)
    along = (rest_shape(item, layout) - np.asarray(layout.origin)) @ np.asarray(layout.along)
    # A single row would be a hinge.
    second = np.unique(along.round(9))[1]
    return np.flatnonzero(along <= max(layout.clamped, second) + 1e-9)


def _connection(name: str, vertex: int, to: str, step: float, *, active: bool) -> str:
    """XML element that ties a vertex to a body. It is stiff: with a softer one the clamped end
    turns by degrees."""
    return (
        f'<connect name="{name}_{vertex}" body1="object_{vertex}" body2="{to}" anchor="0 0 0"'
        f' active="{"true" if active else "false"}" solref="{2 * step} 1"'
        ' solimp="0.9999 0.9999 0.001"/>'
    )


def camera_xml(camera: Camera) -> str:
    T, K = camera.calibrated(), camera.K
    # MuJoCo's cameras look along -z with y up, OpenCV's along z with y down.
    quat = Rotation.from_matrix(T[:3, :3] * [1.0, -1.0, -1.0]).as_quat(scalar_first=True)
    pixel = 3e-6
    principal = [K[0, 2] - (camera.width - 1) / 2, (camera.height - 1) / 2 - K[1, 2]]
    return (
        f'<camera name="{camera.name}" pos="{row(T[:3, 3])}" quat="{row(quat)}"'
        f' resolution="{camera.width} {camera.height}"'
        f' sensorsize="{camera.width * pixel} {camera.height * pixel}"'
        f' focalpixel="{K[0, 0]} {K[1, 1]}" principalpixel="{row(principal)}"/>'
    )


def row(values: npt.ArrayLike) -> str:
    """Numbers as MJCF has them."""
    return " ".join(repr(float(x)) for x in np.ravel(values))
