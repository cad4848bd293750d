"""By how much cameras' clocks are ahead of the robot's, from what they saw of the moving hand.

A picture of a camera whose clock is ahead by tau shows the hand where it was tau before the
picture's time: beside where its measured joints have it by -tau v, with v its velocity. Of each
picture the points of the gripper's body are shifted along the way onto those of the first pictures,
in the hand's frame; a line through these shifts over v gives tau. What is the same in all pictures,
as a calibration's error is, and what grows with the way, as its turn does, are left free.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import KDTree

from gendom.arguments import require
from gendom.arrays import Array, placed
from gendom.errors import DeviceError
from gendom.files import write_json
from gendom.perception import Camera, Frame, FrameSource, read_cameras
from gendom.perception.frames import interpolate
from gendom.reading import read_json
from gendom.robot import Arm, read_joints, tcp_pose

MAX_OFFSET = 0.02
"""Of a camera's clock from the robot's [s]; two deviations beyond it a recording is refused."""

_FRAMES, _FIRST = 200, 8  # pictures looked at, and those of them that the others are compared with
_SPAN = 0.02  # [s]; over which the hand's velocity is taken
_RADIUS, _BEHIND, _TIPS = 0.06, 0.02, 0.06  # [m]; the body: about the axis, behind the flange, and
# how far from the tool point it ends
_EDGE = 0.01  # [m]; more of it in the pictures that the others are compared with
_POINTS, _FEWEST = 1000, 60  # of a picture
_REACH, _FAR = 0.015, 0.008  # [m]; of shifts; how far off a point may count
_BLOCKS = 8  # of pictures in a row that the jackknife leaves out

_Seen = tuple[Array, Array, Array, Array]  # the tool's pose, its velocity, points of the body


def check_clocks(folder: Path, arm: Arm) -> dict[str, tuple[float, float]]:
    """By how much each camera's clock is ahead of the robot's, and the standard deviation [s], also
    written into the folder's recording.json; cameras that do not show it are left out.

    Args:
        folder: A recording, as `gendom.perception.read_cameras` reads it, with joints.csv.
        arm: The robot.

    Raises:
        DeviceError: A clock is off by more than `MAX_OFFSET`.
        GendomError: The recording cannot be read.
    """
    states, wrong = read_joints(folder / "joints.csv", arm), []
    tool = tcp_pose(arm, states.q)
    every = read_cameras(folder, arm=arm).sources
    found = {s.camera.name: _slope(_seen(s, states.time, tool, arm)) for s in every}
    offsets = {name: offset for name, offset in found.items() if offset is not None}
    for name, (offset, sd) in offsets.items():
        if abs(offset) - 2.0 * sd > MAX_OFFSET:
            what = f"camera {name}: its clock is {1e3 * offset:+.0f} ms off the robot's"
            wrong.append(f"{what} (+- {1e3 * sd:.0f}), {1e3 * MAX_OFFSET:.0f} ms allowed")
    said = read_json(folder / "recording.json")
    said |= {"clocks": offsets, "ended": (*wrong, said["ended"])[0]}
    write_json(folder / "recording.json", said)
    fix = "let cameras use the computer's clock (Global Time), end other programs, lift again"
    require(not wrong, said["ended"], where=str(folder), fix=fix, error=DeviceError)
    return offsets


def _seen(source: FrameSource, time: Array, tool: Array, arm: Arm) -> list[_Seen]:
    """What one camera shows of a tool with poses [N, 4, 4] at times [N] of the robot's clock."""
    frames = [f for f in source if time[0] + _SPAN <= f.time <= time[-1] - _SPAN]
    frames = frames[:: len(frames) // _FRAMES + 1]
    camera, seen = source.camera, []
    rays = (camera.rays() @ camera.calibrated()[:3, :3].T).reshape(camera.height, camera.width, 3)
    for frame in frames:
        T = tool[np.abs(time - frame.time).argmin()].copy()
        moments = frame.time - _SPAN, frame.time, frame.time + _SPAN
        before, T[:3, 3], after = (interpolate(time, tool[:, :3, 3], moment) for moment in moments)
        seen.append((T, (after - before) / (2.0 * _SPAN), *_body(camera, rays, frame, T, arm)))
    return seen


def _body(camera: Camera, rays: Array, frame: Frame, T: Array, arm: Arm) -> tuple[Array, Array]:
    """[n, 3] what a picture shows of the gripper's body, in the tool's frame [m]: with `_EDGE` and
    without; rays of the pixels [height, width, 3] in the world's axes."""
    length = arm.T_flange_tcp[2, 3]
    x, y, z = placed(np.linalg.inv(camera.calibrated()), T[:3, 3] - 0.5 * length * T[:3, 2])
    u, v = (camera.K @ [x / z, y / z, 1.0])[:2]
    reach = camera.K[0, 0] * (length + _RADIUS) / max(z, 0.1)
    box = tuple(slice(max(int(at - reach), 0), max(int(at + reach), 0)) for at in (v, u))
    depth, rays = frame.read().depth[box], rays[box]
    points = rays[depth > 0] * (camera.depth_unit * depth[depth > 0][:, None].astype(float))
    points = placed(np.linalg.inv(T), points + camera.position)
    x, y, z = points.T
    beyond = np.maximum(np.hypot(x, y) - _RADIUS, np.maximum(z + _TIPS, -z - length - _BEHIND))
    return points[beyond < _EDGE], points[beyond < 0.0]


def _slope(seen: list[_Seen]) -> tuple[float, float] | None:
    """The clock's offset and its deviation [s]; None: it does not show."""
    seen = [one for one in seen if len(one[3]) >= _FEWEST]
    if len(seen) < 4 * _BLOCKS:
        return None
    velocities = np.array([v for _, v, _, _ in seen])
    along = np.linalg.svd(velocities, full_matrices=False)[2][0]
    # Whatever differs with the view has the other sign against the last pictures.
    ends = (seen[:_FIRST], seen[-_FIRST:])
    shift = np.mean([_shifts(seen, end, along) for end in ends], axis=0)
    v, way = velocities @ along, np.array([T[:3, 3] @ along for T, _, _, _ in seen])
    A = np.stack([v, np.ones_like(v), way - way.mean()], axis=1)
    if np.ptp(v) < 1e-3 or np.linalg.cond(A / np.linalg.norm(A, axis=0)) > 1e3:
        return None  # it stands, or never does
    block = np.arange(len(v)) * _BLOCKS // len(v)
    found = [np.linalg.lstsq(A[some], shift[some])[0][0]
             for some in (block >= 0, *(block != k for k in range(_BLOCKS)))]  # fmt: skip
    sd = np.sqrt((_BLOCKS - 1) * np.var(found[1:]))
    return -float(found[0]), float(sd)


def _shifts(seen: list[_Seen], known: list[_Seen], along: Array) -> Array:
    """[N] by how much the body is seen farther along a direction than in some pictures [m]."""
    tree, found = KDTree(np.concatenate([_few(wide) for _, _, wide, _ in known])), []
    for T, _, _, points in seen:
        points, way = _few(points), along @ T[:3, :3]

        def apart(by: float, points: Array = points, way: Array = way) -> float:
            far = tree.query(points - by * way, distance_upper_bound=_FAR)[0]
            return float(np.mean(np.minimum(far, _FAR) ** 2))

        best: Any = minimize_scalar(apart, bounds=(-_REACH, _REACH), options={"xatol": 2e-5})
        found.append(best.x)
    return np.array(found)


def _few(points: Array) -> Array:
    return points[:: len(points) // _POINTS + 1]
