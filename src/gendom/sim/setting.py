"""Input of an engine: the checked arguments of a simulator, and the frames to record."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim.bodies import Body
from gendom.sim.gripper import Grippers
from gendom.sim.scene import Table

DRAG = {"rope": 1.1, "cloth": 1.2}
"""Drag coefficients of a cylinder across the flow at Reynolds numbers of 1e3 to 1e5 and of a plate
that faces it. Source: Hoerner (1965), "Fluid-Dynamic Drag", chapter 3."""


@dataclass(frozen=True)
class Frames:
    """The frames that a run records."""

    began: float
    """Time of the initial state [s]."""
    times: NDArray[np.float64]
    """[T] times of the frames [s]."""
    particles: NDArray[np.integer]
    """[P] indices of the recorded particles."""
    x: NDArray[np.floating]
    """[T, W, P, 3] positions [m], filled by the run."""
    on_frame: Callable[[int], None] | None
    keep_going: bool


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Description of all worlds: the arguments of ``Simulator``, checked."""

    body: Body
    materials: Sequence[Material]
    grippers: Grippers
    table: Table | None
    gravity: ArrayLike
    velocity_damping: ArrayLike
    air_density: ArrayLike
    self_contact: bool
    self_friction: ArrayLike
    stiffness: ArrayLike
    mass: ArrayLike
    natural_curvature: ArrayLike
    positions: ArrayLike
    start_time: float
    dtype: str
    device: Any
    threads: int
    substep: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """[W] longest substep of each world [s]."""

    def error(
        self,
        w: int,
        time: float,
        what: str,
        *,
        where: str,
        fix: str,
        particle: int | None = None,
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


def spread(values: Any, shape: tuple[int, ...], name: str) -> NDArray[np.floating]:
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
