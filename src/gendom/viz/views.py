"""Clouds in three views, for a look at what was recorded."""

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image
from PIL.ImageColor import getrgb

from gendom.arrays import Array
from gendom.viz.animation import Animation, Layer
from gendom.viz.films import Stage
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR

_SIZE = 420, 420  # of a view [pixels]
_MOST = 60_000  # points drawn of all clouds
_UPRIGHT = 0.5 * math.pi
_VIEWS = {"top: x, y": (0.0, _UPRIGHT), "front: x, z": (0.0, 0.0), "side: y, z": (_UPRIGHT, 0.0)}


def draw_views(
    clouds: Sequence[Array], *, gripper: Array | None = None, table: float | None = None
) -> Image.Image:
    """From the top (x right, y up), the front (x, z) and the side (y, z), one beside the other.

    Args:
        clouds: [n, 3] in the order of time [m], the first grey, the last blue.
        gripper: [M, 3] its path [m], orange.
        table: z of the table [m].

    Raises:
        ParameterError: There are no points at all.
    """
    layers = []
    first, last = (np.array(getrgb(color)) for color in ("#BBBBBB", RECORDED_COLOR))
    for k, cloud in enumerate(clouds):
        share, few = k / max(len(clouds) - 1, 1), 1 + len(cloud) * len(clouds) // _MOST
        mixed = (1.0 - share) * first + share * last
        color = f"#{bytes(mixed.astype(np.uint8)).hex()}"
        layers.append(Layer(name="", color=color, points=[cloud[::few]]))
    if gripper is not None and len(gripper) > 1:
        path = np.stack([gripper[:-1], gripper[1:]], axis=1)
        layers.append(Layer(name="gripper", color=SIMULATED_COLOR, points=[path], radius=1e-4))
    shown = Animation(times=np.zeros(1), layers=tuple(layers), table_height=table)
    stages = [Stage(shown, view, _SIZE, f"from the {name}") for name, view in _VIEWS.items()]
    return Image.fromarray(np.concatenate([np.asarray(s.draw(0)) for s in stages], axis=1))
