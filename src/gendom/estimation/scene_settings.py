"""How recordings are turned into scenes: resolution, clock, material and what is compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gendom.arguments import require
from gendom.materials import catalogue
from gendom.sim import ENGINES, check_numbers
from gendom.sim.bodies import CELLS_ACROSS

SHELL_POINTS = 33
"""Along the longer side of a cloth. Cloths that bend over 0.09 and 0.16 of a side then move like
ones of 81 points if E is 0.87 and 1.01 times theirs."""

SPACING, MOST_SHELL_POINTS, MOST_ROD_POINTS = 1.0 / 3.0, 49, 65
"""Limp objects are then estimated again with points this many bending lengths apart, up to so many
of cloths and ropes, where that is at least a tenth more. Lifted ropes with points twice as far
apart are off by 0.5 to 5 mm, as if their bending length was 5 to 40 % another."""

SHELL_ERROR = 1.5
"""Error of ln(E) by the distance of a cloth's points, in bending lengths and to the third power
(docs/notes/cloths.md)."""

STRETCH = 0.002
"""An object's own weight lengthens it by this at most, hanging by a side or an end: the simulated
stiffness along it is limited to that. For a cloth this allows longer time steps: two to four times
where it bends over 25 to 45 mm and is 0.5 to 1 mm thick. A rope gets at least that stiffness: its
fibres resist stretch more than bending, in which they slide past each other. With one E for both
soft ropes stretch by up to 4 %, and their tails follow less over the table."""

COARSE_POINTS, COARSE_SHARE, COARSE_FRAMES, COARSE_STRETCH = 21, 0.6, 18, 0.01
"""Where a search begins: points of a rod, or along the longer side of a shell, of which that is the
least, and a share of the points that it has else; frames that are compared, at most; and in place
of `STRETCH`."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How a recording is turned into a simulation; written into every result."""

    engine: Literal["thin", "mpm"] = "thin"
    """Engine of the simulator. thin: ropes as rods, cloths as shells. mpm: material points, slower.
    """
    material: str | None = None
    """Its material, by a name of gendom materials: narrows the priors, and gives the density where
    the mass is unknown."""
    points: int | None = None
    """Points of a rod, or along the longer side of a shell; by default the engine's choice."""
    cells_across: float = 1.5
    """With mpm: grid cells across a rope's diameter (cloths alike); finer is slower."""
    slow_frames: int = 36
    """Frames that are compared where the gripper is slow, at most."""
    fast_frames: int = 60
    """Frames that are compared elsewhere, at most."""
    dtype: str | None = None
    """``float32`` or ``float64``; None: the first for cloths as shells, else the engine's own."""
    substep: float | None = None
    """Of all worlds [s]; None: each its own. Then the number of substeps between two frames depends
    on E, and where it changes, positions jump by some 1e-7 m, which shows in exact clouds only."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.material is not None:
            catalogue.get(self.material)
        check_numbers("cells_across", self.cells_across, above=0.0)
        low, high = CELLS_ACROSS
        fit = low <= self.cells_across <= high
        fix = f"give {low:g} to {high:g}"
        require(fit, f"is {self.cells_across:g}", where="cells_across", fix=fix)
        unknown, fix = f"unknown engine {self.engine!r}", f"choose one of {', '.join(ENGINES)}"
        require(self.engine in ENGINES, unknown, fix=fix)
        if self.substep is not None:
            check_numbers("substep", self.substep, above=0.0)
        few = f"is {self.points}"
        require(self.points is None or self.points >= 5, few, where="points", fix="give 5 or more")
