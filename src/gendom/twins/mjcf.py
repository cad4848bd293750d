"""Twins for MuJoCo 4: a rope as a chain of edges, a cloth as a shell of triangles (flex).

The scene is the second reality's (`gendom.reality.model`), with the corrections that MuJoCo's
models need. What MJCF cannot say, each vertex's mass and each hinge's stiffness, lift.py sets from
lift.npz.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.materials import Item, Rope
from gendom.reality import Layout, as_real
from gendom.reality.model import compiled, rest_shape, scene_xml
from gendom.twins.lift import Lift

SCRIPT = "mujoco_lift.py"


def edge(item: Item) -> float | None:
    """Length of a rope's edges [m]: it bends at its vertices, the last that is held too."""
    return as_real(item).spacing if isinstance(item, Rope) else None


def written(lift: Lift) -> tuple[dict[str, str], Array, dict[str, Any]]:
    """Text files by name, the vertices [V, 3] at rest [m], and arrays for the script.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: MuJoCo refuses the scene.
    """
    item = as_real(lift.item)
    half = np.sqrt(0.5)
    origin = (0.0, 0.0, item.radius)
    layout = Layout(origin=origin)
    if not isinstance(item, Rope):
        layout = Layout(origin=origin, along=(half, -half, 0.0), across=(half, half, 0.0))
    places = rest_shape(item, layout)
    reach = lift.hold + (0.5 * item.spacing if isinstance(item, Rope) else 0.0)
    held = np.flatnonzero(np.linalg.norm(places - origin, axis=1) <= reach + 1e-9)
    hand = f'<body name="hand" mocap="true" pos="0 0 {item.radius!r}"/>'
    xml = scene_xml(item, layout, bodies=[hand], ties=held, tied=True)
    model = compiled(item, xml)
    return (
        {"scene.xml": xml},
        places,
        {"masses": item.vertex_masses, "bending": np.array(model.flex_bending)},
    )
