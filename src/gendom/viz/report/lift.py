"""The section that shows the recorded and the simulated lift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gendom.viz.clouds import CloudSequence
from gendom.viz.playable import thinned
from gendom.viz.report.markup import escaped
from gendom.viz.report.page import Section
from gendom.viz.report.quantities import length_text
from gendom.viz.report.residuals import residual_charts
from gendom.viz.report.summary import EstimateSummary
from gendom.viz.report.viewer import scene_id, viewer
from gendom.viz.views import choose_view

_NAME = "lift"
_STRIP_FRAMES = 6
_STRIP_WIDTH = 240.0
_STRIP_POINTS = 300


@dataclass(frozen=True, kw_only=True)
class LiftPictures:
    """The recorded and the simulated lift."""

    clouds: CloudSequence
    view: str = "auto"
    """One of `gendom.viz.views.VIEWS`; "oblique" suits cloths."""
    note: str = ""
    """Text below the heading."""


def lift_section(lift: LiftPictures, summary: EstimateSummary | None = None) -> Section:
    """Film and 3D view with one slider, residuals over time, and a filmstrip.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    clouds = lift.clouds
    both = clouds.simulated is not None
    subject = "Recorded and simulated lift" if both else "Recorded lift"
    parts = [f"<p>{escaped(lift.note)}</p>"] if lift.note else []
    parts.append(viewer(clouds, name=_NAME, subject=subject, view=lift.view))
    parts.append(residual_charts(clouds, summary, scene_id(_NAME)))
    if clouds.num_frames > 1:
        parts.append(_filmstrip(clouds, lift.view))
    title = "The lift, recorded and simulated" if both else "The recorded lift"
    return Section(title=title, body="\n".join(part for part in parts if part))


def _filmstrip(clouds: CloudSequence, view: str) -> str:
    """Evenly spaced frames as drawings, which need no script and print well."""
    axes = choose_view(clouds, view).axes
    low, high = clouds.extent(axes)
    names = choose_view(clouds, view).names
    table = clouds.table_height if names and names[1] == "z" else None
    if table is not None:
        low[1] = min(low[1], table)
    span = np.maximum(high - low, 1e-3)
    low, span = low - 0.06 * span.max(), span + 0.12 * span.max()
    scale = _STRIP_WIDTH / span[0]
    height = min(scale * span[1], 1.3 * _STRIP_WIDTH)
    scale = min(scale, height / span[1])
    middle = low + span / 2.0

    def places(points: np.ndarray) -> np.ndarray:
        flat = (points @ axes.T - middle) * scale * np.array([1.0, -1.0])
        return flat + np.array([_STRIP_WIDTH, height]) / 2.0

    frames = []
    for t in clouds.spread(_STRIP_FRAMES):
        drawn = []
        if table is not None:
            y = height / 2.0 - (table - middle[1]) * scale
            drawn.append(f'<path class="ground" d="M0 {y:.1f}H{_STRIP_WIDTH:g}"/>')
        for kind, sequence, size in (
            ("simulated", clouds.simulated, 4),
            ("recorded", clouds.recorded, 2),
        ):
            if sequence is None:
                continue
            data = "".join(
                f"M{x:.1f} {y:.1f}h0" for x, y in places(thinned(sequence[t], _STRIP_POINTS))
            )
            drawn.append(f'<path class="{kind} dots" stroke-width="{size}" d="{data}"/>')
        if clouds.gripper is not None:
            for x, y in places(clouds.gripper[t]):
                drawn.append(f'<path class="ink line" d="M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"/>')
        said = f"{clouds.times[t]:.2f} s"
        label = f"Frame {t + 1} of {clouds.num_frames}"
        if clouds.chamfer is not None:
            said += f" · {length_text(float(clouds.chamfer[t]))}"
        frames.append(
            f'<li><svg class="plot" viewBox="0 0 {_STRIP_WIDTH:g} {height:.1f}" role="img" '
            f'aria-label="{label}">{"".join(drawn)}</svg><span>{escaped(said)}</span></li>'
        )
    caption = "Evenly spaced frames, first to last"
    caption += f"; blue: {clouds.labels[0]}, orange: {clouds.labels[1]}" if clouds.simulated else ""
    caption += "; cross: gripper" if clouds.gripper is not None else ""
    caption += "; with the time and the Chamfer distance." if clouds.chamfer is not None else "."
    return (
        f'<h3>Frame by frame</h3><figure><ul class="strip">{"".join(frames)}</ul>'
        f"<figcaption>{escaped(caption)}</figcaption></figure>"
    )
