"""Derivatives by state and parameters while they are summed up."""

# pyright: basic

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.gradients import Gradients
from gendom.sim.mpm.engine import MpmEngine


@wp.struct
class Trouble:
    """Where a derivative overflowed."""

    status: wp.array(dtype=wp.int32)  # pyright: ignore  # [W]
    slot: wp.array(dtype=wp.int32)  # pyright: ignore  # [W] substep
    failed_particle: wp.array(dtype=wp.int32)  # pyright: ignore  # [W]


class Sums:
    """Derivatives by state and parameters while they are summed up."""

    def __init__(self, s: MpmEngine):
        worlds, types = s.worlds, s.worlds.types
        self.device_is_cuda = s.device.is_cuda
        W, N = worlds.num_worlds, worlds.num_particles
        G, K = worlds.paths.time.shape[1:]
        by_particle = dict.fromkeys(("mu", "lam", "mass", "yield_stress", "drag"), (W, N))
        self.matter = worlds.allocate(types.MatterBars, **by_particle)
        state = worlds.make_state(W, wp.zeros)
        for name in ("x", "v", "C", "Z", "G"):
            setattr(self.matter, name, getattr(state, name))
        by_world = (
            "friction", "velocity_damping", "damping", "gravity", "damping_factor",
            "branch_factor", "branch_share",
        )  # fmt: skip
        self.scene = worlds.allocate(
            types.SceneBars,
            **dict.fromkeys(by_world, W),
            **dict.fromkeys(("position", "turn"), (W, G, K)),
            radius=(W, G),
            **dict.fromkeys(("weight", "place"), (W, G, N)),
            **dict.fromkeys(("centre", "rotation", "velocity", "spin"), worlds.grips.closed.shape),
        )
        self.trouble = worlds.allocate(Trouble, status=W, slot=W, failed_particle=W)

    def add_positions(self, w: int | slice, bar: NDArray[np.floating]) -> None:
        """Add a loss's own derivative by world w's positions now, [N, 3] or [W, N, 3] [1/m]."""
        now = self.matter.x.numpy()
        now[w] += bar
        if self.device_is_cuda:
            self.matter.x.assign(now)

    def gradients(self, s: MpmEngine) -> Gradients:
        """What the sums mean for the numbers that a user gave."""
        matter, scene = self.matter, self.scene
        E = np.array([m.E for m in s.materials])[:, None]
        nu = np.array([m.nu for m in s.materials])[:, None]
        mu_bar, lam_bar = matter.mu.numpy().astype(float), matter.lam.numpy().astype(float)
        # mu = E / (2 (1 + nu)), lam = E nu / ((1 + nu) (1 - k nu)), times the stiffness
        constraint = s.body.lateral_constraint
        room = (1.0 + nu) * (1.0 - constraint * nu)
        mu_E = 1.0 / (2.0 * (1.0 + nu))
        lam_E = nu / room
        mu_nu = -E / (2.0 * (1.0 + nu) ** 2)
        lam_nu = E * (1.0 + constraint * nu**2) / room**2
        by_E = mu_bar * mu_E + lam_bar * lam_E
        by_knots = {}
        for name in ("position", "turn"):
            by_knot = np.array(getattr(scene, name).numpy())
            for w, grippers in enumerate(s.worlds.setting.grippers):
                for g, gripper in enumerate(grippers):
                    last = len(np.asarray(gripper.time)) - 1
                    by_knot[w, g, last] += by_knot[w, g, last + 1 :].sum(axis=0)
                    by_knot[w, g, last + 1 :] = 0.0
            by_knots[name] = by_knot
        return Gradients(
            E=(by_E * s.stiffness).sum(axis=1),
            nu=((mu_bar * mu_nu + lam_bar * lam_nu) * s.stiffness).sum(axis=1),
            density=matter.mass.numpy().astype(float).sum(axis=1) * s.body.volume,
            stiffness=by_E * E,
            damping=np.array(scene.damping.numpy()),
            velocity_damping=np.array(scene.velocity_damping.numpy()),
            air_density=matter.drag.numpy().astype(float).sum(axis=1) * s.worlds.drag_by_air,
            friction=np.array(scene.friction.numpy()),
            self_friction=np.zeros(s.num_worlds),
            gravity=np.array(scene.gravity.numpy()),
            positions=np.array(matter.x.numpy()),
            velocities=np.array(matter.v.numpy()),
            gripper_positions=by_knots["position"],
            gripper_rotations=by_knots["turn"],
            gripper_radius=np.array(scene.radius.numpy()),
        )

    def overflow(
        self,
        s: MpmEngine,
        w: int,
        start: tuple[float, int, int, float],
        x: Callable[[int, int], NDArray[np.floating]],
    ) -> SimulationError:
        """The error of a derivative by world w's state that is not finite.

        Args:
            s: Whose derivatives.
            w: World.
            start: Of the frame that was reversed [s]; where the recorded substeps begin, in it and
                in all; their length [s].
            x: [N, 3] the recorded positions of (substep, world).
        """
        frame_start, step, age, dt = start
        slot = int(self.trouble.slot.numpy()[w])
        particle = int(self.trouble.failed_particle.numpy()[w])
        J = float(np.linalg.det(s.worlds.deformation_at(x(slot, w))[particle].astype(float)))
        cause = (
            f"its volume is {J:.2g} of that at rest, where the stress law is singular"
            if J < 0.1
            else f"derivatives grew beyond {s.dtype} over the substeps after it"
        )
        return s.worlds.setting.error(
            w,
            frame_start + (step + slot) * dt,
            f"the derivative by the state of particle {particle} is not finite: {cause}",
            where=f"substep {age + slot}",
            fix="use float64, a shorter rollout, or more damping",
            particle=particle,
        )
