"""How thick cameras show a rope: across their views, where errors of depth play no part."""

from __future__ import annotations

import numpy as np
from numpy.linalg import norm, solve
from numpy.typing import NDArray

from gendom.estimation.likelihood import Comparison, NoiseModel
from gendom.estimation.replay import taken

Array = NDArray[np.floating]

EDGE, STRAY = 6e-4, 0.02
"""Where a picture's edge may be wrong, a third of a pixel of 2 mm; and distance from the line
beyond which points are not the rope's [m]."""

IN_FRONT = np.pi / 4.0
"""By how much of half its thickness what a camera sees lies before a rope's middle, in the mean."""

ROUNDS, FEWEST = 20, 200
"""Of expectation and maximisation, and points that they take at least."""


def seen_breadth(comparison: Comparison, noise: NoiseModel) -> float | None:
    """Diameter of a rope as its cameras see it [m], None where their places are not known.

    Pixels lie evenly across the strip that a camera sees of a rope, so that three quarters of them
    lie within three quarters of half its breadth. Which camera saw a point is a latent variable of
    a mixture (McLachlan and Peel 2000, "Finite mixture models"), as fused points are of several: a
    point lies in one camera's strip, and before the rope's middle as seen from there, with the
    noise of depth. Each camera's strip may be off by a rigid motion. Errors of what is simulated
    are those of the registered line.
    """
    o = comparison.observation
    cameras = o.scene.recording.camera_positions
    if cameras is None or o.markers is not None or not o.shape.rope:
        return None
    line = comparison.registered(noise)
    index, _, foot = o.shape.nearest(line, o.points)
    ahead = np.diff(taken(line, index), axis=2)[:, :, 0]
    ahead = ahead / norm(ahead, axis=2, keepdims=True)
    off = o.points - foot
    off = off - (off * ahead).sum(axis=2, keepdims=True) * ahead
    # beyond its ends a line is not a cylinder
    inner = (index[..., 0] > 2) & (index[..., 1] < line.shape[1] - 3)
    own = inner & (o.counts > 0.0) & (norm(off, axis=2) < STRAY)
    if own.sum() < FEWEST:
        return None
    off, foot, ahead, about = off[own], foot[own], ahead[own], o.points[own] - o.centre
    view = foot - cameras[:, None].astype(float)
    view /= norm(view, axis=2, keepdims=True)
    across = np.cross(view, ahead)
    steep = norm(across, axis=2)  # a rope that is seen along its length shows no breadth
    across /= np.maximum(steep, 1e-9)[..., None]
    back = np.cross(ahead, across)
    sideways, deep = (_Moved(off, about, to) for to in (across, back))
    share = np.where((deep.off < 0.0) & (steep > 0.3), 0.6, 0.4)
    radius = comparison.radius
    for _ in range(ROUNDS):
        weight = share * (steep > 0.3)
        front = -IN_FRONT * radius
        aside, depth = sideways.off, deep.off - front
        a = weight / (1.0 + (sideways.left / radius) ** 4) / (radius / 2.0) ** 2
        b = weight / (1.0 + ((deep.left - front) / noise.sensor) ** 2) / noise.sensor**2
        H = sideways.normal(a) + deep.normal(b) + np.diag(noise.with_unknown_cameras().fixed[:6])
        moved = solve(H, (sideways.pull(a, aside) + deep.pull(b, depth))[..., None])[..., 0]
        sideways.move(moved)
        deep.move(moved)
        out = np.maximum(np.abs(sideways.left) - radius, 0.0) / EDGE
        far = (deep.left - front) / noise.sensor
        likely = 1.0 / ((1.0 + out**2 / 2.0) ** 1.5 * (1.0 + far**2 / 2.0))
        share = likely / likely.sum(axis=0)
        weight = share * (steep > 0.3)
        radius = _quantile(np.abs(sideways.left).ravel(), weight.ravel(), 0.75) / 0.75
    return 2.0 * radius


class _Moved:
    """Residuals [C, m] of points for C cameras in directions [C, m, 3], after rigid motions."""

    def __init__(self, off: Array, about: Array, to: Array):
        self.off = self.left = (off * to).sum(axis=2)
        self.by = np.concatenate([to, np.cross(about, to)], axis=2)

    def normal(self, weight: Array) -> Array:
        return np.swapaxes(self.by, 1, 2) @ (weight[..., None] * self.by)

    def pull(self, weight: Array, off: Array) -> Array:
        return np.einsum("cmi,cm->ci", self.by, weight * off)

    def move(self, motions: Array) -> None:
        self.left = self.off - np.einsum("cmi,ci->cm", self.by, motions)


def _quantile(values: Array, weight: Array, level: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(total, level * total[-1])]])
