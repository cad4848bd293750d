"""Checks of the content of a recording.

Types and shapes of its arrays are checked in `gendom.datasets.recording`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import KDTree

from gendom.errors import one_line

if TYPE_CHECKING:
    from gendom.datasets.recording import Recording
    from gendom.datasets.recording_form import ObjectDescription

KINDS = ("rope", "cloth")
GRASPS = ("end", "corner", "center", "both ends")
GRIPPER_SOURCES = ("commanded", "measured")
NEEDED_SIZES = {"rope": ("length",), "cloth": ("width", "height")}
SIZES = (
    "length",
    "diameter",
    "width",
    "height",
    "thickness",
    "mass",
    "grasp_radius",
    "grasp_inset",
)

MAX_GRASP_DISTANCE = 0.15
"""A gripper farther than this from every point in every frame [m] does not hold the object."""
_MAX_EXTENT = 20.0  # [m]; larger clouds are not in metres
_MIN_TRAVEL = 1e-3  # [m]


@dataclass(frozen=True)
class Fault:
    """One fault of a recording; `str()` gives it in one line."""

    what: str
    where: str
    """The key, and the frame if there is one."""
    fix: str
    """How to correct it."""
    severity: str = "error"
    """"error" (the recording cannot be used) or "warning"."""

    def __str__(self) -> str:
        return one_line(self.what, where=self.where, fix=self.fix)


def check(recording: Recording) -> list[Fault]:
    """Check the content and return all faults, errors before warnings."""
    faults = [*_check_object(recording.object), *_check_fields(recording)]
    number_faults = [*_check_numbers(recording), *_check_time(recording)]
    faults += number_faults
    if not number_faults:
        faults += _check_frames(recording)
        for look in (_check_units, _check_other_units, _check_motion, _check_grippers):
            found = look(recording)
            faults += found
            if any(fault.severity == "error" for fault in found):
                break
    return sorted(faults, key=lambda fault: fault.severity)


MAX_DENSITY = 12e3
"""Upper bound on the density of ropes and cloths, that of lead [kg/m^3]."""
MIN_DENSITY = {"rope": 120.0, "cloth": 30.0}
"""Lower bounds [kg/m^3]: a quarter and a half of the lightest of the materials' catalogue."""
USUAL_SPEED = (5e-4, 2.0)
"""Slowest and fastest usual speed of a gripper [m/s]: arms move at 1 m/s at most, hands
that shake a cable at 0.6 to 1 m/s."""
NUMBERED = 10
"""From so many frames on, times that are whole seconds one after another are frame numbers."""
FEWEST_FRAMES = 4
"""With points, of a motion that tells something."""
_THICKEST = {"rope": 0.1, "cloth": 0.02}  # of the size, where the thickness is unknown
_USUAL_DENSITY = (200.0, 3000.0)  # [kg/m^3]
_MAX_STEP = 10.0  # [s] between frames
_TIMES = (  # frames less far apart than so many seconds, their unit, and what brings seconds
    (5e3, "milliseconds", "1000"),
    (5e6, "microseconds", "1e6"),
    (math.inf, "nanoseconds", "1e9"),
)
_MAX_BELOW = 5.0  # [m] that a table lies from the object
_MAX_AWAY = 50.0  # [m] that a camera stands from it


def _check_object(description: ObjectDescription) -> list[Fault]:
    faults = []
    if description.kind not in KINDS:
        faults.append(
            Fault(
                f"is {description.kind!r}", "object.kind", f"give {' or '.join(map(repr, KINDS))}"
            )
        )
    if description.grasp not in GRASPS:
        faults.append(
            Fault(
                f"is {description.grasp!r}",
                "object.grasp",
                f"give one of {', '.join(map(repr, GRASPS))}",
            )
        )
    if "outline" in description.extra:
        faults.append(
            Fault(
                "is not supported: cloths of recordings are rectangles",
                "object.outline",
                "leave it out if the cloth is a rectangle",
            )
        )
    for name in SIZES:
        value = getattr(description, name)
        unit = "kg" if name == "mass" else "metres"
        if value is None:
            if name in NEEDED_SIZES.get(description.kind, ()):
                faults.append(
                    Fault(
                        f"is missing for a {description.kind}",
                        f"object.{name}",
                        f"measure it and give {unit}",
                    )
                )
        elif not (math.isfinite(value) and value > 0.0):
            faults.append(
                Fault(f"is {value}", f"object.{name}", f"give {unit} above 0, or null if unknown")
            )
    return faults


def _check_fields(recording: Recording) -> list[Fault]:
    faults = []
    height = recording.table_height
    if height is not None and not math.isfinite(height):
        faults.append(
            Fault(f"is {height}", "table_height", "give metres, or null where there is no table")
        )
    if recording.gripper_source not in GRIPPER_SOURCES:
        faults.append(
            Fault(
                f"is {recording.gripper_source!r}",
                "gripper_source",
                "give 'commanded' or 'measured'",
            )
        )
    return faults


def _check_numbers(recording: Recording) -> list[Fault]:
    """NaN and infinity anywhere, and the length of the axes."""
    faults = []
    bad_points = ~np.isfinite(recording.points).all(axis=1)
    if bad_points.any():
        frame_of = np.repeat(np.arange(recording.num_frames), np.diff(recording.offsets))
        frames, counts = np.unique(frame_of[bad_points], return_counts=True)
        faults.append(
            Fault(
                f"{counts[0]} of {len(recording.frame(int(frames[0])))} points are not finite"
                + (
                    f", and {counts[1:].sum()} in {len(frames) - 1} more" if len(frames) > 1 else ""
                ),
                f"points, frame {frames[0]}",
                "drop points without depth before writing",
            )
        )
    for name in ("time", "gripper_position", "gripper_axis", "camera_positions"):
        array = getattr(recording, name)
        if array is None:
            continue
        bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
        if bad.any():
            label = "camera" if name == "camera_positions" else "frame"
            faults.append(
                Fault(
                    f"is not finite in {bad.sum()} of {len(bad)} {label}s",
                    f"{name}, {label} {int(np.argmax(bad))}",
                    "give numbers, or cut those frames" if label == "frame" else "give numbers",
                )
            )
        elif name == "gripper_axis":
            length = np.linalg.norm(array, axis=2)
            off = (np.abs(length - 1.0) > 0.01).any(axis=1)
            if off.any():
                t = int(np.argmax(off))
                worst = length[t][np.argmax(np.abs(length[t] - 1.0))]
                faults.append(
                    Fault(
                        f"has length {worst:.3g}, not 1",
                        f"gripper_axis, frame {t}",
                        "give unit vectors, or leave it out",
                    )
                )
    return faults


def _check_time(recording: Recording) -> list[Fault]:
    step = np.diff(recording.time)
    if not np.isfinite(recording.time).all() or (step > 0).all():
        return []
    t = int(np.argmax(step <= 0)) + 1
    return [
        Fault(
            f"goes from {recording.time[t - 1]:.6g} s to {recording.time[t]:.6g} s",
            f"time, frame {t}",
            "sort the frames and drop repeated ones; each must be later than the one before",
        )
    ]


def _check_frames(recording: Recording) -> list[Fault]:
    """Frames without points."""
    valid = recording.frame_valid
    if valid.all():
        return []
    if not valid.any():
        return [Fault("all frames are empty", "points", "check the cropping and the depth range")]
    early = max(3, math.ceil(0.1 * len(valid)))
    if not valid[:early].any():
        return [
            Fault(
                f"the first {int(np.argmax(valid))} frames are empty, so the start is not seen",
                "points, frame 0",
                "cut them off, or record from before the lift",
            )
        ]
    empty = np.flatnonzero(~valid)
    listed = ", ".join(map(str, empty[:8])) + (", ..." if len(empty) > 8 else "")
    return [
        Fault(
            f"{len(empty)} of {len(valid)} frames are empty ({listed})",
            "points",
            "nothing need be done: they are skipped",
            "warning",
        )
    ]


_LENGTHS = {"centimetres": 100.0, "millimetres": 1000.0}
"""Units in which lengths may be given by mistake, and their number in a metre."""
_USUAL_EXTENT = (0.1, 2.0)
"""Usual lengths of objects that robots handle [m]."""


def _meant(value: float, usual: tuple[float, float]) -> str:
    """Name the units in which a too large length would be usual, and the conversion to metres.

    Args:
        value: The length as given.
        usual: Lowest and highest usual length [m].
    """
    low, high = usual
    units = [u for u, of_metre in _LENGTHS.items() if low <= value / of_metre <= high]
    return _divide(units or list(_LENGTHS))


def _nearest_unit(distance: Callable[[Recording, float], float], recording: Recording) -> str:
    """Name the unit in which something would be nearest to the points, and its conversion.

    Args:
        distance: Function of a recording and the number of units in a metre; gives a distance [m].
        recording: Its points are in metres.
    """
    return _divide([min(_LENGTHS, key=lambda unit: distance(recording, _LENGTHS[unit]))])


def _gripper_distance(recording: Recording, of_metre: float) -> float:
    """Initial distance between points and a gripper whose position is in another unit [m]."""
    start = recording.frame(int(np.argmax(recording.frame_valid)))
    away = start[None] - recording.gripper_position[0, :, None] / of_metre
    return float(np.linalg.norm(away, axis=2).min())


def _table_distance(recording: Recording, of_metre: float) -> float:
    """Distance between the lowest point and a table whose height is in another unit [m]."""
    assert recording.table_height is not None
    return abs(recording.table_height / of_metre - float(recording.points[:, 2].min()))


def _divide(units: Sequence[str]) -> str:
    """Text with units of length and their conversion to metres."""
    factors = " or ".join(f"{_LENGTHS[unit]:g}" for unit in units)
    return f"{' or '.join(units)}; divide by {factors}"


def _check_units(recording: Recording) -> list[Fault]:
    """Check for coordinates or sizes in smaller units, and clouds far larger than the object."""
    extents = [np.ptp(cloud, axis=0).max() for cloud in recording.frames() if len(cloud)]
    if not extents:
        return []
    extent = float(np.median(extents))
    size = recording.object.size
    if size is not None and not (math.isfinite(size) and size > 0.0):
        size = None  # reported as a separate fault
    other = "" if size is None else f", the object {size:.4g} m"
    if extent > _MAX_EXTENT or (size is not None and extent > 30.0 * size):
        usual = _USUAL_EXTENT
        if size is not None and size <= _MAX_EXTENT:
            usual = (0.25 * size, 2.0 * size)
        looks = f"they look like {_meant(extent, usual)}"
        fix = looks if extent > _MAX_EXTENT else "give points and sizes in metres"
        return [Fault(f"a frame spans {extent:.4g} m{other}", "points", fix)]
    if size is not None and size > 30.0 * extent:
        name = "length" if recording.object.kind == "rope" else "width and object.height"
        return [
            Fault(
                f"the object spans {size:.4g} m, a frame {extent:.4g} m",
                f"object.{name}",
                f"they look like {_meant(size, (0.5 * extent, 4.0 * extent))}",
            )
        ]
    travel = np.ptp(recording.gripper_position, axis=0).max()
    if travel > _MAX_EXTENT:
        return [
            Fault(
                f"moves by {travel:.4g} m",
                "gripper_position",
                f"it looks like {_nearest_unit(_gripper_distance, recording)}",
            )
        ]
    longest = float(max(np.linalg.norm(np.ptp(c, axis=0)) for c in recording.frames() if len(c)))
    if size is not None and recording.num_grippers == 1 and size > 1.6 * longest:
        return [
            Fault(
                f"the object spans {size:.3g} m, no frame more than {longest:.3g} m",
                "object.length" if recording.object.kind == "rope" else "object.width",
                f"check its unit (is it {longest:.2g} m?), and that all of it is in view",
                "warning",
            )
        ]
    if size is not None and extent > 1.5 * size:
        return [
            Fault(
                f"a frame spans {extent:.3g} m, the object only {size:.3g} m",
                "points",
                "check the sizes, and that robot and table are cropped away",
                "warning",
            )
        ]
    return []


def _check_other_units(recording: Recording) -> list[Fault]:
    """Check for values in grams, milliseconds or, beside sizes in metres, in millimetres."""
    held, size, faults = recording.object, recording.object.size, []

    def wrong(what: str, where: str, unit: str) -> None:
        faults.append(Fault(what, where, f"it looks like {unit}"))

    if size is not None and math.isfinite(size) and size > 0.0:
        for name in ("diameter", "thickness", "grasp_radius", "grasp_inset"):
            value = getattr(held, name)
            if value is not None and math.isfinite(value) and value > size:
                thin = (2e-4 * size, 0.2 * size)
                what = f"is {value:.4g} m, the object spans {size:.4g} m"
                wrong(what, f"object.{name}", _meant(value, thin))
        if not faults:
            faults += _check_density(held, size)
    step = float(np.median(np.diff(recording.time))) if recording.num_frames > 1 else 0.0
    if step > _MAX_STEP:
        unit, factor = next((u, f) for most, u, f in _TIMES if step < most)
        fix = f"they look like {unit}; divide by {factor}"
        faults.append(Fault(f"frames are {step:.4g} s apart", "time", fix))
    if len(recording.points):
        lowest = recording.points.min(axis=0)
        height, cameras = recording.table_height, recording.camera_positions
        if height is not None and abs(height - lowest[2]) > _MAX_BELOW:
            what = f"is {height:.4g} m, the lowest point at {lowest[2]:.4g} m"
            wrong(what, "table_height", _nearest_unit(_table_distance, recording))
        if cameras is not None and len(cameras):
            away = np.linalg.norm(cameras - recording.points.mean(axis=0), axis=1).max()
            if away > _MAX_AWAY:
                unit = _meant(away, (0.3, 5.0))
                wrong(f"a camera is {away:.4g} m away", "camera_positions", unit)
    return faults


def _check_density(held: ObjectDescription, size: float) -> list[Fault]:
    """Check mass and sizes against each other. Sizes that are not stated count as the thickest that
    there are: only a density that is too large then is a fault."""
    if held.mass is None or not (math.isfinite(held.mass) and held.mass > 0.0):
        return []
    name = "diameter" if held.kind == "rope" else "thickness"
    stated = getattr(held, name)
    across = stated or _THICKEST.get(held.kind, 0.1) * size
    power = 2 if held.kind == "rope" else 1
    volume = math.pi / 4.0 * across**2 * size
    if held.kind == "cloth":
        volume = (held.width or size) * (held.height or size) * across
    density = held.mass / volume
    stated_low = MIN_DENSITY.get(held.kind, 0.0) if stated else 0.0
    if stated_low <= density <= MAX_DENSITY:
        return []
    heavy = density > MAX_DENSITY
    tenfold = 10.0**power if heavy else 10.0**-power
    fix = "give the mass in kilograms, and sizes in metres"
    if _USUAL_DENSITY[0] <= density / 1000.0 <= _USUAL_DENSITY[1]:
        fix = "it looks like grams; divide by 1000"
    elif stated and _USUAL_DENSITY[0] <= density / tenfold <= _USUAL_DENSITY[1]:
        fix = f"object.{name} looks ten times too {'small' if heavy else 'large'}"
    what = f"is {held.mass:.4g} kg, a density of {density:.2g} kg/m^3"
    what += "" if stated else " or more"
    return [Fault(what, "object.mass", fix, "error" if heavy else "warning")]


def _check_motion(recording: Recording) -> list[Fault]:
    """Check that there are frames enough, as far apart as seconds are, and markers as many."""
    if recording.extra.get("static", False):
        return _check_markers(recording)
    faults, frames = _check_markers(recording), np.flatnonzero(recording.frame_valid)
    if len(frames) < FEWEST_FRAMES:
        what = f"{len(frames)} with points"
        fix = f"record a whole lift: {FEWEST_FRAMES} frames at least"
        return [*faults, Fault(what, "frames", fix, "warning")]
    if numbered(recording):
        what = "frames are exactly 1 s apart"
        fix = "give seconds, if times are frame numbers"
        faults.append(Fault(what, "time", fix, "warning"))
    speed = usual_speed(recording)
    if speed is None or USUAL_SPEED[0] <= speed <= USUAL_SPEED[1]:
        return faults
    fix = "give seconds, and positions in metres"
    for unit, factor, words in (
        ("milliseconds", 1e3, "divide by 1000"),
        ("minutes", 1 / 60.0, "multiply by 60"),
        ("microseconds", 1e6, "divide by 1e6"),
    ):
        if USUAL_SPEED[0] <= speed * factor <= USUAL_SPEED[1]:
            fix = f"times look like {unit}; {words}"
            break
    what = f"the gripper moves at {speed:.2g} m/s"
    return [*faults, Fault(what, "time", fix, "warning")]


def numbered(recording: Recording) -> bool:
    """Whether the times of a motion in which they matter look like numbers of frames."""
    if recording.quasi_static or recording.num_frames < NUMBERED:
        return False
    return bool((np.diff(recording.time) == 1.0).all())


def usual_speed(recording: Recording) -> float | None:
    """Median speed of the fastest gripper while it moves and holds the object [m/s]; None: none
    does."""
    frames = np.flatnonzero(recording.frame_valid)
    holds = recording.holds[frames]
    steps = np.linalg.norm(np.diff(recording.gripper_position[frames], axis=0), axis=2)
    steps = np.where(holds[1:] & holds[:-1], steps, 0.0).max(axis=1, initial=0.0)
    moving = steps > 1e-3 * (recording.object.size or 1.0)
    if not moving.any():
        return None
    return float(np.median(steps[moving] / np.diff(recording.time[frames])[moving]))


def _check_markers(recording: Recording) -> list[Fault]:
    """Ordered markers are the same ones in each frame."""
    if not recording.extra.get("ordered_markers", False):
        return []
    counts = np.diff(recording.offsets)[recording.frame_valid]
    if len(counts) == 0 or (counts == counts[0]).all():
        return []
    t = int(np.flatnonzero(recording.frame_valid)[np.argmax(counts != counts[0])])
    return [
        Fault(
            f"has {len(recording.frame(t))} ordered markers, the first frame {counts[0]}",
            f"points, frame {t}",
            "give all markers in each frame, or none where one is missing",
        )
    ]


def _check_grippers(recording: Recording) -> list[Fault]:
    """Check that each gripper holds the object and is close to it, and that one moves."""
    faults = _check_holds(recording)
    if not (recording.frame_valid.any() and recording.cameras_calibrated):
        return faults
    frames = np.flatnonzero(recording.frame_valid)
    distance = np.array(
        [KDTree(recording.frame(int(t))).query(recording.gripper_position[t])[0] for t in frames]
    )
    for gripper in range(recording.num_grippers):
        # An open gripper may be anywhere.
        held = recording.holds[frames, gripper]
        far = distance[held, gripper] > MAX_GRASP_DISTANCE
        if not far.any():
            continue
        nearest = distance[held, gripper].min()
        if far.all():
            faults.append(
                Fault(
                    f"never comes nearer to the object than {nearest:.3g} m",
                    f"gripper_position, gripper {gripper}",
                    "check that both are metres in the same (robot base) frame",
                )
            )
        else:
            faults.append(
                Fault(
                    f"is farther than {MAX_GRASP_DISTANCE} m from the object in {far.sum()} of "
                    f"{len(far)} frames, first in frame {frames[held][np.argmax(far)]}",
                    f"gripper_position, gripper {gripper}",
                    "check that the object did not slip out",
                    "warning",
                )
            )
    travel = np.linalg.norm(np.ptp(recording.gripper_position, axis=0), axis=1)
    if travel.max() < _MIN_TRAVEL and not recording.extra.get("static", False):
        faults.append(
            Fault(
                f"moves by {travel.max():.2g} m in all",
                "gripper_position",
                "record a lift; an object at rest shows little of its parameters",
                "warning",
            )
        )
    return faults


def _check_holds(recording: Recording) -> list[Fault]:
    """Check whether each gripper is closed at some time, and from the start."""
    faults = []
    for gripper, closed in enumerate(recording.holds.T):
        where = f"gripper_closed, gripper {gripper}"
        if not closed.any():
            fix = "give true where it holds the object, or leave the gripper out"
            faults.append(Fault("is never closed", where, fix))
        elif not closed[0]:
            faults.append(
                Fault(
                    f"is open until frame {int(np.argmax(closed))}",
                    where,
                    "cut the frames before it closes: the object is taken as held in the first",
                    "warning",
                )
            )
    return faults
