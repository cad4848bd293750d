"""Contact of thin bodies with themselves: arrays of the kernels' model, and checks of a start.

See ``native/contact.h`` and its adjoint.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.sim.setting import Setting, spread

MARGIN_OF_LISTS = 0.3
"""Margin of the list of pairs that may come into contact [spacings]."""

PAIRS = 40
"""Maximum number of such pairs for each point."""

MOST_TURNS = 12
"""Maximum number of turns over the contacts of a step. Where a hand presses layers on a table there
is no room for all of them, and turns are in vain."""

LISTED = 3
"""Components of a kept state that hold where points were when pairs were listed."""

LEAST_BETWEEN_EDGES = 0.8
"""Smallest initial distance between centre lines of a rope's parts, in diameters: contact keeps
0.9."""

LEAST_BETWEEN_LAYERS = 0.5
"""The same between a cloth's layers, in thicknesses: what a hand presses comes nearer."""

NEIGHBOURS = 2
"""Columns and rows between a point and a cell of a cloth that are not layers."""


def contact_arrays(setting: Setting, n: int, spacing: float) -> dict[str, Any]:
    """What the kernels' model of n points, at most ``spacing`` [m] apart, needs for contact, by
    name: numbers, and arrays [..., n] or of integers."""
    on = int(setting.self_contact)
    W, thickness = len(setting.materials), setting.body.thickness
    return {
        "contact": on,
        "contact_distance": thickness,
        "contact_margin": MARGIN_OF_LISTS * spacing,
        "contact_most_turns": MOST_TURNS,
        "self_friction": spread(setting.self_friction, (W,), "self_friction"),
        "push": np.zeros((W * on, 10, n)),
        # where nothing is near: the first step lists pairs
        "listed": np.broadcast_to(1e6 * (1.0 + np.arange(n)), (W * on, 3, n)),
        "boxes": np.zeros((W * on, 13, n)),
        "pair_counts": np.zeros((W * on, 3, 2), np.int32),
    }


def check_rope(x: Array, diameter: float, apart: int) -> None:
    """Check that edges of a rope [n, 3] [m] do not overlap if they are ``apart`` points apart."""
    from gendom.robot.collision import segments_apart  # with all of arms

    i, j = np.triu_indices(len(x) - 1, apart)
    if not len(i):
        return
    distance = segments_apart(x[i], x[i + 1], x[j], x[j + 1])
    k = int(distance.argmin())
    require(
        distance[k] >= LEAST_BETWEEN_EDGES * diameter,
        f"the rope begins in itself: two parts of it are {1e3 * distance[k]:.3g} mm apart",
        where=f"edges {i[k]} and {j[k]}, {1e3 * diameter:.3g} mm thick",
        fix="give other positions, or no self_contact",
    )


def check_cloth(x: Array, model: Any) -> None:
    """Check that a cloth of points [n, 3] [m], a ``ShellModel``, does not cross itself, nor lie in
    itself."""
    edges, triangles = edges_and_triangles(model)
    middles, centres = x[edges].mean(axis=1), x[triangles].mean(axis=1)
    reach = np.linalg.norm(x[edges] - middles[:, None], axis=2).max()
    reach += np.linalg.norm(x[triangles] - centres[:, None], axis=2).max()
    fix = "give other positions, or no self_contact"
    places = np.indices(model.shape).reshape(2, -1).T

    tree = scipy.spatial.KDTree
    near = tree(middles).sparse_distance_matrix(tree(centres), reach, output_type="ndarray")
    e, t = edges[near["i"]], triangles[near["j"]]
    apart = ~(e[:, :, None] == t[:, None]).any(axis=(1, 2))
    e, t = e[apart], t[apart]
    crosses = np.flatnonzero(_crosses(x[e], x[t]))
    if len(crosses):
        rows, columns = places[[e[crosses[0], 0], t[crosses[0], 0]]].T.tolist()
        raise ParameterError(
            "the cloth begins crossing itself",
            where=f"at its points (row, column) {tuple(rows)} and {tuple(columns)}",
            fix=fix,
        )

    layers = tree(x).sparse_distance_matrix(
        tree(centres), reach + model.thickness, output_type="ndarray"
    )
    p, t = layers["i"], layers["j"]
    along = np.abs(places[p][:, None] - places[triangles[t]]).min(axis=1).max(axis=1)
    p, t = p[along > NEIGHBOURS], t[along > NEIGHBOURS]
    far = triangle_distance(x[p], x[triangles[t]])
    if len(far) and far.min() < LEAST_BETWEEN_LAYERS * model.thickness:
        k = int(far.argmin())
        here, there = (places[of].tolist() for of in (p[k], triangles[t[k], 0]))
        raise ParameterError(
            f"the cloth begins in itself: two layers of it are {1e3 * far[k]:.3g} mm apart",
            where=f"at its points (row, column) {tuple(here)} and {tuple(there)}, "
            f"{1e3 * model.thickness:.3g} mm thick",
            fix=fix,
        )


def edges_and_triangles(model: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Points of a cloth's edges [E, 2], with one diagonal of each cell, and triangles [F, 3]."""
    (rows, columns), g = model.shape, model.lines[0].index
    a, b, c, d = (g[j : rows - 1 + j, i : columns - 1 + i].ravel() for j in (0, 1) for i in (0, 1))
    ends = [np.stack([l[:, :-1].ravel(), l[:, 1:].ravel()], axis=1) for l in (g, g.T)]
    edges = np.concatenate([*ends, np.stack([b, c], axis=1)])
    return edges, np.concatenate([np.stack([a, b, c], axis=1), np.stack([d, b, c], axis=1)])


def _crosses(ends: Array, corners: Array) -> NDArray[np.bool_]:
    """[k] whether edges with ends [k, 2, 3] go through triangles with corners [k, 3, 3]."""
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    normal, _, _ = _on_plane(start, corners)
    level = np.sum(way * normal, axis=1)
    s = np.sum((corners[:, 0] - start) * normal, axis=1) / np.where(level == 0.0, 1.0, level)
    _, along, across = _on_plane(start + s[:, None] * way, corners)
    inside = (along > 0.0) & (across > 0.0) & (along + across < 1.0)
    return (level != 0.0) & (s > 0.0) & (s < 1.0) & inside


def _on_plane(x: Array, corners: Array) -> tuple[Array, Array, Array]:
    """Normals [F, 3] of triangles [F, 3, 3], and how far along the two sides from their first
    corner the feet of points [F, 3] are [F]."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal, at = np.cross(u, v), x - a
    square = np.maximum(np.sum(normal**2, axis=1), 1e-300)
    along = np.sum(np.cross(at, v) * normal, axis=1) / square
    return normal, along, np.sum(np.cross(u, at) * normal, axis=1) / square


def triangle_distance(x: Array, corners: Array) -> Array:
    """[F] smallest distances between points [F, 3] and triangles [F, 3, 3] [m]."""
    normal, along, across = _on_plane(x, corners)
    above = (along >= 0.0) & (across >= 0.0) & (along + across <= 1.0)
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-150)
    level = np.abs(np.sum((x - corners[:, 0]) * normal, axis=1)) / size
    step = np.roll(corners, -1, axis=1) - corners
    from_corner = x[:, None] - corners
    share = np.sum(from_corner * step, axis=2) / np.maximum(np.sum(step**2, axis=2), 1e-300)
    foot = np.clip(share, 0.0, 1.0)[..., None] * step
    sides = np.linalg.norm(from_corner - foot, axis=2).min(axis=1)
    return np.where(above, np.minimum(level, sides), sides)
