"""What `gendom perceive` makes of scenes that are hard to segment: right, or refused.

Lifts of the MuJoCo test scene, six moments of each, with other tables and with other things in
view. A row says what share of the points is farther than 20 mm from the true object, in all frames
and in those that are kept, how many times the object's own area the clouds cover
(`gendom.perception.quality.times_own_area`), and how many frames are kept, or why none is.

    python -m experiments.segmentation DIR [--kinds plain hand ...] [--objects rope:0 cloth:3 ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.reality import FINER, finer
from experiments.lifts import draw_widely
from gendom.datasets.recording_form import parse_meta
from gendom.errors import GendomError
from gendom.perception import (
    Camera,
    CameraRecording,
    Frame,
    PerceptionSettings,
    Pictures,
    RobotPath,
    perceive,
)
from gendom.perception.quality import times_own_area
from gendom.perception.robot import arm_capsules
from gendom.reality import RealObject, RealRope, TrialRun, lift, lift_cameras
from gendom.reality.arm import RobotArm
from gendom.reality.sensor import observe
from gendom.reality.world import Reality
from gendom.robot import XARM7, JointStates

MOMENTS = 6
"""Pictures of a lift."""

FAR, MOST_FAR = 0.02, 0.05
"""Points farther than this from the true object [m] are wrong; the largest share of them that is
right."""

WHITE, RED, BEIGE, GREY = (235, 235, 230), (190, 45, 40), (205, 190, 160), (150, 150, 150)
SKIN = (215, 165, 135)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How a scene differs from a plain lift."""

    own: tuple[int, int, int] = RED
    """The object's colour."""
    table: tuple[int, int, int] = (158, 148, 133)
    """The table's colour."""
    things: str = ""
    """What else is in view, one of `THINGS`."""
    noise: float = 1.0
    """Of the cameras' disparity, over a D435i's; 0: exact."""
    away: float = 1.0
    """Distance of the cameras, in the usual one."""
    cameras: int = 2
    arm: bool = True
    """Whether the arm's joints are known."""
    good: bool = False
    """Whether a refusal is wrong."""


KINDS = {
    "plain": Kind(good=True),
    "noise twice": Kind(good=True, noise=2.0),
    "no noise": Kind(good=True, noise=0.0),
    "near cameras": Kind(good=True, away=0.7),
    "far cameras": Kind(good=True, away=1.5),
    "one camera": Kind(good=True, cameras=1),
    "white on white": Kind(own=WHITE, table=WHITE),
    "white on beige": Kind(own=WHITE, table=BEIGE),
    "white on grey": Kind(own=WHITE, table=GREY),
    "checks of its colour": Kind(things="checks"),
    "hand near": Kind(things="hand"),
    "white and a hand": Kind(own=WHITE, things="hand"),
    "hand touches": Kind(things="touching"),
    "cable beside": Kind(things="cable"),
    "cable of its colour": Kind(things="own cable"),
    "cable crosses": Kind(things="crossing"),
    "cup": Kind(things="cup"),
    "sheet of paper": Kind(own=WHITE, things="paper"),
    "arm unknown": Kind(arm=False),
}


def capsules(points: Any, radius: float, colour: tuple[int, int, int]) -> str:
    """A chain of them along points [n, 3] [m]."""
    points = np.asarray(points, dtype=float)
    rgba = " ".join(f"{c / 255:.3f}" for c in colour)
    return "".join(
        f'<geom type="capsule" fromto="{" ".join(map(str, [*a, *b]))}" size="{radius}"'
        f' rgba="{rgba} 1" contype="0" conaffinity="0"/>'
        for a, b in pairwise(points)
    )


def box(place: Any, size: Any, colour: tuple[int, int, int], form: str = "box") -> str:
    """One with half its sizes [m]."""
    rgba = " ".join(f"{c / 255:.3f}" for c in colour)
    return (
        f'<geom type="{form}" pos="{" ".join(map(str, place))}" size="{" ".join(map(str, size))}"'
        f' rgba="{rgba} 1" contype="0" conaffinity="0"/>'
    )


def things(kind: Kind, x: NDArray[np.float64]) -> str:
    """What else is in view, beside an object that begins with vertices [V, 3] [m]."""
    (x0, y0, _), (x1, y1, _) = x.min(axis=0), x.max(axis=0)
    own, size = kind.own, float(np.ptp(x[:, 0]))
    far = np.array([x1 + 0.03, 0.0, 0.07])
    hand = capsules([np.add(far, (0.03, 0.03, 0.0)), np.add(far, (0.1, 0.12, 0.03))], 0.035, SKIN)
    for k in range(4):
        finger = np.add(far, (0.02 * k - 0.02, 0.0, 0.0))
        hand += capsules([finger, np.add(finger, (-0.03, -0.04, -0.03))], 0.009, SKIN)
    if kind.things == "checks":
        edge, places = 0.025, np.mgrid[-6:7, -5:6].reshape(2, -1).T
        middle = [(x0 + x1) / 2.0, (y0 + y1) / 2.0]
        tiles = [middle + 2.0 * edge * np.add(p, (0.5 * (p[1] % 2), 0.0)) for p in places]
        return "".join(box([*t, 0.0001], [edge / 2, edge / 2, 1e-4], own) for t in tiles)
    if kind.things in ("hand", "touching"):
        if kind.things == "hand":
            return f'<body pos="0 0.08 0">{hand}</body>'
        return f'<body pos="-0.05 0 -0.02">{hand}</body>'
    if kind.things in ("cable", "own cable"):
        at = np.linspace(x0 - 0.1, x1 + 0.1, 12)
        line = np.stack([at, y1 + 0.1 + 0.02 * np.sin(20 * at), 0 * at + 0.006], axis=1)
        return capsules(line, 0.005, own if kind.things == "own cable" else (30, 30, 30))
    if kind.things == "crossing":
        at = np.linspace(-0.2, 0.2, 12)
        middle = x0 + 0.6 * size
        return capsules(np.stack([middle + 0.2 * at, at, 0 * at + 0.006], axis=1), 0.005, own)
    if kind.things == "cup":
        return box([x1, y1 + 0.12, 0.05], [0.04, 0.05], (60, 90, 200), "cylinder")
    if kind.things == "paper":
        return box([(x0 + x1) / 2, (y0 + y1) / 2, 1e-4], [0.148, 0.105, 1e-4], (240, 240, 240))
    return ""


class Crowded(RobotArm):
    """The arm, and other things."""

    others = ""

    def xml(self) -> str:
        return super().xml() + self.others


@dataclass(frozen=True, kw_only=True)
class Lifted:
    """An object's lift without cameras: states at moments, of which a scene is rendered."""

    item: RealObject
    run: TrialRun
    time: NDArray[np.float64]
    qpos: NDArray[np.float64]
    hand: NDArray[np.float64]
    axis: NDArray[np.float64]
    joints: NDArray[np.float64]
    vertices: NDArray[np.float64]


def lifted(name: str, folder: Path) -> Lifted:
    """The lift of a drawn object KIND:SEED; its states are kept in a folder."""
    kind, seed = name.split(":")
    item = draw_widely(kind, int(seed))
    trial = lift(item)
    run = TrialRun(replace(trial, timestep=0.001 if item.kind == "rope" else None))
    path = folder / f"{kind}-{seed}.npz"
    if not path.exists():
        world, rows = run.world, []
        run.step_to(run.closes)
        for time in np.linspace(run.closes, run.end, MOMENTS):
            run.step_to(float(time))
            state = world.data.qpos.copy(), world.hand, world.hand_axis
            rows.append((time, *state, world.robot.measured(world.data), world.vertices()))
        names = ("time", "qpos", "hand", "axis", "joints", "vertices")
        columns = map(np.array, zip(*rows, strict=True))
        states: dict[str, Any] = dict(zip(names, columns, strict=True))
        np.savez(path, **states)
    with np.load(path) as stored:
        return Lifted(item=item, run=run, **{key: stored[key] for key in stored.files})


class Rendered:
    """One camera's pictures, which are kept."""

    def __init__(self, camera: Camera):
        self.camera = camera
        self.pictures: list[tuple[float, Pictures]] = []

    def __iter__(self) -> Iterator[Frame]:
        for time, seen in self.pictures:
            yield Frame(time, f"{self.camera.name} at {time:g} s", lambda seen=seen: seen)


def scene(found: Lifted, kind: Kind, seed: int = 0) -> CameraRecording:
    """What the cameras see of a lift in a scene of a kind."""
    item = replace(found.item, colour=kind.own)
    cameras = [
        camera.at(moved_away(camera.calibrated(), kind.away))
        for camera in lift_cameras(item)[: kind.cameras]
    ]
    assert found.run.motion is not None
    arm = Crowded(XARM7, found.run.motion, opening=thickness(item))
    arm.others = things(kind, found.vertices[0])
    world = Reality(item, found.run.trial.layout, robot=arm, cameras=cameras)
    world.model.geom("table").rgba[:3] = np.array(kind.table) / 255.0
    sources, rng = [Rendered(camera) for camera in cameras], np.random.default_rng(seed)
    with world:
        for time, qpos in zip(found.time, found.qpos, strict=True):
            world.data.qpos[:] = qpos
            world._update_positions()
            for k, source in enumerate(sources):
                seen = observe(
                    *world.render(k), source.camera, rng,
                    noisy=kind.noise > 0.0, times=kind.noise,
                )  # fmt: skip
                source.pictures.append((float(time), seen))
    trial = found.run.trial
    described = {**item.description(), "grasp": trial.grasp}
    states = JointStates(found.time, found.joints)
    return CameraRecording(
        [*sources],
        RobotPath(found.time, found.hand[:, None], found.axis[:, None]),
        {"object": described, "table_height": 0.0, "gripper_source": "measured"},
        arm_capsules(XARM7, states, held=thickness(item)) if kind.arm else None,
        where="scene",
    )


def moved_away(T: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """A camera's pose [4, 4], so many times as far from a point 0.8 m in front of it."""
    T = T.copy()
    T[:3, 3] += 0.8 * (1.0 - factor) * T[:3, 2]
    return T


def thickness(item: RealObject) -> float:
    return 2.0 * item.radius


def away(item: RealObject, vertices: NDArray[np.float64], points: Any) -> NDArray[np.float64]:
    """[n] how far points are from the object's surface [m]."""
    if isinstance(item, RealRope):
        shape = finer(vertices, 4 * FINER)
    else:
        grid = finer(vertices.reshape(*item.counts, 3), 4)
        shape = finer(np.swapaxes(grid, 0, 1), 4).reshape(-1, 3)
    return np.abs(KDTree(shape).query(points)[0] - item.radius)


def measured(found: Lifted, recorded: CameraRecording, kind: Kind, colour: bool) -> dict[str, Any]:
    """A row of the table."""
    seen: list[tuple[float, NDArray[np.floating]]] = []
    warned: list[str] = []
    row: dict[str, Any] = {"colour": colour, "warned": warned, "said": ""}
    try:
        perceived = perceive(
            recorded,
            PerceptionSettings(colour=kind.own if colour else None),
            on_warning=lambda fault: warned.append(str(fault)),
            on_frame=lambda time, cloud: seen.append((time, cloud.points)),
        )
        recording = perceived.recording
        kept = set(recording.time.tolist())
        row |= {"share": perceived.seen_share, "apart": perceived.disagreement}
    except GendomError as error:
        row["said"], kept = str(error), set()
    held = parse_meta(recorded.meta)[0]["object"]
    row |= {"area": [], "far": [], "points": [], "kept": [time in kept for time, _ in seen]}
    for time, points in seen:
        off = away(found.item, found.vertices[np.searchsorted(found.time, time)], points)
        row["area"].append(times_own_area(points, held))
        row["points"].append(len(points))
        row["far"].append(int((off > FAR).sum()))
    return row


def right(row: dict[str, Any]) -> bool:
    """Whether there is a recording of which nearly all points are the object's."""
    kept = np.array(row["kept"], bool)
    points, far = (np.array(row[key])[kept].sum() for key in ("points", "far"))
    return not row["said"] and bool(far <= MOST_FAR * points)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--objects", nargs="*", default=["rope:3", "rope:5", "thin:2", "cloth:1"])
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    for kind in args.kinds:
        for name in args.objects:
            found = lifted(name, args.folder)
            recorded = scene(found, KINDS[kind])
            for colour in (False, True):
                row = measured(found, recorded, KINDS[kind], colour)
                print(shown(f"{kind}, {name}, {'colour' if colour else 'height'}", row), flush=True)


def shown(name: str, row: dict[str, Any]) -> str:
    """A row of the table in words."""
    points, far = np.array(row["points"]), np.array(row["far"])
    kept = np.array(row["kept"], bool)
    said = (
        row["said"] or f"{kept.sum()} of {len(kept)} frames, {'right' if right(row) else 'WRONG'}"
    )
    share = 100.0 * far.sum() / max(points.sum(), 1)
    own = 100.0 * far[kept].sum() / max(points[kept].sum(), 1)
    area = float(np.median(row["area"])) if row["area"] else 0.0
    return f"{name:40}{share:8.1f} %{own:8.1f} %{area:8.2f}  {said}"


if __name__ == "__main__":
    main()
