"""What acts on particles besides each other: the table and grippers.

All of it acts section by section (``Body.section``), so that no cell of the grid shows in where a
body rests or is held; see docs/simulator.md.

- **The table** is a spring, k = m ``SPRING`` / dt^2 (what lies at rest is 1e-7 m deep in it), and a
  dashpot. Friction takes as much of the velocity along it, with all other impulses of the substep,
  as its push allows.
- **Grippers**: what is held with weight f has of its velocity u with all impulses

      w = (1 - f) u + f (V + b (X - x) / dt),    b = ``STIFFNESS`` (dt c / dx)^2,

  X and V the place and velocity that the gripper would give it, c the speed of pressure waves: a
  spring as stiff as the material, whatever the substep. With f = 1 it has no part in the grid. At
  rest w = 0 for every particle, whatever the phase of the grid.

Each function has its transpose beside it. Whether a section touches, slides or sticks, and when
grippers open and close, is not differentiated.

Shapes: W worlds, N particles, G grippers, K path knots.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.bodies import Body
from gendom.sim.mpm.particles import Variant, make_moving, make_taped
from gendom.sim.mpm.types import make_types
from gendom.sim.native import functions_of
from gendom.sim.paths import make_paths

SPRING = 0.1
"""Of the table, for the mass of a section and the square of a substep."""

BEYOND = 1.22
"""Where the weight of what is held falls to 0, in lattice spacings beyond the gripper's surface:
half a spacing for the ramp, and 0.72 because differences between neighbours span two spacings, so
that what is held bends a little. Free lengths then are those of beams, see ``make validate``."""

STIFFNESS = 1.4
"""Of the spring on what is held in part, for the material's own."""

COARSE = (1.25, 3.0)
"""The two of ropes with two by two particles a section, which bend more where they are held. With
1.33 and 1.4 sags are theory's, too, but the energy of a swinging rope grows."""

FOLLOWS = 0.5
"""Share of its distance from where it belongs that held material makes good in a substep, at
most."""

DASHPOT = 0.85
"""Share of the velocity into the table that it takes in a substep."""


def grip_constants(body: Body) -> tuple[float, float]:
    """``BEYOND`` and ``STIFFNESS`` of a body."""
    return COARSE if body.kind == "rope" and body.section == 4 else (BEYOND, STIFFNESS)


@functools.cache
def make_boundary(variant: Variant) -> SimpleNamespace:
    """Build what acts on particles and its transposes, for one way to store them."""
    real = variant.real
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Model, Paths, Grips = types.Model, types.Paths, types.Grips
    Substep, ConditionsAdjoint = types.Substep, types.ConditionsAdjoint
    Records, fields, taped = types.Records, make_moving(variant), make_taped(variant)
    paths_of = make_paths(real)
    section_centre = _section_centre(types, fields.x_of)
    taped_section_centre = _section_centre(types, taped.x_of)

    @wp.func
    def pushed(gap: real, outwards: real, dt: real):
        """Velocity that the table gives to what is at a height ``gap`` and would move away at
        ``outwards``."""
        given = real(0.0)
        if gap < real(0.0):
            given = wp.max(real(0.0), real(-SPRING) / dt * gap - real(DASHPOT) * outwards)
        return given

    @wp.func
    def contact(now: Substep, x: vec3, u: vec3, model: Model):
        """Change of the velocity u of a section at x by the table, where all other impulses of the
        substep are in u."""
        change = vec3()
        given = pushed(x[2] - model.contact_radius, u[2], now.h)
        if given > real(0.0):
            slip = wp.sqrt(u[0] * u[0] + u[1] * u[1])
            lost = real(1.0)
            if slip > model.friction[now.w] * given:
                lost = model.friction[now.w] * given / slip
            change = vec3(-lost * u[0], -lost * u[1], given)
        return change

    @wp.func
    def spring(now: Substep, modulus: real, model: Model):
        """b of a particle that is held in part, and its logarithm's slope by mu + lam / 2
        [1/Pa]."""
        reach = now.h / now.dx
        b = model.grip_stiffness * modulus * model.volume / now.mass * reach * reach
        slope = real(1.0) / modulus
        if b > real(FOLLOWS):
            b = real(FOLLOWS)
            slope = real(0.0)
        return b, slope

    @wp.func
    def follow(now: Substep, g: int, place: vec3, x: vec3, b: real, grips: Grips):
        """Velocity that gripper g gives to a particle of its that is at x, its spin, and the
        derivative of that velocity by b."""
        spin = grips.spin[now.grip_row, g]
        arm = grips.orientation[now.grip_row, g] * place
        V = grips.velocity[now.grip_row, g] + wp.cross(spin, arm)
        # X is known where the substep ends
        behind = grips.centre[now.grip_row, g] + arm - now.h * V - x
        return V + (b / now.h) * behind, spin, behind / now.h

    @wp.func
    def attach(
        now: Substep, g: int, t: wp.float64, model: Model, paths: Paths, grips: Grips,
        particles: Records,
    ):  # fmt: skip
        """Close gripper g on what lies inside its sphere; returns how many particles it holds.

        A particle that another gripper holds is left to it.
        """
        centre, turned, _knot = paths_of.placed(now.w, g, t, paths)
        c = vec3(centre)
        R = mat33(wp.quat_to_matrix(turned))
        spacing = real(0.5) * model.dx
        count = int(0)
        f = real(0.0)
        for p in range(now.N):
            if p % model.section == 0:
                far = wp.length(section_centre(now.w, p, model, particles) - c)
                f = wp.clamp(
                    (paths.radius[now.w, g] - far) / spacing + model.beyond, real(0.0), real(1.0)
                )
            if f > real(0.0) and grips.free[now.w, p] == real(1.0):
                grips.particle[now.w, g, count] = p
                grips.weight[now.w, g, count] = f
                grips.place[now.w, g, count] = wp.transpose(R) * (
                    fields.x_of(particles, now.w, p) - c
                )
                grips.free[now.w, p] = real(1.0) - f
                grips.held_by[now.w, p] = g * now.N + count
                count += 1
        grips.count[now.w, g] = count
        grips.since[now.w, g] = now.age
        return count

    @wp.func
    def hold_on(w: int, g: int, share: real, grips: Grips):
        """Let gripper g hold its particles again (share 1) or not (0)."""
        for n in range(grips.count[w, g]):
            p = grips.particle[w, g, n]
            grips.free[w, p] = real(1.0) - share * grips.weight[w, g, n]
            grips.held_by[w, p] = g * grips.held_by.shape[1] + n

    @wp.func
    def grasp(
        now: Substep, t: wp.float64, model: Model, paths: Paths, grips: Grips, particles: Records,
    ):  # fmt: skip
        """Let the grippers of a world open and close before substep ``age``, which begins at t.

        By one thread; once more does the same. Returns a gripper that closed on nothing, or -1.
        """
        empty = int(-1)
        for g in range(paths.radius.shape[1]):
            since = grips.since[now.w, g]
            until = grips.until[now.w, g]
            if paths_of.is_closed(now.w, g, t, paths):
                if since < 0 or since == now.age:
                    count = attach(now, g, t, model, paths, grips, particles)
                    if count == 0:
                        empty = g
            elif since >= 0 and since < now.age and (until < 0 or until == now.age):
                grips.until[now.w, g] = now.age
                hold_on(now.w, g, real(0.0), grips)
        return empty

    @wp.func
    def add_x(adjoint: Records, w: int, p: int, value: vec3):
        i = fields.place(adjoint, w, p)
        fields.put_x(adjoint, w, i, fields.x(adjoint, w, i) + value)

    @wp.func
    def contact_adjoint(
        now: Substep, x: vec3, u: vec3, model: Model, change_bar: vec3, by: ConditionsAdjoint
    ):
        """Derivatives by x and u from that by the change that ``contact`` makes."""
        x_bar = vec3()
        u_bar = vec3()
        given = pushed(x[2] - model.contact_radius, u[2], now.h)
        if given > real(0.0):
            mu = model.friction[now.w]
            along = vec3(u[0], u[1], real(0.0))
            along_bar = vec3(change_bar[0], change_bar[1], real(0.0))
            given_bar = change_bar[2]
            slip = wp.length(along)
            lost = real(1.0)
            if slip > mu * given:
                lost = mu * given / slip
                lost_bar = -wp.dot(along_bar, along)
                given_bar += lost_bar * mu / slip
                wp.atomic_add(by.friction, now.w, wp.float64(lost_bar * given / slip))
                u_bar -= (lost_bar * lost / (slip * slip)) * along
            u_bar += vec3(real(0.0), real(0.0), real(-DASHPOT) * given_bar) - lost * along_bar
            x_bar[2] = real(-SPRING) / now.h * given_bar
        return x_bar, u_bar

    @wp.func
    def follow_adjoint(
        now: Substep, g: int, n: int, b: real, v_bar: vec3, spin_bar: vec3, grips: Grips,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``follow`` for the n-th particle of gripper g.

        Returns derivatives by the gripper's centre (less those by x), velocity, spin and rotation.
        """
        arm = grips.orientation[now.grip_row, g] * grips.place[now.w, g, n]
        centre_bar = (b / now.h) * v_bar
        V_bar = (real(1.0) - b) * v_bar
        arm_bar = centre_bar + wp.cross(V_bar, grips.spin[now.grip_row, g])
        by.place[now.w, g, n] = (
            by.place[now.w, g, n] + wp.transpose(grips.orientation[now.grip_row, g]) * arm_bar
        )
        return centre_bar, V_bar, spin_bar + wp.cross(arm, V_bar), wp.cross(arm, arm_bar)

    @wp.func
    def turned_adjoint(C_bar: mat33):
        """Derivative by a spin from that by its matrix."""
        return vec3(C_bar[2, 1] - C_bar[1, 2], C_bar[0, 2] - C_bar[2, 0], C_bar[1, 0] - C_bar[0, 1])

    @wp.func
    def driven_adjoint(
        now: Substep, g: int, n: int, modulus: real, f: real, x: vec3, u: vec3, model: Model,
        w_bar: vec3, grips: Grips, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Of the velocity w that the n-th particle of gripper g, held with weight f, is given.

        Returns derivatives by lam and mass, and those of ``follow_adjoint``.
        """
        b, slope = spring(now, modulus, model)
        v, _spin, by_b = follow(now, g, grips.place[now.w, g, n], x, b, grips)
        b_bar = f * wp.dot(w_bar, by_b)
        mass_bar = real(0.0)
        if slope > real(0.0):
            mass_bar = -b_bar * b / model.mass[now.w]
        by.weight[now.w, g, n] = by.weight[now.w, g, n] + wp.dot(w_bar, v - u)
        centre_bar, V_bar, spin_bar, R_bar = follow_adjoint(
            now, g, n, b, f * w_bar, vec3(), grips, by
        )
        return b_bar * b * slope, mass_bar, centre_bar, V_bar, spin_bar, R_bar

    @wp.func
    def attach_adjoint(
        now: Substep, g: int, t: wp.float64, model: Model, paths: Paths, grips: Grips,
        tape: Records, adjoint: Records, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``attach``: to the positions at that moment, and to the gripper's pose."""
        centre, turned, _knot = paths_of.placed(now.w, g, t, paths)
        c = vec3(centre)
        R = mat33(wp.quat_to_matrix(turned))
        spacing = real(0.5) * model.dx
        centre_bar = wp.vec3d()
        R_bar = wp.vec3d()
        for n in range(grips.count[now.w, g]):
            p = grips.particle[now.w, g, n]
            back = R * by.place[now.w, g, n]
            add_x(adjoint, now.w, p, back)
            centre_bar -= wp.vec3d(back)
            R_bar -= wp.vec3d(wp.cross(taped.x_of(tape, now.slot, p) - c, back))
            f = grips.weight[now.w, g, n]
            if f < real(1.0):
                f_bar = by.weight[now.w, g, n] / spacing
                by.radius[now.w, g] = by.radius[now.w, g] + wp.float64(f_bar)
                outwards = -f_bar * wp.normalize(taped_section_centre(now.slot, p, model, tape) - c)
                centre_bar -= wp.vec3d(outwards)
                first = p - p % model.section
                for q in range(first, first + model.section):
                    add_x(adjoint, now.w, q, outwards / real(model.section))
            by.weight[now.w, g, n] = real(0.0)
            by.place[now.w, g, n] = vec3()
        paths_of.pose_adjoint(now.w, g, t, centre_bar, R_bar, paths, by.position, by.turn)

    @wp.func
    def grasp_adjoint(
        now: Substep, t: wp.float64, model: Model, paths: Paths, grips: Grips, tape: Records,
        adjoint: Records, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Go back over grippers that opened or closed before substep ``age``; by one thread."""
        for g in range(paths.radius.shape[1]):
            if grips.until[now.w, g] == now.age:
                hold_on(now.w, g, real(1.0), grips)
            if grips.since[now.w, g] == now.age:
                attach_adjoint(now, g, t, model, paths, grips, tape, adjoint, by)
                hold_on(now.w, g, real(0.0), grips)

    return functions_of(locals())


def _section_centre(types: SimpleNamespace, x_of: Any) -> Any:
    real, vec3, Model, Records = types.real, types.vec3, types.Model, types.Records

    @wp.func
    def section_centre(row: int, p: int, model: Model, particles: Records):
        first = p - p % model.section
        x = vec3()
        for n in range(model.section):
            x += x_of(particles, row, first + n)
        return x / real(model.section)

    return section_centre
