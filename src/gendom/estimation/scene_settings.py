"""How recordings are turned into scenes: resolution, clock, material and what is compared."""

from __future__ import annotations

from dataclasses import dataclass

from gendom.errors import ParameterError
from gendom.materials import catalogue
from gendom.sim import ENGINES, check_numbers
from gendom.sim.bodies import CELLS_ACROSS

SHELL_POINTS = 33
"""Along the longer side of a cloth. In lifts by a corner, cloths of which the bending length is
0.09 and 0.16 of a side move like ones of 81 points if E is 0.87 and 1.01 times theirs; with 26
points, which take half the time, 1.46 and 1.12 times."""

SHELL_SPACING, MOST_SHELL_POINTS = 1.0 / 3.0, 49
"""Limp cloths are then estimated again with points this many bending lengths apart, up to the
largest number below, where that is at least a tenth more. A cloth that bends over 0.056 of a side
moved like MuJoCo's with 45 points, with 33 if its E was 1.5 times as large."""

SHELL_ERROR = 1.5
"""Error of ln(E) by the distance of a cloth's points, in bending lengths and to the third power.
Nearest to lifts of five of MuJoCo's cloths, 33 points less than half a bending length apart had E
by 0.01 to 0.13 (0.08 in the mean) larger than 49."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How a recording is turned into a simulation; written into every result."""

    engine: str = "thin"
    """``thin`` (ropes as rods, cloths as shells) or ``mpm``."""
    material: str | None = None
    """What the object is made of, a name of `gendom.materials.catalogue`: priors, and its density
    where the mass is unknown. None: unknown."""
    points: int | None = None
    """Of a rod, or along the longer side of a shell; None: the engine's own for ropes,
    `SHELL_POINTS` for cloths."""
    stretch: float = 0.002
    """A cloth's own weight lengthens it by this at most, hanging by a side: the simulated stiffness
    in its plane is limited to that. This allows longer time steps: two to four times for cloths
    that bend over 25 to 45 mm and are 0.5 to 1 mm thick. A rope whose diameter is not stated is
    lengthened by no more: a soft one of the diameter that is assumed would stretch by 4 %."""
    coarse_points: int = 21
    """Along the longer side of a shell, where a search begins."""
    cells_across: float = 1.5
    """Grid cells across a rope's diameter; cloths scale with it. Of the MPM."""
    clock: float | None = None
    """Recorded seconds for one simulated second, or None to choose (1 unless quasi-static)."""
    quasi_static_speed: float = 0.05
    """Gripper speed at which quasi-static recordings are replayed [m/s]. Faster, a rope that leaves
    the table swings: by 20 mm at 0.12 m/s."""
    quasi_static_damping: float = 1.0
    """Rate at which velocities decay in quasi-static replays [1/s]; at the speed above its drag is
    0.5 % of gravity."""
    static_damping: float = 3.0
    """The same where nothing moves [1/s]."""
    static_settling: float = 6.0
    """Time in which such an object comes to rest [s]; its slowest swing then has e^-9 left."""
    ramp_speed: float = 0.1
    """Speed at which the gripper takes the object from rest to its first recorded position [m/s]"""
    clamping: float = 0.1
    """Time in which clamps turn from where markers show them to how they hold the rope [s]."""
    slow: float = 0.15
    """Speed of a gripper below which frames are alike [m/s]."""
    after_fast: float = 1.5
    """Time for which an object goes on moving after its gripper was fast or let go [s]."""
    straight: float = 0.1
    """Turn of a lying rope up to which it counts as straight [rad]."""
    rope_reach: float = 0.75
    """How far from its point a gripper holds a rope where `grasp_radius` is not stated [diameters]:
    fingertips 1.5 diameters wide."""
    cloth_reach: float = 0.02
    """The same of a cloth [m]: two fingertips."""
    least_reach_points: float = 0.6
    """Least reach on a cloth as a shell, in its coarse points' spacings, so that it holds points
    wherever it is."""
    least_reach_cells: float = 0.4
    """The same with the MPM, in grid cells."""
    cut_share: float = 0.5
    """Clouds are cut off above the table where less of an object at rest has points near it."""
    cut_near: float = 0.05
    """How near, in the object's size."""
    cut_above: float = 0.003
    """Height of the cut over the lowest point [m]."""
    longest: float = 300.0
    """Longest motion that is simulated [s]; a lift takes 10 s."""
    slow_frames: int = 36
    """Frames that are compared where the gripper is slow, at most."""
    lifted: float = 0.15
    """Rise of the gripper, in a rope's length or a cloth's longer side, from which the object is
    lifted: before, clouds show hardly more than how it lay."""
    fast_frames: int = 60
    """Frames that are compared elsewhere, at most."""
    dtype: str | None = None
    """``float32`` or ``float64``; None: the first for cloths as shells, else the engine's own."""
    substep: float | None = None
    """Of all worlds [s]; None: each its own. Then the number of substeps between two frames depends
    on E, and where it changes, positions jump by some 1e-7 m, which shows in exact clouds only."""
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.material is not None:
            catalogue.get(self.material)
        check_numbers("cells_across", self.cells_across, above=0.0)
        low, high = CELLS_ACROSS
        if not low <= self.cells_across <= high:
            raise ParameterError(
                f"is {self.cells_across:g}", where="cells_across", fix=f"give {low:g} to {high:g}"
            )
        if self.engine not in ENGINES:
            raise ParameterError(
                f"unknown engine {self.engine!r}", fix=f"choose one of {', '.join(ENGINES)}"
            )
        if self.clock is not None:
            check_numbers("clock", self.clock, above=0.0)
        check_numbers("stretch", self.stretch, above=0.0)
        if self.substep is not None:
            check_numbers("substep", self.substep, above=0.0)
        if self.points is not None and self.points < 5:
            raise ParameterError(f"is {self.points}", where="points", fix="give 5 or more")
