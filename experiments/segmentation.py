"""What `gendom perceive` makes of scenes that nobody chose: right, refused, or wrong.

Lifts of the MuJoCo test scene, six moments of each. Object, its colour, table, light, cameras,
noise and what else is in view are drawn from the scene's number. Points farther than 20 mm from the
true object are wrong; right is at most 5 % of them in the frames that are kept.

    python -m experiments.segmentation DIR [--first 0] [--scenes 60] [--jobs 1]
"""

from __future__ import annotations

import argparse
import colorsys
import multiprocessing
from collections import Counter
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
from gendom.perception.robot import arm_capsules
from gendom.reality import RealObject, RealRope, TrialRun, lift, lift_cameras
from gendom.reality.arm import RobotArm
from gendom.reality.objects import description
from gendom.reality.sensor import observe
from gendom.reality.world import Reality
from gendom.robot import XARM7, JointStates

MOMENTS = 6
"""Pictures of a lift."""

FAR, MOST_FAR = 0.02, 0.05
"""Points farther than this from the true object [m] are wrong; the largest share of them that is
right."""

Colour = tuple[int, int, int]

TABLES: tuple[Colour, ...] = (
    (235, 235, 230), (205, 190, 160), (150, 150, 150), (60, 60, 62), (158, 148, 133),
    (140, 95, 60), (70, 110, 160), (90, 140, 90),
)  # fmt: skip
SKINS: tuple[Colour, ...] = ((240, 205, 180), (215, 165, 135), (165, 115, 85), (95, 65, 50))
THINGS = ("", "", "hand", "touching", "cable", "own cable", "crossing", "cup", "paper", "checks")
"""What else is in view, as often as it stands here."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A scene that was drawn."""

    item: str
    own: Colour
    table: Colour
    things: str
    skin: Colour
    shift: NDArray[np.float64]
    """[2] of what else is in view, beside its usual place [m]."""
    light: float
    """In the usual light."""
    noise: float
    """Of the cameras' disparity, over a D435i's."""
    away: float
    """Distance of the cameras, in the usual one."""
    arm: bool
    """Whether the arm's joints are known."""


def draw(number: int) -> Drawn:
    """The scene of a number."""
    rng = np.random.default_rng([20_261_126, number])
    kind = ("rope", "rope", "thin", "cloth")[rng.integers(4)]
    hue, full = rng.uniform(), rng.uniform(0.55, 0.95) * (rng.uniform() < 0.6)
    own = colorsys.hsv_to_rgb(hue, full, rng.uniform(0.15 if full == 0.0 else 0.5, 0.95))
    return Drawn(
        item=f"{kind}:{rng.integers(100, 1000)}",
        own=(round(255 * own[0]), round(255 * own[1]), round(255 * own[2])),
        table=TABLES[rng.integers(len(TABLES))],
        things=THINGS[rng.integers(len(THINGS))],
        skin=SKINS[rng.integers(len(SKINS))],
        shift=rng.uniform(-0.02, 0.03, 2),
        light=float(rng.uniform(0.5, 1.4)),
        noise=float(rng.uniform(0.7, 1.5)),
        away=float(rng.uniform(0.75, 1.3)),
        arm=bool(rng.uniform() < 0.85),
    )


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


def things(kind: Drawn, x: NDArray[np.float64]) -> str:
    """What else is in view, beside an object that begins with vertices [V, 3] [m]."""
    (x0, y0, _), (x1, y1) = x.min(axis=0), x.max(axis=0)[:2] + kind.shift
    own, size = kind.own, float(np.ptp(x[:, 0]))
    far = np.array([x1 + 0.03, 0.0, 0.07])
    hand = capsules(
        [np.add(far, (0.03, 0.03, 0.0)), np.add(far, (0.1, 0.12, 0.03))], 0.035, kind.skin
    )
    for k in range(4):
        finger = np.add(far, (0.02 * k - 0.02, 0.0, 0.0))
        hand += capsules([finger, np.add(finger, (-0.03, -0.04, -0.03))], 0.009, kind.skin)
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


def scene(found: Lifted, kind: Drawn, seed: int = 0) -> CameraRecording:
    """What the cameras see of a lift in a drawn scene."""
    item = replace(found.item, colour=kind.own)
    cameras = [
        camera.at(moved_away(camera.calibrated(), kind.away)) for camera in lift_cameras(item)
    ]
    assert found.run.motion is not None
    arm = Crowded(XARM7, found.run.motion, opening=thickness(item))
    arm.others = things(kind, found.vertices[0])
    world = Reality(item, found.run.trial.layout, robot=arm, cameras=cameras)
    world.model.geom("table").rgba[:3] = np.array(kind.table) / 255.0
    world.model.light_diffuse[:] *= kind.light
    world.model.vis.headlight.ambient[:] *= kind.light
    world.model.vis.headlight.diffuse[:] *= kind.light
    sources, rng = [Rendered(camera) for camera in cameras], np.random.default_rng(seed)
    with world:
        for time, qpos in zip(found.time, found.qpos, strict=True):
            world.data.qpos[:] = qpos
            world._update_positions()
            for k, source in enumerate(sources):
                seen = observe(
                    *world.render(k), source.camera, rng,
                    noisy=True, times=kind.noise,
                )  # fmt: skip
                source.pictures.append((float(time), seen))
    trial = found.run.trial
    described = {**description(item), "grasp": trial.grasp}
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
        grid = finer(vertices.reshape(item.vertices, item.vertices, 3), 4)
        shape = finer(np.swapaxes(grid, 0, 1), 4).reshape(-1, 3)
    return np.abs(KDTree(shape).query(points)[0] - item.radius)


def judged(number: int, folder: Path) -> list[tuple[str, str, str, str]]:
    """What is in view, how it was looked for, the outcome and what is said of a scene's number."""
    kind, rows = draw(number), []
    found = lifted(kind.item, folder)
    recorded = scene(found, kind, number)
    for chosen in (None, kind.own):
        settings = PerceptionSettings(colour=chosen)
        try:
            perceived = perceive(recorded, settings)
        except GendomError as error:
            outcome, said = "refused", str(error)
        else:
            recording = perceived.recording
            off = [
                away(found.item, found.vertices[np.searchsorted(found.time, time)], points)
                for time, points in zip(recording.time, recording.frames(), strict=True)
            ]
            far = float((np.concatenate(off) > FAR).mean())
            outcome = "right" if far <= MOST_FAR else "wrong"
            said = f"{100 * far:.1f} % of {recording.num_frames} frames, "
            said += f"{100 * perceived.seen_share:.0f} % of it seen"
        beside = kind.things or ("nothing" if kind.arm else "the arm")
        rows.append((beside, "height" if chosen is None else "colour", outcome, said))
    return rows


def _judged(job: tuple[int, Path]) -> tuple[int, list[tuple[str, str, str, str]]]:
    return job[0], judged(*job)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    jobs = [(number, args.folder) for number in range(args.first, args.first + args.scenes)]
    counts: Counter[tuple[str, str, str]] = Counter()
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for number, rows in pool.imap_unordered(_judged, jobs):
            for beside, by, outcome, said in rows:
                counts[beside, by, outcome] += 1
                print(f"{number:4} {beside:10} {by:7} {outcome:8} {said}", flush=True)
    print(f"{'beside':12}{'by':8}{'right':>8}{'refused':>8}{'wrong':>8}")
    for beside, by in sorted({key[:2] for key in counts}):
        found = (counts[beside, by, outcome] for outcome in ("right", "refused", "wrong"))
        print(f"{beside:12}{by:8}" + "".join(f"{n:8}" for n in found))


if __name__ == "__main__":
    main()
