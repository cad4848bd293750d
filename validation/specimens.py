"""Bodies and clamps that several cases share."""

import math

import numpy as np
from numpy.typing import ArrayLike

from gendom.arrays import Array
from gendom.sim import Body, Gripper, cloth, rope
from gendom.sim.bodies import neighbours


def clamp_beyond(
    outwards: ArrayLike = (-1.0, 0.0, 0.0), reach: float = 0.1, *, point: ArrayLike = (0, 0, 0)
) -> Gripper:
    """A gripper that holds all material beyond a plane through a ``point`` [3] of the axis [m], on
    the side of a unit vector [3]: a sphere so wide that it looks flat as far as material reaches
    [m]. The free length of a rod or strip begins there, whatever the phase of the grid.
    """
    radius = 1000.0 * reach
    centre = np.asarray(point, dtype=float) + radius * np.asarray(outwards, dtype=float)
    return Gripper.still(centre, radius=radius)


def down(gravity: ArrayLike) -> Array:
    """[W, 3] downwards, of sizes [W] [m/s^2]."""
    return np.outer(np.asarray(gravity, dtype=float), (0.0, 0.0, -1.0))


def across(cells: float) -> str:
    """A resolution in words."""
    return f"{cells:g} cell{'s' * (cells != 1)} across"


def clamped_rope(
    length: float, diameter: float, points: int, *, curvature: float = 0.0, angle: float = 0.0
) -> tuple[Body, Gripper]:
    """A rope of so many points whose first edge is held, at ``angle`` [rad], and whose rest, of a
    length [m], begins at 0; its curvature upwards [1 / length] is free of stress."""
    back = length / (points - 2)
    ds = length / 4000.0
    theta = angle + curvature * (np.arange(4000) + 0.5) / 4000.0
    along = np.array([math.cos(angle), 0.0, math.sin(angle)])
    line = np.cumsum(ds * np.stack([np.cos(theta), 0.0 * theta, np.sin(theta)], axis=1), axis=0)
    line = np.concatenate([[-back * along, [0.0, 0.0, 0.0]], line])
    body = rope(diameter=diameter, centre_line=line, points=points)
    return body, Gripper.still(-0.5 * back * along, radius=0.5 * back)


def clamped_strip(
    length: float, width: float, thickness: float, points: tuple[int, int],
    *, axis: int = 0, back: float | None = None,
) -> tuple[Body, Gripper]:  # fmt: skip
    """A level cloth that is free from 0 along axis 0 or 1 on; a plane holds the rest, which is as
    long as two points are apart or ``back`` [m]. Points are along and across."""
    back = length / (points[0] - 2) if back is None else back
    size, corner = (length + back, width), (-back, -0.5 * width)
    if axis == 1:
        size, corner, points = size[::-1], corner[::-1], (points[1], points[0])
    body = cloth(
        width=size[0], height=size[1], thickness=thickness, dx=0.02, corner=(*corner, 0.0),
        points=points,
    )  # fmt: skip
    return body, clamp_beyond(-np.eye(3)[axis])


def block(size: ArrayLike, dx: float, *, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
    """A solid block of edges ``size`` [3] in cells of ``dx`` [m], its particles half a cell apart
    and half of that from its faces."""
    edges = np.asarray(size, dtype=float)
    count = np.maximum(2, np.round(edges / (dx / 2.0))).astype(int)
    cells = np.argwhere(np.ones(count, dtype=bool))
    local = (cells + 0.5) * (edges / count)
    return Body(
        kind="block", x=local - edges / 2.0 + np.asarray(centre, dtype=float), dx=dx, section=1,
        material_coordinates=local, lattice=neighbours(cells), contact_radius=0.0,
        volume=float(np.prod(edges)) / len(cells), thickness=float(edges[2]),
    )  # fmt: skip


def particle_rope(length: float, diameter: float, cells: float) -> tuple[Body, Gripper]:
    """A rope that is free from x = 0 on; a plane holds three cells of it."""
    back = 3.0 * diameter / cells
    body = rope(
        diameter=diameter, length=length + back, start=(-back, 0.0, 0.0), cells_across=cells
    )
    return body, clamp_beyond(reach=diameter)


def stations(body: Body) -> Array:
    """[S] distances of the cross sections from the body's first end [m]."""
    return np.unique(body.material_coordinates[:, 0])


def sections(values: Array, body: Body) -> Array:
    """Means [..., S, 3] over the cross sections of particle values [..., N, 3]."""
    x = np.asarray(values, dtype=float)
    # all bodies list their particles section by section
    return x.reshape(*x.shape[:-2], len(stations(body)), -1, 3).mean(axis=-2)


def end(values: Array, body: Body) -> Array:
    """[..., 3] where the axis ends: half a section's distance beyond the last section."""
    last = sections(values, body)[..., -2:, :]
    return 1.5 * last[..., 1, :] - 0.5 * last[..., 0, :]
