"""Settings of a simulation: the table, the physics around a body, and how it is solved."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from gendom.arguments import (
    check_choice,
    check_integers,
    check_number,
    check_numbers,
    check_type,
    require,
)
from gendom.materials import AIR_DENSITY, STANDARD_GRAVITY

GRAVITY = (0.0, 0.0, -STANDARD_GRAVITY)
"""Standard gravity, z up [m/s^2]."""

ENGINES = ("mpm", "thin")
"""``mpm``: particles on a grid; ``thin``: ropes as rods, cloths as shells."""


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
    """Share of that limit (default: the engine's ``CFL``)."""
    dtype: str | None = None
    """``float32`` (default of the MPM) or ``float64`` (default of rods and shells)."""
    device: str = "cpu"
    """``cpu``, ``cuda``, ``cuda:0`` and so on."""
    threads: int | None = None
    """Worlds simulated in parallel on the CPU (default: all cores available to the process)."""

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
