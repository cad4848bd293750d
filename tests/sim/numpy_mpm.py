"""The substep of ``gendom.sim`` in NumPy, one world in float64: written to be read, not to be fast.

Every runner of the simulator is held against it. Symplectic Euler; particles and grid exchange by
APIC with quadratic B-splines; an elastic body's forces are derivatives of its energy by positions.

Sources:
    Transfers: Jiang et al. (2015), "The affine particle-in-cell method"; weights: Steffen, Kirby
        and Berzins (2008).
    Lagrangian forces: Jiang, Gast and Teran (2017), "Anisotropic elastoplasticity for cloth, knit
        and hair frictional contact".
    Law: neo-Hookean, Bonet and Wood (2008), chapter 6.
    Material damping: Simo and Hughes (1998), "Computational Inelasticity", chapter 10.

Shapes: N particles, S sections of N / S particles each, K knots of a gripper's path, n grid nodes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from gendom.materials import Material
from gendom.sim import GRAVITY, Body, Gripper, Table

Array = NDArray[np.floating]

DRAG = {"rope": 1.1, "cloth": 1.2}
"""Drag coefficients: of a cylinder, of a plate, across the flow [-]."""
SPRING, DASHPOT = 0.1, 0.85
"""Of the table: what it makes good of depth and of velocity inwards in a substep [-]."""
BEYOND, STIFFNESS = 1.22, 1.4
"""Where a gripper's weights fall to 0, in spacings beyond its surface; stiffness of the spring on
what is held in part, for the material's own [-]."""
COARSE = (1.25, 3.0)
"""The two of ropes with two by two particles a section."""
FOLLOWS = 0.5
"""Share of its distance from where it belongs that held material makes good at most [-]."""


@dataclass
class State:
    """Particles at one moment."""

    x: Array  # [N, 3] [m]
    v: Array  # [N, 3] [m/s]
    C: Array  # [N, 3, 3] affine velocities [1/s]
    Z: Array  # [N, 3, 3] second Piola-Kirchhoff stress, low-pass filtered [Pa]


@dataclass
class Grip:
    """What a gripper took hold of when it closed."""

    weight: Array  # [N] share in which it carries each particle
    place: Array  # [N, 3] where it holds each particle, in its own frame [m]


class NumpyMPM:
    """One world; arguments are those of ``Simulator``."""

    def __init__(
        self, body: Body, material: Material, *, grippers: Sequence[Gripper] = (),
        table: Table | None = None, gravity: ArrayLike = GRAVITY, velocity_damping: float = 0.0,
        air_density: float = 0.0,
    ):  # fmt: skip
        self.body, self.material = body, material
        self.grippers, self.table = grippers, table
        self.gravity = np.asarray(gravity, dtype=float)
        self.velocity_damping, self.air_density = velocity_damping, air_density
        self.mu, self.lam = material.lame_of(body.lateral_constraint)
        self.mass = material.density * body.volume
        coarse = body.kind == "rope" and body.section == 4
        self.beyond, self.stiffness = COARSE if coarse else (BEYOND, STIFFNESS)
        self.grips: list[Grip | None] = [None] * len(grippers)
        self.time = 0.0
        x = np.array(body.x)
        zeros = np.zeros((len(x), 3, 3))
        self.state = State(x=x, v=np.zeros_like(x), C=zeros, Z=zeros)
        if material.damping > 0.0:
            F = self.differences() @ body.rest_frames
            self.state.Z = np.linalg.solve(F, self.elastic_stress(F))

    def run(self, times: ArrayLike, substep: float) -> Array:
        """[T, N, 3] positions at times [T] [s]; each interval in equal substeps of at most
        ``substep`` [s], none where it is empty."""
        frames = []
        for until in np.atleast_1d(np.asarray(times, dtype=float)):
            start, interval = self.time, float(until) - self.time
            steps = max(1, math.ceil(interval / substep - 1e-9)) if interval > 0.0 else 0
            for n in range(steps):
                self.advance(start + n * (interval / steps), interval / steps)
            self.time = float(until)
            frames.append(self.state.x)
        return np.stack(frames)

    def advance(self, t: float, dt: float) -> None:
        """One substep from t to t + dt [s]."""
        self.grasp(t)
        m, x = self.mass, self.state.x
        impulse = self.internal_impulse(dt) + self.drag_impulse(dt)
        u = self.state.v + dt * self.gravity + impulse / m
        u = u + self.spread(self.contact(self.sections(x), self.sections(u), dt))
        held, carried, turning = self.carried(t, dt)
        u = u + held[:, None] * (carried - u)
        grid = held < 1.0  # what is held firmly has no part in the grid
        v, C = self.move_with_grid(grid, m * u, dt)
        self.state.v = np.where(grid[:, None], v, carried)
        self.state.C = np.where(grid[:, None, None], C, turning)
        self.state.x = x + dt * self.state.v

    # ---- table, grippers ------------------------------------------------------------------------

    def contact(self, x: Array, u: Array, dt: float) -> Array:
        """[S, 3] change of the velocities u of sections at x by a spring, a dashpot and
        friction."""
        radius, change = self.body.contact_radius, np.zeros_like(u)

        if self.table is not None:
            gap = x[:, 2] - self.table.height - radius
            given = np.maximum(-SPRING * gap / dt - DASHPOT * u[:, 2], 0.0)
            change[:, 2] = np.where(gap < 0.0, given, 0.0)
            slip = np.linalg.norm(u[:, :2], axis=1)
            most = float(np.asarray(self.table.friction)) * change[:, 2]
            lost = np.where(slip > most, most / np.where(slip > 0.0, slip, 1.0), 1.0)
            change[:, :2] = -np.where(change[:, 2] > 0.0, lost, 0.0)[:, None] * u[:, :2]
        return change

    def grasp(self, t: float) -> None:
        """Let grippers open and close; what one holds is left to it."""
        x = self.state.x
        for i, gripper in enumerate(self.grippers):
            if not gripper.hold_from <= t < gripper.hold_until:
                self.grips[i] = None
            elif self.grips[i] is None:
                centre, R = pose(gripper, t)
                rho = np.linalg.norm(self.sections(x) - centre, axis=1)
                f = np.clip((gripper.radius - rho) / (self.body.dx / 2.0) + self.beyond, 0.0, 1.0)
                taken = sum((g.weight for g in self.grips if g is not None), np.zeros(len(x)))
                self.grips[i] = Grip(np.where(taken > 0.0, 0.0, self.spread(f)), (x - centre) @ R)

    def carried(self, t: float, dt: float) -> tuple[Array, Array, Array]:
        """Weights [N], velocities [N, 3] and affine velocities [N, 3, 3] that grippers impose."""
        x = self.state.x
        held, v, C = np.zeros(len(x)), np.zeros_like(x), np.zeros((len(x), 3, 3))
        for gripper, grip in zip(self.grippers, self.grips, strict=True):
            if grip is None:
                continue
            (c0, R0), (c1, R1) = pose(gripper, t), pose(gripper, t + dt)
            omega = Rotation.from_matrix(R1 @ R0.T).as_rotvec() / dt
            arm = grip.place @ R1.T
            V = (c1 - c0) / dt + np.cross(omega, arm)
            behind = c1 + arm - dt * V - x
            mine = grip.weight > 0.0
            held = held + grip.weight
            modulus = (self.lam + 2.0 * self.mu) / self.material.density
            b = min(self.stiffness * dt**2 * modulus / self.body.dx**2, FOLLOWS)
            b = np.where(grip.weight[:, None] < 1.0, b, FOLLOWS)
            v[mine] = (V + b / dt * behind)[mine]
            C[mine] = np.cross(np.eye(3), omega)  # C r = omega x r
        return held, v, C

    def sections(self, of: Array) -> Array:
        """[S, 3] means over the particles of each section."""
        return of.reshape(-1, self.body.section, 3).mean(axis=1)

    def spread(self, of: Array) -> Array:
        """[N, ...] for each particle what [S, ...] says of its section."""
        return np.repeat(of, self.body.section, axis=0)

    # ---- forces ------------------------------------------------------------------------------

    def differences(self) -> Array:
        """[N, 3, axis] differences of the neighbours' positions along the lattice axes [m]."""
        near = self.body.lattice
        return np.swapaxes(self.state.x[near[:, :, 1]] - self.state.x[near[:, :, 0]], 1, 2)

    def internal_impulse(self, dt: float) -> Array:
        """[N, 3] impulses of the stress [kg m/s]; Z moves on to the end of the substep."""
        B, near, state = self.body.rest_frames, self.body.lattice, self.state
        F = self.differences() @ B
        P = self.elastic_stress(F)
        if self.material.damping > 0.0:
            # the branch's stress S - Z falls to a (S - Z) in dt; its mean acts
            # it cannot be faster than the substep: it is softer instead
            tau = max(self.material.damping, dt)
            a = math.exp(-dt / tau)
            g = self.material.damping / tau * (1.0 + a) / 2.0
            S = np.linalg.solve(F, P)
            P = (1.0 + g) * P - g * F @ state.Z
            state.Z = state.Z + (1.0 - a) * (S - state.Z)
        pull = dt * self.body.volume * P @ np.swapaxes(B, 1, 2)
        impulse = np.zeros_like(state.x)
        for k in range(3):
            np.add.at(impulse, near[:, k, 0], pull[:, :, k])
            np.add.at(impulse, near[:, k, 1], -pull[:, :, k])
        return impulse

    def elastic_stress(self, F: Array) -> Array:
        """[N, 3, 3] first Piola-Kirchhoff stress P of F [N, 3, 3] [Pa]."""
        J = np.linalg.det(F)[:, None, None]
        F_invT = np.swapaxes(np.linalg.inv(F), 1, 2)
        return self.mu * (F - F_invT) + self.lam * np.log(J) * F_invT

    def drag_impulse(self, dt: float) -> Array:
        """[N, 3] impulses of the air, c_d rho_a / 2 |v|^2 A against the velocity v across a rope or
        through a cloth [kg m/s]; A is each particle's share of its section's area [m^2]."""
        body, v = self.body, self.state.v
        alone = (body.lattice == np.arange(body.num_particles)[:, None, None]).any(axis=2)
        edges = self.differences() / np.where(alone, 1.0, 2.0)[:, None, :]  # of one particle
        if body.kind == "rope":
            length = np.linalg.norm(edges[:, :, 0], axis=1, keepdims=True)
            along = edges[:, :, 0] / length
            across = v - np.sum(v * along, axis=1, keepdims=True) * along
            area = body.thickness * length / body.section
        else:
            normal = np.cross(edges[:, :, 0], edges[:, :, 1])
            area = np.linalg.norm(normal, axis=1, keepdims=True)
            normal, area = normal / area, area / body.section
            across = np.sum(v * normal, axis=1, keepdims=True) * normal
        speed = np.linalg.norm(across, axis=1, keepdims=True)
        return -dt / 2.0 * self.air_density * DRAG[body.kind] * area * speed * across

    # ---- grid --------------------------------------------------------------------------------

    def move_with_grid(self, part: NDArray[np.bool_], q: Array, dt: float) -> tuple[Array, Array]:
        """p2g of the particles [N] that have part in it and of their momenta [N, 3] [kg m/s]; g2p.

        Returns:
            [N, 3] velocities v [m/s] and [N, 3, 3] affine velocities C [1/s].
        """
        dx, m, state = self.body.dx, self.mass, self.state
        origin = np.array([0.0, 0.0, 0.0 if self.table is None else self.table.height])
        y = (state.x - origin) / dx
        base = np.floor(y - 0.5).astype(int)
        f = y - base  # in 1/2 .. 3/2
        w = 0.5 * np.stack(
            [(1.5 - f) ** 2, 1.5 - 2.0 * (f - 1.0) ** 2, (f - 0.5) ** 2]
        )  # [3, N, 3]
        offset = np.stack(np.meshgrid(*[range(3)] * 3, indexing="ij"), axis=-1).reshape(27, 3)
        i, j, k = offset.T
        w = (w[i, :, 0] * w[j, :, 1] * w[k, :, 2]).T[..., None]  # [N, 27, 1]
        r = (offset - f[:, None]) * dx  # [N, 27, 3] x_i - x_p

        node = base[:, None] + offset
        node -= node.min(axis=(0, 1))
        flat = np.ravel_multi_index(np.moveaxis(node, 2, 0), tuple(node.max(axis=(0, 1)) + 1))
        nodes, index = np.unique(flat, return_inverse=True)
        index = index.reshape(flat.shape)  # [N, 27] in 0 .. n - 1

        share = w * part[:, None, None]
        mass, momentum = np.zeros((len(nodes), 1)), np.zeros((len(nodes), 3))
        np.add.at(mass, index, share * m)
        np.add.at(momentum, index, share * (q[:, None] + m * r @ np.swapaxes(state.C, 1, 2)))
        u = np.divide(momentum, mass, out=np.zeros_like(momentum), where=mass > 0.0)
        u *= math.exp(-self.velocity_damping * dt)

        wu = w * u[index]  # [N, 27, 3]
        return wu.sum(axis=1), 4.0 / dx**2 * np.swapaxes(wu, 1, 2) @ r


def pose(gripper: Gripper, t: float) -> tuple[Array, Array]:
    """Centre [3] [m] and rotation [3, 3] at time t [s]; turns at constant rate between knots."""
    centre, knots = gripper.position_at(t), np.asarray(gripper.time)
    if gripper.quat_xyzw is None:
        return centre, np.eye(3)
    turns = Slerp(knots, Rotation.from_quat(np.asarray(gripper.quat_xyzw)))
    return centre, turns(np.clip(t, knots[0], knots[-1])).as_matrix()
