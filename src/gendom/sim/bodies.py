"""Ropes and cloths: rest positions of particles and points, from sizes and a resolution."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError

CELLS_ACROSS = (0.5, 6.0)
"""Fewest and most grid cells across a rope for which its bending and twisting are validated."""

EDGES = (24, 48)
"""Fewest and most edges that a rope's centre line has by default."""

POINTS = 28
"""Points along a cloth's longer side by default."""

BULGE = 0.75
"""Share of the map from a square to a disc that is applied to sections (see ``round_section``);
with 0.65 to 0.75, sections of 3 to 16 particles across bend within 2 % and twist within 5 % of
theory at nu up to 0.45."""


@dataclass(frozen=True, kw_only=True)
class Weave:
    """Stiffness of a cloth relative to an isotropic sheet of the same E, nu and thickness.

    Raises:
        ParameterError: If a number is not positive and finite.
    """

    warp: float = 1.0
    """Stretching stiffness along the first axis."""
    weft: float = 1.0
    """Stretching stiffness along the second axis."""
    shear: float = 1.0
    """In-plane shear stiffness."""
    bending: float = 1.0
    """Bending stiffness, in all directions."""

    def __post_init__(self) -> None:
        _check_positive(warp=self.warp, weft=self.weft, shear=self.shear, bending=self.bending)


@dataclass(frozen=True, kw_only=True)
class Body:
    """An object at rest.

    Particles are half a cell apart, so a cell inside the object holds eight of them.
    """

    kind: str
    """``rope`` or ``cloth``."""
    x: NDArray[np.floating]
    """[N, 3] rest positions [m]."""
    material_coordinates: NDArray[np.floating]
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
    points: NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 3)))
    """[n, 3] rest positions of the thin engine's points [m]: a rope's centre line from one end to
    the other, or a cloth's middle surface row by row, each row along the first axis."""
    shape: tuple[int, ...] = (0,)
    """Number of points of a rope, or number of rows and points in each row of a cloth."""
    width: float | None = None
    """Width of a flat rope, horizontal and across it [m]; None: round rope."""
    weave: "Weave" = field(default_factory=lambda: Weave())
    """Stiffness of a cloth's weave relative to an isotropic sheet; for shells."""
    natural_curvature: NDArray[np.floating] | None = None
    """[2, 2] curvature of the stress-free shell in its first two axes, positive where it arches
    towards its third axis [1/m]; None: flat."""

    @property
    def num_particles(self) -> int:
        return len(self.x)

    @property
    def rest_frames(self) -> NDArray[np.floating]:
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

    def surface(self, x: NDArray[np.floating]) -> NDArray[np.floating]:
        """Points on the object's surface, [..., M, 3] [m].

        Args:
            x: [..., N, 3] positions of particles, or of the thin engine's points [m].

        Each particle represents the material around it, so the visible surface of a rope lies
        further out than its particles: its outer particles are moved away from the middle of
        their section, to half a diameter. A cloth is thin, so its particles are its surface.
        """
        x = np.asarray(x, dtype=float)
        if self.kind != "rope":
            return x
        if x.shape[-2] == len(self.points) != self.num_particles:
            return self._around(x)
        sections = x.reshape(*x.shape[:-2], -1, self.section, 3)
        out = sections - sections.mean(axis=-2, keepdims=True)
        out = out[..., self._outer, :]
        length = np.linalg.norm(out, axis=-1, keepdims=True)
        skin = sections.mean(axis=-2, keepdims=True) + out * (self.thickness / 2.0 / length)
        return skin.reshape(*x.shape[:-2], -1, 3)

    def surface_transpose(
        self, x: NDArray[np.floating], bar: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Derivative of a loss with respect to positions, given that with respect to the surface.

        Args:
            x: [..., N, 3] particles, or the thin engine's points [m].
            bar: [..., M, 3] derivative of the loss with respect to ``surface(x)`` [1/m].

        Returns:
            [..., N, 3] [1/m].
        """
        if self.kind != "rope":
            return bar
        if x.shape[-2] == len(self.points) != self.num_particles:
            return self._around_transpose(x, bar)
        sections = x.reshape(*x.shape[:-2], -1, self.section, 3)
        outer = self._outer
        out = (sections - sections.mean(axis=-2, keepdims=True))[..., outer, :]
        length = np.linalg.norm(out, axis=-1, keepdims=True)
        unit = out / length
        bar = bar.reshape(out.shape)
        # skin = centre + r unit
        along = (unit * bar).sum(axis=-1, keepdims=True)
        of_out = (bar - unit * along) * (self.thickness / 2.0 / length)
        found = np.zeros(sections.shape)
        found[..., outer, :] = of_out
        found += (bar - of_out).sum(axis=-2, keepdims=True) / self.section
        return found.reshape(x.shape)

    @property
    def _outer(self) -> NDArray[np.bool_]:
        """Mask of the particles on the rim of a rope's section."""
        radius = np.linalg.norm(self.material_coordinates[: self.section, 1:], axis=1)
        return radius > 0.6 * radius.max()

    def _around(self, x: NDArray[np.floating]) -> NDArray[np.floating]:
        """Rings of eight points around a centre line [..., n, 3], a third of a diameter apart."""
        spacing = np.linalg.norm(self.points[1] - self.points[0])
        parts = max(1, round(3.0 * float(spacing) / self.thickness))
        share = (np.arange(parts) + 0.5)[:, None] / parts
        step = np.diff(x, axis=-2)[..., :, None, :]
        centres = x[..., :-1, None, :] + share * step
        tangent = step / np.linalg.norm(step, axis=-1, keepdims=True)
        # any two normals that change smoothly: a fixed frame under the smallest rotation that
        # takes its axis to the tangent
        first = _fixed_frame(self.points[1] - self.points[0])
        along = tangent + first[2]
        scale = np.maximum(1.0 + tangent @ first[2], 1e-9)[..., None]
        normals = [d - (tangent @ d)[..., None] / scale * along for d in first[:2]]
        angle = 2.0 * math.pi * np.arange(8) / 8.0
        ring = np.cos(angle)[:, None] * normals[0][..., None, :]
        ring = ring + np.sin(angle)[:, None] * normals[1][..., None, :]
        skin = centres[..., None, :] + 0.5 * self.thickness * ring
        return skin.reshape(*x.shape[:-2], -1, 3)

    def _around_transpose(
        self, x: NDArray[np.floating], bar: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Transpose of the derivative of ``_around``, with the same names."""
        n, lead = x.shape[-2], x.shape[:-2]
        bar = bar.reshape(*lead, n - 1, -1, 8, 3)
        parts = bar.shape[-3]
        share = (np.arange(parts) + 0.5)[:, None] / parts
        step = np.diff(x, axis=-2)
        size = np.linalg.norm(step, axis=-1, keepdims=True)
        tangent = step / size
        *first, axis = _fixed_frame(self.points[1] - self.points[0])
        angle = 2.0 * math.pi * np.arange(8) / 8.0
        each = 0.5 * self.thickness * bar.sum(axis=-3)
        along, scale = tangent + axis, np.maximum(1.0 + tangent @ axis, 1e-9)[..., None]
        of_tangent = np.zeros(tangent.shape)
        for d, turn in zip(first, (np.cos(angle), np.sin(angle)), strict=True):
            # normal = d - (t . d) / (1 + t . axis) (t + axis)
            g = (each * turn[:, None]).sum(axis=-2)
            pull, off = (g * along).sum(axis=-1, keepdims=True), (tangent @ d)[..., None]
            of_tangent += axis * off * pull / scale**2 - d * pull / scale - g * off / scale
        of_step = (of_tangent - tangent * (tangent * of_tangent).sum(axis=-1, keepdims=True)) / size
        of_centre = bar.sum(axis=-2)
        of_step += (share * of_centre).sum(axis=-2)
        found = np.zeros(x.shape)
        found[..., :-1, :] = of_centre.sum(axis=-2) - of_step
        found[..., 1:, :] += of_step
        return found

    def moved(self, offset: ArrayLike) -> "Body":
        """Return the same body shifted by ``offset`` [3] [m]."""
        by = np.asarray(offset, dtype=float)
        return replace(self, x=self.x + by, points=self.points + by)


def rope(
    *,
    diameter: float,
    length: float | None = None,
    centre_line: ArrayLike | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    direction: ArrayLike = (1.0, 0.0, 0.0),
    cells_across: float = 2.0,
    points: int | None = None,
    width: float | None = None,
) -> Body:
    """Make a rope, straight or along a centre line.

    Bending is within 2 % and twisting within 5 % of a round rope at every resolution, see
    ``round_section``.

    Args:
        diameter: Diameter [m].
        length: Length [m]; with ``centre_line``, that line is cut or extended to this length
            (default: the length of the line).
        centre_line: [K, 3] points from one end to the other [m].
        start: [3] first end of a straight rope [m].
        direction: [3] direction of a straight rope; need not be a unit vector.
        cells_across: Grid cells across the diameter, 0.5 to 6; particles are twice as dense. For
            the MPM.
        points: Number of points of the centre line, for rods; by default they are one diameter
            apart, but at least 25 and at most 49.
        width: Width of a flat rope (a ribbon), horizontal and across it [m]; its thickness is
            ``diameter``. For rods.

    Raises:
        ParameterError: If sizes are not positive, the centre line is degenerate, ``cells_across``
            lies outside its range, or there are fewer than three points.
    """
    _check_positive(diameter=diameter, cells_across=cells_across)
    if not CELLS_ACROSS[0] <= cells_across <= CELLS_ACROSS[1]:
        raise ParameterError(
            f"cells_across must lie between {CELLS_ACROSS[0]:g} and {CELLS_ACROSS[1]:g}, "
            f"got {cells_across:g}",
            fix="1.5 is the default of estimates; more cost their fourth power",
        )
    if centre_line is None:
        if length is None:
            raise ParameterError("a straight rope needs its length [m]")
        _check_positive(length=length)
        unit = np.asarray(direction, dtype=float)
        norm = np.linalg.norm(unit)
        if norm == 0.0:
            raise ParameterError("direction of a rope must not be the zero vector")
        first = np.asarray(start, dtype=float)
        line = np.stack([first, first + unit / norm * length])
    else:
        line = np.asarray(centre_line, dtype=float)
        if line.ndim != 2 or line.shape[1] != 3 or len(line) < 2:
            raise ParameterError(f"centre_line must be [K >= 2, 3], got {line.shape}")
    dx = diameter / cells_across
    spacing = dx / 2.0
    total = length if length is not None else float(_arc_length(line)[-1])
    if width is not None:
        _check_positive(width=width)
    if points is None:
        points = 1 + min(max(round(total / diameter), EDGES[0]), EDGES[1])
    if points < 3:
        raise ParameterError(f"a rope needs at least three points, got {points}")
    count = max(2, round(total / spacing))
    along = (np.arange(count) + 0.5) * (total / count)
    centre, tangent = _along_line(line, along)

    section, places = round_section(max(2, round(diameter / spacing)), diameter)
    per_section = len(section)

    side, up = _frames(tangent)
    x = centre[:, None] + side[:, None] * section[None, :, :1] + up[:, None] * section[None, :, 1:]
    coordinates = np.concatenate(
        [
            np.broadcast_to(along[:, None, None], (*x.shape[:2], 1)),
            np.broadcast_to(section[None], (*x.shape[:2], 2)),
        ],
        axis=2,
    )
    n = x.shape[0] * x.shape[1]
    cells = np.concatenate(
        [
            np.repeat(np.arange(count), per_section)[:, None],
            np.tile(places, (count, 1)),
        ],
        axis=1,
    )
    return Body(
        kind="rope",
        x=x.reshape(n, 3),
        material_coordinates=coordinates.reshape(n, 3).copy(),
        lattice=_neighbours(cells),
        volume=math.pi / 4.0 * diameter**2 * total / n,
        dx=dx,
        thickness=diameter,
        section=per_section,
        contact_radius=diameter / 2.0,
        points=_along_line(line, np.linspace(0.0, total, points))[0],
        shape=(points,),
        width=width,
    )


def cloth(
    *,
    width: float,
    height: float,
    thickness: float,
    dx: float,
    corner: ArrayLike = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    points: tuple[int, int] | None = None,
    weave: Weave | None = None,
    natural_curvature: ArrayLike | None = None,
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
        weave: Stiffness along threads, in shear and in bending; for shells (default: isotropic).
        natural_curvature: [2, 2] curvature of the stress-free cloth in its first two axes,
            positive where it arches towards its third axis [1/m]; for shells (default: flat).
        corner: [3] position of one corner of the mid-plane [m].
        yaw: Angle of the first axis about z [rad].

    Raises:
        ParameterError: If a size is not positive, or there are fewer than two points along a side.
    """
    _check_positive(width=width, height=height, thickness=thickness, dx=dx)
    if points is None:
        spacing = max(width, height) / (POINTS - 1)
        points = (max(2, 1 + round(width / spacing)), max(2, 1 + round(height / spacing)))
    if min(points) < 2:
        raise ParameterError(f"a cloth needs at least two points along each side, got {points}")
    shape = [max(2, round(size / (dx / 2.0))) for size in (width, height, thickness)]
    ticks = [
        (np.arange(n) + 0.5) * (size / n)
        for n, size in zip(shape, (width, height, thickness), strict=True)
    ]
    ticks[2] -= thickness / 2.0
    ticks[2] *= thickness / math.sqrt(12.0 * np.mean(ticks[2] ** 2))
    local = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    thick = thickness > dx
    c, s = math.cos(yaw), math.sin(yaw)
    to_world = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    x = np.asarray(corner, dtype=float) + local @ to_world
    along, across = (
        np.linspace(0.0, size, n) for size, n in zip((width, height), points, strict=True)
    )
    middle = np.stack([*np.meshgrid(along, across), np.zeros(points[::-1])], axis=-1).reshape(-1, 3)
    return Body(
        kind="cloth",
        x=x,
        material_coordinates=local,
        lattice=_neighbours(np.argwhere(np.ones(shape))),
        volume=width * height * thickness / len(x),
        dx=dx,
        thickness=thickness,
        section=1 if thick else shape[2],
        contact_radius=thickness / shape[2] / 2.0 if thick else thickness / 2.0,
        points=np.asarray(corner, dtype=float) + middle @ to_world,
        shape=points[::-1],
        weave=weave or Weave(),
        natural_curvature=None if natural_curvature is None else _curvature(natural_curvature),
    )


def round_section(across: int, diameter: float) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Place particles in a round section, on a deformed square lattice.

    A section cut out of a square lattice warps where a round section stays plane, and is too soft
    in torsion (0.65 of theory with 12 particles). Instead, a square lattice is deformed until its
    outer particles lie nearly on a circle. The map is the elliptical one, x sqrt(1 - y^2 / 2),
    applied by three quarters; the full map would flatten the lattice at its corners. The points
    are then scaled so that their mean squared distance from an axis is the section's second
    moment, d^2 / 16.

    Args:
        across: Particles across, 2 or more; all have the same volume.
        diameter: Diameter [m].

    Returns:
        points: [across^2, 2] positions in the section, relative to its centre [m].
        cells: [across^2, 2] indices in the lattice; particles that share a side are neighbours.
    """
    cells = np.argwhere(np.ones((across, across)))
    square = cells / (across - 1) * 2.0 - 1.0
    points = square * np.sqrt(1.0 - BULGE * square[:, ::-1] ** 2 / 2.0)
    return points * ((diameter / 4.0) / math.sqrt(np.mean(points[:, 0] ** 2))), cells


def _curvature(values: ArrayLike) -> NDArray[np.floating]:
    """Check a natural curvature and return it as an array [2, 2].

    Raises:
        ParameterError: If it is not [2, 2], finite and symmetric.
    """
    a = np.asarray(values, dtype=float)
    if a.shape != (2, 2) or not np.isfinite(a).all() or a[0, 1] != a[1, 0]:
        raise ParameterError(
            f"natural_curvature must be [2, 2], finite and symmetric, got {values}"
        )
    return a


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ParameterError(f"{name} must be positive and finite, got {value}")


def _neighbours(cells: NDArray[np.integer]) -> NDArray[np.int32]:
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


def _fixed_frame(direction: NDArray[np.floating]) -> NDArray[np.floating]:
    """[3, 3] rows: two normals of a direction [3], and its unit vector."""
    unit = direction / np.linalg.norm(direction)
    side, up = _frames(unit[None])
    return np.stack([side[0], up[0], unit])


def _arc_length(line: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def _along_line(
    line: NDArray[np.floating], along: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Points [M, 3] and unit tangents [M, 3] at arc lengths; straight beyond both ends."""
    s = _arc_length(line)
    steps = np.diff(line, axis=0)
    lengths = np.diff(s)
    if np.any(lengths <= 0.0):
        raise ParameterError("centre_line repeats a point: remove neighbours that coincide")
    unit = steps / lengths[:, None]
    segment = np.clip(np.searchsorted(s, along, side="right") - 1, 0, len(unit) - 1)
    points = line[segment] + unit[segment] * (along - s[segment])[:, None]
    # average tangents over neighbouring points, so that sections do not jump at corners
    tangent = np.gradient(points, axis=0)
    return points, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def _frames(tangent: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Two unit normals [M, 3] of each tangent; the first is horizontal where possible."""
    reference = np.array([0.0, 0.0, 1.0])
    if np.max(np.abs(tangent @ reference)) > 0.99:
        reference = np.array([0.0, 1.0, 0.0])
    side = np.cross(reference, tangent)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(tangent, side)
