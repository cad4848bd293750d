"""Agreement of cameras, and the visible share of the object."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from gendom.arrays import Array
from gendom.datasets import Fault, ObjectDescription
from gendom.perception.camera import Camera
from gendom.perception.line import THICKEST, find_line

MAX_DISAGREEMENT = 0.02
"""Two cameras' clouds of one object may be this far apart [m]."""

MOST_COVERED = 1.1
"""Largest `times_own_area` of an object (docs/perception.md#what-else-is-in-view: evidence)."""

_FIELD = (25.0, 130.0)  # [degrees] across the wider side that depth cameras see
_OFF_CENTRE = 0.15  # of the pictures' size, at most, that their centre lies from the middle
_LEVEL = 0.15  # of the points lie on the largest plane of a scene with a table
_CELL = 0.005  # [m]
_PAIRED_SHARE = 0.6  # of the points: each camera also sees what the other cannot
_MAX_POINTS = 500


def offset_between(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """The translation [3] [m] that moves cloud A [n, 3] onto cloud B [m, 3], neither empty [m].

    Iterated closest points (Besl and McKay, 1992), translation only, on the 60 % nearest pairs.
    Along a straight object nothing shows a shift, and none is found.
    """
    p, q = (_thinned(np.asarray(cloud, dtype=np.float64)) for cloud in (a, b))
    tree = KDTree(q)
    shift = np.zeros(3)
    for _ in range(60):
        distance, index = (np.asarray(found) for found in tree.query(p + shift))
        paired = np.argsort(distance)[: max(1, int(_PAIRED_SHARE * len(p)))]
        step = (q[index[paired]] - p[paired] - shift).mean(axis=0)
        shift += step
        if np.linalg.norm(step) < 1e-5:
            break
    return shift


def sides_apart(
    centre: npt.ArrayLike, a: npt.ArrayLike, b: npt.ArrayLike, description: ObjectDescription
) -> Array:
    """How far cloud B is from cloud A because the cameras, at a and b [3] [m], see different sides
    of an object at a centre [3] [m]: [3] [m].

    The visible half of a cylinder of radius r has its mean pi / 4 r in front of the axis, in a
    picture, where pixels count alike; a sheet's side is half a thickness from its middle. Where
    diameter or thickness are unknown, 0 is taken.
    """
    if description.kind == "rope":
        front = np.pi / 8.0 * (description.diameter or 0.0)
    else:
        front = 0.5 * (description.thickness or 0.0)
    towards = np.array([a, b]) - np.asarray(centre)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return front * (towards[1] - towards[0])


def _thinned(points: np.ndarray) -> np.ndarray:
    few = min(len(points), _MAX_POINTS)
    return points[np.random.default_rng(0).choice(len(points), few, replace=False)]


def own_area(description: ObjectDescription, wider: float = 0.0) -> float:
    """Of an object as it is seen [m^2], each side longer by so much [m]: a rope's length times its
    diameter, or a cloth's width times its height."""
    d = description
    length = d.length or 0.0
    sides = (
        (length, d.diameter or THICKEST * length)
        if d.kind == "rope"
        else (d.width or 0.0, d.height or 0.0)
    )
    return (sides[0] + wider) * (sides[1] + wider)


def times_own_area(points: npt.ArrayLike, description: ObjectDescription) -> float:
    """Area that a cloud [n, 3] [m] covers as seen along x, y or z, at most, over the object's own
    area, which no view of it exceeds. The cloud's 5 mm cells may stand out by one on every side.
    """
    x, y, z = np.floor(np.asarray(points, dtype=np.float64).reshape(-1, 3) / _CELL).T
    covered = max(len(np.unique(1e6 * a + b)) for a, b in ((x, y), (x, z), (y, z)))
    return covered * _CELL**2 / own_area(description, 2.0 * _CELL)


def seen_share(points: npt.ArrayLike, description: ObjectDescription) -> float:
    """About how much of an object, whose sizes are known, a cloud [n, 3] [m] covers, 0 to 1.

    A rope: the length of its line. A cloth: occupied cells of 1.5 cm, of which a surface of any
    direction crosses 1.5 a cell's face on average, over its area, which is good to 0.1 to 0.2.
    """
    p = np.asarray(points, dtype=np.float64)
    if len(p) == 0:
        return 0.0
    if description.kind == "rope":
        assert description.length is not None
        return min(1.0, find_line(p, description).length / description.length)
    assert description.width is not None and description.height is not None
    cell = 0.015
    cells = len(np.unique(np.floor(p / cell).astype(np.int64), axis=0))
    return float(min(1.0, cells * cell**2 / 1.5 / (description.width * description.height)))


def odd_intrinsics(camera: Camera) -> Iterator[Fault]:
    """Faults of a camera whose K is unusual for pictures of its size, as one of other pictures or
    of a cropped part is."""
    (fx, _, cx), (_, fy, cy) = camera.K[0], camera.K[1]
    width, height = camera.width, camera.height
    field = float(np.degrees(2.0 * np.arctan(0.5 * max(width / fx, height / fy))))
    fix = "give K of the stream that these pictures are of"
    if abs(cx / width - 0.5) > _OFF_CENTRE or abs(cy / height - 0.5) > _OFF_CENTRE:
        what = f"its centre ({cx:.0f}, {cy:.0f}) is that of {2 * cx:.0f} x {2 * cy:.0f} pictures, "
        what += f"not of {width} x {height}"
        yield Fault(what, f"{camera.name}: K", f"{fix}; crop shifts the centre", "warning")
    elif not _FIELD[0] < field < _FIELD[1]:
        yield Fault(f"it sees {field:.0f} degrees", f"{camera.name}: K", fix, "warning")
    if abs(fx / fy - 1.0) > 0.05:
        what = f"its focal lengths differ, {fx:.1f} and {fy:.1f} pixels"
        yield Fault(what, f"{camera.name}: K", f"{fix}, resized alike in both", "warning")


def level_axis(points: Array) -> int | None:
    """The axis across which the largest plane of points [n, 3] [m] lies, 0, 1 or 2: 2 where z is
    up and there is a table; None: there is no such plane."""
    shares = []
    for x in points.T:
        x = np.sort(x)
        within = np.searchsorted(x, x + 0.03) - np.arange(len(x))
        shares.append(within.max(initial=0) / max(len(x), 1))
    best = int(np.argmax(shares))
    return best if len(points) > 300 and shares[best] > _LEVEL else None
