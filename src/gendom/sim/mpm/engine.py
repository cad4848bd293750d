"""Engine of ``Simulator`` for the material point method."""

# pyright: basic

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.runner import MOST_PARTICLES, Program, run
from gendom.sim.mpm.tape import Tape
from gendom.sim.setting import Frames, Setting, spread

CFL = 0.6
"""Default share of the time in which a pressure wave crosses one cell."""


SHORTEST_SUBSTEP = 1e-6
"""Below, a second takes hours, and float32 does not resolve motion [s]."""


class MpmEngine:
    """W worlds of material points.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        N, W = setting.body.num_particles, len(setting.materials)
        require(
            not setting.device.is_cuda or N <= MOST_PARTICLES,
            f"the body has {N} particles, on CUDA the MPM takes at most {MOST_PARTICLES}",
            fix="a larger dx, or device='cpu'",
        )
        share = np.sqrt(spread(setting.stiffness, (W, N), "stiffness").max(axis=1))
        limits = [stable_substep(m, setting.body.dx, cfl=cfl or CFL) for m in setting.materials]
        limits = np.full(W, substep) if substep else np.array(limits) / share
        w = int(limits.argmin())
        m = setting.materials[w]
        require(
            limits[w] >= SHORTEST_SUBSTEP,
            f"substeps of {limits[w]:.2g} s would be needed, the shortest are 1e-06 s",
            where=f"world {w} (E {m.E:.6g} Pa, nu {m.nu:.4g}, density {m.density:.6g} kg/m^3, "
            f"damping {m.damping:.4g} s, cells of {setting.body.dx:.4g} m)",
            fix="a softer or denser material, larger cells, or engine='thin'",
        )
        self.setting = setting = replace(setting, substep=limits)
        self.worlds = Worlds(setting)
        self.threads, self.dtype, self.device = setting.threads, setting.dtype, setting.device
        self.together = setting.device.is_cuda
        """Whether one launch runs all worlds; tests set it on the CPU."""
        self._program: Program | None = None

    @property
    def num_points(self) -> int:
        return self.worlds.num_particles

    @property
    def num_worlds(self) -> int:
        return self.worlds.num_worlds

    @property
    def used(self) -> bool:
        """Whether any world has moved."""
        return bool(self.worlds.clock.age.numpy().any())

    @property
    def failures(self) -> dict[int, SimulationError]:
        return self.worlds.failures

    def positions(self) -> Array:
        return self.worlds.state.x.numpy() + self.worlds.origin.astype(self.dtype)

    def velocities(self) -> Array:
        return np.array(self.worlds.state.v.numpy())

    def set_velocities(self, v: ArrayLike, affine: ArrayLike) -> None:
        shape, dtype = (self.worlds.num_worlds, self.num_points, 3), self.dtype
        C = spread(affine, (*shape, 3), "affine velocities")
        self.worlds.state.v.assign(spread(v, shape, "velocities").astype(dtype))
        self.worlds.state.C.assign(C.astype(dtype))

    @property
    def program(self) -> Program:
        """The kernels and what they share, made when first needed."""
        if self._program is None:
            self._program = Program(self.worlds, together=self.together)
        return self._program

    def run(self, frames: Frames) -> None:
        run(self.program, frames, self.threads)
        frames.x[...] += self.worlds.origin.astype(self.dtype)

    def tape(self, memory: float) -> Tape:
        """Make the tape that records a run for its reverse pass."""
        return Tape(self.program, memory, self.threads)


def stable_substep(material: Material, dx: float, *, cfl: float = CFL) -> float:
    """Longest substep [s] at a share ``cfl`` of the Courant limit dx / wave speed.

    The wave speed is that of small strains; ``CFL`` leaves room for stiffening under compression.
    Source: Courant, Friedrichs and Lewy (1928).
    """
    return cfl * dx / material.wave_speed
