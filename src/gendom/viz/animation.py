"""Animations of a recorded and a simulated cloud."""

from __future__ import annotations

import io
import os

from gendom.errors import GendomError
from gendom.files import atomic_path
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import with_palette
from gendom.viz.stage import Stage


def encode_gif(
    clouds: CloudSequence,
    *,
    fps: float = 12.0,
    max_frames: int = 60,
    view: str = "auto",
    width: int = 640,
) -> bytes:
    """Both clouds over each other, frame by frame, as a GIF that repeats for ever.

    Args:
        clouds: What is drawn.
        fps: Frames shown in a second; GIF knows only whole hundredths of a second a frame.
        max_frames: With more frames than these, evenly spaced ones are shown.
        view: One of `gendom.viz.views.VIEWS`; "oblique" suits cloths.
        width: Width of the picture [pixels].

    Raises:
        GendomError: As `gendom.viz.views.choose_view`; or there are no points, or `fps` is not
            in 1 to 50, or `max_frames` below 1.
    """
    if not 1.0 <= fps <= 50.0:
        raise GendomError(f"is {fps:g}", where="fps", fix="give 1 to 50 frames a second")
    chosen = clouds.spread(max_frames)
    stage = Stage(clouds, view=view, width=width)
    images = [with_palette(stage.draw(t)) for t in chosen]
    hundredths = max(2, round(100.0 / fps))
    durations = [10 * hundredths] * len(images)
    durations[-1] += 1000  # time to look at the end
    buffer = io.BytesIO()
    # Left in place, a frame stores only the rectangle that changes.
    images[0].save(
        buffer,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        disposal=1,
        optimize=False,
    )
    return buffer.getvalue()


def write_gif(
    path: str | os.PathLike,
    clouds: CloudSequence,
    *,
    fps: float = 12.0,
    max_frames: int = 60,
    view: str = "auto",
    width: int = 640,
) -> None:
    """Write the animation of `encode_gif`, which explains the arguments, atomically.

    Raises:
        GendomError: As `encode_gif` and `gendom.files.atomic_path`.
    """
    data = encode_gif(clouds, fps=fps, max_frames=max_frames, view=view, width=width)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
