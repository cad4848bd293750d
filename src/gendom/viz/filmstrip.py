"""Several frames of a recorded and a simulated cloud side by side."""

from __future__ import annotations

import io
import math
import os

from PIL import Image

from gendom.errors import GendomError
from gendom.files import atomic_path
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import with_palette
from gendom.viz.stage import Stage


def encode_filmstrip(
    clouds: CloudSequence,
    *,
    frames: int = 6,
    columns: int = 3,
    view: str = "auto",
    width: int = 1600,
) -> bytes:
    """Several frames side by side, as a PNG.

    Args:
        clouds: What is drawn.
        frames: Number of frames; evenly spaced, with the first and the last.
        columns: Frames in a row.
        view: One of `gendom.viz.views.VIEWS`.
        width: Width of the picture [pixels].

    Raises:
        GendomError: As `gendom.viz.views.choose_view`; or there are no points, or a number is
            below 1.
    """
    if columns < 1:
        raise GendomError(f"is {columns}", where="columns", fix="give 1 or more")
    chosen = clouds.spread(frames)
    columns = min(columns, len(chosen))
    stage = Stage(clouds, view=view, width=width // columns, compact=True)
    panel_width, panel_height = stage.size
    rows = math.ceil(len(chosen) / columns)
    sheet = Image.new("RGB", (panel_width * columns, panel_height * rows), "white")
    for i, t in enumerate(chosen):
        sheet.paste(stage.draw(t), (i % columns * panel_width, i // columns * panel_height))
    buffer = io.BytesIO()
    with_palette(sheet).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def write_filmstrip(
    path: str | os.PathLike,
    clouds: CloudSequence,
    *,
    frames: int = 6,
    columns: int = 3,
    view: str = "auto",
    width: int = 1600,
) -> None:
    """Write the PNG of `encode_filmstrip`, which explains the arguments, atomically.

    Raises:
        GendomError: As `encode_filmstrip` and `gendom.files.atomic_path`.
    """
    data = encode_filmstrip(clouds, frames=frames, columns=columns, view=view, width=width)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
