"""Transposes of what acts on particles besides each other; see ``gendom.sim.mpm.boundary``."""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from gendom.sim.mpm.boundary import DASHPOT, SPRING, make_boundary
from gendom.sim.mpm.particles import Particles
from gendom.sim.mpm.types import Namespace, make_types
from gendom.sim.paths import make_paths


@dataclass(frozen=True)
class ParticleBars:
    """A struct of derivatives by particles and the Warp functions that read and write it."""

    Struct: Any
    x: Any
    """(bars, w, p) -> derivative by x."""
    put_x: Any
    """(bars, w, p, value)."""


@functools.cache
def make_row_bars(real: Any) -> ParticleBars:
    """Derivatives in rows of vectors, ``MatterBars``."""
    types = make_types(real)
    vec3, Bars = types.vec3, types.MatterBars

    @wp.func
    def x_of(bars: Bars, w: int, p: int):
        return bars.x[w, p]

    @wp.func
    def put_x(bars: Bars, w: int, p: int, value: vec3):
        bars.x[w, p] = value

    return ParticleBars(Bars, x_of, put_x)


@functools.cache
def make_boundary_adjoint(
    real: Any, particles: Particles, particle_bars: ParticleBars
) -> Namespace:
    """Build the transposes for one scalar type.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        particles: How recorded particles are stored.
        particle_bars: How the derivatives by them are.

    Returns:
        Namespace with ``wide`` (to float64), ``contact_adjoint`` (of a section's mean motion),
        ``follow_adjoint``, ``led_adjoint``, ``carried_adjoint``,
        ``turned_adjoint`` and ``guided_adjoint`` (of a held particle) and ``grasp_adjoint``.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Matter, Scene, Paths, Grips = types.Matter, types.Scene, types.Paths, types.Grips
    SceneBars = types.SceneBars
    Recorded, Bars = particles.Struct, particle_bars.Struct
    boundary = make_boundary(real, particles)
    paths_of = make_paths(real)

    @wp.func
    def wide(a: vec3):
        return wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))

    @wp.func
    def contact_adjoint(
        w: int, x: vec3, u: vec3, dt: real, radius: real, scene: Scene, change_bar: vec3,
        bars: SceneBars,
    ):  # fmt: skip
        """Derivatives by x and u from that by the change that ``contact`` makes."""
        x_bar = vec3()
        u_bar = vec3()
        stiff = real(-SPRING) / dt
        loss = real(-DASHPOT)
        if scene.walls == 1:
            for a in range(3):
                b = change_bar[a]
                if boundary.push(x[a] - scene.box_lower[a] - radius, u[a], dt) > real(0.0):
                    x_bar[a] = x_bar[a] + stiff * b
                    u_bar[a] = u_bar[a] + loss * b
                if boundary.push(scene.box_upper[a] - x[a] - radius, -u[a], dt) > real(0.0):
                    x_bar[a] = x_bar[a] + stiff * b
                    u_bar[a] = u_bar[a] + loss * b
        if scene.table == 1:
            given = boundary.push(x[2] - radius, u[2], dt)
            if given > real(0.0):
                given_bar = change_bar[2]
                slip = wp.sqrt(u[0] * u[0] + u[1] * u[1])
                lost = real(1.0)
                if slip > scene.friction[w] * given:
                    lost = scene.friction[w] * given / slip
                    lost_bar = -(change_bar[0] * u[0] + change_bar[1] * u[1])
                    given_bar += lost_bar * scene.friction[w] / slip
                    wp.atomic_add(bars.friction, w, wp.float64(lost_bar * given / slip))
                    slip_bar = -lost_bar * lost / slip
                    u_bar[0] = u_bar[0] + slip_bar * u[0] / slip
                    u_bar[1] = u_bar[1] + slip_bar * u[1] / slip
                u_bar[0] = u_bar[0] - lost * change_bar[0]
                u_bar[1] = u_bar[1] - lost * change_bar[1]
                x_bar[2] = x_bar[2] + stiff * given_bar
                u_bar[2] = u_bar[2] + loss * given_bar
        return x_bar, u_bar

    @wp.func
    def follow_adjoint(
        w: int, g: int, n: int, grip_row: int, b: real, dt: real, v_bar: vec3, spin_bar: vec3,
        grips: Grips, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``follow`` for the n-th particle of gripper g.

        Returns derivatives by the gripper's centre (less those by x), velocity, spin and rotation.
        """
        arm = grips.orientation[grip_row, g] * grips.place[w, g, n]
        centre_bar = (b / dt) * v_bar
        V_bar = (real(1.0) - b) * v_bar
        arm_bar = centre_bar + wp.cross(V_bar, grips.spin[grip_row, g])
        scene_bars.place[w, g, n] = (
            scene_bars.place[w, g, n] + wp.transpose(grips.orientation[grip_row, g]) * arm_bar
        )
        return centre_bar, V_bar, spin_bar + wp.cross(arm, V_bar), wp.cross(arm, arm_bar)

    @wp.func
    def add_to_pose(
        grip_row: int, g: int, centre_bar: vec3, V_bar: vec3, spin_bar: vec3, R_bar: vec3,
        scene_bars: SceneBars,
    ):  # fmt: skip
        """Add a particle's derivatives by its gripper's pose."""
        wp.atomic_add(scene_bars.centre, grip_row, g, wide(centre_bar))
        wp.atomic_add(scene_bars.velocity, grip_row, g, wide(V_bar))
        wp.atomic_add(scene_bars.spin, grip_row, g, wide(spin_bar))
        wp.atomic_add(scene_bars.rotation, grip_row, g, wide(R_bar))

    @wp.func
    def carried_adjoint(
        w: int, p: int, grip_row: int, b: real, dt: real, v_bar: vec3, spin_bar: vec3, grips: Grips,
        scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``carried``; returns the derivative by x."""
        N = grips.held_by.shape[1]
        g = grips.held_by[w, p] // N
        n = grips.held_by[w, p] % N
        centre_bar, V_bar, by_spin, R_bar = follow_adjoint(
            w, g, n, grip_row, b, dt, v_bar, spin_bar, grips, scene_bars
        )
        add_to_pose(grip_row, g, centre_bar, V_bar, by_spin, R_bar, scene_bars)
        return -centre_bar

    @wp.func
    def turned_adjoint(C_bar: mat33):
        """Derivative by a spin from that by its matrix."""
        return vec3(C_bar[2, 1] - C_bar[1, 2], C_bar[0, 2] - C_bar[2, 0], C_bar[1, 0] - C_bar[0, 1])

    @wp.func
    def led_adjoint(
        w: int, g: int, n: int, modulus: real, f: real, grip_row: int, x: vec3, u: vec3, dt: real,
        dx: real, matter: Matter, w_bar: vec3, grips: Grips, scene_bars: SceneBars,
    ):  # fmt: skip
        """Of the velocity w that the n-th particle of gripper g, held with weight f, is given.

        Returns derivatives by lam and mass, and those of ``follow_adjoint``.
        """
        b, slope = boundary.spring(w, modulus, dt, matter, dx)
        v, _spin, by_b = boundary.follow(g, grips.place[w, g, n], grip_row, x, b, dt, grips)
        b_bar = f * wp.dot(w_bar, by_b)
        mass_bar = real(0.0)
        if slope > real(0.0):
            mass_bar = -b_bar * b / matter.mass[w]
        scene_bars.weight[w, g, n] = scene_bars.weight[w, g, n] + wp.dot(w_bar, v - u)
        centre_bar, V_bar, spin_bar, R_bar = follow_adjoint(
            w, g, n, grip_row, b, dt, f * w_bar, vec3(), grips, scene_bars
        )
        return b_bar * b * slope, mass_bar, centre_bar, V_bar, spin_bar, R_bar

    @wp.func
    def guided_adjoint(
        w: int, p: int, grip_row: int, x: vec3, u: vec3, dt: real, dx: real, matter: Matter,
        w_bar: vec3, grips: Grips, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``guided``; returns the derivatives by x and u, by lam (half of that by mu)
        and by the particle's mass."""
        N = grips.held_by.shape[1]
        g = grips.held_by[w, p] // N
        f = real(1.0) - grips.free[w, p]
        by_lam, by_mass, centre_bar, V_bar, spin_bar, R_bar = led_adjoint(
            w, g, grips.held_by[w, p] % N, boundary.modulus_of(w, p, matter), f, grip_row, x, u,
            dt, dx, matter, w_bar, grips, scene_bars,
        )  # fmt: skip
        add_to_pose(grip_row, g, centre_bar, V_bar, spin_bar, R_bar, scene_bars)
        return -centre_bar, (real(1.0) - f) * w_bar, by_lam, by_mass

    @wp.func
    def attach_adjoint(
        w: int, g: int, t: wp.float64, row: int, matter: Matter, scene: Scene, paths: Paths,
        grips: Grips, recorded: Recorded, bars: Bars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Transpose of ``attach``: to the positions at that moment, and to the gripper's pose."""
        centre, orientation, _knot = paths_of.pose(w, g, t, paths)
        c = paths_of.narrow(centre)
        R = paths_of.narrow_matrix(orientation)
        spacing = real(0.5) * scene.dx
        centre_bar = wp.vec3d()
        R_bar = wp.vec3d()
        for n in range(grips.count[w, g]):
            p = grips.particle[w, g, n]
            back = R * scene_bars.place[w, g, n]
            particle_bars.put_x(bars, w, p, particle_bars.x(bars, w, p) + back)
            centre_bar -= wide(back)
            R_bar -= wide(wp.cross(particles.x(recorded, row, p) - c, back))
            f = grips.weight[w, g, n]
            if f < real(1.0):
                f_bar = scene_bars.weight[w, g, n] / spacing
                scene_bars.radius[w, g] = scene_bars.radius[w, g] + wp.float64(f_bar)
                outwards = -f_bar * wp.normalize(
                    boundary.section_centre(row, p, matter, recorded) - c
                )
                centre_bar -= wide(outwards)
                first = p - p % matter.section
                for q in range(first, first + matter.section):
                    share = outwards / real(matter.section)
                    particle_bars.put_x(bars, w, q, particle_bars.x(bars, w, q) + share)
            scene_bars.weight[w, g, n] = real(0.0)
            scene_bars.place[w, g, n] = vec3()
        paths_of.pose_adjoint(
            w, g, t, centre_bar, R_bar, paths, scene_bars.position, scene_bars.turn
        )

    @wp.func
    def grasp_adjoint(
        w: int, t: wp.float64, age: int, row: int, matter: Matter, scene: Scene, paths: Paths,
        grips: Grips, recorded: Recorded, bars: Bars, scene_bars: SceneBars,
    ):  # fmt: skip
        """Go back over grippers that opened or closed before substep ``age``; by one thread."""
        for g in range(paths.radius.shape[1]):
            if grips.until[w, g] == age:
                boundary.hold_on(w, g, real(1.0), grips)
            if grips.since[w, g] == age:
                attach_adjoint(
                    w, g, t, row, matter, scene, paths, grips, recorded, bars, scene_bars
                )
                boundary.hold_on(w, g, real(0.0), grips)

    return Namespace(
        contact_adjoint, wide, follow_adjoint, led_adjoint, carried_adjoint, turned_adjoint,
        guided_adjoint, grasp_adjoint,
    )  # fmt: skip
