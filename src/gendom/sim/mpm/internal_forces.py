"""Internal forces of bodies and the air's, forward and transposed.

Where they come from: docs/simulator.md. The law is neo-Hookean, P(F).

- **Material damping**: a standard linear solid with one Maxwell branch as stiff as the elastic law.
  The branch's stress is Q = S - Z, S the second Piola-Kirchhoff stress and Z the same filtered with
  the branch's time tau: per substep, with a = exp(-dt / tau) and g = (1 + a) / 2,

      P <- (1 + g) P - g F Z,      Z <- Z + (1 - a) (S - Z).

  Both are exact to second order in dt / tau. At rest Z = S: static shapes do not change.
- **Air**: -1/2 rho c |v_n| v_n A n on each patch of a sheet with the velocity v_n along its normal,
  -1/2 rho c d l |v_t| v_t across each stretch l of a rope, v_t the velocity less its part along it.

Forces go to particles as impulses of a substep: each particle pulls the neighbour behind it along a
lattice axis back and the one before it forth. Each particle's impulses are computed first
(``native/elasticity.h``) and then gathered by the neighbours, so that no two threads write the same
number.

Shapes: W worlds, N particles.
"""

import functools
from types import SimpleNamespace

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.particles import Variant
from gendom.sim.mpm.types import make_types
from gendom.sim.native import functions_of

FILLS = 1.0e-30
"""Share of the branch with which Z is filled and nothing else happens."""


@functools.cache
def make_internal_forces(variant: Variant) -> SimpleNamespace:
    """Build the forces of a variant.

    ``pulled`` is the impulse of a substep on a particle by its neighbours, or, but for its sign,
    the derivative by x through all differences between neighbours.
    """
    real = variant.real
    types = make_types(real)
    vec3, Model, Clock, Substep = types.vec3, types.Model, types.Clock, types.Substep
    Records, ConditionsAdjoint = types.Records, types.ConditionsAdjoint
    block = make_block(real)
    call = f"<{int(variant.room > 0)}, {int(variant.sorts)}>(w, thread, threads, "

    @wp.func_native(f"return gendom::forces_of_records{call}dt, keep, share, model, particles);")
    def set_forces(
        w: int, thread: int, threads: int, dt: real, keep: real, share: real, model: Model,
        particles: Records,
    ) -> int: ...  # fmt: skip

    @wp.func_native(
        f"return gendom::adjoint_of_records{call}row, dt, keep, share, model, tape, adjoint);"
    )
    def set_adjoint(
        w: int, thread: int, threads: int, row: int, dt: real, keep: real, share: real,
        model: Model, tape: Records, adjoint: Records,
    ) -> wp.vec2d: ...  # fmt: skip

    @wp.func_native(f"return gendom::pulled_record<{int(variant.room > 0)}>(w, i, of, near);")
    def pulled(
        w: int, i: int, of: wp.array3d(dtype=real), near: wp.array3d(dtype=wp.int32)
    ) -> vec3: ...

    @wp.func
    def branch(damping: real, dt: real, age: int):
        """Of the Maxwell branch: the share of Z that a substep leaves, and g; (0, 0) without.

        A branch cannot be faster than the substep: it is softer instead. The first substep of all
        only fills Z: what stress a body begins with has relaxed.
        """
        keep = real(0.0)
        share = real(0.0)
        if damping > real(0.0):
            tau = wp.max(damping, dt)
            if age == 0:
                share = real(FILLS)
            else:
                keep = wp.exp(-dt / tau)
                share = real(0.5) * (damping / tau) * (real(1.0) + keep)
        return keep, share

    @wp.func
    def branch_adjoint(damping: real, dt: real, age: int, keep_bar: real, share_bar: real):
        """Derivative by the damping, which is positive."""
        bar = real(0.0)
        if age > 0 and damping > dt:
            slope = wp.exp(-dt / damping) * dt / (damping * damping)
            bar = (keep_bar + real(0.5) * share_bar) * slope
        elif age > 0:
            bar = share_bar * real(0.5) * (real(1.0) + wp.exp(real(-1.0))) / dt
        return bar

    @wp.func
    def forces(now: Substep, model: Model, clock: Clock, particles: Records):
        """Set the impulses of particles on their neighbours, add the air's to velocities and move Z
        on. Return whether a particle is inverted, which the clock names."""
        keep, share = branch(model.damping[now.w], now.h, now.age)
        failed = set_forces(now.w, now.thread, now.threads, now.h, keep, share, model, particles)
        if failed >= 0:
            clock.failed_particle[now.w] = failed
        return block.any(int(failed >= 0))

    @wp.func
    def forces_adjoint(
        now: Substep, model: Model, tape: Records, adjoint: Records, by: ConditionsAdjoint
    ):
        """Transpose of ``forces``; derivatives by impulses are found in those by v."""
        damping = model.damping[now.w]
        keep, share = branch(damping, now.h, now.age)
        sums = set_adjoint(
            now.w, now.thread, now.threads, now.slot, now.h, keep, share, model, tape, adjoint
        )
        if damping > real(0.0):
            by_damping = branch_adjoint(damping, now.h, now.age, real(sums[1]), real(sums[0]))
            wp.atomic_add(by.damping, now.w, wp.float64(by_damping))

    return functions_of(locals())
