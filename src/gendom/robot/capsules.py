"""Capsules that cover a mesh: links of arms from files.

A part of the mesh is covered by the smallest capsule about one of its principal axes; while one
sticks out of the mesh too far, its part is cut in two. A capsule is convex, so where it covers the
vertices of a triangle it covers the triangle.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, KDTree, QhullError

from gendom.arrays import Array
from gendom.robot.collision import segments_apart

Capsule = tuple[Array, Array, float]
"""Both ends of the axis [3] [m] and the radius [m]."""

_CUTS = (0.3, 0.4, 0.5, 0.6, 0.7)  # places along each principal axis at which a part may be cut

_COMPARED = 100  # triangles by which cuts are compared


def fit_capsules(triangles: Array, *, excess: float, most: int) -> tuple[list[Capsule], float]:
    """Cover a mesh.

    Args:
        triangles: [T, 3, 3] corners, anticlockwise seen from outside [m].
        excess: How far the capsules may stick out of the mesh [m].
        most: Largest number of capsules; with fewer than needed they stick out further.

    Returns:
        Capsules that hold all triangles, and how far they stick out [m].
    """
    size = float(np.ptp(triangles, axis=(0, 1)).max())
    triangles = _refined(triangles, max(0.5 * excess, size / 64.0))
    parts, capsules = [triangles], [_fit(triangles)]
    out = sticks_out(capsules, triangles)
    while out.max() > excess and len(parts) < most:
        worst = int(np.argmax(out))
        halves = _halves(parts[worst])
        if not halves:
            break
        parts[worst : worst + 1] = halves
        capsules[worst : worst + 1] = [_fit(half) for half in halves]
        out = sticks_out(capsules, triangles)
    return capsules, float(out.max())


def sticks_out(capsules: Sequence[Capsule], triangles: Array) -> Array:
    """[C] how far the surface of all capsules together is outside of a mesh at most [m], at 400
    places on each; triangles [T, 3, 3] are small."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    middle = triangles.mean(axis=1)
    tree, found = KDTree(middle), np.zeros(len(capsules))
    steps = np.arange(200.0) + 0.5  # a Fibonacci lattice on the sphere
    z, turn = 1.0 - steps / 100.0, np.pi * (1.0 + 5.0**0.5) * steps
    ball = np.stack([*(np.sqrt(1.0 - z * z) * (np.cos(turn), np.sin(turn))), z], axis=1)
    for k, (a, b, radius) in enumerate(capsules):
        along = (b - a) / max(np.linalg.norm(b - a), 1e-12)
        side = ball - np.outer(ball @ along, along)
        side *= radius / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
        ends = np.where((ball @ along > 0.0)[:, None], b, a) + radius * ball
        share = (steps[:, None] * 0.6180339887) % 1.0
        points = np.concatenate([ends, a + share * (b - a) + side])
        for other in (*capsules[:k], *capsules[k + 1 :]):
            points = points[outside(other, points) > 0.0]
        far, nearest = tree.query(points)
        off = np.einsum("ij,ij->i", points - middle[nearest], normal[nearest])
        found[k] = far[off > 0.0].max(initial=0.0)
    return found


def outside(capsule: Capsule, points: Array) -> Array:
    """[N] signed distance of points [N, 3] from a capsule [m]."""
    a, b, radius = capsule
    return segments_apart(points, points, a, b) - radius


def _refined(triangles: Array, longest: float) -> Array:
    """The same surface in triangles with edges of at most a length [m]."""
    done = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        done.append(triangles[~long])
        a, b, c = np.swapaxes(triangles[long], 0, 1)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(three, axis=1) for three in corners])
    return np.concatenate(done)


def _hull(points: Array) -> Array:
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # they lie in a plane
        return points


def _axes(points: Array) -> Array:
    """[3, 3] principal axes of points [N, 3], as rows."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]


def _about(points: Array, axis: Array, middle: Array, wider: float) -> Capsule:
    """The shortest capsule about a line that holds points [N, 3]; `wider` than the least it is
    blunter."""
    axis = axis / np.linalg.norm(axis)
    off = points - middle
    t = off @ axis
    d2 = np.maximum((off * off).sum(axis=1) - t * t, 0.0)
    r2 = (1.0 + wider * wider) * d2.max()
    room = np.sqrt(r2 - d2)
    low, high = (t + room).min(), (t - room).max()
    if low > high:
        low = high = 0.5 * (low + high)
    return middle + low * axis, middle + high * axis, float(np.sqrt(r2))


def _volume(capsule: Capsule) -> float:
    a, b, r = capsule
    return float(np.pi * r * r * (np.linalg.norm(b - a) + 4.0 / 3.0 * r))


def _rough(points: Array) -> Capsule:
    """The least of those about the principal axes through the middle of points' extents."""
    hull = _hull(points)
    axes = _axes(points)
    ends = hull @ axes.T
    middle = 0.5 * (ends.min(axis=0) + ends.max(axis=0)) @ axes
    return min((_about(hull, axis, middle, w) for axis in axes for w in (0.0, 0.6)), key=_volume)


def _fit(triangles: Array) -> Capsule:
    """The least capsule found that holds triangles [T, 3, 3]."""
    points = _hull(triangles.reshape(-1, 3))
    a, b, r = _rough(points)
    along = (b - a) if np.any(a != b) else np.array([0.0, 0.0, 1.0])
    start = np.concatenate([0.5 * (a + b) / r, along / np.linalg.norm(along), [0.4]])

    def capsule(x: Array) -> Capsule:
        return _about(points, x[3:6], r * x[:3], x[6])

    settings = {"maxiter": 600, "xatol": 1e-3, "fatol": 1e-4}
    found = minimize(lambda x: _volume(capsule(x)) / r**3, start, method="Nelder-Mead",
                     options=settings)  # fmt: skip
    return capsule(found.x)


def _halves(triangles: Array) -> list[Array]:
    """Two parts of triangles, cut where their capsules are least; none where that is not."""
    middle = triangles.mean(axis=1)
    best, least = [], np.inf
    for axis in _axes(triangles.reshape(-1, 3)):
        t = middle @ axis
        for share in _CUTS:
            low = t < t.min() + share * np.ptp(t)
            if not 0 < low.sum() < len(low):
                continue
            halves = [triangles[low], triangles[~low]]
            few = [half[:: len(half) // _COMPARED + 1].reshape(-1, 3) for half in halves]
            volume = sum(_volume(_rough(points)) for points in few)
            if volume < least:
                best, least = halves, volume
    return best
