"""Engine of ``Simulator`` for the material point method."""

# pyright: basic

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.runner import MOST_PARTICLES, Program, run
from gendom.sim.mpm.tape import Tape
from gendom.sim.setting import Frames, Setting, spread

CFL = 0.6
"""Default share of the time in which a pressure wave crosses one cell."""

SHORTEST_SUBSTEP = 1e-6
"""Below, a second takes hours, and float32 does not resolve motion [s]."""


class MpmEngine(Worlds):
    """W worlds of material points.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    commanded = None
    """Paths of grippers that somebody controls: none."""

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
        setting = replace(setting, substep=limits)
        setting.check_substep(
            SHORTEST_SUBSTEP,
            fix="a softer or denser material, larger cells, a longer substep, or engine='thin'",
        )
        super().__init__(setting)
        self.together = setting.device.is_cuda
        """Whether one launch runs all worlds; tests set it on the CPU."""

    @property
    def num_points(self) -> int:
        return self.num_particles

    @property
    def used(self) -> bool:
        """Whether any world has moved."""
        return bool(self.clock.age.numpy().any())

    def positions(self) -> Array:
        return self.state.x.numpy() + self.origin.astype(self.numpy_type)

    def velocities(self) -> Array:
        return np.array(self.state.v.numpy())

    def set_velocities(self, v: ArrayLike, affine: ArrayLike) -> None:
        shape, dtype = (self.num_worlds, self.num_particles, 3), self.numpy_type
        C = spread(affine, (*shape, 3), "affine velocities")
        self.state.v.assign(spread(v, shape, "velocities").astype(dtype))
        self.state.C.assign(C.astype(dtype))

    @cached_property
    def program(self) -> Program:
        """The kernels and what they share, made when first needed."""
        return Program(self, together=self.together)

    def run(self, frames: Frames) -> None:
        run(self.program, frames)
        frames.x[...] += self.origin.astype(self.numpy_type)

    def tape(self, memory: float) -> Tape:
        """Make the tape that records a run for its reverse pass."""
        return Tape(self.program, memory)


def stable_substep(material: Material, dx: float, *, cfl: float = CFL) -> float:
    """Longest substep [s] at a share ``cfl`` of the Courant limit dx / wave speed.

    The wave speed is that of small strains; ``CFL`` leaves room for stiffening under compression.
    Source: Courant, Friedrichs and Lewy (1928).
    """
    return cfl * dx / material.wave_speed
