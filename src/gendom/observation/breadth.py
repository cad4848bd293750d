"""How broad a rope looks across the views of its cameras, where errors of depth play no part."""

from __future__ import annotations

import math

import numpy as np

from gendom.arrays import Array

EDGE = 6e-4
"""By how much the edge of a camera's picture may be off: a third of a pixel of 2 mm [m]."""

MOVED = np.array([0.05] * 3 + [0.1] * 3) ** -2.0
"""Precisions of the rigid motion by which cameras are off [1/m^2], [1/rad^2]."""

AHEAD = np.pi / 4.0
"""How far before a rope's middle a camera sees it, in half its thickness, in the mean."""


STRAY, FEWEST, ENOUGH = 0.02, 200, 2000
"""Distance from a rope beyond which points are not its own [m], the fewest that show its breadth,
and how many show it to 1 %."""


def breadth_across(
    points: Array,
    feet: Array,
    tangent: Array,
    cameras: Array,
    noise: float,
    *,
    seen_by: Array | int = -1,
    rounds: int = 20,
) -> float | None:
    """Breadth of the strip that cameras see of a rope [m]; None where too few points show it.

    Pixels lie evenly across it, so that three quarters of them lie within three quarters of half
    its breadth. A point lies in one camera's strip, and before the rope's middle as seen from
    there. Which camera saw it is a latent variable of a mixture (McLachlan and Peel 2000, "Finite
    mixture models") where points of several cameras are fused; each camera's points may be off by
    a rigid motion.

    Args:
        points: [m, 3] of all cameras, fused [m].
        feet: [m, 3] nearest places on the rope's middle line [m].
        tangent: [m, 3] along it.
        cameras: [C, 3] places of the cameras [m].
        noise: Standard deviation of depth [m].
        seen_by: [m] the one camera that saw each point, -1 where it is not known.
        rounds: Of expectation and maximisation.
    """
    near = np.flatnonzero(np.linalg.norm(points - feet, axis=1) < STRAY)
    if len(near) < FEWEST:
        return None
    near = near[:: math.ceil(len(near) / ENOUGH)]
    camera = np.broadcast_to(seen_by, len(points))[near]
    points, feet, tangent = points[near], feet[near], tangent[near]
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    off = points - feet
    view = feet - cameras[:, None]
    view = view / np.linalg.norm(view, axis=2, keepdims=True)
    across = np.cross(view, tangent)
    steep = np.linalg.norm(across, axis=2)
    across = across / np.maximum(steep, 1e-9)[..., None]
    seen = (camera < 0) | (camera == np.arange(len(cameras))[:, None])
    seen &= steep > 0.3  # along its length a rope shows no breadth
    to = np.stack([across, np.cross(tangent, across)])  # sideways, and away from the camera
    by = np.concatenate([to, np.cross(points - points.mean(axis=0), to)], axis=3)
    off = np.einsum("ma,dcma->dcm", points - feet, to)
    # whose points are before the rope, or all on one side of it
    aside = off[0] - np.median(off[0], axis=1, keepdims=True)
    sides = (off[1], 0.6), (aside, 0.95), (-aside, 0.95)
    starts = (seen * np.where(side < 0.0, most, 1.0 - most) for side, most in sides)
    return max(_mixture(off, by, seen, noise, start, rounds) for start in starts)[1]


def _mixture(
    off: Array, by: Array, seen: Array, noise: float, share: Array, rounds: int
) -> tuple[float, float]:
    """Log likelihood and breadth [m], from shares [C, m] of cameras in points on.

    Args:
        off: [2, C, m] how far points lie sideways of the line and behind it, by each camera [m].
        by: [2, C, m, 6] how that grows with a rigid motion.
        seen: [C, m] whether a camera sees the breadth there.
        noise: Standard deviation of depth [m].
        share: In the beginning.
        rounds: Of expectation and maximisation.
    """
    half, reach, left, fits = float(np.median(np.abs(off[0]))), STRAY, off, 0.0
    for _ in range(rounds):
        wanted = np.array([0.0, -AHEAD * half])[:, None, None]
        weight = share * [
            4.0 / (half**2 * (1.0 + (left[0] / reach) ** 4)),
            1.0 / (noise**2 + (left[1] - wanted[1]) ** 2),
        ]
        H = np.einsum("dcmi,dcm,dcmj->cij", by, weight, by, optimize=True) + np.diag(MOVED)
        pull = np.einsum("dcmi,dcm->ci", by, weight * (off - wanted))
        left = off - np.einsum("dcmi,ci->dcm", by, np.linalg.solve(H, pull[..., None])[..., 0])
        order = np.argsort(np.abs(left[0]), axis=None)
        total = np.cumsum(share.ravel()[order])
        place = order[np.searchsorted(total, 0.75 * total[-1])]
        half = reach = float(np.abs(left[0]).ravel()[place]) / 0.75
        outside = np.maximum(np.abs(left[0]) - half, 0.0) / EDGE
        depth = (left[1] - wanted[1]) / noise
        likely = seen / ((1.0 + outside**2 / 2.0) ** 1.5 * (1.0 + depth**2 / 2.0))
        every = np.maximum(likely.sum(axis=0), 1e-300)
        share, fits = likely / every, float(np.log(every / (half + EDGE)).sum())
    return fits, 2.0 * half
