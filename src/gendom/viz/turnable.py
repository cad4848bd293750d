"""Clouds that the reader of a report can turn with the mouse."""

from __future__ import annotations

import base64
import json

import numpy as np

from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import RECORDED_COLOR

# Bytes of all points before base64; keeps a report below 3 MB.
_BUDGET = 420_000
_BYTES_A_POINT = 6
# The simulated colour on white at the opacity of the other pictures. Here dots lie over each
# other singly, and where many do, something transparent would become opaque.
_PALE_SIMULATED_COLOR = "#F2CA73"


def encode_scene(sequence: CloudSequence, *, fps: float = 12.0, max_frames: int = 60) -> str:
    """What `report.js` draws, as JSON that is safe inside a script element.

    Points are thinned to a few hundred kilobytes and rounded to 1 / 65535 of their box. The
    simulated particles that are left are the same in every frame.

    Args:
        sequence: The clouds.
        fps: Frames shown in a second.
        max_frames: With more frames than these, evenly spaced ones are shown.

    Raises:
        GendomError: The sequence has no points.
    """
    chosen = sequence.spread(max_frames)
    low, high = sequence.box()
    if sequence.table_height is not None:
        low[2] = min(low[2], sequence.table_height)
    high = np.maximum(high, low + 1e-3)
    per_frame = _BUDGET // (_BYTES_A_POINT * len(chosen))
    # Points are few in a recording and many in a simulation: what one leaves the other may use.
    counts = [len(sequence.recorded[t]) for t in chosen]
    keep_recorded = min(max(counts), per_frame if sequence.simulated is None else per_frame // 2)
    dot = 3.0 if keep_recorded < 400 else 1.8  # small, or a dense cloud would hide the other
    layers = [(sequence.recorded, keep_recorded, RECORDED_COLOR, dot)]
    if sequence.simulated is not None:
        keep = per_frame - keep_recorded
        layers.insert(0, (sequence.simulated, keep, _PALE_SIMULATED_COLOR, 4.0))
    packed, clouds, total = [], [], 0
    for frames, keep, color, size in layers:
        offsets = [total]
        for t in chosen:
            points = np.clip((_thin(frames[t], keep) - low) / (high - low), 0.0, 1.0)
            packed.append((65535.0 * points).round().astype("<u2"))
            total += len(points)
            offsets.append(total)
        clouds.append({"color": color, "size": size, "offsets": offsets})
    grippers = [] if sequence.gripper is None else sequence.gripper[chosen].round(5).tolist()
    return json.dumps(
        {
            "low": low.tolist(),
            "high": high.tolist(),
            "times": sequence.times[chosen].tolist(),
            "table": sequence.table_height,
            "grippers": grippers,
            "fps": fps,
            "clouds": clouds,
            "points": base64.b64encode(np.concatenate(packed).tobytes()).decode("ascii"),
        },
        separators=(",", ":"),
        allow_nan=False,
    )


def _thin(points: np.ndarray, keep: int) -> np.ndarray:
    """At most `keep` of the points; the same ones for the same number of points."""
    if len(points) <= keep:
        return points
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:keep])]
