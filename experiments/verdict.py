"""What estimates say of lifts of random objects, as recorded and corrupted in many ways.

Corrupted are units, sizes, frames, the gripper and the clouds. An estimate must refuse such a
recording, or be right all the same: some faults do no harm to what is estimated. Right: usable, and
the truth lies in the intervals of E and E / density, or within 10 % of them.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.lifts import Lifts, estimate_settings, truth_of
from experiments.runs import Result, Runs, Table
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.estimation import estimate

Array = NDArray[np.floating]

Corruption = Callable[[Recording], Recording]


def clouds_of(recording: Recording, clouds: list[Array]) -> Recording:
    """The recording with these clouds."""
    return replace(
        recording,
        points=np.concatenate([np.zeros((0, 3)), *clouds]),
        offsets=np.cumsum([0, *map(len, clouds)]),
        seen_by=None,
    )


def _time(factor: float) -> Corruption:
    return lambda r: replace(r, time=r.time[0] + factor * (r.time - r.time[0]))


def _described(**factors: float) -> Corruption:
    """Sizes or mass times these factors, where they are stated."""

    def corrupt(r: Recording) -> Recording:
        own = {n: getattr(r.object, n) for n in factors}
        changed = {n: f * own[n] for n, f in factors.items() if own[n] is not None}
        return replace(r, object=replace(r.object, **changed))

    return corrupt


def _size(factor: float) -> Corruption:
    return _described(length=factor, width=factor, height=factor)


def _thick(factor: float) -> Corruption:
    return _described(diameter=factor, thickness=factor)


def _away(r: Recording) -> tuple[Array, Array]:
    """Level unit vectors from the gripper along the object at rest, and to the left of that."""
    lying = r.frame(int(np.argmax(r.frame_valid)))[:, :2].mean(axis=0)
    along = lying - r.gripper_position[0, 0, :2]
    along = along / np.linalg.norm(along)
    return np.array([*along, 0.0]), np.array([-along[1], along[0], 0.0])


def _gripper_moved(along: float = 0.0, aside: float = 0.0, up: float = 0.0) -> Corruption:
    """Stated so far from where it is [m]."""

    def corrupt(r: Recording) -> Recording:
        a, b = _away(r)
        by = along * a + aside * b + np.array([0.0, 0.0, up])
        return replace(r, gripper_position=r.gripper_position + by)

    return corrupt


def _swapped(*axes: int) -> Corruption:
    return lambda r: replace(
        r,
        points=r.points[:, axes],
        gripper_position=r.gripper_position[..., axes],
        gripper_axis=None if r.gripper_axis is None else r.gripper_axis[..., axes],
    )


def _points(change: Callable[[Array, Recording], Array]) -> Corruption:
    return lambda r: replace(r, points=change(r.points.astype(float), r))


def _about_first(path: Array, factor: float) -> Array:
    return path[:1] + factor * (path - path[:1])


def _grown(points: Array, r: Recording) -> Array:
    centre = points.mean(axis=0)
    return centre + 1.1 * (points - centre)


def _mirrored(points: Array, r: Recording) -> Array:
    """As by cameras of which one axis is wrong."""
    return points * [1.0, -1.0, 1.0]


def _through_lens(factor: float) -> Corruption:
    """Clouds of a camera whose focal length is stated wrongly, seen from its place or, where that
    is unknown, from a metre away."""

    def change(points: Array, r: Recording) -> Array:
        centre = points.mean(axis=0)
        if r.camera_positions is not None:
            eye = r.camera_positions[0].astype(float)
        else:
            eye = centre + np.array([0.7, 0.0, 0.7])
        axis = (centre - eye) / np.linalg.norm(centre - eye)
        ray = points - eye
        depth = ray @ axis
        return eye + depth[:, None] * axis + factor * (ray - depth[:, None] * axis)

    return _points(change)


def _uniform(points: Array, r: Recording) -> Array:
    low, high = points.min(axis=0), points.max(axis=0)
    return np.random.default_rng(0).uniform(low, high, size=points.shape)


def _table(points: Array, r: Recording) -> Array:
    """The table's points in place of the object's."""
    low, high = points.min(axis=0), points.max(axis=0)
    drawn = np.random.default_rng(0).uniform(low, high, size=points.shape)
    height = points[:, 2].min() if r.table_height is None else r.table_height
    drawn[:, 2] = height + 0.002 * np.random.default_rng(1).standard_normal(len(drawn))
    return drawn


def _outliers(share: float) -> Corruption:
    def change(points: Array, r: Recording) -> Array:
        rng = np.random.default_rng(0)
        return np.where(rng.random(len(points))[:, None] < share, _uniform(points, r), points)

    return _points(change)


def _cut(r: Recording) -> Recording:
    """Only what lies on one side of the object's middle at rest is seen."""
    along, _ = _away(r)
    middle = float(np.median(r.frame(0) @ along))
    kept = [c[c @ along < middle] for c in r.frames()]
    return clouds_of(r, kept)


def _still(r: Recording) -> Recording:
    first = r.frame(int(np.argmax(r.frame_valid)))
    held = np.repeat(r.gripper_position[:1], r.num_frames, axis=0)
    return replace(clouds_of(r, [first] * r.num_frames), gripper_position=held)


def _still_cloud(r: Recording) -> Recording:
    """A camera that froze."""
    return clouds_of(r, [r.frame(int(np.argmax(r.frame_valid)))] * r.num_frames)


def _late(frames: float) -> Corruption:
    def corrupt(r: Recording) -> Recording:
        by = round(frames * r.num_frames)
        return clouds_of(r, [r.frame(max(0, t - by)) for t in range(r.num_frames)])

    return corrupt


CORRUPTED: dict[str, Corruption] = {
    "time in milliseconds": _time(1e3),
    "frame numbers as time": lambda r: replace(r, time=np.arange(r.num_frames, dtype=float)),
    "time x 10": _time(10.0),
    "time x 3": _time(3.0),
    "time / 3": _time(1 / 3.0),
    "time / 10": _time(0.1),
    "time in minutes": _time(1 / 60.0),
    "mass in grams": _described(mass=1e3),
    "mass x 10": _described(mass=10.0),
    "mass / 10": _described(mass=0.1),
    "mass / 1000": _described(mass=1e-3),
    "size x 10": _size(10.0),
    "size x 2": _size(2.0),
    "size x 1.25": _size(1.25),
    "size x 1.1": _size(1.1),
    "size / 1.1": _size(1 / 1.1),
    "size / 1.25": _size(0.8),
    "size / 2": _size(0.5),
    "thickness x 10": _thick(10.0),
    "thickness x 2": _thick(2.0),
    "thickness / 2": _thick(0.5),
    "thickness / 10": _thick(0.1),
    "gripper 2 cm aside": _gripper_moved(aside=0.02),
    "gripper 5 cm aside": _gripper_moved(aside=0.05),
    "gripper 2 cm along": _gripper_moved(along=0.02),
    "gripper 5 cm along": _gripper_moved(along=0.05),
    "gripper 2 cm back": _gripper_moved(along=-0.02),
    "gripper 5 cm back": _gripper_moved(along=-0.05),
    "gripper 5 cm up": _gripper_moved(up=0.05),
    "gripper's path reversed": lambda r: replace(r, gripper_position=r.gripper_position[::-1]),
    "gripper's path x 0.7": lambda r: replace(
        r, gripper_position=_about_first(r.gripper_position, 0.7)
    ),
    "y up": _swapped(0, 2, 1),
    "x up": _swapped(2, 1, 0),
    "z down": _points(lambda p, r: p * [1.0, 1.0, -1.0]),
    "clouds mirrored": _points(_mirrored),
    "clouds x 1.43": _points(lambda p, r: 1.43 * p),
    "clouds x 1.1 about their middle": _points(_grown),
    "focal length / 1.2": _through_lens(1.2),
    "focal length x 1.2": _through_lens(1 / 1.2),
    "uniform noise": _points(_uniform),
    "the table's points": _points(_table),
    "30 % outliers": _outliers(0.3),
    "half of the object": _cut,
    "one frame": lambda r: r.head(1),
    "nothing moves": _still,
    "clouds stand still": _still_cloud,
    "clouds a tenth late": _late(0.1),
    "clouds a third late": _late(0.34),
}
"""By name."""

GOOD = "as recorded"

CLOSE_ENOUGH = 0.1
"""Largest relative error of E, and of E / density, of an estimate that is right although its
intervals miss the truth."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Of each lift, by `GOOD` and names of `CORRUPTED`, what an estimate said."""
    lifts = Lifts.of(flags)
    seeds = range(flags.seed, flags.seed + flags.lifts)
    for _ in runs.each(partial(lifts.recorded, runs), seeds, "lifting"):
        pass
    cases = [(seed, case) for seed in seeds for case in (GOOD, *CORRUPTED)]
    said = zip(cases, runs.each(partial(_judged, runs, lifts), cases, "judging"), strict=True)
    rows: dict[int, dict[str, dict[str, Any]]] = {seed: {} for seed in seeds}
    for (seed, case), answer in said:
        rows[seed][case] = answer
    wrong = [
        f"  seed {seed}, {case}: E x {answer['ratios']['E']:.2f}"
        for seed, row in rows.items()
        for case, answer in row.items()
        if is_wrong(answer)
    ]
    found = list(rows.values())
    own = [sum(map(is_wrong, row.values())) * is_wrong(row[GOOD]) for row in found]
    settings = {**asdict(lifts), "lifts": flags.lifts}
    return Result(
        name=f"verdict-{lifts.name}",
        figures={
            **settings,
            "wrong": len(wrong),
            "wrong_as_recorded": sum(own),
            "cases": confusion(found),
            "rows": found,
        },
        shown=[confusion_table(found)],
        notes=[
            f"{len(wrong)} of {len(cases)} are usable and wrong, {sum(own)} of them of the "
            f"{sum(map(bool, own))} lifts whose estimate is wrong as recorded, too",
            *wrong,
        ],
    )


def is_wrong(answer: dict[str, Any]) -> bool:
    """Whether an estimate is usable and not right."""
    return answer["usable"] and not answer["right"]


def _judged(runs: Runs, lifts: Lifts, which: tuple[int, str]) -> dict[str, Any]:
    seed, case = which
    name = re.sub(r"\W+", "-", f"verdict-{lifts.name}-{seed:04d}-{case}")
    return runs.kept(name, lambda: _case(lifts.recorded(runs, seed), case, lifts, seed))


def _case(recording: Recording, case: str, lifts: Lifts, seed: int) -> dict[str, Any]:
    item = lifts.object(seed)
    truth = {name: truth_of(item)[name] for name in ("E_over_rho", "E")}
    try:
        if case != GOOD:
            recording = CORRUPTED[case](recording)
        found = estimate(recording, estimate_settings(seed))
    except GendomError as error:
        return {"usable": False, "reasons": [str(error)]}
    if not found.usable:
        return {"usable": False, "reasons": list(found.verdict.reasons)}
    ratios = {name: found.record[name] / value for name, value in truth.items()}
    inside = [
        low <= value <= high
        for name, value in truth.items()
        if (ends := found.interval(name)) is not None
        for low, high in [ends]
    ]
    near = max(abs(ratio - 1.0) for ratio in ratios.values()) < CLOSE_ENOUGH
    return {"usable": True, "right": near or all(inside), "ratios": ratios}


def confusion(rows: Sequence[dict[str, dict[str, Any]]]) -> dict[str, dict[str, int]]:
    """By case how many lifts were refused, are usable and right, and usable and wrong."""
    table = {}
    for case in (GOOD, *CORRUPTED):
        of_case = [row[case] for row in rows]
        usable = [r for r in of_case if r["usable"]]
        right = sum(r["right"] for r in usable)
        table[case] = {
            "refused": len(of_case) - len(usable),
            "right": right,
            "wrong": len(usable) - right,
        }
    return table


def confusion_table(rows: Sequence[dict[str, dict[str, Any]]]) -> Table:
    """The table of `confusion`, with the worst ratio of E to the truth of those that are wrong."""
    found = {}
    for case, counts in confusion(rows).items():
        off = [row[case]["ratios"]["E"] for row in rows if is_wrong(row[case])]
        worst = max(off, key=lambda ratio: abs(math.log(ratio)), default=None)
        found[case] = (*map(str, counts.values()), "" if worst is None else f"{worst:.2g}")
    return Table(
        title=f"{len(rows)} lifts",
        head=("refused", "usable, right", "usable, wrong", "E / true E at worst"),
        rows=found,
    )
