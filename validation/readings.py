"""What is read off a motion: momenta, energies, frequencies and rates of growth."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.sim import Simulator
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.rods import joint_strains
from gendom.sim.thin.rotation import conjugate, turned
from gendom.sim.thin.types import SPIN, Q

# ---- momenta and energies ------------------------------------------------------------------------


class Mechanics(NamedTuple):
    """Of world 0 at one moment: mass [kg] and its centre [m], momentum P [kg m/s], angular momentum
    L about the centre [kg m^2/s], kinetic and elastic energy [J]."""

    mass: float
    centre: Array
    P: Array
    L: Array
    kinetic: float
    elastic: float


def mechanics(s: Simulator) -> Mechanics:
    """Momenta and energies of world 0, of particles, a rod or a shell."""
    x, v = s.positions()[0].astype(float), s.velocities()[0].astype(float)
    e: Any = s.engine
    if isinstance(s.engine, ThinEngine):
        m = e.model.mass[0]
    else:
        m = np.full(len(x), s.materials[0].density * s.body.volume)
    centre = m @ x / m.sum()
    L = np.cross(x - centre, m[:, None] * v).sum(axis=0)
    kinetic = 0.5 * float(m @ np.sum(v**2, axis=1))
    if isinstance(s.engine, ThinEngine) and e.model.directed:
        J, spin = e.model.inertia[0, :-1], e.component(SPIN)[0][:-1]
        L = L + J @ spin
        kinetic += 0.5 * float(np.sum(J[:, None] * spin**2))
        elastic = rod_energy(s)
    elif isinstance(s.engine, ThinEngine):
        elastic = membrane_energy(s) + bending_energy(s)
    else:
        # A particle carries the moment B = C dx^2 / 4 of its affine velocity and its energy.
        # Source: Jiang et al. (2015), "The affine particle-in-cell method", section 5.
        C = e.state.C.numpy()[0].astype(float)
        B = C.sum(axis=0) * s.body.dx**2 / 4.0
        L = L + m[0] * np.array([B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]])
        kinetic += 0.5 * m[0] * s.body.dx**2 / 4.0 * float(np.sum(C**2))
        elastic = particle_energy(s)
    return Mechanics(float(m.sum()), centre, m @ v, L, kinetic, elastic)


def particle_energy(s: Simulator) -> float:
    """Elastic energy of the MPM's world 0 [J].

    psi = mu / 2 (tr F^T F - 3) - mu ln J + lam / 2 (ln J)^2 times the rest volume (Bonet and Wood
    2008, chapter 6), whose Kirchhoff stress is the simulator's neo-Hookean law.
    """
    mu, lam = s.materials[0].lame_of(s.body.lateral_constraint)
    x, lattice = s.positions()[0].astype(float), s.body.lattice
    F = np.swapaxes(x[lattice[:, :, 1]] - x[lattice[:, :, 0]], 1, 2) @ s.body.rest_frames
    log_J = np.log(np.linalg.det(F))
    stretch = np.einsum("nij,nij->n", F, F) - 3.0
    psi = mu / 2.0 * stretch - mu * log_J + lam / 2.0 * log_J**2
    return float(s.body.volume * psi.sum())


def rod_energy(s: Simulator) -> float:
    """Elastic energy of a rod, world 0 [J]."""
    e: Any = s.engine
    x, q = s.positions()[0].astype(float), e.component(Q)[0][:-1]
    k, rest = e.model.stiffness[0], e.model.rest
    strain = turned(conjugate(q), np.diff(x, axis=0)) * rest[0, :-1, None] - rest[1:4, :-1].T
    bend = joint_strains(q) - rest[4:, 1:-1].T
    at_grips = e.stiffer[0, :, 0].prod(axis=0)[1:-1]
    total = 0.5 * np.sum(k[:3, :-1].T * strain**2 / rest[0, :-1, None])
    return float(total + 0.5 * np.sum(k[3:, 1:-1].T * at_grips[:, None] * bend**2))


def membrane_energy(s: Simulator) -> float:
    """Of a shell, world 0 [J], from the lattice's edges as ``native/shell.h`` says."""
    e: Any = s.engine
    ny, nx = e.model.shape
    x = s.positions()[0].astype(float).reshape(ny, nx, 3)
    lx, ly = e.model.spacing
    u, v = np.diff(x, axis=1), np.diff(x, axis=0)
    rows, columns = (np.sum(u**2, 2) / lx**2 - 1) / 2, (np.sum(v**2, 2) / ly**2 - 1) / 2
    k = e.model.stiffness[0].reshape(8, ny, nx)[:, :-1, :-1]
    F = np.sum((u[1:] + u[:-1]) * (v[:, 1:] + v[:, :-1]), axis=2) / 4
    free = np.sum((u[1:] - u[:-1]) ** 2, axis=2) / 4
    total = 0.5 * np.sum(k[3] * ((F - np.clip(F, -free, free)) / (2 * lx * ly)) ** 2)
    for j, i in ((0, 0), (0, 1), (1, 0), (1, 1)):
        a, b = rows[j : ny - 1 + j], columns[:, i : nx - 1 + i]
        total += 0.5 * np.sum(k[0] * a**2 + k[1] * b**2 + 2 * k[2] * a * b)
    return float(total)


def bending_energy(s: Simulator) -> float:
    """Of a shell, world 0 [J]."""
    e: Any = s.engine
    shape = e.model.shape
    x = s.positions()[0].astype(float).reshape(*shape, 3)
    k = e.model.stiffness[0].reshape(8, *shape)
    xx, yy = np.zeros_like(x), np.zeros_like(x)
    xx[:, 1:-1], yy[1:-1] = np.diff(x, 2, axis=1), np.diff(x, 2, axis=0)
    xy = np.diff(np.diff(x, axis=0), axis=1)
    at_grips = e.stiffer[0].prod(axis=0).reshape(2, *shape)
    total = np.sum(at_grips[0] * k[4] * np.sum(xx**2, 2) + at_grips[1] * k[5] * np.sum(yy**2, 2))
    total += np.sum(2 * k[6] * np.sum(xx * yy, 2)) + np.sum(k[7, :-1, :-1] * np.sum(xy**2, 2))
    return 0.5 * float(total)


def energies(s: Simulator, times: ArrayLike, pull: ArrayLike) -> tuple[Array, Array]:
    """[T] energy of world 0 and its gravitational part, at ``times`` under gravity ``pull`` [J]."""
    total, high = [], []
    for t in np.asarray(times, dtype=float):
        if t > 0.0:
            s.run([t])
        m = mechanics(s)
        high.append(-m.mass * float(m.centre @ np.asarray(pull)))
        total.append(m.kinetic + m.elastic + high[-1])
    return np.array(total), np.array(high)


# ---- frequencies and rates -----------------------------------------------------------------------


def swing(t: Array, y: Array, omega: float) -> tuple[float, float]:
    """Angular frequency [rad/s] and decay rate [1/s] of a damped oscillation y [T] at times [s], by
    least squares from ``omega`` [rad/s] on; a tenth off the answer does no harm.

    y = exp(-gamma t) (a cos omega t + b sin omega t) + c; a, b and c are eliminated.

    Raises:
        SimulationError: If the fit explains less than 99 % of the readings' variance.
    """

    def misfit(p: Array) -> Array:
        decay = np.exp(-p[1] * omega * t)
        basis = np.stack(
            [decay * np.cos(p[0] * omega * t), decay * np.sin(p[0] * omega * t), np.ones_like(t)], 1
        )
        return basis @ np.linalg.lstsq(basis, y, rcond=None)[0] - y

    found = least_squares(misfit, [1.0, 0.0], xtol=1e-12, ftol=1e-12, gtol=1e-12)
    if np.var(found.fun) > 0.01 * np.var(y):
        raise SimulationError("the motion is no single damped oscillation", where="swing")
    return float(found.x[0]) * omega, float(found.x[1]) * omega


def critical_share(shares: Array, t: Array, y: Array, damping: float) -> float:
    """Share of a critical load at which a mode of sizes y [T, W] neither grows nor decays, the one
    nearest to 1, from loads ``shares`` [W] over the critical one.

    All velocities decay at one rate c, ``damping`` [1/s]: of y ~ exp(r t) the squared rate without
    is r (r + c). It is 0 on a parabola through those of ``shares``.

    Raises:
        SimulationError: If there is no such share.
    """
    rate = np.polyfit(t, np.log(np.abs(y.astype(float))), 1)[0]
    if not np.isfinite(rate).all():
        raise SimulationError("a kick came to nothing", where="growth")
    zeros = np.roots(np.polyfit(shares, rate * (rate + damping), 2))
    zeros = zeros[np.isreal(zeros)].real
    if not len(zeros):
        raise SimulationError("no critical load", where="growth")
    return float(zeros[np.abs(zeros - 1.0).argmin()])
