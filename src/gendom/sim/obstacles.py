"""What bodies meet: a table, and rigid boxes, spheres and capsules that stand still or move."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gendom.arguments import check_number, check_numbers, require
from gendom.arrays import Array, of_each
from gendom.sim.bodies import Body
from gendom.sim.gripper import Path


@dataclass(frozen=True, kw_only=True)
class Table:
    """An impenetrable horizontal plane with Coulomb friction, which may differ between worlds.

    Raises:
        ParameterError: If a number is not finite, or friction is negative.
    """

    height: float
    """Height of the plane [m]."""
    friction: float | ArrayLike = 0.3
    """Coefficient of friction, one number or [W]."""

    def __post_init__(self) -> None:
        check_number("table height", self.height)
        check_numbers("friction", self.friction, (), ("W",), least=0.0)


@dataclass(frozen=True, kw_only=True)
class Obstacle(Path):
    """A rigid convex body that stands still or follows a timed path, as grippers do, and meets rods
    and shells with Coulomb friction. Nothing moves it; what a gripper holds goes through it.

    A body meets it with its points, at half its thickness: edges of a box may reach between two
    points by up to half the points' distance, less if they are rounded.

    Raises:
        ParameterError: As of ``Path``, or if a size is not positive or friction negative.
    """

    friction: float = 0.3
    """Coefficient of friction."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(f"{self.kind} friction", self.friction, least=0.0)
        for name in {"radius", "length", "size"} & set(vars(self)):
            sides = (3,) if name == "size" else ()
            check_numbers(f"{self.kind} {name}", getattr(self, name), sides, above=0.0)

    @property
    def core(self) -> tuple[Array, float]:
        """Half the extents [3] of the box, line or point that it is all around, and how far it
        reaches from there [m]."""
        raise NotImplementedError

    @property
    def inner_radius(self) -> float:
        """Radius of the largest sphere inside [m]."""
        return self.core[1]

    def pose_at(self, time: float) -> tuple[Array, Any]:
        """Centre [3] [m] and orientation at a time [s]."""
        t, centre, of = np.asarray(self.time), self.position_at(time), scipy.spatial.transform
        if self.quat_xyzw is None:
            return centre, of.Rotation.identity()
        turned = of.Rotation.from_quat(self.quat_xyzw)
        return centre, of.Slerp(t, turned)(np.clip(time, t[0], t[-1])) if len(t) > 1 else turned[0]

    def distance(self, x: ArrayLike, time: float = 0.0) -> Array:
        """Signed distances [...] of places [..., 3] from its surface at a time [s], negative inside
        [m]."""
        (centre, turned), (half, reach) = self.pose_at(time), self.core
        x = np.asarray(x, dtype=float)
        beyond = np.abs(turned.inv().apply((x - centre).reshape(-1, 3))) - half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return (outside + np.minimum(beyond.max(axis=1), 0.0) - reach).reshape(x.shape[:-1])


@dataclass(frozen=True, kw_only=True)
class Sphere(Obstacle):
    """A ball."""

    radius: float
    """[m]."""

    @property
    def core(self) -> tuple[Array, float]:
        return np.zeros(3), self.radius


@dataclass(frozen=True, kw_only=True)
class Capsule(Obstacle):
    """A round bar along its z axis, with round ends."""

    radius: float
    """[m]."""
    length: float
    """Of its straight part [m]."""

    @classmethod
    def between(cls, a: ArrayLike, b: ArrayLike, *, radius: float, **more: Any) -> "Capsule":
        """Return a still one from a place [3] to another [m]; errors as of ``Obstacle``."""
        ends = check_numbers("ends of a capsule", np.stack([np.asarray(a), np.asarray(b)]), (2, 3))
        along, length = ends[1] - ends[0], float(np.linalg.norm(ends[1] - ends[0]))
        require(length > 0.0, "a capsule's ends are the same place", fix="a Sphere")
        (turned, _) = scipy.spatial.transform.Rotation.align_vectors(
            [along / length], [[0.0, 0.0, 1.0]]
        )
        middle, q = ends.mean(axis=0), turned.as_quat()[None]
        return cls(position=middle, quat_xyzw=q, radius=radius, length=length, **more)

    @property
    def core(self) -> tuple[Array, float]:
        return np.array([0.0, 0.0, self.length / 2.0]), self.radius


@dataclass(frozen=True, kw_only=True)
class Cuboid(Obstacle):
    """A box; a large one is a wall, or a floor.

    Raises:
        ParameterError: As of ``Obstacle``, or if it is rounded by more than half its least side.
    """

    size: ArrayLike
    """[3] lengths of its sides along its axes [m]."""
    rounding: float = 0.0
    """Radius of its edges and corners [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("Cuboid rounding", self.rounding, least=0.0)
        least = float(np.min(self.size))
        require(
            2.0 * self.rounding <= least,
            f"a Cuboid of {least:g} m is rounded by {self.rounding:g} m: at most half as much",
        )

    @property
    def core(self) -> tuple[Array, float]:
        return np.asarray(self.size, dtype=float) / 2.0 - self.rounding, self.rounding

    @property
    def inner_radius(self) -> float:
        return float(np.min(self.size)) / 2.0


def numbers_of_obstacles(every: Sequence[Sequence[Obstacle]]) -> Array:
    """[W, O, 23] what the thin engine's kernels know of obstacles, see ``native/surroundings.h``;
    they set the poses themselves."""
    rows = of_each(every, lambda some: [[*of.core[0], of.core[1], of.friction] for of in some])
    sizes = rows.reshape(*rows.shape[:2], -1 if len(every[0]) else 5)
    return np.pad(sizes, ((0, 0), (0, 0), (0, 18)))


def check_thick(every: Sequence[Sequence[Obstacle]], radius: float, spacing: float) -> None:
    """Check that no world's obstacle fits between a body's points, ``spacing`` apart, at ``radius``
    [m].

    Raises:
        ParameterError: If one does.
    """
    different = {id(some): some for some in every}.values()  # often all worlds have the same
    for o, of in [pair for some in different for pair in enumerate(some)]:
        require(
            of.inner_radius + radius >= spacing,
            f"obstacle {o} ({of.kind}) fits between the body's points, which are "
            f"{1e3 * spacing:.3g} mm apart",
            where=f"it is {2e3 * of.inner_radius:.3g} mm thick",
            fix="a thicker obstacle, or a body of more points",
        )


def check_clear(
    body: Body,
    x: Array,
    least: float,
    table: Table | None,
    every: Sequence[Sequence[Obstacle]],
    time: float,
) -> None:
    """Check that cross-sections with centres [n, 3] or [W, n, 3] do not begin deeper than ``least``
    [m] in the table or an obstacle.

    Raises:
        ParameterError: If one does; the error names world, obstacle, depth and extent.
    """
    radius, alike = body.contact_radius, all(some is every[0] for some in every)
    same = alike and (x.ndim == 2 or len(x) == 1)
    for w in range(1 if same else len(every)):
        centres = x[w % len(x)] if x.ndim == 3 else x
        around = [(f"obstacle {o} ({of.kind})", of.distance(centres, time))
                  for o, of in enumerate(every[w])]  # fmt: skip
        if table is not None:
            around.append(("table", centres[:, 2] - table.height))
        for name, distance in around:
            depth = radius - float(distance.min())
            low, high = (m(centres, axis=0).round(4).tolist() for m in (np.min, np.max))
            require(
                depth <= least,
                f"the object begins {1e3 * depth:.3g} mm inside the {name}",
                where=f"{'' if same else f'world {w}, '}centres of its cross-sections "
                f"lie between {low} and {high} m, half its thickness is {radius:.4g} m",
                fix=f"move the object, or the {name.split()[0]}",
            )
