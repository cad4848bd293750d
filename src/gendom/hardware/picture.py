"""A cell, the arm in it and paths of its tool, drawn from the top and from the side."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import ConvexHull

from gendom.arrays import Array
from gendom.hardware.cell import Cell
from gendom.robot import Box, Post, arm_shape
from gendom.viz.palette import INK, SOFT_INK, TABLE_LINE, nice_step

WIDTH, MARGIN, FINER = 900, 50, 2
"""Of a view [pixels], and by how much finer it is drawn, for smooth edges."""

COLOURS = ("#0072B2", "#D55E00", "#009E73")
"""Of paths."""

_GRID, _FAINT_ARM = (225, 225, 225), (222, 226, 232)
_ARM, _BOX, _SPACE = (150, 160, 175), (214, 170, 140), (120, 180, 140)


def draw_cell(cell: Cell, q: Array, paths: Mapping[str, Array] | None = None) -> Image.Image:
    """Two views, one above the other: from the top (x up, y left) and from the side.

    Args:
        cell: What stands there.
        q: [P, J] poses of the arm [rad]; all but the last are drawn faintly.
        paths: [N, 3] of the tool point [m], by what the legend calls them.
    """
    views = (("from the top", (1, 0), (-1.0, 1.0)), ("from the side", (0, 2), (1.0, 1.0)))
    images = [_View(cell, *view).draw(q, paths or {}) for view in views]
    whole = Image.new("RGB", (WIDTH, sum(i.height for i in images)), "white")
    for k, image in enumerate(images):
        whole.paste(image, (0, sum(i.height for i in images[:k])))
    return whole


class _View:
    """One view: two axes of the base's frame."""

    def __init__(self, cell: Cell, name: str, axes: tuple[int, int], signs: tuple[float, float]):
        self.cell, self.name = cell, name
        self.axes, self.signs = list(axes), np.array(signs)
        ends = [_ends(obstacle) for obstacle in cell.surroundings.obstacles]
        flat = np.concatenate([np.zeros((1, 3)), cell.workspace, *ends])[:, self.axes] * self.signs
        self.low, self.high = flat.min(axis=0) - 0.1, flat.max(axis=0) + 0.1
        wide, high = self.high - self.low
        self.scale = FINER * (WIDTH - 2 * MARGIN) / float(wide)
        size = (FINER * WIDTH, int(self.scale * high) + 2 * FINER * MARGIN)
        self.image = Image.new("RGB", size, "white")
        self.pen = ImageDraw.Draw(self.image)

    def at(self, points: Array) -> list[tuple[float, float]]:
        flat = (np.atleast_2d(points)[:, self.axes] * self.signs - self.low) * self.scale
        edge = FINER * MARGIN
        return [(edge + u, self.image.height - edge - v) for u, v in flat.tolist()]

    def text(self, x: float, y: float, said: str, size: float = 13.0, ink: Any = INK) -> None:
        self.pen.text((x, y), said, fill=ink, font=ImageFont.load_default(FINER * size))

    def draw(self, q: Array, paths: Mapping[str, Array]) -> Image.Image:
        self._grid()
        (left, right), (top, bottom) = map(sorted, zip(*self.at(self.cell.workspace), strict=True))
        self.pen.rectangle((left, top, right, bottom), outline=_SPACE, width=2 * FINER)
        self.text(left + 6, top + 4, "workspace", ink=_SPACE)
        if 2 in self.axes and self.cell.table_height is not None:
            ((_, y),) = self.at(np.array([0.0, 0.0, self.cell.table_height]))
            self.pen.line([(0, y), (self.image.width, y)], fill=TABLE_LINE, width=2 * FINER)
            self.text(self.image.width - 90 * FINER, y + 4, "table", ink=SOFT_INK)
        # Obstacles behind the arm: a view from the side would hide it.
        for obstacle in self.cell.surroundings.obstacles:
            self._obstacle(obstacle)
        for k, pose in enumerate(q):
            shape = arm_shape(self.cell.model, pose, self.cell.tool.max_opening)
            for start, end, radius in zip(shape.start, shape.end, shape.radius, strict=True):
                ends = np.array([start, end])
                self._line(ends, _ARM if k == len(q) - 1 else _FAINT_ARM, radius * self.scale)
        for k, (name, path) in enumerate(paths.items()):
            colour = COLOURS[k % len(COLOURS)]
            self._line(path, colour, FINER)
            self._line(path[-1:], colour, 7)
            self.text(FINER * WIDTH - 300, 12 + 32 * k, name, ink=colour)
        self.text(20, 12, self.name, size=16.0)
        return self.image.resize((WIDTH, self.image.height // FINER), Image.Resampling.LANCZOS)

    def _line(self, points: Array, colour: Any, radius: float) -> None:
        """A line, round at its ends."""
        places = self.at(points)
        self.pen.line(places, fill=colour, width=max(int(2 * radius), 1))
        for x, y in (places[0], places[-1]):
            self.pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=colour)

    def _grid(self) -> None:
        step = nice_step(float((self.high - self.low).max()) / 8.0)
        for k, axis in enumerate(self.axes):
            ends = sorted(float(e) * self.signs[k] for e in (self.low[k], self.high[k]))
            for value in np.arange(np.ceil(ends[0] / step), ends[1] / step) * step:
                ((u, v),) = self.at(value * np.eye(3)[axis])
                line = [(u, 0), (u, self.image.height)] if k == 0 else [(0, v), (4000, v)]
                self.pen.line(line, fill=_GRID, width=FINER)
                spot = (u + 4, self.image.height - 38) if k == 0 else (6, v - 32)
                self.text(*spot, f"{'xyz'[axis]} {value + 0.0:.1f}", size=11.0, ink=SOFT_INK)

    def _obstacle(self, obstacle: Box | Post) -> None:
        if isinstance(obstacle, Post):
            self._line(_ends(obstacle), _BOX, obstacle.radius * self.scale)
            x, y = self.at(obstacle.end)[0]
        else:
            corners = np.array(self.at(_ends(obstacle)))
            hull = corners[ConvexHull(corners, qhull_options="QJ").vertices]
            self.pen.polygon([*map(tuple, hull.tolist())], fill=_BOX, outline=INK)
            x, y = hull[0]
        self.text(x + 10, y - 34, obstacle.name)


def _ends(obstacle: Box | Post) -> Array:
    """Ends of a post's axis, or corners of a box, [N, 3] [m]."""
    if isinstance(obstacle, Post):
        return np.stack([obstacle.start, obstacle.end])
    signs = np.array(list(product((-0.5, 0.5), repeat=3)))
    return (signs * obstacle.size) @ obstacle.turn.T + obstacle.position
