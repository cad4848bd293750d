"""A scene as a file of rerun (.rrd), to be opened with its viewer."""

from __future__ import annotations

import os

import numpy as np
import rerun as rr  # pyright: ignore[reportMissingImports]
import rerun.blueprint as rrb  # pyright: ignore[reportMissingImports]

from gendom.files import atomic_path
from gendom.viz.palette import TABLE_FILL, rgb
from gendom.viz.viewer.scene import PointLayer, ViewerScene

_APPLICATION = "gendom"


def write_rrd(path: str | os.PathLike, scene: ViewerScene, *, title: str) -> None:
    """Write a scene, whole or not at all: layers below ``world/``, curves below ``curves/``.

    Args:
        path: Ends in .rrd.
        scene: What is written, on the timeline ``time`` [s].
        title: Name of the recording.

    Raises:
        GendomError: As `gendom.files.atomic_path`.
    """
    with atomic_path(path) as temporary:
        stream = rr.RecordingStream(_APPLICATION)
        stream.save(temporary, default_blueprint=_blueprint(scene))
        stream.send_recording_name(title)
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, value in scene.facts:
            stream.log(["facts", name], rr.TextDocument(value), static=True)
        _log_table(stream, scene)
        for t, time in enumerate(scene.times):
            stream.set_time("time", duration=float(time))
            _log_frame(stream, scene, t)
        stream.flush()
        stream.disconnect()


def _log_frame(stream: rr.RecordingStream, scene: ViewerScene, t: int) -> None:
    for layer in scene.layers:
        if len(layer) == 1 and t > 0:
            continue
        if isinstance(layer, PointLayer):
            shape = rr.Points3D(layer.points[t], radii=layer.radius, colors=rgb(layer.color))
        else:
            shape = rr.Mesh3D(
                vertex_positions=layer.vertices[t],
                triangle_indices=layer.faces,
                albedo_factor=(*rgb(layer.color), round(255 * layer.opacity)),
            )
        stream.log(["world", layer.name], shape)
    for name, values in scene.curves.items():
        stream.log(["curves", name], rr.Scalars(float(values[t])))


def _log_table(stream: rr.RecordingStream, scene: ViewerScene) -> None:
    if scene.table_height is None:
        return
    low, high = scene.box
    margin = 0.2 * float((high - low)[:2].max())
    (x0, y0, _), (x1, y1, _) = low - margin, high + margin
    z = scene.table_height
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    table = rr.Mesh3D(
        vertex_positions=corners,
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        albedo_factor=TABLE_FILL,
    )
    stream.log("world/table", table, static=True)


def _blueprint(scene: ViewerScene) -> rrb.Blueprint:
    world = rrb.Spatial3DView(origin="world", name="world")
    if not scene.curves:
        return rrb.Blueprint(world)
    curves = rrb.TimeSeriesView(origin="curves", name="curves")
    return rrb.Blueprint(rrb.Vertical(world, curves, row_shares=[3, 1]))
