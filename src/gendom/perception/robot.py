"""The robot's own shape as capsules, to take it out of the clouds.

capsules.csv has one row for each capsule and time, in order of time, under
`time,capsule,x0,y0,z0,x1,y1,z1,radius`: seconds, a name, both ends of the capsule's axis in the
world [m] and its radius [m]. A capsule that never moves needs one row.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gendom.errors import RecordingError

_COLUMNS = ("time", "capsule", "x0", "y0", "z0", "x1", "y1", "z1", "radius")


@dataclass(frozen=True, eq=False)
class Capsules:
    """C capsules at one moment."""

    start: npt.NDArray[np.float64]
    """[C, 3] one end of the axis [m]."""
    end: npt.NDArray[np.float64]
    """[C, 3] the other end [m]."""
    radius: npt.NDArray[np.float64]
    """[C] [m]."""

    def contain(self, points: npt.NDArray[np.floating], margin: float = 0.0) -> np.ndarray:
        """[n] points [n, 3] that are in a capsule or nearer to one than a margin [m]."""
        found = np.zeros(len(points), dtype=bool)
        columns = np.ascontiguousarray(points.T)
        for a, b, r in zip(self.start, self.end, self.radius, strict=True):
            reach = r + margin
            low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
            # Most links are far from the object: their boxes settle that.
            near = (columns[0] >= low[0]) & (columns[0] <= high[0])
            for k in (1, 2):
                near &= (columns[k] >= low[k]) & (columns[k] <= high[k])
            some = np.flatnonzero(near)
            if len(some) == 0:
                continue
            axis, rel = b - a, columns[:, some].T - a
            length2 = axis @ axis
            along = np.clip(rel @ axis / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(some))
            rel -= along[:, None] * axis
            found[some] |= np.einsum("ij,ij->i", rel, rel) <= reach**2
        return found


@dataclass(frozen=True, eq=False)
class CapsulePath:
    """Capsules over time."""

    tracks: dict[str, tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]
    """Name -> times [M] [s] and rows [M, 7]: both ends and the radius [m]."""

    def at(self, time: float) -> Capsules:
        """The capsules at a time, ends linear between rows and at rest before and after."""
        rows = np.array(
            [
                [np.interp(time, times, column) for column in values.T]
                for times, values in self.tracks.values()
            ]
        )
        return Capsules(rows[:, :3], rows[:, 3:6], rows[:, 6])


def read_capsules(path: str | os.PathLike) -> CapsulePath:
    """The capsules of a file capsules.csv; see the top of this module.

    Raises:
        RecordingError: The file cannot be read, or a row is malformed or out of order.
    """
    path = Path(path)
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, [text.strip() for text in row]) for row in reader if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(
            f"cannot be read ({error})", where=str(path), fix="save it as CSV"
        ) from None
    if len(lines) < 2 or tuple(lines[0][1]) != _COLUMNS:
        raise RecordingError(
            "has no rows under its header" if len(lines) == 1 else "has another header",
            where=str(path),
            fix=f"write {','.join(_COLUMNS)}, or remove the file",
        )
    tracks: dict[str, list[list[float]]] = {}
    for number, row in lines[1:]:
        try:
            values = [float(text) for i, text in enumerate(row) if i != 1]
            if len(row) != len(_COLUMNS) or not np.isfinite(values).all() or values[-1] <= 0.0:
                raise ValueError
        except ValueError:
            raise RecordingError(
                f"is no capsule: {','.join(row)[:60]!r}",
                where=f"{path}, line {number}",
                fix="give seconds, a name, two ends and a radius above 0 in metres",
            ) from None
        track = tracks.setdefault(row[1], [])
        if track and values[0] <= track[-1][0]:
            raise RecordingError(
                f"time of capsule {row[1]!r} goes from {track[-1][0]:g} to {values[0]:g} s",
                where=f"{path}, line {number}",
                fix="sort the rows",
            )
        track.append(values)
    arrays = {name: np.array(track) for name, track in tracks.items()}
    return CapsulePath({name: (a[:, 0], a[:, 1:]) for name, a in arrays.items()})
