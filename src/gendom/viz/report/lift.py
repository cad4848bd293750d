"""The section of the lift: a film and a view that turns, driven by one slider (`viewer.js` brings
them to life), and residuals over time."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from gendom.viz.charts import Axis, Plot
from gendom.viz.clouds import CloudSequence, choose_view
from gendom.viz.report.markup import Section, escaped, side_by_side
from gendom.viz.report.summary import EstimateSummary

# Bytes of all points before base64; two viewers then fit into a report of 2 MB.
_BUDGET = 420_000
_BYTES_A_POINT = 6

_FRAMES = 60
"""With more frames than these, evenly spaced ones are shown."""

_UNHURRIED = 3.0  # seconds; a shorter motion is played slowly at first
_SPEEDS = (("1", "real time"), ("0.5", "half speed"), ("0.25", "quarter speed"))


@dataclass(frozen=True, kw_only=True)
class LiftPictures:
    """The recorded and the simulated lift."""

    clouds: CloudSequence
    view: str = "auto"
    """One of `gendom.viz.clouds.VIEWS`; "oblique" suits cloths."""
    note: str = ""
    """Text below the heading."""


def lift_section(lift: LiftPictures, summary: EstimateSummary | None = None) -> Section:
    """Film and 3D view with one slider, and residuals over time.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    clouds = lift.clouds
    both = clouds.simulated is not None
    subject = "Recorded and simulated lift" if both else "Recorded lift"
    parts = [f"<p>{escaped(lift.note)}</p>"] if lift.note else []
    parts.append(viewer(clouds, name="lift", subject=subject, view=lift.view))
    parts.append(side_by_side(_residual_charts(clouds, summary)))
    title = "The lift, recorded and simulated" if both else "The recorded lift"
    return Section(title=title, body="\n".join(part for part in parts if part))


def viewer(clouds: CloudSequence, *, name: str, subject: str, view: str = "auto") -> str:
    """Hidden until the script runs, so that a page without scripts has no dead buttons.

    Args:
        clouds: What is played.
        name: Of this viewer in the page, a word.
        subject: What is seen; plain text.
        view: From where the film looks, one of `gendom.viz.clouds.VIEWS`.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    duration = float(clouds.times[-1] - clouds.times[0])
    first = next((v for v, _ in _SPEEDS if duration / float(v) >= _UNHURRIED), _SPEEDS[-1][0])
    speeds = "".join(
        f'<option value="{value}"{" selected" if value == first else ""}>{said}</option>'
        for value, said in _SPEEDS
    )
    recorded, simulated = map(escaped, clouds.labels)
    layers = [
        ("recorded", recorded, "dot", clouds.recorded),
        ("simulated", simulated, "dot", clouds.simulated),
        ("arm", "arm", "area", clouds.arm),
        ("goal", "goal", "ring", clouds.goal),
    ]
    options = "".join(
        f'<label><input type="checkbox" data-layer="{kind}" checked>'
        f'<i class="{kind} key {shape}"></i>{label}</label>'
        for kind, label, shape, shown in layers
        if shown is not None
    )
    if clouds.simulated is not None:
        options += (
            f'<label>{recorded} <input type="range" class="fade" min="-1" max="1" step="0.05" '
            f'value="0" aria-label="Fade from {recorded} to {simulated}"> {simulated}</label>'
        )
    where = "from above at an angle" if view == "oblique" else "from the side"
    said = escaped(subject)
    kind = "viewer" if clouds.num_frames > 1 else "viewer still"
    return (
        f'<div class="{kind}" id="{name}" data-scene="{name}-scene" hidden>'
        '<div class="screens">'
        f'<figure><canvas class="film" role="img" aria-label="{said}, {where}"></canvas>'
        f"<figcaption>Film {where}</figcaption></figure>"
        f'<figure><canvas class="turning" tabindex="0" role="img" aria-label="{said}; drag or use '
        'the arrow keys to turn it"></canvas>'
        "<figcaption>3D view: drag it, or use the arrow keys, to turn it</figcaption></figure>"
        '</div><div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" class="time" min="0" value="0" aria-label="Time"><output></output>'
        f'<select class="speed" aria-label="Speed">{speeds}</select></div>'
        f'<div class="options">{options}</div></div>'
        f'<script type="application/json" id="{name}-scene">'
        f"{encode_scene(clouds, view=view)}</script>"
    )


def encode_scene(sequence: CloudSequence, *, view: str = "auto") -> str:
    """What `viewer.js` draws, as JSON that is safe inside a script element.

    Points are thinned to a few hundred kilobytes and rounded to 1 / 65535 of their box. The
    simulated particles that are left are the same in every frame. The arm is rounded to
    millimetres.

    Raises:
        GendomError: The sequence has no points, or the view is unknown.
    """
    chosen = sequence.spread(_FRAMES)
    low, high = sequence.box()
    if sequence.goal is not None:
        low = np.minimum(low, sequence.goal.min(axis=0))
        high = np.maximum(high, sequence.goal.max(axis=0))
    high = np.maximum(high, low + 1e-3)
    clouds, points = _packed(sequence, chosen, low, high)
    side, grippers, chamfer = choose_view(sequence, view), sequence.gripper, sequence.chamfer
    arm, aside = None, 0.5
    if sequence.arm is not None and sequence.arm_radius is not None:
        ends = (1e3 * sequence.arm[chosen]).round().astype(int)
        arm = {
            "radius": (1e3 * sequence.arm_radius).round().astype(int).tolist(),
            "ends": ends.reshape(len(chosen), -1).tolist(),
        }
        # the view that turns begins where the arm stands behind the object
        away = sequence.arm[chosen[0]].mean(axis=(0, 1)) - 0.5 * (low + high)
        aside = -0.5 if away[:2] @ [np.cos(side.turn), np.sin(side.turn)] > 0.0 else 0.5
    scene = {
        "low": low.tolist(),
        "high": high.tolist(),
        "times": sequence.times[chosen].round(5).tolist(),
        "frames": [t + 1 for t in chosen],
        "of": sequence.num_frames,
        "chamfer": None if chamfer is None else chamfer[chosen].tolist(),
        "table": sequence.table_height,
        "view": {"turn": side.turn, "tilt": side.tilt, "aside": aside},
        "grippers": [] if grippers is None else grippers[chosen].round(5).tolist(),
        "arm": arm,
        "goal": None if sequence.goal is None else sequence.goal.round(5).tolist(),
        "clouds": clouds,
        "points": base64.b64encode(points.tobytes()).decode("ascii"),
    }
    return json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _packed(
    sequence: CloudSequence, chosen: list[int], low: np.ndarray, high: np.ndarray
) -> tuple[list[dict[str, Any]], np.ndarray]:
    """What each cloud is and where its frames begin, and the points [n, 3] of all, 0 to 65535
    between two corners."""
    per_frame = _BUDGET // (_BYTES_A_POINT * len(chosen))
    # Points are few in a recording and many in a simulation: what one leaves the other may use.
    counts = [len(sequence.recorded[t]) for t in chosen]
    keep = min(max(counts), per_frame if sequence.simulated is None else per_frame // 2)
    dot = 3.2 if keep < 400 else 2.2  # small, or a dense cloud would hide the other
    layers = [("recorded", sequence.recorded, keep, dot)]
    if sequence.simulated is not None:
        layers.insert(0, ("simulated", sequence.simulated, per_frame - keep, 4.4))
    packed, clouds, total = [], [], 0
    for kind, frames, keep, size in layers:
        offsets = [total]
        for t in chosen:
            points = np.clip((_thinned(frames[t], keep) - low) / (high - low), 0.0, 1.0)
            packed.append((65535.0 * points).round().astype("<u2"))
            total += len(points)
            offsets.append(total)
        clouds.append({"kind": kind, "size": size, "offsets": offsets})
    return clouds, np.concatenate(packed)


def _thinned(points: np.ndarray, keep: int) -> np.ndarray:
    """At most `keep` of the points; the same ones for the same number of points."""
    if len(points) <= keep:
        return points
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:keep])]


def _residual_charts(clouds: CloudSequence, summary: EstimateSummary | None) -> list[str]:
    """Distances of both clouds over time, as far as they are known for these frames."""
    residuals = {
        "Points to simulated surface [mm]": (
            None if summary is None else summary.values.get("rms_by_frame"),
            "Distance of recorded points from the simulated surface, root mean square in each "
            "frame that was compared.",
        ),
        "Chamfer distance of both clouds [mm]": (
            clouds.chamfer,
            "Mean distance from each recorded point to the nearest simulated one, plus the mean "
            "distance the other way round. Cameras see one side of the object only, so it is not "
            "zero even for a perfect fit.",
        ),
    }
    figures = []
    for title, (distance, said) in residuals.items():
        if distance is None or not len(distance) == clouds.num_frames > 1:
            continue
        times, shown = clouds.times, 1e3 * np.asarray(distance, dtype=float)
        plot = Plot(
            x=Axis(low=float(times[0]), high=float(times[-1]), label="time [s]"),
            y=Axis(low=0.0, high=1.15 * max(float(shown.max()), 1e-6)),
        )
        plot.area(times, shown, "recorded")
        plot.line(times, shown, "recorded")
        plot.level(float(shown.mean()), "soft", f"mean {shown.mean():.1f} mm")
        plot.cursor("lift-scene")
        figures.append(plot.figure(title, said))
    return figures
