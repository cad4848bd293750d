"""Twins for MuJoCo 4: a rope as a chain of edges, a cloth as a shell of triangles (flex).

The scene is the second reality's (`gendom.reality.model`), with the corrections that MuJoCo's
models need. What MJCF cannot say, each vertex's mass and each hinge's stiffness, lift.py sets from
lift.npz.
"""

from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.materials import Item
from gendom.reality import Layout, RealRope, as_real
from gendom.reality.model import compiled, rest_shape, scene_xml
from gendom.twins.lift import Lift

SCRIPT = "mujoco_lift.py"


def written(item: Item) -> tuple[Lift, dict[str, str], Array, dict[str, Any]]:
    """The lift, text files by name, the vertices [V, 3] at rest [m], and arrays for the script.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: MuJoCo refuses the scene.
    """
    real = as_real(item)
    rope, origin, half = isinstance(real, RealRope), (0.0, 0.0, real.radius), np.sqrt(0.5)
    # a rope bends at its vertices, the last that is held too
    lift = Lift(item=item, edge=real.spacing if rope else None)
    layout = Layout(origin=origin)
    if not rope:
        layout = Layout(origin=origin, along=(half, -half, 0.0), across=(half, half, 0.0))
    places = rest_shape(real, layout)
    reach = lift.hold + (0.5 * real.spacing if rope else 0.0)
    held = np.flatnonzero(np.linalg.norm(places - origin, axis=1) <= reach + 1e-9)
    hand = f'<body name="hand" mocap="true" pos="0 0 {real.radius!r}"/>'
    xml = scene_xml(real, layout, bodies=[hand], ties=held, tied=True)
    arrays = {"masses": real.vertex_masses, "bending": np.array(compiled(real, xml).flex_bending)}
    return lift, {"scene.xml": xml}, places, arrays
