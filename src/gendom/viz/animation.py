"""Animations of a recorded and a simulated cloud."""

from __future__ import annotations

import io
import os

import numpy.typing as npt

from gendom.errors import GendomError
from gendom.files import atomic_path
from gendom.viz.clouds import Clouds, CloudSequence, Stage, make_sequence, with_palette


def write_gif(
    path: str | os.PathLike,
    recorded: Clouds,
    simulated: Clouds | None,
    *,
    times: npt.ArrayLike,
    table_height: float | None,
    gripper: npt.ArrayLike | None,
    chamfer: npt.ArrayLike | None = None,
    fps: float = 12.0,
    max_frames: int = 60,
    view: str = "auto",
    width: int = 640,
) -> None:
    """Write the animation of `encode_gif`, which explains the arguments, atomically.

    Raises:
        GendomError: As `encode_gif` and `gendom.files.atomic_path`.
    """
    sequence = make_sequence(recorded, simulated, times, table_height, gripper, chamfer)
    data = animate(sequence, fps=fps, max_frames=max_frames, view=view, width=width)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def encode_gif(
    recorded: Clouds,
    simulated: Clouds | None,
    *,
    times: npt.ArrayLike,
    table_height: float | None,
    gripper: npt.ArrayLike | None,
    chamfer: npt.ArrayLike | None = None,
    fps: float = 12.0,
    max_frames: int = 60,
    view: str = "auto",
    width: int = 640,
) -> bytes:
    """Both clouds over each other, frame by frame, as a GIF that repeats for ever.

    Args:
        recorded: T clouds [n_t, 3] [m].
        simulated: T clouds [m_t, 3], or [T, m, 3] [m]; None: only the recording.
        times: [T] [s].
        table_height: z of the table [m]; None: no table.
        gripper: [T, G, 3] [m], or None.
        chamfer: [T] Chamfer distance [m], written above the frames.
        fps: Frames shown in a second; GIF knows only whole hundredths of a second a frame.
        max_frames: With more frames than these, evenly spaced ones are shown.
        view: One of `gendom.viz.clouds.VIEWS`; "oblique" suits cloths.
        width: Width of the picture [pixels].

    Raises:
        GendomError: As `gendom.viz.clouds.CloudSequence` and `choose_view`; or `fps` is not in
            1 to 50, or `max_frames` below 1.
    """
    sequence = make_sequence(recorded, simulated, times, table_height, gripper, chamfer)
    return animate(sequence, fps=fps, max_frames=max_frames, view=view, width=width)


def animate(
    sequence: CloudSequence, *, fps: float, max_frames: int, view: str, width: int
) -> bytes:
    """`encode_gif` of a sequence."""
    if not 1.0 <= fps <= 50.0:
        raise GendomError(f"is {fps:g}", where="fps", fix="give 1 to 50 frames a second")
    chosen = sequence.spread(max_frames)
    stage = Stage(sequence, view=view, width=width)
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
