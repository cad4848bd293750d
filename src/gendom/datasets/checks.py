"""Checks of the content of a recording.

Types and shapes of its arrays are checked in `gendom.datasets.recording_form`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial import KDTree

from gendom.arguments import time_text
from gendom.datasets.recording_form import (
    GRASPS,
    NEEDED_SIZES,
    SIZES,
    Fault,
    ObjectDescription,
    RecordingData,
)
from gendom.materials import KINDS

MAX_GRASP_DISTANCE = 0.15
"""A gripper farther than this from every point in every frame [m] does not hold the object."""
MAX_DENSITY = 12e3
"""Upper bound on the density of ropes and cloths, that of lead [kg/m^3]."""
MIN_DENSITY = {"rope": 120.0, "cloth": 30.0}
"""Lower bounds [kg/m^3]: a quarter and a half of the lightest of the materials' catalogue."""
USUAL_SPEED = (5e-4, 2.0)
"""Slowest and fastest usual speed of a gripper [m/s]: arms move at 1 m/s at most, hands
that shake a cable at 0.6 to 1 m/s."""
FEWEST_FRAMES = 4
"""Fewest frames with points of a motion that tells something."""

_MAX_EXTENT = 20.0  # [m]; larger clouds are not in metres
_USUAL_EXTENT = (0.1, 2.0)  # [m]; usual lengths of objects that robots handle
_THICKEST = {"rope": 0.1, "cloth": 0.02}  # of the size, where the thickness is unknown
_USUAL_DENSITY = (200.0, 3000.0)  # [kg/m^3]
_SINCE_1970 = 1e9  # [s]; later times are not from a start
_USUAL_STEP = (5e-3, 5.0)  # [s] between frames
_MAX_STEP, _LONGEST_GAP = 10.0, 2.0  # [s] between frames, usually and once
_UPS = {  # other axes that may point up, and what stands for x, y and z then
    (0, 1, 0): ("y", "x, -z, y"),
    (0, -1, 0): ("-y", "x, z, -y"),
    (1, 0, 0): ("x", "-z, y, x"),
    (-1, 0, 0): ("-x", "z, y, -x"),
}
_MISPLACED = 0.1  # of the clouds: in right order none of 50 lifts has one, shuffled half of them
_MAX_BELOW, _MAX_AWAY = 5.0, 50.0  # [m] that a table lies from the object, that a camera stands
_OF_GRASP = ("grasp_radius", "grasp_inset")
# Units given by mistake, in a metre or in a second.
_LENGTHS = {"centimetres": 100.0, "millimetres": 1000.0}
_TIMES = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


@np.errstate(over="ignore", invalid="ignore")  # of numbers that are told
def check(recording: RecordingData) -> list[Fault]:
    """Check the content and return all faults, errors before warnings."""
    faults = [*_check_object(recording.object)]
    height, source = recording.table_height, recording.gripper_source
    if height is not None and not math.isfinite(height):
        fix = "give metres, or null where there is no table"
        faults.append(Fault(f"is {height}", "table_height", fix))
    if source not in ("commanded", "measured"):
        faults.append(Fault(f"is {source!r}", "gripper_source", "give 'commanded' or 'measured'"))
    number_faults = list(_check_numbers(recording))
    faults += number_faults
    if not number_faults:
        faults += _check_frames(recording)
        for look in (_check_units, _check_other_units, _check_motion, _check_grippers, _check_up):
            found = list(look(recording))
            faults += found
            if any(fault.severity == "error" for fault in found):
                break
    return sorted(faults, key=lambda fault: fault.severity)


def _check_object(described: ObjectDescription) -> Iterator[Fault]:
    for name, known in (("kind", KINDS), ("grasp", GRASPS)):
        if (value := getattr(described, name)) not in known:
            yield Fault(f"is {value!r}", f"object.{name}", f"give {' or '.join(map(repr, known))}")
    if "outline" in described.extra:
        what = "is not supported: cloths of recordings are rectangles"
        yield Fault(what, "object.outline", "leave it out if the cloth is a rectangle")
    share = described.extra.get("natural_curvature")
    if share is not None and not (isinstance(share, (int, float)) and 0.0 <= share <= 1.0):
        fix = "give a share of the lying curvature, 0 to 1, or null if unknown"
        yield Fault(f"is {share}", "object.natural_curvature", fix)
    for name in SIZES:
        value, unit = getattr(described, name), "kg" if name == "mass" else "metres"
        if value is None and name in NEEDED_SIZES.get(described.kind, ()):
            what = f"is missing for a {described.kind}"
            yield Fault(what, f"object.{name}", f"measure it and give {unit}")
        elif value is not None and not _is_length(value):
            yield Fault(f"is {value}", f"object.{name}", f"give {unit} above 0, or null if unknown")
    for name in ("diameter", "thickness"):
        size, sd = getattr(described, name), getattr(described, f"{name}_sd")
        if _is_length(size) and _is_length(sd) and sd > size:
            what = f"is {sd}, more than the {name}, {size}"
            yield Fault(what, f"object.{name}_sd", "give how far off it may be [m], or null")


def _is_length(value: float | None) -> bool:
    """Whether a size is known and above 0."""
    return value is not None and math.isfinite(value) and value > 0.0


def _check_numbers(recording: RecordingData) -> Iterator[Fault]:
    """NaN and infinity anywhere, the length of the axes, and the order of times."""
    bad_points = ~np.isfinite(recording.points).all(axis=1)
    if bad_points.any():
        frame_of = np.repeat(np.arange(recording.num_frames), np.diff(recording.offsets))
        frames, counts = np.unique(frame_of[bad_points], return_counts=True)
        what = f"{counts[0]} of {len(recording.frame(int(frames[0])))} points are not finite"
        if len(frames) > 1:
            what += f", and {counts[1:].sum()} in {len(frames) - 1} more"
        yield Fault(what, f"points, frame {frames[0]}", "drop points without depth before writing")
    for name in ("time", "gripper_position", "gripper_axis", "camera_positions"):
        array = getattr(recording, name)
        if array is None:
            continue
        bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
        if bad.any():
            label = "camera" if name == "camera_positions" else "frame"
            what = f"is not finite in {bad.sum()} of {len(bad)} {label}s"
            fix = "give numbers, or cut those frames" if label == "frame" else "give numbers"
            yield Fault(what, f"{name}, {label} {int(np.argmax(bad))}", fix)
        elif name == "gripper_axis":
            length = np.linalg.norm(array, axis=2)
            off = (np.abs(length - 1.0) > 0.01).any(axis=1)
            if off.any():
                t = int(np.argmax(off))
                worst = length[t][np.argmax(np.abs(length[t] - 1.0))]
                fix = "give unit vectors, or leave it out"
                yield Fault(f"has length {worst:.3g}, not 1", f"gripper_axis, frame {t}", fix)
    time, late = recording.time, np.diff(recording.time) > 0
    if np.isfinite(time).all() and not late.all():
        t = int(np.argmax(~late)) + 1
        what = f"goes from {time_text(time[t - 1])} s to {time_text(time[t])} s"
        fix = "sort the frames and drop repeated ones; each must be later than the one before"
        if time.min() > _SINCE_1970 and (time.astype(np.float32) == time).all():
            fix = "they look like float32, which tells times since 1970 to 2 minutes only: store "
            fix += "float64, or seconds from the start"
        yield Fault(what, f"time, frame {t}", fix)


def _check_frames(recording: RecordingData) -> Iterator[Fault]:
    """Frames without points."""
    valid = recording.frame_valid
    empty = np.flatnonzero(~valid)
    early = max(3, math.ceil(0.1 * len(valid)))
    if not valid.any():
        yield Fault("all frames are empty", "points", "check the cropping and the depth range")
    elif not valid[:early].any():
        what = f"the first {int(np.argmax(valid))} frames are empty, so the start is not seen"
        yield Fault(what, "points, frame 0", "cut them off, or record from before the lift")
    elif len(empty):
        listed = ", ".join(map(str, empty[:8])) + (", ..." if len(empty) > 8 else "")
        what = f"{len(empty)} of {len(valid)} frames are empty ({listed})"
        yield Fault(what, "points", "nothing need be done: they are skipped", "warning")


def _units(value: float, low: float, high: float, known: Mapping[str, float] = _LENGTHS) -> str:
    """The units in which a too large length or time would lie between two usual ones [m] or [s],
    and what brings these."""
    units = [unit for unit, factor in known.items() if low <= value / factor <= high]
    if not units and value > 100.0 * high * max(known.values()):
        return "it is as large in no unit; look for numbers that are wrong"
    units = units or known
    factors = " or ".join(f"{known[unit]:g}" for unit in units)
    return f"it looks like {' or '.join(units)}; divide by {factors}"


def _check_units(recording: RecordingData) -> Iterator[Fault]:
    """The first of: coordinates or sizes in smaller units, clouds far larger than the object."""
    frames = np.flatnonzero(recording.frame_valid).tolist()
    clouds = recording.frames(frames)
    if not clouds:
        return
    extent = float(np.median([np.ptp(cloud, axis=0).max() for cloud in clouds]))
    # most points of each: single ones fly
    wide = np.array([np.ptp(np.quantile(x, (0.1, 0.9), axis=0), axis=0).max() for x in clouds])
    if (odd := wide > 30.0 * np.median(wide)).any() and np.median(wide) > 0.0:
        t = int(np.argmax(odd))
        what = f"spans {wide[t]:.4g} m, most frames {np.median(wide):.4g} m"
        fix = _units(float(wide[t]), 0.2 * float(np.median(wide)), 5.0 * float(np.median(wide)))
        yield Fault(what, f"points, frame {frames[t]}", fix)
        return
    longest = float(max(np.linalg.norm(np.ptp(cloud, axis=0)) for cloud in clouds))
    travel = float(np.ptp(recording.gripper_position, axis=0).max())
    given, is_rope = recording.object.size, recording.object.kind == "rope"
    size = 0.0 if given is None or not _is_length(given) else given  # others are faults themselves
    where, both = "object.length" if is_rope else "object.width and object.height", "points"
    if extent > _MAX_EXTENT or (size and extent > 30.0 * size):
        usual = (0.25 * size, 2.0 * size) if 0.0 < size <= _MAX_EXTENT else _USUAL_EXTENT
        fix = "give points and sizes in metres"
        fix = _units(extent, *usual) if extent > _MAX_EXTENT else fix
        yield Fault(f"a frame spans {extent:.4g} m, the object {size:.4g} m", both, fix)
    elif size > 30.0 * extent:
        what = f"the object spans {size:.4g} m, a frame {extent:.4g} m"
        yield Fault(what, where, _units(size, 0.5 * extent, 4.0 * extent))
    elif travel > _MAX_EXTENT:
        fix = _units(travel, 0.02 * size, 4.0 * max(size, extent))
        yield Fault(f"moves by {travel:.4g} m", "gripper_position", fix)
    elif recording.num_grippers == 1 and size > 1.6 * longest:
        what = f"the object spans {size:.3g} m, no frame more than {longest:.3g} m"
        fix = f"check its unit (is it {longest:.2g} m?), and that all of it is in view"
        yield Fault(what, where, fix, "warning")
    elif size and extent > 1.5 * size:
        what = f"a frame spans {extent:.3g} m, the object only {size:.3g} m"
        fix = "check the sizes, and that robot and table are cropped away"
        yield Fault(what, both, fix, "warning")


def _check_other_units(recording: RecordingData) -> Iterator[Fault]:
    """Values in grams, milliseconds or, beside sizes in metres, in millimetres."""
    held, size = recording.object, recording.object.size
    if size is not None and _is_length(size):
        sizes = {n: getattr(held, n) for n in ("diameter", "thickness", *_OF_GRASP)}
        thick = {n: v for n, v in sizes.items() if v is not None and math.isfinite(v) and v > size}
        for name, value in thick.items():
            what = f"is {value:.4g} m, the object spans {size:.4g} m"
            yield Fault(what, f"object.{name}", _units(value, 2e-4 * size, 0.2 * size))
        if not thick:
            yield from _check_density(held, size)
    step = float(np.median(np.diff(recording.time))) if recording.num_frames > 1 else 0.0
    if step > _MAX_STEP:
        fix = _units(step, *_USUAL_STEP, _TIMES)
        yield Fault(f"frames are {step:.4g} s apart", "time", fix)
    if len(recording.points) == 0:
        return
    low = float(recording.points[:, 2].min())
    height, cameras = recording.table_height, recording.camera_positions
    if height is not None and abs(height - low) > _MAX_BELOW:
        what = f"is {height:.4g} m, the lowest point at {low:.4g} m"
        yield Fault(what, "table_height", _units(abs(height), 0.0, 2.0))
    if cameras is not None and len(cameras):
        away = np.linalg.norm(cameras - recording.points.mean(axis=0), axis=1).max()
        if away > _MAX_AWAY:
            fix = _units(float(away), 0.3, 5.0)
            yield Fault(f"a camera is {away:.4g} m away", "camera_positions", fix)
        named = 0 if recording.seen_by is None else int(recording.seen_by.max()).bit_length()
        if named > len(cameras):
            what = f"names camera {named - 1}; camera_positions has {len(cameras)} rows"
            yield Fault(what, "seen_by", "give each camera's position, in the order of the bits")


def _check_density(held: ObjectDescription, size: float) -> Iterator[Fault]:
    """Check mass and sizes against each other. Sizes that are not stated count as the thickest that
    there are: only a density that is too large then is a fault."""
    mass = held.mass
    if mass is None or not _is_length(mass):
        return
    cloth = held.kind == "cloth"
    name = KINDS["cloth" if cloth else "rope"].sizes[1]
    stated = getattr(held, name)
    across = stated or _THICKEST.get(held.kind, 0.1) * size
    area = (held.width or size) * (held.height or size)
    density = mass / (area * across if cloth else math.pi / 4.0 * across**2 * size)
    if (MIN_DENSITY.get(held.kind, 0.0) if stated else 0.0) <= density <= MAX_DENSITY:
        return
    low, high = _USUAL_DENSITY
    fix = "give the mass in kilograms, and sizes in metres"
    if low <= density / 1000.0 <= high:
        fix = "it looks like grams; divide by 1000"
    what = f"is {mass:.4g} kg, a density of {density:.2g} kg/m^3{'' if stated else ' or more'}"
    severity = "error" if density > MAX_DENSITY else "warning"
    yield Fault(what, "object.mass", fix, severity)


def _check_motion(recording: RecordingData) -> Iterator[Fault]:
    """Check that there are frames enough, as far apart as seconds are, and markers as many."""
    frames = np.flatnonzero(recording.frame_valid)
    counts = np.diff(recording.offsets)[frames]
    if recording.extra.get("ordered_markers", False) and (counts != counts[:1]).any():
        t = int(frames[np.argmax(counts != counts[0])])
        what = f"has {len(recording.frame(t))} ordered markers, the first frame {counts[0]}"
        fix = "give all markers in each frame, or none where one is missing"
        yield Fault(what, f"points, frame {t}", fix)
    if recording.extra.get("static", False):
        return
    if len(frames) < FEWEST_FRAMES:
        fix = f"record a whole lift: {FEWEST_FRAMES} frames at least"
        yield Fault(f"{len(frames)} with points", "frames", fix, "warning")
        return
    steps = np.diff(recording.time[frames])
    if steps.max() > max(_LONGEST_GAP, 20.0 * np.median(steps)):
        t = int(frames[np.argmax(steps)])
        fix = "cut the recording there, or check the clock: all of that time is simulated"
        yield Fault(f"{steps.max():.3g} s pass to the next one", f"time, frame {t}", fix, "warning")
    if numbered(recording):
        fix = "give seconds, if times are frame numbers"
        yield Fault("frames are exactly 1 s apart", "time", fix, "warning")
    speed = usual_speed(recording)
    if speed is None or USUAL_SPEED[0] <= speed <= USUAL_SPEED[1]:
        return
    low, high = USUAL_SPEED
    units = [unit for unit, factor in _TIMES.items() if low <= speed * factor <= high]
    fix = f"times look like {units[0]}" if units else "give seconds, and positions in metres"
    yield Fault(f"the gripper moves at {speed:.2g} m/s", "time", fix, "warning")


def numbered(recording: RecordingData) -> bool:
    """Whether the times of a motion in which they matter look like numbers of frames."""
    even = bool((np.diff(recording.time) == 1.0).all())
    return even and not recording.quasi_static and recording.num_frames >= 10


def usual_speed(recording: RecordingData) -> float | None:
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


def _check_grippers(recording: RecordingData) -> Iterator[Fault]:
    """Check that each gripper holds the object and is close to it, and that one moves."""
    for gripper, closed in enumerate(recording.holds.T):
        where = f"gripper_closed, gripper {gripper}"
        if not closed.any():
            fix = "give true where it holds the object, or leave the gripper out"
            yield Fault("is never closed", where, fix)
        elif not closed[0]:
            what = f"is open until frame {int(np.argmax(closed))}"
            fix = "cut the frames before it closes: the object is taken as held in the first"
            yield Fault(what, where, fix, "warning")
    frames = np.flatnonzero(recording.frame_valid)
    if not (len(frames) and recording.cameras_calibrated):
        return
    trees = [KDTree(recording.frame(int(t))) for t in frames]
    places = recording.gripper_position[frames]
    distance = np.array([tree.query(at)[0] for tree, at in zip(trees, places, strict=True)])
    for gripper in range(recording.num_grippers):
        held = recording.holds[frames, gripper]  # an open gripper may be anywhere
        far = distance[held, gripper] > MAX_GRASP_DISTANCE
        where = f"gripper_position, gripper {gripper}"
        if len(far) and far.all():
            nearest = distance[held, gripper].min()
            what = f"never comes nearer to the object than {nearest:.3g} m"
            fix = "check that both are metres in the same (robot base) frame"
            yield Fault(what, where, fix)
        elif far.any():
            what = f"is farther than {MAX_GRASP_DISTANCE} m from the object in {far.sum()} of "
            what += f"{len(far)} frames, first in frame {frames[held][np.argmax(far)]}"
            yield Fault(what, where, "check that the object did not slip out", "warning")
        if len(far) and not far.all():
            own = [tree for tree, is_held in zip(trees, held, strict=True) if is_held]
            yield from _check_order(own, places[held, gripper], distance[held, gripper], where)
    travel = np.linalg.norm(np.ptp(recording.gripper_position, axis=0), axis=1).max()
    if travel < 1e-3 and not recording.extra.get("static", False):
        fix = "record a lift; an object at rest shows little of its parameters"
        yield Fault(f"moves by {travel:.2g} m in all", "gripper_position", fix, "warning")


def _check_order(
    clouds: list[KDTree], places: np.ndarray, distance: np.ndarray, where: str
) -> Iterator[Fault]:
    """Check that clouds follow a gripper's path: each is to lie as near to the gripper's place
    [T, 3] of its own frame (`distance` [T], in metres) as to that of any other."""
    travel = float(np.linalg.norm(np.ptp(places, axis=0)))
    some = np.unique(np.linspace(0, len(places) - 1, 60).astype(int))
    nearest = np.array([cloud.query(places[some])[0].min() for cloud in clouds])
    off = distance - nearest > max(0.03, 0.1 * travel)
    if off.mean() > _MISPLACED and off[: len(off) // 2].any():  # slipped out, it would be later
        what = f"{off.sum()} of {len(off)} clouds lie at its place of another time"
        yield Fault(what, where, "check the order of the clouds, and both clocks")


def _check_up(recording: RecordingData) -> Iterator[Fault]:
    """Check that z points up: grippers rise along it, and what they hold hangs below them. Where
    another axis does, the object lay flat across that one before. A task is no lift."""
    frames = np.flatnonzero(recording.frame_valid)
    lift = recording.cameras_calibrated and "task" not in recording.extra
    if len(frames) == 0 or not lift:
        return
    way = recording.gripper_position.mean(axis=1)
    way = way - way[frames[0]]
    farthest = way[int(np.argmax(np.linalg.norm(way, axis=1)))]
    if np.linalg.norm(farthest) < 0.02:
        return
    late = frames[-max(1, len(frames) // 3) :]
    held = recording.gripper_position.mean(axis=1)
    hang = np.mean([recording.frame(int(t)).mean(axis=0) - held[t] for t in late], axis=0)
    rise, hang = farthest / np.linalg.norm(farthest), hang / np.linalg.norm(hang)
    extent = np.ptp(recording.frame(int(frames[0])), axis=0)
    for up, (name, right) in _UPS.items():
        along = float(hang @ up)
        flat = float(extent @ np.abs(up)) < 0.35 * extent.max()
        if rise @ up > 0.8 and along < -0.15 and hang[2] > along and flat:
            low = float(recording.frame(int(frames[0]))[:, 2].min())
            height = recording.table_height
            lies = height is not None and abs(low - height) < 0.05
            what = f"the gripper rises along {name}, and the object hangs below it there"
            fix = f"give z up: {right} in place of x, y, z"
            fix += ", unless the object was dragged over the table" if lies else ""
            yield Fault(what, "points", fix, "warning" if lies else "error")
