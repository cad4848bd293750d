"""The model of the MuJoCo test scene: a table, one object as a MuJoCo flex, an arm and two cameras.

MuJoCo's models differ from those of `gendom.sim`: a rope is a discrete elastic rod and a cloth a
shell of triangles, both integrated implicitly, with MuJoCo's contact model. docs/reality.md
compares both with closed-form solutions; `gendom.reality.twist` describes what the rods lack.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError
from gendom.installation import load_mujoco
from gendom.materials import STANDARD_GRAVITY
from gendom.perception.camera import Camera
from gendom.reality.objects import RealCloth, RealObject, RealRope

ROPE_STEP, CLOTH_STEP = 0.001, 0.004
"""Time steps [s]."""

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

    def rotation(self) -> Rotation:
        """Rotation from the flex's axes to the world's."""
        x, y = np.asarray(self.along), np.asarray(self.across)
        return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=1))


def default_cameras(centre: npt.ArrayLike = (0.5, 0.0, 0.1)) -> list[Camera]:
    """Two D435i-like cameras of 640 x 480 pixels on opposite sides of a point [3] [m], looking at
    it: "left" (at positive y) and "right", with the true poses."""
    centre = np.asarray(centre, dtype=float)
    width, height = CAMERA_SIZE
    K = np.array([[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1.0]])
    tilt = np.radians(CAMERA_ELEVATION)
    cameras = []
    for name, side in (("left", 1.0), ("right", -1.0)):
        offset = np.array([0.0, side * np.cos(tilt), np.sin(tilt)])
        cameras.append(
            Camera(
                name=name,
                width=width,
                height=height,
                K=K,
                T_world_camera=looking_at(centre + CAMERA_DISTANCE * offset, centre),
                depth_unit=DEPTH_UNIT,
            )
        )
    return cameras


def looking_at(position: npt.ArrayLike, target: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`T_world_camera` [4, 4] [m] of an upright camera at a position, looking at a target."""
    position = np.asarray(position, dtype=float)
    forward = np.asarray(target, dtype=float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = position
    return T


def build_model(
    item: RealObject,
    layout: Layout,
    *,
    arm: str = "",
    actuators: str = "",
    hand: str = "",
    cameras: Sequence[Camera] = (),
    table: bool = True,
    timestep: float | None = None,
    tolerance: float | None = None,
    gravity: npt.ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY),
) -> Any:
    """Compile the scene.

    Each vertex of the object has one connect constraint to the hand, named HAND_INDEX and
    initially inactive; `Reality` switches them to attach and release. Vertices held by the stand
    are connected to the world.

    Args:
        item: The object.
        layout: Its initial placement.
        arm: Bodies of a robot, see `gendom.reality.arm`, or of a free hand.
        actuators: The robot's actuators.
        hand: Name of a body that can hold the object.
        cameras: Fixed cameras.
        table: Whether the scene has a table.
        timestep: Time step [s]; by default 1 ms for ropes, 4 ms for cloths.
        tolerance: Of MuJoCo's solver; by default 1e-8 for ropes, 1e-6 for cloths.
        gravity: [3] gravity [m/s^2].

    Returns:
        The `mujoco.MjModel`.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: MuJoCo refuses the model.
    """
    step = timestep or (ROPE_STEP if isinstance(item, RealRope) else CLOTH_STEP)
    vertices = len(rest_shape(item, layout))
    connections = [
        connection(f"{hand}_{v}", f"object_{v}", hand, step, active=False)
        for v in range(vertices if hand else 0)
    ]
    connections += [
        f'<connect name="stand_{v}" body1="object_{v}" anchor="0 0 0" {_firm(step)}/>'
        for v in clamped_vertices(item, layout)
    ]
    xml = scene_xml(
        item,
        layout,
        step=step,
        tolerance=tolerance,
        gravity=gravity,
        bodies=("".join(map(_camera, cameras)), arm),
        actuators=actuators,
        connections=connections,
        table=table,
    )
    return compiled(item, xml)


def scene_xml(
    item: RealObject,
    layout: Layout,
    *,
    step: float,
    bodies: Sequence[str],
    connections: Sequence[str],
    actuators: str = "",
    table: bool = True,
    tolerance: float | None = None,
    gravity: npt.ArrayLike = (0.0, 0.0, -STANDARD_GRAVITY),
) -> str:
    """The scene as MJCF; other arguments as of `build_model`.

    Args:
        step: Time step [s].
        bodies: Elements beside table and object.
        connections: Equality constraints.
    """
    # CG needs many iterations where a cloth lies on itself; with too few, vertices penetrate.
    solver, usual = ("Newton", 1e-8) if isinstance(item, RealRope) else ("CG", 1e-6)
    options = (
        f'timestep="{step}" integrator="discrete" solver="{solver}" iterations="400"'
        f' tolerance="{usual if tolerance is None else tolerance}" gravity="{_row(gravity)}"'
    )
    around = [_table(item, step)] if table else []
    return _SCENE.format(
        name=item.name,
        options=options,
        floor=f'contype="{_FIXED}" conaffinity="{_OBJECT}"',
        bodies="".join([*around, *bodies, _flex(item, layout, step)]),
        actuators=actuators,
        connections="".join(connections),
    )


def compiled(item: RealObject, xml: str) -> Any:
    """The `mujoco.MjModel` of a scene, with what MJCF cannot say of its object.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: MuJoCo refuses the scene.
    """
    try:
        model = load_mujoco().MjModel.from_xml_string(xml)
    except ValueError as error:
        raise ParameterError(
            f"MuJoCo refuses the scene ({error})", where=item.name, fix="check its sizes"
        ) from None
    _weigh(model, item)
    if isinstance(item, RealCloth):
        _bend_alike(model, item)
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
    {bodies}
  </worldbody>
  <actuator>{actuators}</actuator>
  <equality>
    {connections}
  </equality>
</mujoco>"""


def _table(item: RealObject, step: float) -> str:
    """The table: a box that is seen, and a plane that is touched.

    A plane makes one contact for each vertex, a box one for each corner of each triangle, six times
    as many constraints. Each of the plane's contacts is harder, so that objects on a slope creep as
    little. By its priority, the plane's contact parameters apply.
    """
    x, y, wide, deep = TABLE
    return (
        f'<geom name="table" type="box" pos="{x} {y} -0.02" size="{wide / 2} {deep / 2} 0.02"'
        ' rgba="0.62 0.58 0.52 1" contype="0" conaffinity="0"/>'
        f'<geom name="top" type="plane" group="{_UNSEEN}" size="{wide / 2} {deep / 2} 0.1"'
        f' pos="{x} {y} 0" contype="{_FIXED}" conaffinity="{_OBJECT}"'
        f' friction="{item.friction} 0.005 0.0001" solref="{2 * step} 1" solimp="0.99 0.999 0.0005"'
        ' priority="1"/>'
    )


def _weigh(model: Any, item: RealObject) -> None:
    """Set each vertex's mass to that of its share of the object; flexcomp makes them all equal."""
    mujoco = load_mujoco()
    # The inertia of these bodies has no effect: they translate and do not rotate.
    model.body_mass[model.flex_vertbodyid] = item.vertex_masses
    mujoco.mj_setConst(model, mujoco.MjData(model))


def softened(cloth: RealCloth) -> float:
    """Factor by which a sheet's in-plane stiffness is reduced."""
    m = cloth.material
    return min(1.0, m.density * STANDARD_GRAVITY * cloth.side / (2.0 * SHEET_STRETCH * m.E))


def _bend_alike(model: Any, cloth: RealCloth) -> None:
    """Set the bending rigidity of a sheet, softened or not, in every direction."""
    length = np.linalg.norm(np.diff(cloth.sheet[0][model.flex_edge], axis=1), axis=(1, 2))
    diagonal = length > 1.2 * cloth.spacing
    hinges = model.flex_bending.reshape(len(length), -1)
    hinges *= np.where(diagonal, DIAGONAL_HINGES, SIDE_HINGES)[:, None] / softened(cloth)


def rest_shape(item: RealObject, layout: Layout) -> npt.NDArray[np.float64]:
    """Initial positions of the vertices, [V, 3] [m]; for a cloth `across` varies fastest."""
    origin = np.asarray(layout.origin, dtype=np.float64)
    if isinstance(item, RealRope):
        along = np.linspace(0.0, item.length, item.vertices)
        return origin + along[:, None] * np.asarray(layout.along)
    points, _ = item.sheet
    return origin + points @ np.array([layout.along, layout.across], dtype=np.float64)


def _flex(item: RealObject, layout: Layout, step: float) -> str:
    """XML element of the object."""
    centre = rest_shape(item, layout).mean(axis=0)
    turned = layout.rotation().as_quat(scalar_first=True)
    place = f'pos="{_row(centre)}" quat="{_row(turned)}" mass="{item.mass!r}"'
    colour = _row([*(c / 255.0 for c in item.colour), 1.0])
    # Hard contact: two time steps to settle. The table's friction takes precedence. Cloths touch
    # themselves, too.
    touched = _FIXED if isinstance(item, RealRope) else _FIXED | _OBJECT
    contact = (
        f'<contact contype="{_OBJECT}" conaffinity="{touched}" selfcollide="auto"'
        f' friction="{item.friction} 0.005 0.0001" solref="{2 * step} 1"/>'
    )
    E, nu = item.material.E, item.material.nu
    damping = item.material.damping
    if isinstance(item, RealRope):
        n, dx = item.vertices, item.length / (item.vertices - 1)
        return (
            f'<flexcomp name="object" type="grid" dim="1" count="{n} 1 1" spacing="{dx} {dx} {dx}"'
            f' {place} radius="{item.radius}" rgba="{colour}">'
            # A rope hardly stretches: constraints, not springs, keep the length of its edges.
            f'<edge equality="true" solref="{2 * step} 1" solimp="0.99 0.999 0.001"/>'
            f'<elasticity young="{float(E)!r}" poisson="{nu}" damping="{damping}"'
            f' section="circle"/>'
            f"{contact}</flexcomp>"
        )
    # Implicit steps damp like a damping as long as they are: with 4 ms a sheet of 12 ms was damped
    # like one of 15.5 ms, one of 2 ms like one of 6.4 ms.
    damping = max(damping - step, 0.0)
    flat = Layout(origin=(0.0, 0.0, 0.0))
    points = rest_shape(item, flat)
    points -= points.mean(axis=0)
    return (
        f'<flexcomp name="object" type="direct" dim="2" point="{_row(points)}"'
        f' element="{" ".join(map(str, item.sheet[1].ravel()))}"'
        f' {place} radius="{item.radius}" rgba="{colour}">'
        f'<elasticity young="{float(softened(item) * E)!r}" poisson="{nu}" damping="{damping}"'
        f' thickness="{float(item.thickness)!r}" elastic2d="both"/>'
        f"{contact}</flexcomp>"
    )


def clamped_vertices(item: RealObject, layout: Layout) -> npt.NDArray[np.intp]:
    """Indices of the vertices clamped by the stand, in order."""
    if layout.clamped <= 0.0:
        return np.empty(0, dtype=np.intp)
    along = (rest_shape(item, layout) - np.asarray(layout.origin)) @ np.asarray(layout.along)
    # A single row would be a hinge.
    second = np.unique(along.round(9))[1]
    return np.flatnonzero(along <= max(layout.clamped, second) + 1e-9)


def connection(name: str, body: str, hand: str, step: float, *, active: bool) -> str:
    """XML element that ties a body's origin to a hand."""
    state = "true" if active else "false"
    return (
        f'<connect name="{name}" body1="{body}" body2="{hand}" anchor="0 0 0" active="{state}"'
        f" {_firm(step)}/>"
    )


def _firm(step: float) -> str:
    """Parameters of a stiff constraint; a softer one lets the clamped end rotate by degrees."""
    return f'solref="{2 * step} 1" solimp="0.9999 0.9999 0.001"'


def _camera(camera: Camera) -> str:
    T, K = camera.calibrated(), camera.K
    # MuJoCo's cameras look along -z with y up, OpenCV's along z with y down.
    quat = Rotation.from_matrix(T[:3, :3] * [1.0, -1.0, -1.0]).as_quat(scalar_first=True)
    pixel = 3e-6
    principal = [K[0, 2] - (camera.width - 1) / 2, (camera.height - 1) / 2 - K[1, 2]]
    return (
        f'<camera name="{camera.name}" pos="{_row(T[:3, 3])}" quat="{_row(quat)}"'
        f' resolution="{camera.width} {camera.height}"'
        f' sensorsize="{camera.width * pixel} {camera.height * pixel}"'
        f' focalpixel="{K[0, 0]} {K[1, 1]}" principalpixel="{_row(principal)}"/>'
    )


def _row(values: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))
