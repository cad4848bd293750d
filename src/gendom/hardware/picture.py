"""A cell, the arm in it and paths of its tool, drawn from the top and from the side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gendom.hardware.cell import Cell
from gendom.robot import Box, arm_shape
from gendom.viz.palette import INK, SOFT_INK, TABLE_LINE, nice_step

WIDTH, MARGIN, FINER = 900, 50, 2
"""Of a view [pixels], and by how much finer it is drawn, for smooth edges."""

COLOURS = ("#0072B2", "#D55E00", "#009E73")
"""Of paths."""

_GRID = (225, 225, 225)
_ARM, _BOX, _SPACE = (150, 160, 175), (214, 170, 140), (120, 180, 140)


def draw_cell(
    cell: Cell,
    q: NDArray[np.float64],
    paths: Mapping[str, NDArray[np.float64]] | None = None,
) -> Image.Image:
    """Two views, one above the other: from the top (x up, y left) and from the side.

    Args:
        cell: What stands there.
        q: [P, J] poses of the arm [rad]; all but the last are drawn faintly.
        paths: [N, 3] of the tool point [m], by what the legend calls them.
    """
    paths = paths or {}
    views = (("from the top", (1, 0), (-1.0, 1.0)), ("from the side", (0, 2), (1.0, 1.0)))
    images = [_View(cell, name, axes, signs).draw(q, paths) for name, axes, signs in views]
    whole = Image.new("RGB", (WIDTH, sum(i.height for i in images)), "white")
    for k, image in enumerate(images):
        whole.paste(image, (0, sum(i.height for i in images[:k])))
    return whole


class _View:
    """One view: two axes of the base's frame."""

    def __init__(self, cell: Cell, name: str, axes: tuple[int, int], signs: tuple[float, float]):
        self.cell, self.name = cell, name
        self.axes, self.signs = list(axes), np.array(signs)
        points = [np.zeros((1, 3)), np.stack(cell.workspace)]
        for obstacle in cell.surroundings.obstacles:
            points.append(_corners(obstacle) if isinstance(obstacle, Box) else _ends(obstacle))
        flat = np.concatenate(points)[:, self.axes] * self.signs
        self.low, self.high = flat.min(axis=0) - 0.1, flat.max(axis=0) + 0.1
        self.scale = FINER * (WIDTH - 2 * MARGIN) / float((self.high - self.low)[0])
        height = int(self.scale * float((self.high - self.low)[1])) + 2 * FINER * MARGIN
        self.image = Image.new("RGB", (FINER * WIDTH, height), "white")
        self.pen = ImageDraw.Draw(self.image)

    def at(self, points: NDArray[np.float64]) -> list[tuple[float, float]]:
        flat = (np.atleast_2d(points)[:, self.axes] * self.signs - self.low) * self.scale
        edge = FINER * MARGIN
        return [(edge + u, self.image.height - edge - v) for u, v in flat]

    def text(self, at: tuple[float, float], said: str, size: float = 13.0, ink=INK) -> None:
        self.pen.text(at, said, fill=ink, font=ImageFont.load_default(FINER * size))

    def draw(self, q: NDArray[np.float64], paths: Mapping[str, NDArray[np.float64]]) -> Image.Image:
        self._grid()
        low, high = self.cell.workspace
        a, b = self.at(low)[0], self.at(high)[0]
        self.pen.rectangle(_sorted(a, b), outline=_SPACE, width=2 * FINER)
        self.text((min(a[0], b[0]) + 6, min(a[1], b[1]) + 4), "workspace", ink=_SPACE)
        table = self.cell.surroundings.table_height
        if 2 in self.axes and table is not None:
            y = self.at(np.array([0.0, 0.0, table]))[0][1]
            self.pen.line([(0, y), (self.image.width, y)], fill=TABLE_LINE, width=2 * FINER)
            self.text((self.image.width - 90 * FINER, y + 4), "table", ink=SOFT_INK)
        self._obstacles()  # behind the arm: a view from the side would hide it
        for pose in q[:-1]:
            self._arm(pose, (222, 226, 232))
        self._arm(q[-1], _ARM)
        for path, colour in zip(paths.values(), COLOURS * 9, strict=False):
            self.pen.line(self.at(path), fill=colour, width=2 * FINER)
            x, y = self.at(path[-1])[0]
            self.pen.ellipse([x - 7, y - 7, x + 7, y + 7], fill=colour)
        for k, (name, colour) in enumerate(zip(paths, COLOURS * 9, strict=False)):
            self.text((FINER * WIDTH - 300, 12 + 32 * k), name, ink=colour)
        self.text((20, 12), self.name, size=16.0)
        return self.image.resize((WIDTH, self.image.height // FINER), Image.Resampling.LANCZOS)

    def _grid(self) -> None:
        step = nice_step(float((self.high - self.low).max()) / 8.0)
        for k, axis in enumerate(self.axes):
            ends = sorted(float(e) * self.signs[k] for e in (self.low[k], self.high[k]))
            for value in np.arange(np.ceil(ends[0] / step), ends[1] / step) * step:
                at = np.zeros(3)
                at[axis] = value
                u, v = self.at(at)[0]
                line = [(u, 0), (u, self.image.height)] if k == 0 else [(0, v), (4000, v)]
                self.pen.line(line, fill=_GRID, width=FINER)
                said = f"{'xyz'[axis]} {value + 0.0:.1f}"
                spot = (u + 4, self.image.height - 38) if k == 0 else (6, v - 32)
                self.text(spot, said, size=11.0, ink=SOFT_INK)

    def _arm(self, q: NDArray[np.float64], colour: tuple[int, int, int]) -> None:
        shape = arm_shape(self.cell.model, q, self.cell.tool.max_opening)
        for start, end, radius in zip(shape.start, shape.end, shape.radius, strict=True):
            self._rod(start, end, float(radius), colour)

    def _rod(self, start, end, radius: float, colour: tuple[int, int, int]) -> None:
        r = radius * self.scale
        ends = self.at(np.array([start, end]))
        self.pen.line(ends, fill=colour, width=max(int(2 * r), 1))
        for x, y in ends:
            self.pen.ellipse([x - r, y - r, x + r, y + r], fill=colour)

    def _obstacles(self) -> None:
        for obstacle in self.cell.surroundings.obstacles:
            if isinstance(obstacle, Box):
                hull = _hull(self.at(_corners(obstacle)))
                self.pen.polygon(hull, fill=_BOX, outline=INK)
                at = hull[0]
            else:
                self._rod(obstacle.start, obstacle.end, obstacle.radius, _BOX)
                at = self.at(obstacle.end)[0]
            self.text((at[0] + 10, at[1] - 34), obstacle.name)


def _corners(box: Box) -> NDArray[np.float64]:
    signs = np.array(list(product((-0.5, 0.5), repeat=3)))
    return (signs * box.size) @ box.turn.T + box.position


def _ends(post) -> NDArray[np.float64]:
    return np.stack([post.start, post.end])


def _sorted(a: tuple[float, float], b: tuple[float, float]) -> list[float]:
    return [min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1])]


def _hull(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The convex hull of points of a picture, in order."""
    from scipy.spatial import ConvexHull

    array = np.array(points)
    return [tuple(array[k]) for k in ConvexHull(array, qhull_options="QJ").vertices]
