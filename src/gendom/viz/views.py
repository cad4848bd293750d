"""Clouds in three views, for a look at what was recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gendom.viz.palette import INK, RECORDED_COLOR, SIMULATED_COLOR, TABLE_LINE, nice_step, rgb

_SIDE, _MARGIN = 420, 40  # of a view [pixels]
_MOST = 20_000  # points drawn of a cloud
_FIRST, _LAST = rgb("#BBBBBB"), rgb(RECORDED_COLOR)
_VIEWS = (("from the top", 0, 1), ("from the front", 0, 2), ("from the side", 1, 2))


def draw_views(
    clouds: Sequence[NDArray[np.floating]],
    *,
    gripper: NDArray[np.floating] | None = None,
    table: float | None = None,
) -> Image.Image:
    """From the top (x right, y up), the front (x, z) and the side (y, z), one beside the other.

    Args:
        clouds: [n, 3] in the order of time [m], the first grey, the last blue.
        gripper: [M, 3] its path [m], orange.
        table: z of the table [m], a line.
    """
    path = np.zeros((0, 3)) if gripper is None else gripper
    points = np.concatenate([*clouds, path])
    points = points if len(points) else np.zeros((1, 3))
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    low, high = (
        np.minimum(low, path.min(axis=0, initial=np.inf)),
        np.maximum(high, path.max(axis=0, initial=-np.inf)),
    )
    middle, reach = 0.5 * (low + high), max(float((high - low).max()), 0.05)
    scale = (_SIDE - 2 * _MARGIN) / reach
    whole = Image.new("RGB", (3 * _SIDE, _SIDE), "white")
    for k, (name, u, v) in enumerate(_VIEWS):
        image = Image.new("RGB", (_SIDE, _SIDE), "white")
        pen = ImageDraw.Draw(image)

        def placed(p: NDArray[np.floating], u: int = u, v: int = v) -> NDArray[np.floating]:
            return np.stack(
                [
                    _SIDE / 2 + scale * (p[:, u] - middle[u]),
                    _SIDE / 2 - scale * (p[:, v] - middle[v]),
                ],
                axis=1,
            )

        if table is not None and v == 2:
            y = _SIDE / 2 - scale * (table - middle[2])
            pen.line([(0, y), (_SIDE, y)], fill=TABLE_LINE)
        for n, cloud in enumerate(clouds):
            share = n / max(len(clouds) - 1, 1)
            colour = tuple(
                int((1 - share) * a + share * b) for a, b in zip(_FIRST, _LAST, strict=True)
            )
            thinned = cloud[:: max(1, len(cloud) // _MOST)]
            pen.point([(float(x), float(y)) for x, y in placed(thinned)], fill=colour)
        if len(path) > 1:
            way = [(float(x), float(y)) for x, y in placed(path)]
            pen.line(way, fill=rgb(SIMULATED_COLOR), width=2)
        step = nice_step(reach / 4)
        pen.line([(12, _SIDE - 14), (12 + scale * step, _SIDE - 14)], fill=INK, width=2)
        pen.text((12, _SIDE - 30), f"{step:g} m", fill=INK)
        pen.text((12, 8), f"{name}: {'xyz'[u]} to the right, {'xyz'[v]} up", fill=INK)
        whole.paste(image, (k * _SIDE, 0))
    return whole
