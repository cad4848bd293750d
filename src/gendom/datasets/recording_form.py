"""Read, convert and check the arrays and the meta of a recording's file.

They are described in `gendom.datasets.recording`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gendom.datasets.checks import GRASPS, KINDS, SIZES, Fault
from gendom.datasets.npz import LOAD_ERRORS
from gendom.datasets.static import FORMAT_STATIC, recording_of_static
from gendom.errors import RecordingError

FORMAT = "gendom-recording/1"


@dataclass(frozen=True, kw_only=True)
class ObjectDescription:
    """Description of the object: kind, sizes at rest, and grasp. None means unknown."""

    kind: str
    """"rope" or "cloth"."""
    length: float | None = None
    """Rope: length [m]; always needed."""
    diameter: float | None = None
    """Rope: diameter [m]."""
    width: float | None = None
    """Cloth: first side [m]; always needed."""
    height: float | None = None
    """Cloth: second side [m]; always needed."""
    thickness: float | None = None
    """Cloth: thickness [m]."""
    mass: float | None = None
    """Total mass [kg]."""
    grasp: str = "end"
    """"end", "corner", "center" or "both ends"."""
    grasp_radius: float | None = None
    """Distance from the gripper's position within which the fingers hold the object [m]."""
    grasp_inset: float | None = None
    """Distance of the gripper's position from the rope's end or from the cloth's corner [m]."""
    extra: dict[str, Any] = field(default_factory=dict)
    """Other keys of the file's `object`, kept and written back."""

    @property
    def size(self) -> float | None:
        """Largest distance between two points of the object laid out flat [m]."""
        if self.kind == "rope":
            return self.length
        if self.width is None or self.height is None:
            return None
        return math.hypot(self.width, self.height)


# Arrays of a recording: type, shape (a letter is any length, the same wherever it appears).
ARRAYS = {
    "points": (np.float32, ("S", 3)),
    "offsets": (np.int64, ("T + 1",)),
    "time": (np.float64, ("T",)),
    "gripper_position": (np.float64, ("T", "G", 3)),
    "gripper_axis": (np.float64, ("T", "G", 3)),
    "gripper_closed": (np.bool_, ("T", "G")),
    "camera_positions": (np.float64, ("K", 3)),
}
STORED_ARRAYS = tuple(name for name in ARRAYS if name != "camera_positions")
_OPTIONAL_ARRAYS = ("gripper_axis", "gripper_closed", "camera_positions")
# Kinds of NumPy types that are converted to each type.
_CONVERTED_KINDS = {np.float32: "iuf", np.float64: "iuf", np.int64: "iu", np.bool_: "b"}


def convert(arrays: Mapping[str, Any]) -> tuple[dict[str, np.ndarray | None], list[Fault]]:
    """Convert arrays to their types, read-only; return them and faults of type and shape."""
    converted: dict[str, np.ndarray | None] = {}
    faults = []
    for name, (dtype, shape) in ARRAYS.items():
        value = arrays.get(name)
        if value is None and name in _OPTIONAL_ARRAYS:
            converted[name] = None
            continue
        if value is None:
            faults.append(Fault("is missing", name, f"add it: {_form(name)}"))
            continue
        array = np.asarray(value)
        if array.dtype.kind not in _CONVERTED_KINDS[dtype] and array.size:
            faults.append(Fault(f"has the type {array.dtype}", name, f"give {_form(name)}"))
            continue
        if array.ndim != len(shape) or any(
            isinstance(want, int) and have != want
            for have, want in zip(array.shape, shape, strict=False)
        ):
            faults.append(Fault(f"has shape {list(array.shape)}", name, f"give {_form(name)}"))
            continue
        with np.errstate(over="ignore"):  # becomes infinite, which `validate` finds
            array = np.ascontiguousarray(array, dtype=dtype).view()
        array.flags.writeable = False
        converted[name] = array
    return converted, faults or _check_lengths(converted)


def _form(name: str) -> str:
    dtype, shape = ARRAYS[name]
    return f"{np.dtype(dtype)} [{', '.join(map(str, shape))}]"


def _check_lengths(arrays: Mapping[str, np.ndarray | None]) -> list[Fault]:
    """Check that arrays, each of which is valid, have matching lengths."""
    points, offsets, time = arrays["points"], arrays["offsets"], arrays["time"]
    position, axis = arrays["gripper_position"], arrays["gripper_axis"]
    assert points is not None and offsets is not None and time is not None
    assert position is not None
    frames = len(time)
    if frames == 0:
        return [Fault("is empty", "time", "give at least one frame")]
    faults = []
    if len(offsets) != frames + 1:
        faults.append(
            Fault(
                f"has {len(offsets)} entries for {frames} frames",
                "offsets",
                f"give {frames + 1}, one more than time has",
            )
        )
    else:
        step = np.diff(offsets)
        if offsets[0] != 0 or offsets[-1] != len(points):
            faults.append(
                Fault(
                    f"runs from {offsets[0]} to {offsets[-1]}, but there are {len(points)} points",
                    "offsets",
                    f"let it run from 0 to {len(points)}",
                )
            )
        if (step < 0).any():
            t = int(np.argmax(step < 0))
            faults.append(
                Fault(
                    f"falls from {offsets[t]} to {offsets[t + 1]}",
                    f"offsets, frame {t}",
                    "let it never decrease",
                )
            )
    if len(position) != frames:
        faults.append(
            Fault(
                f"has {len(position)} frames, but time has {frames}",
                "gripper_position",
                "give one position a frame",
            )
        )
    if position.shape[1] == 0:
        faults.append(Fault("has no gripper", "gripper_position", "give at least one: [T, 1, 3]"))
    closed = arrays["gripper_closed"]
    if closed is not None and closed.shape != position.shape[:2]:
        faults.append(
            Fault(
                f"has shape {list(closed.shape)}, but gripper_position {list(position.shape)}",
                "gripper_closed",
                "give true or false for each position, or leave it out",
            )
        )
    if axis is not None and axis.shape != position.shape:
        faults.append(
            Fault(
                f"has shape {list(axis.shape)}, but gripper_position {list(position.shape)}",
                "gripper_axis",
                "give one unit vector for each position, or leave it out",
            )
        )
    return faults


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and the parsed `meta` of a recording's file."""

    def fault(what: str, fix: str) -> RecordingError:
        return RecordingError(what, where=str(path), fix=fix)

    if path.suffix.lower() in (".ply", ".pcd"):
        raise fault("is a single cloud", "give the folder that holds all frames")
    try:
        with open(path, "rb") as file:
            if file.read(2) != b"PK":
                raise fault("is no .npz file", f"write {FORMAT} with numpy.savez")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                wanted = (*STORED_ARRAYS, "loops", "meta")
                names = [name for name in wanted if name in archive.files]
                stored = {name: archive[name] for name in names}
    except FileNotFoundError:
        raise fault("no such file", "check the path") from None
    except LOAD_ERRORS as error:
        if isinstance(error, OSError) and error.strerror:
            raise fault(f"cannot be read ({error.strerror})", "check the file") from None
        if "allow_pickle" in str(error):
            raise fault(
                "holds Python objects (pickles), which are never loaded",
                "write its arrays as numbers and meta as JSON text",
            ) from None
        raise fault(f"is damaged ({_short(error)})", "copy or record it again") from None
    meta = stored.pop("meta", None)
    if meta is None:
        raise fault("meta: is missing", f"add JSON text with format = {FORMAT!r}")
    try:
        if meta.size != 1 or meta.dtype.kind not in "US":
            raise ValueError(f"it is {meta.dtype} {list(meta.shape)}")
        parsed = json.loads(meta.item())
    except ValueError as error:
        raise fault(
            f"meta: is not JSON text ({_short(error)})", "write it with json.dumps"
        ) from None
    if not isinstance(parsed, dict):
        raise fault("meta: is not a JSON object", "write it with json.dumps from a dict")
    if parsed.get("format") == FORMAT_STATIC:
        return recording_of_static(stored, parsed, str(path))
    if parsed.get("format") != FORMAT:
        raise fault(
            f"meta.format: is {parsed.get('format')!r}", f"only {FORMAT!r} can be read here"
        )
    return stored, parsed


def _short(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:120]


def missing_keys(meta: Mapping[str, Any]) -> list[Fault]:
    fixes = {
        "table_height": "add z of the table in metres, or null where there is none",
        "gripper_source": "add 'commanded' or 'measured'",
        "quasi_static": "add true or false",
    }
    return [
        Fault("is missing", f"meta.{key}", fix) for key, fix in fixes.items() if key not in meta
    ]


def parse_meta(meta: Mapping[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Read the fields of a `Recording` from its meta; return them and faults of type."""
    rest = {key: value for key, value in meta.items() if key != "format"}
    values: dict[str, Any] = {}
    faults = []

    def take(source: dict, key: str, default: Any, right: Callable[[Any], bool], want: str, at=""):
        value = source.pop(key, default)
        if right(value):
            return value
        faults.append(Fault(f"is {_short_value(value)}", f"{at}{key}", f"give {want}"))
        return default

    table = rest.pop("object", None)
    if not isinstance(table, dict):
        what = "is missing" if table is None else f"is {_short_value(table)}"
        faults.append(Fault(what, "object", "give kind, sizes in metres and grasp"))
    else:
        table = dict(table)
        kind = take(table, "kind", None, _is_text, " or ".join(map(repr, KINDS)), "object.")
        sizes = {
            key: take(table, key, None, _is_number_or_none, "a number, or null", "object.")
            for key in SIZES
        }
        default_grasp = "corner" if kind == "cloth" else "end"
        grasp = take(table, "grasp", default_grasp, _is_text, f"one of {GRASPS}", "object.")
        values["object"] = ObjectDescription(kind=kind, grasp=grasp, extra=table, **sizes)
    values["table_height"] = take(
        rest, "table_height", None, _is_number_or_none, "metres, or null for no table"
    )
    values["gripper_source"] = take(
        rest, "gripper_source", "commanded", _is_text, "'commanded' or 'measured'"
    )
    values["quasi_static"] = take(
        rest, "quasi_static", False, lambda v: isinstance(v, bool), "true or false"
    )
    for key in ("source", "notes"):
        values[key] = take(rest, key, "", _is_text, "text")
    cameras = rest.pop("camera_positions", None)
    if cameras is not None:
        try:
            cameras = np.array(cameras, dtype=np.float64)
        except (TypeError, ValueError):
            cameras = np.empty((0, 0))
        if cameras.ndim != 2 or cameras.shape[1] != 3:
            faults.append(
                Fault("is no list of positions", "camera_positions", "give [K, 3] in metres")
            )
            cameras = None
    values["camera_positions"] = cameras
    values["cameras_calibrated"] = take(
        rest, "cameras_calibrated", True, lambda v: isinstance(v, bool), "true or false"
    )
    values["extra"] = rest
    return values, faults


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_number_or_none(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _short_value(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
