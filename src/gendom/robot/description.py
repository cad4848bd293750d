"""An arm from a URDF or MJCF file, as MuJoCo reads it (extra reality).

The arm is the chain of revolute joints from the first one on, up to where it ends or fingers branch
off; its base is the body that carries the first joint. Shapes for collisions, or all shapes of a
link that has none of those, become capsules (`gendom.robot.capsules`).

Such files know no accelerations, and few a gripper: beside NAME.urdf or NAME.xml, NAME.toml may
hold the fields of `Hand`. The file's own fingers are replaced by those of that hand.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array, outwards, placed, rigid
from gendom.errors import RobotError
from gendom.installation import load_mujoco
from gendom.reading import read_bytes, read_toml, record_of
from gendom.robot.arm import Arm, FingerCapsule, LinkCapsule, ParallelGripper
from gendom.robot.capsules import fit_capsules

EXCESS, MOST_CAPSULES = 0.03, 4
"""How far a link's capsules may stick out of its shapes [m], and how many there are at most, with
which they may stick out further."""

_LARGEST, _LARGEST_ASSETS = 1 << 22, 1 << 27  # of the file and of all that it names [bytes]

_MOST_TRIANGLES, _LARGEST_LINK = 300_000, 3.0  # of all links, and of one [m]
_FINGER = 0.045  # length of a finger [m]
_PACKAGE_LEVELS = 6  # folders above a file in which package:// is looked for
_REFUSED = {"include", "replicate", "composite", "flexcomp"}  # files, and any amount


@dataclass(frozen=True, kw_only=True)
class Hand:
    """What files of robots leave out, in metres, seconds and radians."""

    flange: str = ""
    """Body or site whose z points out of the fingers and whose y is from finger to finger; joints
    beyond it are the hand's. By default the body that carries the file's fingers, else the last one
    behind the last joint."""
    tool: float | None = None
    """From there to the point between the fingertips; by default to the end of the file's shapes,
    at least 0.1 m."""
    opening: float = 0.08
    """Largest distance of the fingers."""
    finger_radius: float = 0.008
    max_speed: tuple[float, ...] = ()
    """Of each joint; by default the file's, else 1.5."""
    max_acceleration: tuple[float, ...] = ()
    """Of each joint; by default 5."""
    max_jerk: tuple[float, ...] = ()
    """Of each joint; by default 50."""
    max_tcp_speed: float = 1.0
    home: tuple[float, ...] = ()
    """A free configuration; by default the file's first keyframe, else the middle of the ranges."""


def read_arm(path: str | os.PathLike) -> Arm:
    """The arm of a URDF or MJCF file, by the file's name.

    Raises:
        RobotError: The file, one that it names or its .toml cannot be read, or it holds no arm of 6
            or 7 revolute joints in a row.
        DeviceError: MuJoCo is not installed.
    """
    path, mujoco = Path(path), load_mujoco()
    model, speeds = _compiled(path, mujoco)
    beside = path.with_suffix(".toml")
    hand = _hand(beside) if beside.exists() else Hand()
    chain = _Chain(mujoco, model, path, hand.flange)
    joints, address = chain.joints, model.jnt_qposadr[chain.joints]
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[joints], [[-2.0 * np.pi, 2.0 * np.pi]]).T
    rest = model.key_qpos[0][address] if model.nkey else 0.5 * (low + high)

    def each(name: str, otherwise: Any, low: Any = 1e-6, high: Any = 1e6) -> Array:
        told = getattr(hand, name)
        value = np.array(told or np.broadcast_to(otherwise, len(joints)), dtype=float)
        good = value.shape == joints.shape and np.all((low <= value) & (value <= high))
        fix = f"give {len(joints)} numbers within the joints' limits"
        require(good, f"{name} is {list(told)}", where=str(beside), fix=fix, error=RobotError)
        return value

    r = hand.finger_radius  # two round fingers that slide
    finger = FingerCapsule("finger", (0.0, 0.0, 0.0), (0.0, 0.0, max(_FINGER - r, 0.0)), r, True)
    return Arm(
        name=path.stem,
        T_links=np.linalg.inv(chain.frames[:-1]) @ chain.frames[1:],
        T_flange_tcp=np.linalg.inv(chain.frames[-1]) @ chain.tool(hand),
        q_min=low,
        q_max=high,
        max_speed=each("max_speed", [speeds.get(model.joint(j).name) or 1.5 for j in joints]),
        max_acceleration=each("max_acceleration", 5.0),
        max_jerk=each("max_jerk", 50.0),
        max_tcp_speed=hand.max_tcp_speed,
        home=each("home", np.clip(rest, low, high), low, high),
        capsules=tuple(chain.capsules()),
        gripper=ParallelGripper(
            length=_FINGER, max_opening=hand.opening, pivot_y=0.0, pivot_z=0.0, knuckle=0.0, face=r,
            fingers=(finger,),
        ),
    )  # fmt: skip


def _hand(path: Path) -> Hand:
    """The fields of a .toml."""
    table, fix = read_toml(path, error=RobotError), "see docs/robot.md for what it may hold"
    hand = record_of(Hand, table, where=str(path), fix=fix, by_hand=True, error=RobotError)
    for name in ("tool", "opening", "finger_radius", "max_tcp_speed"):
        value, fix = getattr(hand, name), "give metres (a second) above 0, at most 2"
        good = value is None or 0.0 < value <= 2.0
        require(good, f"{name} is {value}", where=str(path), fix=fix, error=RobotError)
    return hand


def _compiled(path: Path, mujoco: Any) -> tuple[Any, dict[str, float]]:
    """MuJoCo's model of a file, and the largest speeds that a URDF has by joints' names [rad/s]."""
    data, fix = (
        read_bytes(path, RobotError, most=_LARGEST),
        "give a URDF or MJCF file of one arm, its meshes as STL or OBJ",
    )
    plain = not any(word in data for word in (b"<!DOCTYPE", b"<!ENTITY", b"\0"))
    require(plain, "declares entities", where=str(path), fix=fix, error=RobotError)
    try:
        tree = ElementTree.fromstring(data)
        tags = {element.tag for element in tree.iter()} & _REFUSED
        require(not tags, f"holds <{min(tags, default='')}>", where=str(path), fix=fix,
                error=RobotError)  # fmt: skip
        speeds = {
            joint.get("name", ""): float(limit.get("velocity", 0.0))
            for joint in tree.iterfind("joint")
            for limit in joint.iterfind("limit")
        }
        spec = mujoco.MjSpec.from_string(data.decode())
        spec.compiler.fusestatic = False
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6
        spec.compiler.balanceinertia = True
        left = _LARGEST_ASSETS
        for k, asset in enumerate((*spec.meshes, *spec.textures, *spec.hfields)):
            if asset.file:
                file = _beside(path, asset.file, spec.meshdir)
                asset.file = f"{k}{file.suffix.lower()}"
                spec.assets[asset.file] = held = read_bytes(file, RobotError, most=left)
                left -= len(held)
        spec.meshdir = spec.texturedir = ""
        return spec.compile(), speeds
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as fault:
        what = f"cannot be read ({str(fault).strip().splitlines()[0]})"
        raise RobotError(what, where=str(path), fix=fix) from None


def _beside(path: Path, name: str, folder: str) -> Path:
    """The file that another one names: from that file's folder, or as package://."""
    bare = Path(name.partition("package://")[2] or name)
    near = [path.parent / folder / bare, path.parent / bare, path.parent / bare.name]
    for above in list(path.resolve().parents)[:_PACKAGE_LEVELS]:
        near += [above / bare, above.joinpath(*bare.parts[1:])]
    return next((file for file in near if os.path.isfile(file)), near[0])


class _Chain:
    """The arm's joints and what hangs on them in MuJoCo's model, at angles of zero."""

    def __init__(self, mujoco: Any, model: Any, path: Path, flange: str):
        self._types, self._model, self._path = mujoco.mjtGeom, model, path
        weld, parent = model.body_weldid, model.body_parentid  # weld: the body that carries it
        moving = [b for b in range(1, model.nbody) if weld[b] == b]
        self._sites = {model.site(k).name: model.site_bodyid[k] for k in range(model.nsite)}
        self._named = {model.body(b).name: b for b in range(model.nbody)} | self._sites
        carrier = int(weld[self._named.get(flange, 0)])  # what comes after it is a hand's
        self.bodies, joints = [], []
        next_ones = [b for b in moving if not weld[parent[b]]][:1]
        while len(next_ones) == 1 and len(joints) < 7 and carrier not in self.bodies:
            (body,) = next_ones
            joint = int(model.body_jntadr[body])
            hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            if model.body_jntnum[body] != 1 or not hinge:
                break
            self.bodies, joints = [*self.bodies, body], [*joints, joint]
            next_ones = [b for b in moving if weld[parent[b]] == body]
        what, fix = f"has {len(joints)} revolute joints in a row", "give an arm of 6 or 7, fixed"
        require(len(joints) >= 6, what, where=str(path), fix=fix, error=RobotError)
        self.joints, self._fingers = np.array(joints), next_ones
        self._data = data = mujoco.MjData(model)
        data.qpos[model.jnt_qposadr[self.joints]] = 0.0
        mujoco.mj_kinematics(model, data)
        root = int(parent[self.bodies[0]])
        frames = [self._frame(root)]
        for body, joint in zip(self.bodies, joints, strict=True):
            T = self._frame(body)
            turn = Rotation.align_vectors(model.jnt_axis[joint], [0.0, 0.0, 1.0])[0]
            T[:3, :3] = T[:3, :3] @ turn.as_matrix()
            T[:3, 3] = data.xanchor[joint]
            frames.append(T)
        self.frames = np.array(frames)
        """[J + 1, 4, 4] the base's and the links'."""
        links = {body: link for link, body in enumerate(self.bodies, 1)}
        own = [root and model.body_rootid[b] == model.body_rootid[root] for b in range(model.nbody)]
        self._link = {
            b: links.get(int(weld[b]), 0 if own[b] and not weld[b] else -1)
            for b in range(model.nbody)
        }

    def _frame(self, body: int) -> Array:
        return rigid(self._data.xmat[body].reshape(3, 3), self._data.xpos[body])

    def _geoms(self, bodies: Callable[[int], bool]) -> list[int]:
        """Geoms of some bodies: those that collide, or all where there are none."""
        model = self._model
        some = [g for g in range(model.ngeom) if bodies(int(model.geom_bodyid[g]))]
        solid = [g for g in some if model.geom_contype[g] or model.geom_conaffinity[g]]
        return solid or some

    def _triangles(self, geom: int) -> Array:
        """[T, 3, 3] surface of a geom in the base's frame [m]."""
        model, size, types = self._model, self._model.geom_size[geom], self._types
        kind = model.geom_type[geom]
        if kind == types.mjGEOM_MESH:
            k = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[k], model.mesh_vertnum[k]
            points = model.mesh_vert[first : first + count].astype(float)
            first, count = model.mesh_faceadr[k], model.mesh_facenum[k]
            faces = points[model.mesh_face[first : first + count]]
        elif kind in (types.mjGEOM_PLANE, types.mjGEOM_HFIELD):
            return np.empty((0, 3, 3))
        else:
            hull = ConvexHull(_points(types, kind, size))
            faces = hull.points[outwards(hull)]
        T = rigid(self._data.geom_xmat[geom].reshape(3, 3), self._data.geom_xpos[geom])
        return placed(np.linalg.inv(self.frames[0]) @ T, faces)

    def capsules(self) -> Iterator[LinkCapsule]:
        """Those that cover the links, in the links' frames.

        Raises:
            RobotError: Their surfaces have too many triangles, or a link is too large.
        """
        where, surfaces = str(self._path), []
        for link, T in enumerate(np.linalg.inv(np.linalg.inv(self.frames[0]) @ self.frames)):
            geoms = self._geoms(lambda body, link=link: self._link[body] == link)
            triangles = [np.empty((0, 3, 3)), *map(self._triangles, geoms)]
            surfaces.append(placed(T, np.concatenate(triangles)))
            size = np.ptp(surfaces[-1], axis=(0, 1)).max() if len(surfaces[-1]) else 0.0
            what, fix = f"link {link} is {size:.4g} m large", "give meshes in metres, or a scale"
            require(size <= _LARGEST_LINK, what, where=where, fix=fix, error=RobotError)
        count, fix = sum(map(len, surfaces)), "give simpler meshes to collide"
        what = f"has {count} triangles, at most {_MOST_TRIANGLES} are read"
        require(count <= _MOST_TRIANGLES, what, where=where, fix=fix, error=RobotError)
        for link, triangles in enumerate(surfaces):
            if not len(triangles):
                continue
            found, _ = fit_capsules(triangles, excess=EXCESS, most=MOST_CAPSULES)
            for k, (a, b, radius) in enumerate(found, 1):
                name = f"link{link} part {k}" if link else f"base part {k}"
                yield LinkCapsule(name, link, (*a.tolist(),), (*b.tolist(),), radius)

    def tool(self, hand: Hand) -> Array:
        """[4, 4] pose of the point between the fingertips in MuJoCo's world.

        Raises:
            RobotError: There is no body or site of the flange's name.
        """
        model, data, last = self._model, self._data, len(self.bodies)
        behind = [b for b, link in self._link.items() if link == last]
        if self._fingers:
            behind = [int(model.body_parentid[self._fingers[0]])]
        flange = self._frame(behind[-1])
        if hand.flange:
            what, fix = f"has no body or site {hand.flange!r}", "correct `flange` in its .toml"
            known = hand.flange in self._named
            require(known, what, where=str(self._path), fix=fix, error=RobotError)
            at = (data.site if hand.flange in self._sites else data.body)(hand.flange)
            flange = rigid(at.xmat.reshape(3, 3), at.xpos)
        carriers = {self.bodies[-1], *self._fingers}
        ends = [0.1]
        for g in self._geoms(lambda b: self._link[b] == last or self._below(b, carriers)):
            T = np.linalg.inv(flange) @ self.frames[0]
            ends.append((self._triangles(g) @ T[2, :3] + T[2, 3]).max(initial=0.0))
        flange[:3, 3] += (hand.tool or max(ends)) * flange[:3, 2]
        return flange

    def _below(self, body: int, carriers: set[int]) -> bool:
        while body and body not in carriers:
            body = int(self._model.body_parentid[body])
        return body in carriers


def _points(types: Any, kind: int, size: Array) -> Array:
    """[N, 3] points whose hull is a geom that is no mesh [m]."""
    around, tilt = np.meshgrid(np.pi / 12.0 * np.arange(24), np.pi / 12.0 * np.arange(-6, 7))
    ball = np.stack([np.cos(tilt) * np.cos(around), np.cos(tilt) * np.sin(around), np.sin(tilt)])
    ring = np.stack([np.cos(around), np.sin(around), 0.0 * around])
    ends = np.sign(np.sin(tilt)) * np.eye(3)[2][:, None, None]
    r, high = size[0], size[1]
    points = {
        int(types.mjGEOM_BOX): size[:, None, None] * np.sign(np.round(ball, 9)),
        int(types.mjGEOM_CYLINDER): r * ring + high * ends,
        int(types.mjGEOM_CAPSULE): r * ball + high * ends,
        int(types.mjGEOM_ELLIPSOID): size[:, None, None] * ball,
    }
    return points.get(int(kind), r * ball).reshape(3, -1).T
