"""What an engine is given: the physics around a body, how it is solved, the checked
arguments of a simulator, and the frames to record."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import (
    check_choice,
    check_integers,
    check_number,
    check_numbers,
    check_type,
    require,
)
from gendom.arrays import Array
from gendom.errors import ParameterError, SimulationError
from gendom.materials import AIR_DENSITY, STANDARD_GRAVITY, Material
from gendom.sim.bodies import Body
from gendom.sim.gripper import Grippers
from gendom.sim.obstacles import Obstacle, Table

GRAVITY = (0.0, 0.0, -STANDARD_GRAVITY)
"""Standard gravity, z up [m/s^2]."""

DRAG = {"rope": 1.1, "cloth": 1.2}
"""Drag coefficients of a cylinder across the flow at Reynolds numbers of 1e3 to 1e5 and of a plate
that faces it. Source: Hoerner (1965), "Fluid-Dynamic Drag", chapter 3."""

ENGINES = ("mpm", "thin")
"""``mpm``: particles on a grid; ``thin``: ropes as rods, cloths as shells."""


@dataclass(frozen=True, kw_only=True)
class Physics:
    """What acts on a body besides its own elasticity, the table and grippers.

    Raises:
        ParameterError: If a value is of another type or shape, out of its range or not finite.
    """

    gravity: ArrayLike = GRAVITY
    """[3] or [W, 3] [m/s^2]."""
    velocity_damping: float | ArrayLike = 0.0
    """Rate at which all velocities decay, one number or [W] [1/s]; for damping inside the material
    see ``Material.damping``."""
    air_density: float | ArrayLike = AIR_DENSITY
    """Density of the air, which exerts drag on ropes and cloths, one number or [W] [kg/m^3]."""
    self_contact: bool = False
    """Whether rods and shells keep their thickness where they meet themselves. The MPM resolves
    self-contact through its grid in any case."""
    self_friction: float | ArrayLike = 0.3
    """Coefficient of friction at self-contact, one number or [W]."""

    def __post_init__(self) -> None:
        check_numbers("gravity", self.gravity, (3,), ("W", 3))
        check_type("self_contact", self.self_contact, bool)
        for name in ("velocity_damping", "air_density", "self_friction"):
            check_numbers(name, getattr(self, name), (), ("W",), least=0.0)


@dataclass(frozen=True, kw_only=True)
class Variation:
    """How the bodies of worlds differ from the one that they are made from."""

    stiffness: ArrayLike = 1.0
    """E of each particle or point over that of its material, [N] or [W, N] [-]; of shells with a
    membrane's modulus that of bending alone."""
    mass: ArrayLike = 1.0
    """Mass of each point of a rod or shell over that of its material, likewise [-]."""
    natural_curvature: ArrayLike = 1.0
    """Share of a rod's bending and twist that is free of stress, one number or [W] [-]; 0: it is
    straight by nature."""
    stretch: ArrayLike = 1.0
    """Length of a rod's edges over that in the body, one number or [W] [-]."""
    turning: float = 1.0
    """Rotary inertia of a rod's edges over that of stiff ones [-]: with more, steps are longer."""
    diameter: ArrayLike | None = None
    """Of rods that meet nothing, [W] [m]; None: that of the body."""

    def check(self, points: int) -> None:
        """Check shapes and ranges for a body of so many particles or points.

        Raises:
            ParameterError: If one is wrong.
        """
        for name in ("stiffness", "mass"):
            shapes = (), (points,), ("W", points)
            check_numbers(name, getattr(self, name), *shapes, above=0.0)
        check_numbers("natural_curvature", self.natural_curvature, (), ("W",))
        check_numbers("stretch", self.stretch, (), ("W",), above=0.0)
        check_number("turning", self.turning, above=0.0)
        if self.diameter is not None:
            check_numbers("diameter", self.diameter, ("W",), above=0.0)


@dataclass(frozen=True, kw_only=True)
class Solver:
    """How a simulation is computed.

    Raises:
        ParameterError: If a value is unknown, of another type or out of its range.
    """

    engine: str | None = None
    """``thin`` (a rope as a rod, a cloth as a shell), the default for ropes and cloths, or ``mpm``
    (particles on a grid), the default for all other bodies."""
    substep: float | None = None
    """Fixed substep [s], or None for ``cfl`` times each world's stability limit."""
    cfl: float | None = None
    """Share of that limit (default: the engine's)."""
    dtype: str | None = None
    """``float32`` (default of the MPM) or ``float64`` (default of rods and shells)."""
    device: str = "cpu"
    """``cpu``, ``cuda``, ``cuda:0`` and so on."""
    threads: int | None = None
    """Worlds simulated in parallel on the CPU (default: all cores available to the process)."""
    interleaved: bool = False
    """Whether rods that meet neither obstacles nor themselves are side by side in the SIMD lanes of
    a CPU: many take half as long, a single one up to five times. Rounding differs."""

    def __post_init__(self) -> None:
        if self.engine is not None:
            check_choice("engine", self.engine, ENGINES)
        known = self.dtype in (None, "float32", "float64")
        require(known, f"dtype must be float32 or float64, got {self.dtype!r}")
        for name in ("substep", "cfl"):
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), above=0.0)
        if self.threads is not None:
            check_integers("threads", self.threads, (), least=1)


@dataclass(frozen=True)
class Frames:
    """The frames that a run records."""

    began: float
    """Time of the initial state [s]."""
    times: Array
    """[T] times of the frames [s]."""
    particles: NDArray[np.integer]
    """[P] indices of the recorded particles."""
    x: Array
    """[T, W, P, 3] positions [m], filled by the run."""
    on_frame: Callable[[int], None] | None
    keep_going: bool


@dataclass(frozen=True, kw_only=True)
class Setting(Physics):
    """Description of all worlds: the arguments of ``Simulator``, checked."""

    body: Body
    materials: Sequence[Material]
    parameters: Mapping[str, Array]
    """Those of the materials, as of ``parameters_of``."""
    grippers: Grippers
    table: Table | None
    obstacles: Sequence[Sequence[Obstacle]]
    """Of each world."""
    variation: Variation
    positions: ArrayLike
    start_time: float
    dtype: str
    device: Any
    threads: int
    interleaved: bool = False
    substep: Array = field(default_factory=lambda: np.empty(0))
    """[W] longest substep of each world [s]."""

    def error(
        self, w: int, time: float, what: str, *, where: str, fix: str, particle: int | None = None
    ) -> SimulationError:
        """Return an error that names world, time [s], parameters and optionally a particle."""
        m = self.materials[w]
        return SimulationError(
            what,
            where=f"world {w} at {time:.4f} s ({self._material(w)}, {where})",
            fix=fix,
            world=w,
            time=time,
            parameters={"E": m.E, "nu": m.nu, "density": m.density}
            | ({"damping": m.damping} if m.damping > 0.0 else {}),
            particle=particle,
        )

    def check_substep(self, shortest: float, *, fix: str) -> None:
        """Check that no world's substep is too short.

        Raises:
            ParameterError: If one is below ``shortest`` [s]; the error names the world.
        """
        w = int(self.substep.argmin())
        if self.substep[w] < shortest:
            raise ParameterError(
                f"substep would be {self.substep[w]:.2g} s, the shortest is {shortest:g} s",
                where=f"world {w} ({self._material(w)})",
                fix=fix,
            )

    def _material(self, w: int) -> str:
        m = self.materials[w]
        return f"E {m.E:.6g} Pa, nu {m.nu:.4g}, density {m.density:.6g} kg/m^3"


def spread(values: Any, shape: tuple[int, ...], name: str) -> Array:
    """Broadcast values to a shape.

    Raises:
        ParameterError: If the shapes do not match; the error contains ``name``.
    """
    try:
        return np.broadcast_to(np.asarray(values, dtype=float), shape)
    except ValueError:
        raise ParameterError(
            f"{name} has shape {np.shape(values)}, which does not fit {shape}"
        ) from None
