"""The section that shows the recorded and the simulated lift."""

from __future__ import annotations

from dataclasses import dataclass

from gendom.viz.animation import encode_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.filmstrip import encode_filmstrip
from gendom.viz.report.markup import escaped, figure, image
from gendom.viz.report.page import Section
from gendom.viz.turnable import encode_scene

# Bytes of the animation before base64; with more, fewer frames are shown.
_MAX_GIF = 1_200_000


@dataclass(frozen=True, kw_only=True)
class LiftPictures:
    """The recorded and the simulated lift."""

    clouds: CloudSequence
    view: str = "auto"
    """One of `gendom.viz.views.VIEWS`; "oblique" suits cloths."""
    fps: float = 12.0
    """Frames of the animation shown in a second."""
    note: str = ""
    """Text below the heading."""


def lift_section(lift: LiftPictures) -> Section:
    """Animation, clouds that can be turned, and a filmstrip.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    clouds = lift.clouds
    both = clouds.simulated is not None
    subject = "Recorded and simulated lift" if both else "Recorded lift"
    parts = [f"<p>{escaped(lift.note)}</p>"] if lift.note else []
    moving = animated_figure(clouds, subject, view=lift.view, fps=lift.fps)
    parts.append(f'<div class="pair">{moving}{_viewer(clouds, lift.fps)}</div>')
    strip = encode_filmstrip(clouds, frames=6, columns=3, view=lift.view, width=1600)
    caption = "Evenly spaced frames, first to last. "
    caption += "Blue: recorded. Orange: simulated. " if both else ""
    caption += "Cross: gripper." if clouds.gripper is not None else ""
    parts.append(figure(strip, f"{subject}, six frames", caption, kind="png"))
    title = "The lift, recorded and simulated" if both else "The recorded lift"
    return Section(title=title, body="\n".join(parts))


def animated_figure(clouds: CloudSequence, subject: str, *, view: str, fps: float) -> str:
    """An animation that is not too large for a page, and how long it is.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    gif, max_frames = b"", 60
    for max_frames in (60, 40, 25, 12):
        gif = encode_gif(clouds, fps=fps, max_frames=max_frames, view=view, width=640)
        if len(gif) <= _MAX_GIF:
            break
    duration = float(clouds.times[-1] - clouds.times[0])
    shown = len(clouds.spread(max_frames))
    caption = f"{clouds.num_frames} frames over {duration:.3g} s"
    caption += f", shown in {shown / fps:.2g} s." if shown > 1 else "."
    return (
        f'<figure class="moving">{image(gif, "gif", f"{subject}, animated")}'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _viewer(clouds: CloudSequence, fps: float) -> str:
    """What `report.js` brings to life; once in a page, as it is found by its id."""
    return (
        '<figure class="viewer" id="viewer" hidden>'
        '<canvas role="img" aria-label="The clouds of one frame; drag to turn them"></canvas>'
        '<div class="controls"><button type="button">Play</button>'
        '<input type="range" min="0" value="0" aria-label="Frame"><output></output></div>'
        "<figcaption>The same, thinned out: drag to turn it, move the slider through the "
        "frames.</figcaption></figure>"
        f'<script type="application/json" id="scene">{encode_scene(clouds, fps=fps)}</script>'
    )
