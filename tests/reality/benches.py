"""The objects of the MuJoCo test scene on a test bench: does the flex bend according to its
modulus?

Each object is clamped at one end and sags under its weight, made stiff enough for small
deflections: a flex's resistance to bending scales with its modulus, so what is checked is the
discretisation with which the object is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import STANDARD_GRAVITY
from gendom.reality.model import Layout
from gendom.reality.objects import SHEET_NU, RealCloth, RealObject, RealRope, grid
from gendom.reality.world import Reality

SAG = 0.02
"""Sag in lengths for which the modulus is chosen."""

STRIP = 8
"""Spacings across the strip that is cut from a cloth. Wider ones sag less, as plates do near a
clamp; along the diagonal the borders of 6 and 10 are softer than the rest."""

STEP = 0.001
"""Time step [s]. With a cloth's 4 ms the clamp of a stiffened strip gives way by 1.4 mm."""


@dataclass(frozen=True, kw_only=True)
class Strip(RealCloth):
    """A strip that is cut from a cloth along its first side or its diagonal."""

    across: int
    """Spacings across; along the diagonal: half diagonals."""
    diagonal: bool = False

    @property
    def counts(self) -> tuple[int, int]:
        return self.vertices, self.across + 1

    @property
    def sheet(self):
        if self.diagonal:
            return diagonal_strip(self.vertices, self.across, self.spacing)
        return grid(*self.counts, self.spacing)


def strip_of(cloth: RealCloth, across: int, diagonal: bool) -> Strip:
    own = {field.name: getattr(cloth, field.name) for field in fields(cloth)}
    return Strip(across=across, diagonal=diagonal, **own)


@dataclass(frozen=True)
class Bench:
    """One object's cantilever."""

    name: str
    sag: float
    """Measured [m]."""
    expected: float
    """q L^4 / (8 B) [m] with weight a length q and rigidity B: E I of a rope, of a strip its width
    times that of its sheet times 1 - nu^2, because it is free to bend across, with `SHEET_NU` for
    nu. Source: Timoshenko, "Strength of Materials"."""

    @property
    def error(self) -> float:
        """Relative error."""
        return self.sag / self.expected - 1.0


def diagonal_strip(
    vertices: int, across: int, spacing: float
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """A strip along the diagonal of a square, without its pointed ends.

    Args:
        vertices: Along a side of the square.
        across: Half squares of the grid across the strip.
        spacing: Between neighbours along a side [m].

    Returns:
        Vertices [V, 2], along and across the strip [m], and triangles [F, 3].
    """
    points, triangles = grid(vertices, vertices, spacing)
    turn = np.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    turned = points @ turn
    half = across / 2.0 * spacing * 0.5**0.5
    middle = turned[:, 0].max() / 2.0
    away = np.abs(turned - [middle, 0.0])
    kept = np.all(away <= np.array([middle - half, half]) + 1e-6 * spacing, axis=1)
    triangles = triangles[kept[triangles].all(axis=1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    strip = np.asarray(turned[used] - [half, 0.0], dtype=np.float64)
    return strip, triangles.reshape(-1, 3)


def cantilever(item: RealObject, *, diagonal: bool = False, seconds: float = 1.5) -> Bench:
    """Let an object sag from a clamp.

    Args:
        item: A rope or a cloth; of a cloth a strip is taken.
        diagonal: Along the cloth's diagonal, not along its first side.
        seconds: Simulated time until it is at rest [s].
    """
    if isinstance(item, RealCloth):
        item = strip_of(item, STRIP, diagonal)
        rows, row = np.unique(item.sheet[0][:, 0].round(9), return_inverse=True)
        length, spacing = float(rows[-1]), float(rows[1])
        breadth = item.mass / (item.material.density * item.thickness * length)
        rigidity = item.rigidity * (1.0 - SHEET_NU**2) * breadth
    else:
        length, spacing = item.length, item.length / (item.vertices - 1)
        row = np.arange(item.vertices)
        rigidity = item.material.E * math.pi * item.diameter**4 / 64.0
    # Curvature at a vertex stands for half an edge to both sides, at the clamp's last one too: the
    # beam is free from half an edge before it.
    free = length - spacing / 2.0
    weight = item.mass * STANDARD_GRAVITY / length
    soft = weight * free**4 / (8.0 * rigidity)
    stiff = replace(
        item,
        material=replace(
            item.material,
            E=item.material.E * soft / (SAG * length),
            damping=0.02,  # brings the first mode to rest within a second or so
        ),
    )
    world = Reality(stiff, Layout(origin=(0.0, 0.0, 0.5), clamped=1e-6), table=False, timestep=STEP)
    # Stiffened, a sheet is beyond conjugate gradients.
    world.model.opt.solver = 2  # Newton
    world.step_to(seconds)
    height = np.bincount(row, world.vertices()[:, 2]) / np.bincount(row)
    # Without the rotation of the clamp itself.
    slope = (height[1] - height[0]) / spacing
    sag = height[1] - height[-1] + slope * (length - spacing)
    return Bench(item.name, float(sag), SAG * length)


def stretch(rope: RealRope, vertices: np.ndarray) -> float:
    """How much longer a rope [V, 3] [m] is than at rest, relative."""
    return float(np.linalg.norm(np.diff(vertices, axis=0), axis=1).sum() / rope.length - 1.0)
