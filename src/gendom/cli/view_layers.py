"""Layers that recordings and demonstrations have in common in the viewer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gendom.robot import Arm, arm_shape
from gendom.sim import Body
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.viz.palette import INK, SIMULATED_COLOR
from gendom.viz.viewer import MeshLayer, capsules, tube_faces

ARM_COLOR = "#d0d0d0"

RING = 8
"""Points of a rod's skin around its centre line, see `gendom.sim.Body.surface`."""

_Array = NDArray[np.floating]


def object_layer(
    name: str,
    body: Body,
    points: _Array,
    lattice: tuple[int, int] | None,
    opacity: float = 1.0,
) -> MeshLayer:
    """A simulated rope or cloth.

    Args:
        name: Of the layer.
        body: The object.
        points: [T, n, 3] a rope's centre line, or a cloth's middle surface, row by row [m].
        lattice: A cloth's rows and points in a row; None: a rope.
        opacity: Below 1 where something else is to be seen through it.
    """
    if lattice is not None:
        vertices, faces = points, lattice_triangles(*lattice)
    elif points.shape[1] == len(body.points):
        vertices = body.surface(points)
        faces = tube_faces(vertices.shape[1] // RING, RING)
    else:  # the sections of particles
        links = np.stack([points[:, :-1], points[:, 1:]], axis=-2)
        vertices, faces = capsules(links, np.full(links.shape[1], 0.5 * body.thickness))
    return MeshLayer(
        name=name,
        color=SIMULATED_COLOR,
        vertices=vertices,
        faces=faces,
        opacity=opacity,
    )


def gripper_layer(position: _Array, size: float, axis: _Array | None = None) -> MeshLayer:
    """Grippers as sticks that stand on what they hold, and a bar along the object at the clamp.

    Args:
        position: [T, G, 3] where they hold it [m].
        size: Of the object [m].
        axis: [T, G, 3] unit vectors along the object at the clamps; None: unknown.
    """
    up = np.array([0.0, 0.0, 0.15 * size])
    ends = [np.stack([position, position + up], axis=-2)]
    if axis is not None:
        half = 0.04 * size * axis
        ends.append(np.stack([position - half, position + half], axis=-2))
    every = np.concatenate(ends, axis=1)
    vertices, faces = capsules(every, np.full(every.shape[1], 0.012 * size))
    color = "#" + "".join(f"{c:02x}" for c in INK)
    return MeshLayer(name="gripper", color=color, vertices=vertices, faces=faces)


def arm_layer(
    arm: Arm, q: _Array, opening: float, T_world_frame: _Array | None = None
) -> MeshLayer:
    """An arm as capsules.

    Args:
        arm: The arm, whose base frame is the world.
        q: [T, J] joint angles [rad].
        opening: Between its fingers [m].
        T_world_frame: [4, 4] pose of the frame that is shown; None: the world.
    """
    shape = arm_shape(arm, q, opening)
    ends = np.stack([shape.start, shape.end], axis=-2)
    if T_world_frame is not None:
        T = np.linalg.inv(T_world_frame)
        ends = ends @ T[:3, :3].T + T[:3, 3]
    vertices, faces = capsules(ends, shape.radius)
    return MeshLayer(name="arm", color=ARM_COLOR, vertices=vertices, faces=faces, framed=False)
