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

from gendom.arguments import require
from gendom.datasets.recording_form import FORMAT
from gendom.errors import RecordingError

FORMAT_STATIC = "gendom-static/1"


def recording_of_static(
    arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], where: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Convert a shape at rest, by the arrays and meta of its file, to those of a recording.

    Each repeat becomes a frame, one second after the previous one. Points are ordered markers, two
    grippers hold the ends, and `static` in the meta marks the recording as motionless.

    Raises:
        RecordingError: Something is missing or not a number.
    """

    def wanted(holds: bool, what: str, fix: str) -> None:
        require(holds, what, where=where, fix=fix, error=RecordingError)

    loops = np.asarray(arrays.get("loops", np.zeros(0)))
    right = loops.ndim == 3 and loops.shape[1] >= 5 and loops.shape[2] == 3
    fix = "give [K, n, 3]: K repeats of n points, 5 at least"
    wanted(right, f"loops: has shape {list(loops.shape)}", fix)
    loops = loops.astype(float)
    finite = bool(np.isfinite(loops).all())
    wanted(finite, "loops: holds numbers that are not finite", "give metres")
    described = dict(meta.get("object") or {})
    kind = described.get("kind")
    wanted(kind in ("rope", "wire"), f"object.kind: is {kind!r}", "give rope or wire")
    described["kind"] = "rope"
    for name in ("length", "mass_per_length"):
        value = described.get(name)
        right = isinstance(value, int | float) and 0.0 < value < np.inf
        wanted(right, f"object.{name}: is {value!r}", "give a number above 0, in SI")
    described["mass"] = described["length"] * described["mass_per_length"]
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
    usual = {"table_height": None, "gripper_source": "measured", "quasi_static": True}
    marked = {"ordered_markers": True, "static": True}
    return made, {**usual, **marked, **meta, "format": FORMAT, "object": described}
