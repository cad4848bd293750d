"""The data of a recording, and the conversion of its arrays and `meta` between file and memory.

Files are described in `gendom.datasets.recording`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self, get_type_hints

import numpy as np
import numpy.typing as npt

from gendom.arguments import fits, require
from gendom.errors import GendomError, RecordingError, did_you_mean, one_line
from gendom.files import to_json
from gendom.materials import KINDS
from gendom.reading import record_of
from gendom.shown import Shown

FORMAT = "gendom-recording/1"

GRASPS = ("end", "corner", "center", "both ends")
NEEDED_SIZES = {"rope": ("length",), "cloth": ("width", "height")}
SIZES = ("length", "diameter", "diameter_sd", "width", "height", "thickness", "thickness_sd")
SIZES += ("mass", "grasp_radius", "grasp_inset")

# Arrays of a recording: type, shape (a letter is any length, the same wherever it appears).
ARRAYS = {
    "points": (np.float32, ("S", 3)),
    "offsets": (np.int64, ("T + 1",)),
    "time": (np.float64, ("T",)),
    "gripper_position": (np.float64, ("T", "G", 3)),
    "gripper_axis": (np.float64, ("T", "G", 3)),
    "gripper_closed": (np.bool_, ("T", "G")),
    "seen_by": (np.uint8, ("S",)),
    "camera_positions": (np.float64, ("K", 3)),
}
STORED_ARRAYS = tuple(name for name in ARRAYS if name != "camera_positions")
_OF_OBJECT = ("natural_curvature", "outline")
_META = ("table_height", "gripper_source", "quasi_static", "source", "notes")
_META += ("cameras_calibrated", "camera_positions")
_BESIDE_OBJECT = ("robot", "static", "ordered_markers")
"""Other keys of `meta` that are read."""
_OPTIONAL_ARRAYS = ("gripper_axis", "gripper_closed", "seen_by", "camera_positions")
_KINDS_OF = {"f": "iuf", "i": "iu", "u": "iu", "b": "b"}  # that are converted to each kind


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


@dataclass(frozen=True, kw_only=True)
class ObjectDescription:
    """Description of the object: kind, sizes at rest, and grasp. None means unknown."""

    kind: str
    """"rope" or "cloth"."""
    length: float | None = None
    """Rope: length [m]; always needed."""
    diameter: float | None = None
    """Rope: diameter [m]."""
    diameter_sd: float | None = None
    """Standard deviation of that [m]; None: a caliper's on something soft."""
    width: float | None = None
    """Cloth: first side [m]; always needed."""
    height: float | None = None
    """Cloth: second side [m]; always needed."""
    thickness: float | None = None
    """Cloth: thickness [m]."""
    thickness_sd: float | None = None
    """Standard deviation of that [m], likewise."""
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

    def meta(self) -> dict[str, Any]:
        """All fields in the form of the file; unknown sizes only where the kind has them."""
        optional = KINDS[self.kind].sizes[1] if self.kind in KINDS else ""
        shown = (*NEEDED_SIZES.get(self.kind, ()), optional, "mass")
        sizes = {name: getattr(self, name) for name in SIZES}
        sizes = {name: v for name, v in sizes.items() if name in shown or v is not None}
        return {"kind": self.kind, **sizes, "grasp": self.grasp, **self.extra}


@dataclass(frozen=True, kw_only=True, repr=False)
class RecordingData(Shown):
    """The data of a `gendom.datasets.Recording`."""

    points: np.ndarray
    """[S, 3] float32: all frames' points, one after another [m]."""
    offsets: np.ndarray
    """[T + 1] int64: frame t is points[offsets[t]:offsets[t + 1]]."""
    time: np.ndarray
    """[T] float64: strictly increasing [s]."""
    gripper_position: np.ndarray
    """[T, G, 3] float64: where each gripper holds the object [m]."""
    gripper_axis: np.ndarray | None = None
    """[T, G, 3] float64: unit vector along the object at the clamp; None: unknown."""
    gripper_closed: np.ndarray | None = None
    """[T, G] bool: whether each gripper holds the object; None: all do, always."""
    seen_by: np.ndarray | None = None
    """[S] uint8: bit k is set where camera k saw the point; None: unknown."""
    object: ObjectDescription
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    gripper_source: str = "commanded"
    """"commanded" or "measured"."""
    quasi_static: bool = False
    """True: inertia is negligible, and time may be rescaled."""
    camera_positions: np.ndarray | None = None
    """[K, 3] float64 [m]; None: unknown."""
    cameras_calibrated: bool = True
    """False: the transform between cameras and gripper is unknown, so points and
    `camera_positions` are in another frame than the gripper, upright to within a few degrees."""
    source: str = ""
    notes: str = ""
    extra: dict[str, Any] = field(default_factory=dict)
    """Other keys of the file's `meta`, kept and written back."""

    def __post_init__(self):
        arrays = {name: getattr(self, name) for name in ARRAYS}
        converted, faults = convert(arrays)
        if faults:
            raise RecordingError(faults=faults)
        for name, array in converted.items():
            object.__setattr__(self, name, array)

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return len(self.time)

    @property
    def num_grippers(self) -> int:
        """Number of grippers, G."""
        return self.gripper_position.shape[1]

    @property
    def holds(self) -> np.ndarray:
        """[T, G] bool: `gripper_closed`, all true where that is None."""
        if self.gripper_closed is None:
            return np.ones(self.gripper_position.shape[:2], dtype=bool)
        return self.gripper_closed

    @property
    def cameras_apart(self) -> float:
        """How far apart perception found cameras' clouds of the object at worst [m]; 0: unknown."""
        found: Any = self.extra
        for key in ("perception", "cameras_apart", "at_worst"):
            found = found.get(key) if isinstance(found, dict) else None
        return float(found) if type(found) in (int, float) else 0.0

    @property
    def frame_valid(self) -> np.ndarray:
        """[T] bool: the frame has points."""
        return np.diff(self.offsets) > 0

    @property
    def begins_with(self) -> str:
        """SHA-256 of the first points; a recording and a longer one of the same motion share it."""
        first = self.frame(int(np.argmax(self.frame_valid)))
        return hashlib.sha256(np.ascontiguousarray(first, dtype="<f4").tobytes()).hexdigest()

    @property
    def digest(self) -> str:
        """SHA-256 of all data that an estimate depends on: all arrays, and `meta` without `source`,
        `notes` and `extra`. It does not depend on the file format."""
        found = hashlib.sha256()
        for name in STORED_ARRAYS:
            array = getattr(self, name)
            if array is not None:
                little = array.astype(array.dtype.newbyteorder("<"), copy=False)
                found.update(f"{name} {array.dtype.name} {array.shape}".encode())
                found.update(np.ascontiguousarray(little).tobytes())
        meta = self.meta()
        stated = {n: meta[n] for n in sorted(meta.keys() - {"source", "notes", *self.extra})}
        stated["object"] = asdict(replace(self.object, extra={}))
        found.update(to_json(stated).encode())
        return found.hexdigest()

    def frame(self, t: int) -> np.ndarray:
        """[n, 3] float32: the points of frame t [m]; a negative t counts from the end.

        Raises:
            IndexError: There is no such frame.
        """
        if not -self.num_frames <= t < self.num_frames:
            raise IndexError(f"frame {t} of a recording with {self.num_frames} frames")
        t %= self.num_frames
        return self.points[self.offsets[t] : self.offsets[t + 1]]

    def frames(self, which: Sequence[int] | range | None = None) -> list[np.ndarray]:
        """The points of the given frames, by default of all."""
        return [self.frame(t) for t in (range(self.num_frames) if which is None else which)]

    def head(self, n: int) -> Self:
        """The first n frames.

        Raises:
            RecordingError: n is not in 1..T.
        """
        what = f"cannot take the first {n} of {self.num_frames} frames"
        fix = f"choose 1 to {self.num_frames}"
        require(1 <= n <= self.num_frames, what, fix=fix, error=RecordingError)
        names = ("time", "gripper_position", "gripper_axis", "gripper_closed")
        arrays = {name: getattr(self, name) for name in names}
        cut = {name: array[:n] for name, array in arrays.items() if array is not None}
        points = self.points[: self.offsets[n]]
        if self.seen_by is not None:
            cut["seen_by"] = self.seen_by[: self.offsets[n]]
        return replace(self, points=points, offsets=self.offsets[: n + 1], **cut)

    def moved(self, T: np.ndarray) -> Self:
        """Return a copy with points and cameras moved by T [4, 4] [m], and unchanged grippers."""
        R, shift, cameras = T[:3, :3], T[:3, 3], self.camera_positions
        cameras = None if cameras is None else cameras @ R.T + shift
        return replace(self, points=self.points @ R.T + shift, camera_positions=cameras)

    @classmethod
    def from_frames(
        cls,
        frames: Sequence[npt.ArrayLike],
        *,
        time: npt.ArrayLike,
        gripper_position: npt.ArrayLike,
        gripper_axis: npt.ArrayLike | None = None,
        gripper_closed: npt.ArrayLike | None = None,
        object: ObjectDescription,
        **other: Any,
    ) -> Self:
        """Make a recording from one cloud for each frame.

        Args:
            frames: T arrays [n, 3] [m]; n may differ and may be 0.
            time: [T] [s].
            gripper_position: [T, G, 3], or [T, 3] for one gripper [m].
            gripper_axis: Like `gripper_position`, unit vectors; or None.
            gripper_closed: [T, G] bool, or [T] for one gripper; None: closed throughout.
            object: Description of the object.
            other: The remaining fields, by name.

        Raises:
            RecordingError: A cloud is not [n, 3], or the lengths do not fit together.
        """
        clouds = [np.asarray(cloud) for cloud in frames]
        for t, cloud in enumerate(clouds):
            what, right = f"has shape {list(cloud.shape)}", cloud.shape[1:] == (3,)
            require(right, what, where=f"frame {t}", fix="give [n, 3]", error=RecordingError)

        def per_gripper(values: npt.ArrayLike | None, ndim: int) -> Any:
            """Values [T, G, ...] from these or from those of one gripper, of `ndim` - 1 axes."""
            array = None if values is None else np.asarray(values)
            return array[:, None] if array is not None and array.ndim == ndim - 1 else array

        other |= {"time": np.asarray(time), "gripper_position": per_gripper(gripper_position, 3)}
        other |= {"gripper_axis": per_gripper(gripper_axis, 3)}
        other |= {"gripper_closed": per_gripper(gripper_closed, 2)}
        return cls(**joined(clouds), object=object, **other)

    def meta(self) -> dict[str, Any]:
        """All fields except the arrays, in the form of the file."""
        meta = {
            "format": FORMAT,
            "object": self.object.meta(),
            "table_height": self.table_height,
            "gripper_source": self.gripper_source,
            "quasi_static": self.quasi_static,
            "source": self.source,
            "notes": self.notes,
        }
        if self.camera_positions is not None:
            meta["camera_positions"] = self.camera_positions
        if not self.cameras_calibrated:
            meta["cameras_calibrated"] = False
        return {**meta, **{k: v for k, v in self.extra.items() if k not in meta}}

    def _shown(self) -> tuple[str, list[tuple[str, str]]]:
        counts, held = np.diff(self.offsets), self.object
        sizes = [f"{n} {v:.4g} m" for n in SIZES if n != "mass" and (v := getattr(held, n))]
        mass = [] if held.mass is None else [f"mass {held.mass:.4g} kg"]
        motion = "quasi-static" if self.quasi_static else "dynamic"
        table = "none" if self.table_height is None else f"at z = {self.table_height:.4g} m"
        return f"Recording ({held.kind}, {self.num_frames} frames)", [
            ("object", ", ".join([*sizes, *mass, f"held by: {held.grasp}"])),
            ("points", f"{counts.min()} to {counts.max()} a frame"),
            ("time", f"{self.time[0]:.4g} to {self.time[-1]:.4g} s, {motion}"),
            ("grippers", f"{self.num_grippers} ({self.gripper_source})"),
            ("table", table),
        ]


def joined(clouds: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """`points` and `offsets` of a recording with one cloud [n, 3] for each frame."""
    points = np.concatenate([np.zeros((0, 3), np.float32), *clouds])
    return {"points": points, "offsets": np.cumsum([0, *map(len, clouds)])}


def convert(arrays: Mapping[str, Any]) -> tuple[dict[str, np.ndarray | None], list[Fault]]:
    """Convert arrays to their types, read-only; return them and faults of type and shape."""
    converted: dict[str, np.ndarray | None] = dict.fromkeys(ARRAYS)
    faults = []
    for name, (dtype, shape) in ARRAYS.items():
        form = f"{np.dtype(dtype)} [{', '.join(map(str, shape))}]"
        if arrays.get(name) is None:
            if name not in _OPTIONAL_ARRAYS:
                faults.append(Fault("is missing", name, f"add it: {form}"))
            continue
        array = np.asarray(arrays[name])
        if array.dtype.kind not in _KINDS_OF[np.dtype(dtype).kind] and array.size:
            faults.append(Fault(f"has the type {array.dtype}", name, f"give {form}"))
        elif not fits(array.shape, shape):
            faults.append(Fault(f"has shape {list(array.shape)}", name, f"give {form}"))
        else:
            with np.errstate(over="ignore"):  # becomes infinite, which `validate` finds
                array = np.ascontiguousarray(array, dtype=dtype).view()
            array.flags.writeable = False
            converted[name] = array
    return converted, faults or list(_length_faults(converted))


def _length_faults(arrays: Mapping[str, np.ndarray | None]) -> Iterator[Fault]:
    """What does not fit in the lengths of arrays, each of which is valid."""
    points, offsets, time, position = (
        np.asarray(arrays[name]) for name in ("points", "offsets", "time", "gripper_position")
    )
    sizes = {"S": len(points), "T": len(time), "T + 1": len(time) + 1, "G": position.shape[1]}
    for letter, name, what in (("T", "time", "frame"), ("G", "gripper_position", "gripper")):
        if sizes[letter] == 0:
            yield Fault(f"has no {what}", name, "give at least one")
    for name, (_, shape) in ARRAYS.items():
        array = arrays[name]
        if array is None or name == "camera_positions":
            continue
        wanted = [n if isinstance(n, int) else sizes[n] for n in shape]
        if list(array.shape) != wanted:
            fix = f"give [{', '.join(map(str, shape))}], which is {wanted} here"
            yield Fault(f"has shape {list(array.shape)}", name, fix)
    falls = np.flatnonzero(np.diff(offsets) < 0)
    if len(offsets) == sizes["T + 1"] and (offsets[0] != 0 or offsets[-1] != len(points)):
        what = f"runs from {offsets[0]} to {offsets[-1]}, but there are {len(points)} points"
        yield Fault(what, "offsets", f"let it run from 0 to {len(points)}")
    elif len(falls):
        t = int(falls[0])
        what = f"falls from {offsets[t]} to {offsets[t + 1]}"
        yield Fault(what, f"offsets, frame {t}", "let it never decrease")


_FIXES = {
    "table_height": "give z of the table in metres, or null where there is none",
    "gripper_source": "give 'commanded' or 'measured'",
    "quasi_static": "give true or false",
    "object": "give kind, sizes in metres and grasp",
}


def missing_keys(meta: Mapping[str, Any]) -> list[Fault]:
    """A fault for each key that the `meta` of a file must have and has not."""
    needed = ("table_height", "gripper_source", "quasi_static")
    return [Fault("is missing", f"meta.{k}", _FIXES[k]) for k in needed if k not in meta]


def unread_arrays(names: Sequence[str]) -> list[Fault]:
    """A warning that names a file's arrays that nothing reads, if there are any."""
    near = filter(None, (did_you_mean(name, STORED_ARRAYS, cutoff=0.75) for name in names))
    fix = " ".join(dict.fromkeys(near)) or "docs/recordings.md says which there are"
    what = f"{'are' if len(names) > 1 else 'is'} read by nothing"
    return [Fault(what, ", ".join(names), fix, "warning")] if names else []


def parse_meta(meta: Mapping[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Read the fields of a `Recording` from its meta; return them and faults of type."""
    rest = {key: value for key, value in meta.items() if key != "format"}
    values: dict[str, Any] = {key: getattr(RecordingData, key) for key in _META}
    faults: list[Fault] = []
    held = rest.setdefault("object", {})
    if isinstance(held, dict):
        usual = {"grasp": "corner" if held.get("kind") == "cloth" else "end"}
        known = ("kind", *SIZES, "grasp")
        extra = {key: value for key, value in held.items() if key not in known}
        faults += _misspelt(extra, (*known, *_OF_OBJECT), "object.")
        rest["object"] = {**usual, **{k: held[k] for k in known if k in held}, "extra": extra}
    kinds = get_type_hints(RecordingData)
    for key in ("object", *(key for key in _META if key in rest)):
        fix = _FIXES.get(key, "docs/recordings.md says what it holds")
        try:
            values[key] = record_of(kinds[key], rest.pop(key), where=key, fix=fix)
        except GendomError as error:
            faults.append(Fault(error.what, str(error.where).replace(": ", "."), fix))
    faults += _misspelt(rest, (*_META, *_BESIDE_OBJECT))
    return {**values, "extra": rest}, faults


def _misspelt(rest: Mapping[str, Any], known: Sequence[str], at: str = "") -> Iterator[Fault]:
    """Faults of keys that nothing reads and that look like ones that are read."""
    for key in rest:
        if key not in known and (advice := did_you_mean(key, known, cutoff=0.8)):
            yield Fault("is read by nothing", f"{at}{key}", advice)
