"""What acts on particles besides each other: the table, walls, grippers.

All of it acts on particles, section by section (the particles of a rope's cross-section, or those
through a cloth's thickness, ``Body.section``), so that no cell of the grid shows in where a body
rests or is held.

- **Table and walls** push a section whose centre is nearer than the body's contact radius: with a
  spring as stiff as substeps allow (k = m ``SPRING`` / dt^2; what lies at rest is 1e-7 m deep in
  it) and a dashpot, and never pull. Coulomb friction takes as much of the velocity along the table,
  with all other impulses of the substep, as that push allows. These impulses go to the grid with
  the others; at rest every section is then in balance by itself, and the grid has nothing to say.
- **Grippers**: when one closes, each particle keeps its place in the gripper's frame, with a weight
  f that falls from 1 to 0 over one lattice spacing about the surface of the gripper's sphere,
  measured to the centre of its section. From then on a spring and a dashpot that are stiffer the
  larger f is make of its velocity u with all impulses

      w = (1 - f) u + f (V + b (X - x) / dt),    b = ``STIFFNESS`` (dt c / dx)^2,

  X and V the place and velocity that the gripper would give it, c the speed of pressure waves: a
  spring as stiff as the material, whatever the substep. w goes to the grid. What is held with
  f = 1 has no part in the grid: it goes where the gripper goes, and acts on the rest by its elastic
  forces alone. At rest w = 0 for every particle, whatever the phase of the grid.

Each function has its transpose beside it, which carries derivatives of a loss back to the
particles, to friction and to the grippers' paths. Whether a section touches, slides or sticks, and
when grippers open and close, is not differentiated.

Shapes: W worlds, N particles, G grippers, K path knots.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.mpm.particles import Particles
from gendom.sim.mpm.types import make_types

SPRING = 0.1
"""Of table and walls, for the mass of a section and the square of a substep."""

BEYOND = 1.22
"""Where the weight of what is held falls to 0, in lattice spacings beyond the gripper's surface:
half a spacing for the ramp, and 0.72 because differences between neighbours span two spacings, so
that what is held bends a little. Free lengths then are those of beams, see ``gendom validate``."""

STIFFNESS = 1.4
"""Of the spring on what is held in part, for the material's own."""

FOLLOWS = 0.5
"""Share of its distance from where it belongs that held material makes good in a substep, at
most."""

DASHPOT = 0.85
"""Share of the velocity into table or walls that they take in a substep."""


@functools.cache
def make_paths(real: Any) -> SimpleNamespace:
    """Build what grippers' paths say, for one scalar type.

    Returns:
        Namespace with ``is_closed``, ``pose`` (of a gripper at a time), ``pose_gripper`` (of a
        substep) and the transposes of both in the path's positions and orientations.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Paths, Grips, SceneBars = types.Paths, types.Grips, types.SceneBars

    @wp.func
    def narrow(a: wp.vec3d):
        return vec3(real(a[0]), real(a[1]), real(a[2]))

    @wp.func
    def narrow_matrix(A: wp.mat33d):
        return mat33(
            real(A[0, 0]), real(A[0, 1]), real(A[0, 2]),
            real(A[1, 0]), real(A[1, 1]), real(A[1, 2]),
            real(A[2, 0]), real(A[2, 1]), real(A[2, 2]),
        )  # fmt: skip

    @wp.func
    def is_closed(w: int, g: int, t: wp.float64, paths: Paths):
        return t >= paths.hold_from[w, g] and t < paths.hold_until[w, g]

    @wp.func
    def knot_before(w: int, g: int, t: wp.float64, paths: Paths):
        """The knot that starts the segment of time t, and the share of the segment gone by."""
        last = paths.time.shape[2] - 1
        lo = int(0)
        hi = int(last)
        while hi - lo > 1:
            mid = (lo + hi) // 2
            if paths.time[w, g, mid] <= t:
                lo = mid
            else:
                hi = mid
        span = paths.time[w, g, hi] - paths.time[w, g, lo]
        u = wp.float64(0.0)
        if span > wp.float64(0.0):
            u = wp.clamp((t - paths.time[w, g, lo]) / span, wp.float64(0.0), wp.float64(1.0))
        return lo, u

    @wp.func
    def rotation(turn: wp.vec3d):
        """exp of a rotation vector [rad], as a quaternion."""
        angle = wp.length(turn)
        q = wp.quatd(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
        if angle > wp.float64(0.0):
            q = wp.quat_from_axis_angle(turn / angle, angle)
        return q

    @wp.func
    def pose(w: int, g: int, t: wp.float64, paths: Paths):
        """Centre [m] and orientation of a gripper at time t [s]: between two knots on a straight
        line, at constant rates. The knot before, too."""
        knot, u = knot_before(w, g, t, paths)
        a = paths.position[w, g, knot]
        centre = a + u * (paths.position[w, g, knot + 1] - a)
        R = wp.identity(n=3, dtype=wp.float64)
        if paths.turns[w, g] == 1:
            R = wp.quat_to_matrix(
                rotation(u * paths.turn[w, g, knot]) * paths.orientation[w, g, knot]
            )
        return centre, R, knot

    @wp.func
    def left_jacobian(turn: wp.vec3d, sign: wp.float64):
        """Of exp: exp(turn + d) = exp(J d) exp(turn); with sign -1 that from the right.

        Source: Sola, Deray and Atchuthan (2018), "A micro Lie theory", equation 145.
        """
        angle = wp.length(turn)
        K = wp.skew(turn)
        a = wp.float64(0.5)
        b = wp.float64(1.0) / wp.float64(6.0)
        if angle > wp.float64(1.0e-4):
            a = (wp.float64(1.0) - wp.cos(angle)) / (angle * angle)
            b = (angle - wp.sin(angle)) / (angle * angle * angle)
        return wp.identity(n=3, dtype=wp.float64) + (sign * a) * K + b * (K * K)

    @wp.func
    def turn_adjoint(
        w: int, g: int, knot: int, u: wp.float64, R_bar: wp.vec3d, by_turn: wp.vec3d,
        paths: Paths, bars: SceneBars,
    ):  # fmt: skip
        """To the knots' rotations, from that by a rotation at the share u of a segment, and from
        that by the segment's rotation vector."""
        turn = paths.turn[w, g, knot]
        gone = wp.quat_to_matrix(rotation(u * turn))
        turn_bar = by_turn + u * (wp.transpose(left_jacobian(u * turn, wp.float64(1.0))) * R_bar)
        # the vector turn = log(R_next R^T)
        one = wp.float64(1.0)
        next_bar = wp.transpose(wp.inverse(left_jacobian(turn, one))) * turn_bar
        this_bar = wp.transpose(gone) * R_bar
        this_bar -= wp.transpose(wp.inverse(left_jacobian(turn, -one))) * turn_bar
        bars.turn[w, g, knot] = bars.turn[w, g, knot] + this_bar
        bars.turn[w, g, knot + 1] = bars.turn[w, g, knot + 1] + next_bar

    @wp.func
    def pose_adjoint(
        w: int, g: int, t: wp.float64, centre_bar: wp.vec3d, R_bar: wp.vec3d, paths: Paths,
        bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``pose``; derivatives by R are by a rotation of it, in world axes."""
        knot, u = knot_before(w, g, t, paths)
        bars.position[w, g, knot] = bars.position[w, g, knot] + (wp.float64(1.0) - u) * centre_bar
        bars.position[w, g, knot + 1] = bars.position[w, g, knot + 1] + u * centre_bar
        if paths.turns[w, g] == 1:
            turn_adjoint(w, g, knot, u, R_bar, wp.vec3d(), paths, bars)

    @wp.func
    def pose_gripper(
        row: int, w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, grips: Grips
    ):
        """Gripper g of world w in the substep from t to t + dt [s]."""
        grips.closed[row, g] = int(is_closed(w, g, t, paths))
        here, _R, knot = pose(w, g, t, paths)
        there, R, end = pose(w, g, t + dt, paths)
        grips.centre[row, g] = narrow(there)
        grips.orientation[row, g] = narrow_matrix(R)
        grips.velocity[row, g] = narrow((there - here) / dt)
        # each segment turns it for as long as the substep has part in it
        turned = wp.vec3d()
        if paths.turns[w, g] == 1:
            for k in range(knot, end + 1):
                span = paths.time[w, g, k + 1] - paths.time[w, g, k]
                until = wp.min(t + dt, paths.time[w, g, k + 1])
                inside = wp.max(until - wp.max(t, paths.time[w, g, k]), wp.float64(0.0))
                if span > wp.float64(0.0):
                    turned += (inside / span) * paths.turn[w, g, k]
        grips.spin[row, g] = narrow(turned / dt)

    @wp.func
    def pose_gripper_adjoint(
        w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, bars: SceneBars
    ):
        """Transpose of ``pose_gripper``; the substep's sums begin anew."""
        moved = bars.velocity[w, g] / dt
        _here, _R, knot = pose(w, g, t, paths)
        _there, _R_end, end = pose(w, g, t + dt, paths)
        pose_adjoint(w, g, t, -moved, wp.vec3d(), paths, bars)
        pose_adjoint(w, g, t + dt, bars.centre[w, g] + moved, bars.rotation[w, g], paths, bars)
        if paths.turns[w, g] == 1:
            for k in range(knot, end + 1):
                span = paths.time[w, g, k + 1] - paths.time[w, g, k]
                until = wp.min(t + dt, paths.time[w, g, k + 1])
                inside = wp.max(until - wp.max(t, paths.time[w, g, k]), wp.float64(0.0))
                if span > wp.float64(0.0):
                    turn_adjoint(
                        w, g, k, wp.float64(0.0), wp.vec3d(), (inside / span / dt) * bars.spin[w,
                        g],
                        paths, bars,
                    )  # fmt: skip
        bars.centre[w, g] = wp.vec3d()
        bars.rotation[w, g] = wp.vec3d()
        bars.velocity[w, g] = wp.vec3d()
        bars.spin[w, g] = wp.vec3d()

    return SimpleNamespace(
        is_closed=is_closed,
        pose=pose,
        pose_adjoint=pose_adjoint,
        pose_gripper=pose_gripper,
        pose_gripper_adjoint=pose_gripper_adjoint,
        narrow=narrow,
        narrow_matrix=narrow_matrix,
    )


@functools.cache
def make_boundary(real: Any, particles: Particles) -> SimpleNamespace:
    """Build what acts on particles, for one scalar type and one way to store them.

    Returns:
        Namespace with ``contact`` (of a section's mean position and velocity), ``near_table``,
        ``guided`` and ``carried`` (a held particle), ``grasp`` (grippers that open and close) and
        ``hold_as_at``.
    """
    types = make_types(real)
    vec3 = types.vec3
    Matter, Scene, Paths, Grips = types.Matter, types.Scene, types.Paths, types.Grips
    Stored = particles.Struct
    x_of = particles.x
    paths_of = make_paths(real)
    is_closed, pose = paths_of.is_closed, paths_of.pose
    narrow, narrow_matrix = paths_of.narrow, paths_of.narrow_matrix

    @wp.func
    def push(gap: real, outwards: real, dt: real):
        """Velocity that a plane gives to what is so near to it and would move away at
        ``outwards``."""
        given = real(0.0)
        if gap < real(0.0):
            given = wp.max(real(0.0), real(-SPRING) / dt * gap - real(DASHPOT) * outwards)
        return given

    @wp.func
    def contact(w: int, x: vec3, u: vec3, dt: real, radius: real, scene: Scene):
        """What table and walls change of the velocity of a section whose centre is at x, and which
        would move at u with all other impulses of the substep."""
        change = vec3()
        if scene.table == 1:
            given = push(x[2] - radius, u[2], dt)
            if given > real(0.0):
                slip = wp.sqrt(u[0] * u[0] + u[1] * u[1])
                lost = real(1.0)
                if slip > scene.friction[w] * given:
                    lost = scene.friction[w] * given / slip
                change = vec3(-lost * u[0], -lost * u[1], given)
        if scene.walls == 1:
            for a in range(3):
                change[a] = change[a] + push(x[a] - scene.box_lower[a] - radius, u[a], dt)
                change[a] = change[a] - push(scene.box_upper[a] - x[a] - radius, -u[a], dt)
        return change

    @wp.func
    def near_table(x: vec3, matter: Matter, scene: Scene):
        """Whether a particle's section may touch table or walls before the grid is rebuilt."""
        return scene.walls == 1 or (
            scene.table == 1 and x[2] < real(2.0) * matter.contact_radius + real(2.0) * scene.dx
        )

    @wp.func
    def spring(w: int, p: int, dt: real, matter: Matter, dx: real):
        """b of a particle that is held in part, and its logarithm's slope by mu + lam / 2
        [1/Pa]."""
        modulus = matter.lam[w, p] + real(2.0) * matter.mu[w, p]
        b = real(STIFFNESS) * dt * dt * modulus * matter.volume / (matter.mass[w] * dx * dx)
        slope = real(1.0) / modulus
        if b > real(FOLLOWS):
            b = real(FOLLOWS)
            slope = real(0.0)
        return b, slope

    @wp.func
    def carried(w: int, p: int, grip_row: int, x: vec3, b: real, dt: real, grips: Grips):
        """Velocity that a gripper gives to a particle of its that is at x, its spin, and the
        derivative of that velocity by b."""
        N = grips.held_by.shape[1]
        g = grips.held_by[w, p] // N
        spin = grips.spin[grip_row, g]
        arm = grips.orientation[grip_row, g] * grips.place[w, g, grips.held_by[w, p] % N]
        V = grips.velocity[grip_row, g] + wp.cross(spin, arm)
        # X is known where the substep ends
        behind = grips.centre[grip_row, g] + arm - dt * V - x
        return V + (b / dt) * behind, spin, behind / dt

    @wp.func
    def guided(
        w: int, p: int, grip_row: int, x: vec3, u: vec3, dt: real, dx: real, matter: Matter,
        grips: Grips,
    ):  # fmt: skip
        """Velocity w of a particle that is held in part, from its place and its own u."""
        b, _slope = spring(w, p, dt, matter, dx)
        v, _spin, _by_b = carried(w, p, grip_row, x, b, dt, grips)
        return u + (real(1.0) - grips.free[w, p]) * (v - u)

    @wp.func
    def section_centre(row: int, p: int, matter: Matter, particles: Stored):
        first = p - p % matter.section
        x = vec3()
        for n in range(matter.section):
            x += x_of(particles, row, first + n)
        return x / real(matter.section)

    @wp.func
    def attach(
        w: int, g: int, t: wp.float64, age: int, row: int, N: int, matter: Matter, scene: Scene,
        paths: Paths, grips: Grips, particles: Stored,
    ):  # fmt: skip
        """Close gripper g on what lies inside its sphere; returns how many particles it holds.

        A particle that another gripper holds is left to it.
        """
        centre, orientation, _knot = pose(w, g, t, paths)
        c = narrow(centre)
        R = narrow_matrix(orientation)
        spacing = real(0.5) * scene.dx
        count = int(0)
        f = real(0.0)
        for p in range(N):
            if p % matter.section == 0:
                far = wp.length(section_centre(row, p, matter, particles) - c)
                f = wp.clamp(
                    (paths.radius[w, g] - far) / spacing + real(BEYOND), real(0.0), real(1.0)
                )
            if f > real(0.0) and grips.free[w, p] == real(1.0):
                grips.particle[w, g, count] = p
                grips.weight[w, g, count] = f
                grips.place[w, g, count] = wp.transpose(R) * (x_of(particles, row, p) - c)
                grips.free[w, p] = real(1.0) - f
                grips.held_by[w, p] = g * N + count
                count += 1
        grips.count[w, g] = count
        grips.since[w, g] = age
        return count

    @wp.func
    def hold_on(w: int, g: int, share: real, grips: Grips):
        """Let gripper g hold its particles again (share 1) or not (0)."""
        for n in range(grips.count[w, g]):
            p = grips.particle[w, g, n]
            grips.free[w, p] = real(1.0) - share * grips.weight[w, g, n]
            grips.held_by[w, p] = g * grips.held_by.shape[1] + n

    @wp.func
    def hold_as_at(w: int, age: int, grips: Grips):
        """Hold what was held before substep ``age`` began."""
        for g in range(grips.since.shape[1]):
            hold_on(w, g, real(0.0), grips)
        for g in range(grips.since.shape[1]):
            since = grips.since[w, g]
            until = grips.until[w, g]
            if since >= 0 and since < age and (until < 0 or until >= age):
                hold_on(w, g, real(1.0), grips)

    @wp.func
    def grasp(
        w: int, t: wp.float64, age: int, row: int, N: int, matter: Matter, scene: Scene,
        paths: Paths, grips: Grips, particles: Stored,
    ):  # fmt: skip
        """Let the grippers of a world open and close before substep ``age``, which begins at t.

        By one thread; once more does the same. Returns a gripper that closed on nothing, or -1.
        """
        empty = int(-1)
        for g in range(paths.radius.shape[1]):
            since = grips.since[w, g]
            until = grips.until[w, g]
            if is_closed(w, g, t, paths):
                if since < 0 or since == age:
                    count = attach(w, g, t, age, row, N, matter, scene, paths, grips, particles)
                    if count == 0 and paths.may_miss[w, g] == 0:
                        empty = g
            elif since >= 0 and since < age and (until < 0 or until == age):
                grips.until[w, g] = age
                hold_on(w, g, real(0.0), grips)
        return empty

    return SimpleNamespace(
        push=push,
        contact=contact,
        near_table=near_table,
        spring=spring,
        carried=carried,
        guided=guided,
        section_centre=section_centre,
        hold_on=hold_on,
        hold_as_at=hold_as_at,
        grasp=grasp,
    )
