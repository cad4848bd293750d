"""Derivatives by everything that a simulation was given, and their sums while it is reversed."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.simulator import Simulator


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """Derivatives of a loss by everything that a simulation was given.

    Not differentiated: when grippers open and close, what they hold, how they turn, the substep's
    length, and whether a grid node sticks, slides or is held.
    """

    E: NDArray[np.float64]
    """[W] by Young's modulus [1/Pa]."""
    nu: NDArray[np.float64]
    """[W] by Poisson's ratio."""
    density: NDArray[np.float64]
    """[W] by density [m^3/kg]."""
    yield_stress: NDArray[np.float64]
    """[W] by yield stress [1/Pa]; 0 where nothing yields."""
    stiffness: NDArray[np.float64]
    """[W, N] by each particle's share of E."""
    damping: NDArray[np.float64]
    """[W] by the rate of damping [s]."""
    friction: NDArray[np.float64]
    """[W] by the table's coefficient of friction."""
    gravity: NDArray[np.float64]
    """[W, 3] by gravity [s^2/m]."""
    positions: NDArray[np.floating]
    """[W, N, 3] by the initial positions, the rest shape unchanged [1/m]."""
    velocities: NDArray[np.floating]
    """[W, N, 3] by the initial velocities [s/m]."""
    gripper_positions: NDArray[np.float64]
    """[W, G, K, 3] by the grippers' positions at their knots [1/m]; shorter paths repeat their
    last knot, whose derivatives stand at the first of the repeats."""


def overflow(
    s: Simulator, w: int, *, substep: int, time: float, particle: int, F: NDArray[np.floating]
) -> SimulationError:
    """The error of a derivative by a particle's state [its F: 3, 3] that is not finite."""
    J = float(np.linalg.det(np.asarray(F, dtype=float)))
    cause = (
        f"its volume is {J:.2g} of that at rest, where the stress law is singular"
        if J < 0.1
        else f"derivatives grew beyond {s.dtype} over the substeps after it"
    )
    return s.worlds.error(
        w,
        time,
        f"the derivative by the state of particle {particle} is not finite: {cause}",
        where=f"substep {substep}",
        fix="use float64, a shorter rollout, or more damping",
        particle=particle,
    )


class Sums:
    """Derivatives by state and parameters while they are summed up."""

    def __init__(self, s: Simulator):
        worlds = s.worlds
        self.device_is_cuda = s.device.is_cuda
        W, N = worlds.num_worlds, worlds.num_particles
        G, K = worlds.paths.time.shape[1:]
        k, real = worlds.kernels, worlds.real
        self.matter = k.transfers.MatterBars()
        state = worlds.make_state((W, N), wp.zeros)
        for name in worlds.carried:
            setattr(self.matter, name, getattr(state, name))
        for name in ("mu", "lam", "mass", "yield_stress"):
            setattr(self.matter, name, worlds.zeros((W, N), real))
        self.scene = k.boundary.SceneBars()
        for name in ("friction", "damping", "keep"):
            setattr(self.scene, name, worlds.zeros(W, wp.float64))
        self.scene.gravity = worlds.zeros(W, wp.vec3d)
        self.scene.path = worlds.zeros((W, G, K), wp.vec3d)
        for name in ("centre", "velocity"):
            setattr(self.scene, name, worlds.zeros((W, G), wp.vec3d))
        self.trouble = worlds.reverse.Trouble()
        for name in ("status", "slot", "culprit"):
            setattr(self.trouble, name, worlds.zeros(W, wp.int32))

    def add_positions(self, w: int | slice, bar: NDArray[np.floating]) -> None:
        """Add a loss's own derivative by world w's positions now, [N, 3] or [W, N, 3] [1/m]."""
        now = self.matter.x.numpy()
        now[w] += bar
        if self.device_is_cuda:
            self.matter.x.assign(now)

    def gradients(self, s: Simulator) -> Gradients:
        """What the sums mean for the numbers that a user gave."""
        matter, scene = self.matter, self.scene
        E = np.array([m.E for m in s.materials])[:, None]
        nu = np.array([m.nu for m in s.materials])[:, None]
        mu_bar, lam_bar = matter.mu.numpy().astype(float), matter.lam.numpy().astype(float)
        # mu = E / (2 (1 + nu)), lam = E nu / ((1 + nu) (1 - 2 nu)) or, in plane stress,
        # E nu / (1 - nu^2), times the stiffness
        twice = 1.0 if s.worlds.plane_stress else 2.0
        room = (1.0 + nu) * (1.0 - twice * nu)
        mu_E = 1.0 / (2.0 * (1.0 + nu))
        lam_E = nu / room
        mu_nu = -E / (2.0 * (1.0 + nu) ** 2)
        lam_nu = E * (1.0 + twice * nu**2) / room**2
        by_E = mu_bar * mu_E + lam_bar * lam_E
        path = np.array(scene.path.numpy())
        for w, grippers in enumerate(s.worlds.setting.grippers):
            for g, gripper in enumerate(grippers):
                last = len(np.asarray(gripper.time)) - 1
                path[w, g, last] += path[w, g, last + 1 :].sum(axis=0)
                path[w, g, last + 1 :] = 0.0
        return Gradients(
            E=(by_E * s.stiffness).sum(axis=1),
            nu=((mu_bar * mu_nu + lam_bar * lam_nu) * s.stiffness).sum(axis=1),
            density=matter.mass.numpy().astype(float).sum(axis=1) * s.body.volume,
            yield_stress=matter.yield_stress.numpy().astype(float).sum(axis=1),
            stiffness=by_E * E,
            damping=np.array(scene.damping.numpy()),
            friction=np.array(scene.friction.numpy()),
            gravity=np.array(scene.gravity.numpy()),
            positions=np.array(matter.x.numpy()),
            velocities=np.array(matter.v.numpy()),
            gripper_positions=path,
        )
