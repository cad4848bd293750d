"""A cell, the arm in it and paths of its tool, drawn from the top and from the side."""

import math
from collections.abc import Mapping
from itertools import combinations, product

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gendom.arrays import Array
from gendom.hardware.cell import Cell
from gendom.robot import Post, arm_shape
from gendom.viz.animation import Animation, Layer
from gendom.viz.films import Stage
from gendom.viz.palette import INK

COLOURS = ("#0072B2", "#D55E00", "#009E73")
"""Of paths."""

_SIZE, _LINE = (900, 620), 0.002  # of a view [pixels]; half a line's thickness [m]
_VIEWS = {
    "from the top: x up, y left": (-0.5 * math.pi, 0.5 * math.pi),
    "from the side: x, z": (0, 0),
}
_FAINT_ARM, _ARM, _OBSTACLE, _SPACE = "#DEE2E8", "#96A0AF", "#D6AA8C", "#78B48C"


def draw_cell(cell: Cell, q: Array, paths: Mapping[str, Array] | None = None) -> Image.Image:
    """Two views, one above the other: from the top (x up, y left) and from the side.

    Args:
        cell: What stands there; boxes as their edges.
        q: [P, J] poses of the arm [rad]; all but the last are drawn thin and faint.
        paths: [N, 3] of the tool point, dots over all else [m], by what the legend calls them.

    Raises:
        ParameterError: The workspace is not finite.
    """
    layers = [_lines("workspace", _SPACE, _edges(*cell.workspace))]
    labels = {}
    for one in cell.surroundings.obstacles:
        if isinstance(one, Post):
            place, ends, radius = one.end, np.array([[one.start, one.end]]), one.radius
        else:
            ends = _edges(-0.5 * one.size, 0.5 * one.size) @ one.turn.T + one.position
            place, radius = one.position, _LINE
        labels[one.name] = place
        layers.append(_lines("", _OBSTACLE, ends, radius))
    for k, pose in enumerate(q):
        shape = arm_shape(cell.model, pose, cell.tool.max_opening)
        colour, share = (_ARM, 1.0) if k == len(q) - 1 else (_FAINT_ARM, 0.3)
        ends = np.stack([shape.start, shape.end], axis=1)
        layers.append(_lines("", colour, ends, share * shape.radius))
    for k, (name, path) in enumerate((paths or {}).items()):
        layers.append(_lines(name, COLOURS[k % len(COLOURS)], path, 2.0 * _LINE))
    shown = Animation(times=np.zeros(1), layers=tuple(layers), table_height=cell.table_height)
    views = [_drawn(Stage(shown, view, _SIZE, title), labels) for title, view in _VIEWS.items()]
    return Image.fromarray(np.concatenate(views))


def _lines(name: str, colour: str, ends: Array, radius: float | Array = _LINE) -> Layer:
    return Layer(name=name, color=colour, points=[ends], radius=radius)


def _edges(low: Array, high: Array) -> Array:
    """[12, 2, 3] of a box between two corners [m]."""
    corners = np.array([*product((0.0, 1.0), repeat=3)]) * np.subtract(high, low) + low
    along = [(a, b) for a, b in combinations(range(8), 2) if (a ^ b).bit_count() == 1]
    return corners[np.array(along)]


def _drawn(stage: Stage, labels: Mapping[str, Array]) -> Array:
    """A view with names and places of obstacles."""
    image, font = stage.draw(0), ImageFont.load_default(11)
    pen = ImageDraw.Draw(image)
    for k, (name, place) in enumerate(labels.items()):
        said = f"{name} ({', '.join(f'{x:.2f}' for x in place)})"
        x, y = stage.at(place)
        pen.text((x, y - 14 * (k % 3)), said, fill=INK, font=font, anchor="ms")
    return np.asarray(image)
