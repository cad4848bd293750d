"""A scene drawn with viser: its layers, its table, and from where it is looked at."""

from __future__ import annotations

import math

import numpy as np
import viser

from gendom.viz.palette import TABLE_FILL, TABLE_LINE, nice_step, rgb
from gendom.viz.viewer.layers import Array, Layer, MeshLayer, PointLayer, ViewerScene

FIELD_OF_VIEW = math.radians(35.0)
"""The camera's field of view, upwards."""

_TURN, _TILT = math.radians(25.0), math.radians(18.0)
"""From where the camera looks, around and down."""

_NARROW = 0.8
"""Width over height of a window below which the panel lies below what is shown."""

_SQUARES = 10
"""Squares of the table's grid along the longer side of what is shown."""


class Painter:
    """Draws one scene after another, at one frame after another."""

    def __init__(self, canvas: viser.SceneApi):
        self._canvas = canvas
        self._handles: dict[str, viser.PointCloudHandle | viser.MeshHandle] = {}
        self._drawn: dict[str, Layer] = {}
        self._table: float | None = None
        self._hidden: set[str] = set()

    def paint(self, scene: ViewerScene, frame: int) -> None:
        """Show a frame of a scene; what another scene had and this one lacks goes."""
        layers = {layer.name: layer for layer in scene.layers}
        for name in self._handles.keys() - layers.keys():
            self._handles.pop(name).remove()
            del self._drawn[name]
        for layer in scene.layers:
            self._paint(layer, frame if len(layer) > 1 else 0)
        self._lay_table(scene)

    def show(self, name: str, visible: bool) -> None:
        """Show or hide a layer, now and in all scenes to come."""
        (self._hidden.discard if visible else self._hidden.add)(name)
        if name in self._handles:
            self._handles[name].visible = visible

    def _paint(self, layer: Layer, frame: int) -> None:
        handle, drawn = self._handles.get(layer.name), self._drawn.get(layer.name)
        if isinstance(layer, PointLayer):
            points = np.asarray(layer.points[frame], dtype=np.float32)
            if isinstance(handle, viser.PointCloudHandle):
                handle.points = points
            else:
                self._replace(layer, points)
        elif (
            isinstance(handle, viser.MeshHandle)
            and isinstance(drawn, MeshLayer)
            and np.array_equal(drawn.faces, layer.faces)
        ):
            if len(layer) > 1 or drawn is not layer:
                handle.vertices = layer.vertices[frame].astype(np.float32)
        else:
            self._replace(layer, layer.vertices[frame])
        self._drawn[layer.name] = layer

    def _replace(self, layer: Layer, points: Array) -> None:
        if layer.name in self._handles:
            self._handles.pop(layer.name).remove()
        visible = layer.name not in self._hidden
        if isinstance(layer, PointLayer):
            handle = self._canvas.add_point_cloud(
                f"/{layer.name}",
                points,
                rgb(layer.color),
                point_size=2.0 * layer.radius,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
                visible=visible,
            )
        else:
            handle = self._canvas.add_mesh_simple(
                f"/{layer.name}",
                points,
                layer.faces,
                color=rgb(layer.color),
                opacity=None if layer.opacity == 1.0 else layer.opacity,
                side="double",
                visible=visible,
            )
        self._handles[layer.name] = handle

    def _lay_table(self, scene: ViewerScene) -> None:
        """A table as large as what was shown first, in squares of a round size."""
        z = scene.table_height
        if z == self._table:
            return
        self._table = z
        if z is None:
            self._canvas.remove_by_name("/table")
            return
        step = square_size(scene)
        low = np.floor(scene.box[0, :2] / step - 2.0) * step
        high = np.ceil(scene.box[1, :2] / step + 2.0) * step
        (width, depth), (x, y) = (high - low).tolist(), (0.5 * (low + high)).tolist()
        self._canvas.add_grid(
            "/table",
            width=width,
            height=depth,
            cell_size=step,
            cell_color=(214, 214, 214),
            section_size=5.0 * step,
            section_color=TABLE_LINE,
            plane_color=TABLE_FILL,
            plane_opacity=0.7,
            position=(x, y, z),
        )


def square_size(scene: ViewerScene) -> float:
    """Side of the squares of a scene's table [m]."""
    low, high = scene.box
    return nice_step(float((high - low)[:2].max()) / _SQUARES)


def camera_of(scene: ViewerScene, aspect: float = 1.0) -> tuple[Array, Array]:
    """Where the camera stands and what it looks at, [3] each [m]: at the broad side of what is
    shown, from a little above.

    Args:
        scene: What is to be seen.
        aspect: Width over height of the picture.
    """
    low, high = scene.box
    middle, (x, y, _) = 0.5 * (low + high), high - low
    turn = (-0.5 * math.pi if x >= y else 0.0) + _TURN
    towards = np.array([math.cos(turn), math.sin(turn), 0.0])
    direction = math.cos(_TILT) * towards + math.sin(_TILT) * np.array([0.0, 0.0, 1.0])
    radius = 0.5 * float(np.linalg.norm(high - low)) + 1e-3
    away = 1.05 * radius / math.sin(0.5 * FIELD_OF_VIEW) / min(aspect, 1.0)
    if aspect < _NARROW:  # the panel covers the lower part
        middle = middle - [0.0, 0.0, 0.6 * away * math.tan(0.5 * FIELD_OF_VIEW)]
    return middle + away * direction, middle
