"""Ropes and cloths: rest positions of particles and points, from sizes and a resolution."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import check_integers, check_number, check_numbers, require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.sim.lines import along_line, arc_length, around, frames

CELLS_ACROSS = (0.6, 6.0)
"""Fewest and most grid cells across a rope for which its bending and twisting are validated."""

EDGES = (24, 48)
"""Fewest and most edges that a rope's centre line has by default."""

POINTS = 28
"""Points along a cloth's longer side by default."""

MOST = 10_000_000
"""Maximum number of particles, and of points; ten million particles take 2 GB."""

BULGE = 0.75
"""Share of the map from a square to a disc that is applied to sections (see ``round_section``);
with 0.65 to 0.75, sections of 3 to 16 particles across bend within 2 % and twist within 5 % of
theory at nu up to 0.45."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """An object at rest.

    Particles are half a cell apart, so a cell inside the object holds eight of them.
    """

    kind: str
    """``rope`` or ``cloth``."""
    x: Array
    """[N, 3] rest positions [m]."""
    material_coordinates: Array
    """[N, 3] positions in the object's own frame [m]: along, across and through it."""
    lattice: NDArray[np.int32]
    """[N, 3, 2] previous and next neighbour of each particle along each axis, or the particle
    itself where there is none."""
    volume: float
    """Volume of one particle [m^3]."""
    dx: float
    """Size of a grid cell [m]."""
    thickness: float
    """Diameter of a rope, thickness of a cloth [m]."""
    section: int
    """Number of particles in a cross-section of a rope or through the thickness of a cloth. They
    have consecutive indices, and touch the table and are gripped together. 1 for a thick cloth."""
    contact_radius: float
    """Height of a section's centre above the table when the section lies on it [m]."""
    points: Array = field(default_factory=lambda: np.empty((0, 3)))
    """[n, 3] rest positions of the thin engine's points [m]: a rope's centre line from one end to
    the other, or a cloth's middle surface row by row, each row along the first axis."""
    shape: tuple[int, ...] = (0,)
    """Number of points of a rope, or numbers of rows and of points in each row of a cloth."""

    @property
    def num_particles(self) -> int:
        return len(self.x)

    @property
    def rest_frames(self) -> Array:
        """Inverses of the position differences along the lattice axes at rest, [N, 3, 3] [1/m]."""
        first, second = self.lattice[:, :, 0], self.lattice[:, :, 1]
        return np.linalg.inv(np.swapaxes(self.x[second] - self.x[first], 1, 2))

    @property
    def lateral_constraint(self) -> float:
        """The factor k in lam = 2 mu nu / (1 - k nu), which is 2 for a solid.

        A section of two particles across cannot become thinner on one side and thicker on the
        other when it bends, and would be too stiff. Sheets use plane stress (k = 1) instead. For
        ropes k = 2/3: a section of four particles then bends and twists like a round rope at
        every nu (and is 4 to 10 % too soft in stretching).
        """
        alone = self.lattice == np.arange(len(self.x))[:, None, None]
        two = alone.any(axis=2).all(axis=0)
        if not two.any():
            return 2.0
        return 2.0 / 3.0 if self.kind == "rope" else 1.0

    def surface(self, x: Array) -> Array:
        """Points on the object's surface, [..., M, 3] [m].

        Args:
            x: [..., N, 3] positions of particles, or of the thin engine's points [m].

        Raises:
            ParameterError: If that is not the shape of ``x``.

        Each particle represents the material around it, so the visible surface of a rope lies
        further out than its particles: its outer particles are moved away from the middle of
        their section, to half a diameter. A cloth is thin, so its particles are its surface.
        """
        x = check_numbers("x", x, finite=False)
        known = {self.num_particles, len(self.points)}
        if x.ndim < 2 or x.shape[-1] != 3 or x.shape[-2] not in known:
            raise ParameterError(
                f"x has shape {x.shape}, expected [..., N, 3]",
                fix=f"give the positions of its {' or '.join(map(str, sorted(known)))} points",
            )
        if self.kind != "rope":
            return x
        if x.shape[-2] == len(self.points) != self.num_particles:
            return around(self.points, self.thickness, x)
        sections = x.reshape(*x.shape[:-2], -1, self.section, 3)
        centre = sections.mean(axis=-2, keepdims=True)
        out = (sections - centre)[..., self._outer, :]
        out = out * (self.thickness / 2.0 / np.linalg.norm(out, axis=-1, keepdims=True))
        return (centre + out).reshape(*x.shape[:-2], -1, 3)

    @property
    def _outer(self) -> NDArray[np.bool_]:
        """Mask of the particles on the rim of a rope's section."""
        radius = np.linalg.norm(self.material_coordinates[: self.section, 1:], axis=1)
        return radius > 0.6 * radius.max()


def rope(
    *,
    diameter: float,
    length: float | None = None,
    centre_line: ArrayLike | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    direction: ArrayLike = (1.0, 0.0, 0.0),
    cells_across: float = 2.0,
    points: int | None = None,
) -> Body:
    """Make a rope, straight or along a centre line.

    Bending is within 2 % and twisting within 5 % of a round rope, see ``round_section``.

    Args:
        diameter: Diameter [m].
        length: Length [m]; with ``centre_line``, that line is cut or extended to this length
            (default: the length of the line).
        centre_line: [K, 3] points from one end to the other [m].
        start: [3] first end of a straight rope [m].
        direction: [3] direction of a straight rope; need not be a unit vector.
        cells_across: Grid cells across the diameter, 0.6 to 6; particles are twice as dense. For
            the MPM.
        points: Number of points of the centre line, for rods; by default they are one diameter
            apart, but at least 25 and at most 49.

    Raises:
        ParameterError: If an argument is of another type or shape or not finite, sizes are not
            positive, the centre line is degenerate, ``cells_across`` lies outside its range, or
            there are fewer than three points or more than ``MOST``.
    """
    check_number("diameter", diameter, above=0.0)
    check_number("cells_across", cells_across, above=0.0)
    least, most = CELLS_ACROSS
    fix = "1.5 is the default of estimates; more cost their fourth power"
    what = f"cells_across must lie between {least:g} and {most:g}, got {cells_across:g}"
    require(least <= cells_across <= most, what, fix=fix)
    line = _line_of(centre_line, start, direction, length)
    dx = diameter / cells_across
    spacing = dx / 2.0
    total = length if length is not None else float(arc_length(line)[-1])
    if points is None:
        points = 1 + min(max(round(total / diameter), EDGES[0]), EDGES[1])
    check_integers("points", points, (), least=3, most=MOST)
    _check_many(total / spacing * (diameter / spacing) ** 2, "a larger diameter")
    x, coordinates, cells = _rope_particles(line, total, diameter, spacing)
    return Body(
        kind="rope",
        x=x,
        material_coordinates=coordinates,
        lattice=neighbours(cells),
        volume=math.pi / 4.0 * diameter**2 * total / len(x),
        dx=dx,
        thickness=diameter,
        section=max(2, round(diameter / spacing)) ** 2,
        contact_radius=diameter / 2.0,
        points=along_line(line, np.linspace(0.0, total, points))[0],
        shape=(points,),
    )


def _line_of(
    centre_line: ArrayLike | None, start: ArrayLike, direction: ArrayLike, length: float | None
) -> Array:
    """[K, 3] the given centre line, or that of a straight rope."""
    if length is not None:
        check_number("length", length, above=0.0)
    if centre_line is not None:
        line = check_numbers("centre_line", centre_line, ("K", 3))
        require(len(line) >= 2, f"centre_line must have at least two points, got {len(line)}")
        return line
    if length is None:
        raise ParameterError("a straight rope needs its length [m]")
    unit = check_numbers("direction", direction, (3,))
    norm = np.linalg.norm(unit)
    require(norm > 0.0, "direction of a rope must not be the zero vector")
    first = check_numbers("start", start, (3,))
    return np.stack([first, first + unit / norm * length])


def _rope_particles(
    line: Array, total: float, diameter: float, spacing: float
) -> tuple[Array, Array, NDArray[np.integer]]:
    """Particles of a rope along a line: positions, material coordinates and cells, [N, 3] each."""
    count = max(2, round(total / spacing))
    along = (np.arange(count) + 0.5) * (total / count)
    centre, tangent = along_line(line, along)
    section, places = round_section(max(2, round(diameter / spacing)), diameter)
    side, up = frames(tangent)
    x = centre[:, None] + side[:, None] * section[None, :, :1] + up[:, None] * section[None, :, 1:]
    across = np.tile(section, (count, 1))
    coordinates = np.column_stack([np.repeat(along, len(section)), across])
    cells = np.column_stack(
        [np.repeat(np.arange(count), len(section)), np.tile(places, (count, 1))]
    )
    return x.reshape(-1, 3), coordinates, cells


def cloth(
    *,
    width: float,
    height: float,
    thickness: float,
    dx: float,
    corner: ArrayLike = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    points: tuple[int, int] | None = None,
) -> Body:
    """Make a flat rectangular cloth in a horizontal plane.

    It has at least two layers of particles. Their spacing is such that their mean squared distance
    from the middle is the sheet's second moment, h^2 / 12 per unit of area. A sheet thinner than
    a cell is simulated at its true thickness: its layers stretch and shorten with the curvature
    of the velocity field, which the grid resolves.

    Args:
        width, height: Sizes along the cloth's own first and second axis [m].
        thickness: Thickness [m].
        dx: Size of a grid cell [m]. For the MPM.
        points: Numbers of points along the first and second axis, for shells; by default 28 along
            the longer side and the same spacing along the other.
        corner: [3] position of one corner of the mid-plane, from which both axes go [m].
        yaw: Angle of the first axis about z [rad].

    Raises:
        ParameterError: If an argument is of another type or shape or not finite, a size is not
            positive, or there are fewer than two points along a side or more than ``MOST``.
    """
    given = {"width": width, "height": height, "thickness": thickness, "dx": dx}
    for name, size in given.items():
        check_number(name, size, above=0.0)
    check_number("yaw", yaw)
    origin = check_numbers("corner", corner, (3,))
    if points is None:
        spacing = max(width, height) / (POINTS - 1)
        points = (max(2, 1 + round(width / spacing)), max(2, 1 + round(height / spacing)))
    nx, ny = check_integers("points", points, (2,), least=2).tolist()
    _check_many(nx * ny, "fewer points")
    body = _sheet((width, height, thickness), dx, (nx, ny))
    c, s = math.cos(yaw), math.sin(yaw)
    to_world = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    return replace(body, x=origin + body.x @ to_world, points=origin + body.points @ to_world)


def _sheet(sizes: tuple[float, float, float], dx: float, points: tuple[int, int]) -> Body:
    """A cloth as of ``cloth`` in its own frame, from its corner on."""
    width, height, thickness = sizes
    counts = [max(2.0, size / (dx / 2.0)) for size in sizes]
    _check_many(math.prod(counts), "a larger dx")
    shape = [round(count) for count in counts]
    ticks = [(np.arange(n) + 0.5) * (size / n) for n, size in zip(shape, sizes, strict=True)]
    ticks[2] -= thickness / 2.0
    ticks[2] *= thickness / math.sqrt(12.0 * np.mean(ticks[2] ** 2))
    local = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.argwhere(np.ones(shape))
    axes = (np.linspace(0.0, size, n) for size, n in zip(sizes, points, strict=False))
    middle = np.stack([*np.meshgrid(*axes), np.zeros(points[::-1])], axis=-1).reshape(-1, 3)
    thick = thickness > dx
    return Body(
        kind="cloth",
        x=local,
        material_coordinates=local,
        lattice=neighbours(cells),
        volume=width * height * thickness / len(local),
        dx=dx,
        thickness=thickness,
        section=1 if thick else shape[2],
        contact_radius=thickness / shape[2] / 2.0 if thick else thickness / 2.0,
        points=middle,
        shape=points[::-1],
    )


def round_section(across: int, diameter: float) -> tuple[Array, NDArray[np.integer]]:
    """Particles [across^2, 2] of a round section about its centre [m], on a deformed square
    lattice, and their cells in it.

    A section cut out of a square lattice warps where a round section stays plane, and is too soft
    in torsion (0.65 of theory with 12 particles). Instead, a square lattice is deformed until its
    outer particles lie nearly on a circle. The map is the elliptical one, x sqrt(1 - y^2 / 2),
    applied by three quarters; the full map would flatten the lattice at its corners. The points
    are then scaled so that their mean squared distance from an axis is the section's second
    moment, d^2 / 16.
    """
    cells = np.argwhere(np.ones((across, across)))
    square = cells / (across - 1) * 2.0 - 1.0
    points = square * np.sqrt(1.0 - BULGE * square[:, ::-1] ** 2 / 2.0)
    return points * ((diameter / 4.0) / math.sqrt(np.mean(points[:, 0] ** 2))), cells


def _check_many(count: float, fix: str) -> None:
    would = f"the body would have {count:.3g} particles or points, at most {MOST:.0e} fit"
    require(count <= MOST, would, fix=fix)


def neighbours(cells: NDArray[np.integer]) -> NDArray[np.int32]:
    """[N, 3, 2] indices of each particle's neighbours, from lattice cells [N, 3]."""
    number = np.full(cells.max(axis=0) + 3, -1)
    number[tuple((cells + 1).T)] = np.arange(len(cells))
    found = np.empty((len(cells), 3, 2), dtype=np.int32)
    for axis in range(3):
        for side, step in enumerate((-1, 1)):
            beside = cells + 1
            beside[:, axis] += step
            n = number[tuple(beside.T)]
            found[:, axis, side] = np.where(n >= 0, n, np.arange(len(cells)))
    return found
