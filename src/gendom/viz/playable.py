"""What a report's viewer plays: clouds, arm and goal of all frames, packed as JSON."""

from __future__ import annotations

import base64
import json

import numpy as np

from gendom.viz.clouds import CloudSequence
from gendom.viz.views import choose_view

# Bytes of all points before base64; two viewers then fit into a report of 2 MB.
_BUDGET = 420_000
_BYTES_A_POINT = 6


def encode_scene(sequence: CloudSequence, *, view: str = "auto", max_frames: int = 60) -> str:
    """What `viewer.js` draws, as JSON that is safe inside a script element.

    Points are thinned to a few hundred kilobytes and rounded to 1 / 65535 of their box. The
    simulated particles that are left are the same in every frame. The arm is rounded to
    millimetres.

    Args:
        sequence: The clouds.
        view: From where the film looks, one of `gendom.viz.views.VIEWS`.
        max_frames: With more frames than these, evenly spaced ones are shown.

    Raises:
        GendomError: The sequence has no points, or the view is unknown.
    """
    chosen = sequence.spread(max_frames)
    low, high = sequence.box()
    if sequence.goal is not None:
        low = np.minimum(low, sequence.goal.min(axis=0))
        high = np.maximum(high, sequence.goal.max(axis=0))
    high = np.maximum(high, low + 1e-3)
    per_frame = _BUDGET // (_BYTES_A_POINT * len(chosen))
    # Points are few in a recording and many in a simulation: what one leaves the other may use.
    counts = [len(sequence.recorded[t]) for t in chosen]
    keep_recorded = min(max(counts), per_frame if sequence.simulated is None else per_frame // 2)
    dot = 3.2 if keep_recorded < 400 else 2.2  # small, or a dense cloud would hide the other
    layers = [("recorded", sequence.labels[0], sequence.recorded, keep_recorded, dot)]
    if sequence.simulated is not None:
        keep = per_frame - keep_recorded
        layers.insert(0, ("simulated", sequence.labels[1], sequence.simulated, keep, 4.4))
    packed, clouds, total = [], [], 0
    for kind, label, frames, keep, size in layers:
        offsets = [total]
        for t in chosen:
            points = np.clip((thinned(frames[t], keep) - low) / (high - low), 0.0, 1.0)
            packed.append((65535.0 * points).round().astype("<u2"))
            total += len(points)
            offsets.append(total)
        clouds.append({"kind": kind, "label": label, "size": size, "offsets": offsets})
    side = choose_view(sequence, view)
    arm = None
    if sequence.arm is not None and sequence.arm_radius is not None:
        ends = (1e3 * sequence.arm[chosen]).round().astype(int)
        arm = {
            "radius": (1e3 * sequence.arm_radius).round().astype(int).tolist(),
            "ends": ends.reshape(len(chosen), -1).tolist(),
        }
    return json.dumps(
        {
            "low": low.tolist(),
            "high": high.tolist(),
            "times": sequence.times[chosen].round(5).tolist(),
            "frames": [t + 1 for t in chosen],
            "of": sequence.num_frames,
            "chamfer": None if sequence.chamfer is None else sequence.chamfer[chosen].tolist(),
            "table": sequence.table_height,
            "view": {"turn": side.turn, "tilt": side.tilt, "names": side.names},
            "grippers": (
                [] if sequence.gripper is None else sequence.gripper[chosen].round(5).tolist()
            ),
            "arm": arm,
            "goal": None if sequence.goal is None else sequence.goal.round(5).tolist(),
            "clouds": clouds,
            "points": base64.b64encode(np.concatenate(packed).tobytes()).decode("ascii"),
        },
        separators=(",", ":"),
        allow_nan=False,
    ).replace("<", "\\u003c")


def thinned(points: np.ndarray, keep: int) -> np.ndarray:
    """At most `keep` of the points; the same ones for the same number of points."""
    if len(points) <= keep:
        return points
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:keep])]
