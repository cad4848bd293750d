"""One shape at rest: a rope or wire that hangs between two clamps, `gendom-static/1`.

A NumPy `.npz` without pickles:

    loops   float [K, n, 3]   K repeats of the same shape: points along it, evenly spaced [m], z up
    meta    JSON text         object: kind ("rope" or "wire"), length [m], mass_per_length [kg/m],
                              optional diameter [m]; source, notes, and anything else

Position and direction of the clamped ends are those of the first and last segment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gendom.errors import RecordingError

FORMAT_STATIC = "gendom-static/1"


def recording_of_static(
    arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], where: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Convert a shape at rest to the arrays and meta of a recording.

    Each repeat becomes a frame, one second after the previous one. Points are ordered markers, two
    grippers hold the ends, and `static` in the meta marks the recording as motionless.

    Args:
        arrays: Arrays of the file, with `loops`.
        meta: Meta of the file.
        where: Name of the file in messages.

    Raises:
        RecordingError: Something is missing or not a number.
    """
    loops = np.asarray(arrays.get("loops", np.zeros(0)))
    if loops.ndim != 3 or loops.shape[1] < 5 or loops.shape[2] != 3:
        raise RecordingError(
            f"loops: has shape {list(loops.shape)}",
            where=where,
            fix="give [K, n, 3]: K repeats of n points, 5 at least",
        )
    loops = loops.astype(float)
    if not np.isfinite(loops).all():
        raise RecordingError("loops: holds numbers that are not finite", where=where)
    described = dict(meta.get("object") or {})
    if described.get("kind") not in ("rope", "wire"):
        raise RecordingError(
            f"object.kind: is {described.get('kind')!r}", where=where, fix="give rope or wire"
        )
    described["kind"] = "rope"
    numbers = {}
    for name in ("length", "mass_per_length"):
        value = described.get(name)
        if not (isinstance(value, int | float) and 0.0 < value < np.inf):
            raise RecordingError(
                f"object.{name}: is {value!r}", where=where, fix="give a number above 0, in SI"
            )
        numbers[name] = float(value)
    described["mass"] = numbers["length"] * numbers.pop("mass_per_length")
    described["grasp"] = "both ends"
    # the clamped ends are at their mean position over all repeats
    ends = loops[:, [0, -1]].mean(axis=0)
    axes = (loops[:, [1, -2]] - loops[:, [0, -1]]).mean(axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    K, n = loops.shape[:2]
    made = {
        "points": loops.reshape(-1, 3).astype(np.float32),
        "offsets": np.arange(K + 1) * n,
        "time": np.arange(K, dtype=float),
        "gripper_position": np.tile(ends, (K, 1, 1)),
        "gripper_axis": np.tile(axes, (K, 1, 1)),
    }
    rest = {k: v for k, v in meta.items() if k not in ("format", "object")}
    return made, {
        "format": "gendom-recording/1",
        "object": described,
        "table_height": None,
        "gripper_source": "measured",
        "quasi_static": True,
        "ordered_markers": True,
        "static": True,
        **rest,
    }
