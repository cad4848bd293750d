"""What cameras saw: colour beside depth, a row a camera."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image

from gendom.errors import GendomError

_QUALITY = 80


def encode_sights(
    sights: Sequence[tuple[npt.NDArray[np.uint8], npt.NDArray[np.floating]]],
    *,
    width: int = 1280,
    near: float = 0.5,
    far: float = 1.3,
) -> bytes:
    """One JPEG: a row for each camera, colour on the left and depth on the right.

    Args:
        sights: Colour [height, width, 3] and depth [height, width] [m], 0 where there is none,
            of each camera; pictures of one size.
        width: Of the whole [pixels].
        near, far: Depths of the ends of the colour scale [m]; black is no depth.

    Raises:
        GendomError: There is no picture, or their sizes differ.
    """
    sizes = {colour.shape[:2] for colour, _ in sights} | {depth.shape for _, depth in sights}
    if len(sizes) != 1:
        raise GendomError(
            f"has pictures of {len(sizes)} sizes", where="sights", fix="give pictures of one size"
        )
    import matplotlib

    scale = matplotlib.colormaps["viridis_r"]
    rows = []
    for colour, depth in sights:
        share = np.clip((depth - near) / (far - near), 0.0, 1.0)
        painted = (255 * scale(share)[..., :3]).astype(np.uint8)
        painted[depth <= 0.0] = 0
        rows.append(np.concatenate([colour, painted], axis=1))
    whole = Image.fromarray(np.concatenate(rows))
    height = round(whole.height * width / whole.width)
    buffer = io.BytesIO()
    whole.resize((width, height), Image.Resampling.LANCZOS).save(
        buffer, "JPEG", quality=_QUALITY, optimize=True
    )
    return buffer.getvalue()
