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

import functools
from typing import Any

import warp as wp

from gendom.sim.bodies import Body
from gendom.sim.mpm.particles import Particles
from gendom.sim.mpm.types import Namespace, make_types
from gendom.sim.paths import make_paths

SPRING = 0.1
"""Of table and walls, for the mass of a section and the square of a substep."""

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
"""Share of the velocity into table or walls that they take in a substep."""


def grip_constants(body: Body) -> tuple[float, float]:
    """``BEYOND`` and ``STIFFNESS`` of a body."""
    return COARSE if body.kind == "rope" and body.section == 4 else (BEYOND, STIFFNESS)


@functools.cache
def make_boundary(real: Any, particles: Particles) -> Namespace:
    """Build what acts on particles, for one scalar type and one way to store them.

    Returns:
        Namespace with ``contact`` (of a section's mean position and velocity), ``near_table``,
        ``follow``, ``guided`` and ``carried`` (a held particle), ``grasp`` (grippers that open and
        close) and ``hold_as_at``.
    """
    types = make_types(real)
    vec3 = types.vec3
    Matter, Scene, Paths, Grips = types.Matter, types.Scene, types.Paths, types.Grips
    Stored = particles.Struct
    x_of = particles.x
    paths_of = make_paths(real)

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
    def modulus_of(w: int, p: int, matter: Matter):
        """Of pressure waves [Pa]."""
        return matter.lam[w, p] + real(2.0) * matter.mu[w, p]

    @wp.func
    def spring(w: int, modulus: real, dt: real, matter: Matter, dx: real):
        """b of a particle that is held in part, and its logarithm's slope by mu + lam / 2
        [1/Pa]."""
        b = matter.grip_stiffness * dt * dt * modulus * matter.volume / (matter.mass[w] * dx * dx)
        slope = real(1.0) / modulus
        if b > real(FOLLOWS):
            b = real(FOLLOWS)
            slope = real(0.0)
        return b, slope

    @wp.func
    def follow(g: int, place: vec3, grip_row: int, x: vec3, b: real, dt: real, grips: Grips):
        """Velocity that gripper g gives to a particle of its that is at x, its spin, and the
        derivative of that velocity by b."""
        spin = grips.spin[grip_row, g]
        arm = grips.orientation[grip_row, g] * place
        V = grips.velocity[grip_row, g] + wp.cross(spin, arm)
        # X is known where the substep ends
        behind = grips.centre[grip_row, g] + arm - dt * V - x
        return V + (b / dt) * behind, spin, behind / dt

    @wp.func
    def carried(w: int, p: int, grip_row: int, x: vec3, b: real, dt: real, grips: Grips):
        """``follow`` of a particle that is held."""
        N = grips.held_by.shape[1]
        g = grips.held_by[w, p] // N
        v, spin, by_b = follow(
            g, grips.place[w, g, grips.held_by[w, p] % N], grip_row, x, b, dt, grips
        )
        return v, spin, by_b

    @wp.func
    def guided(
        w: int, p: int, grip_row: int, x: vec3, u: vec3, dt: real, dx: real, matter: Matter,
        grips: Grips,
    ):  # fmt: skip
        """Velocity w of a particle that is held in part, from its place and its own u."""
        b, _slope = spring(w, modulus_of(w, p, matter), dt, matter, dx)
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
        centre, orientation, _knot = paths_of.pose(w, g, t, paths)
        c = paths_of.narrow(centre)
        R = paths_of.narrow_matrix(orientation)
        spacing = real(0.5) * scene.dx
        count = int(0)
        f = real(0.0)
        for p in range(N):
            if p % matter.section == 0:
                far = wp.length(section_centre(row, p, matter, particles) - c)
                f = wp.clamp(
                    (paths.radius[w, g] - far) / spacing + matter.beyond, real(0.0), real(1.0)
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
            if paths_of.is_closed(w, g, t, paths):
                if since < 0 or since == age:
                    count = attach(w, g, t, age, row, N, matter, scene, paths, grips, particles)
                    if count == 0 and paths.may_miss[w, g] == 0:
                        empty = g
            elif since >= 0 and since < age and (until < 0 or until == age):
                grips.until[w, g] = age
                hold_on(w, g, real(0.0), grips)
        return empty

    return Namespace(
        push, contact, near_table, modulus_of, spring, carried, follow, guided, section_centre,
        hold_on, hold_as_at, grasp,
    )  # fmt: skip
