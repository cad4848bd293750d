"""Bodies, clamps and readings that several cases share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from gendom.errors import SimulationError
from gendom.sim import Body, Gripper, Simulator
from gendom.sim.mpm.boundary import FOLLOWS, grip_constants


def block(size: ArrayLike, dx: float, *, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
    """A solid rectangular block, particles half a cell apart and half of that from its faces.

    Args:
        size: [3] edges along x, y and z [m].
        dx: Size of a grid cell [m].
        centre: [3] [m].
    """
    edges = np.asarray(size, dtype=float)
    count = np.maximum(2, np.round(edges / (dx / 2.0))).astype(int)
    cells = np.argwhere(np.ones(count, dtype=bool))
    local = (cells + 0.5) * (edges / count)
    number = np.arange(len(cells)).reshape(count)
    lattice = np.empty((len(cells), 3, 2), dtype=np.int32)
    for axis in range(3):
        for side, step in enumerate((-1, 1)):
            beside = cells.copy()
            beside[:, axis] = np.clip(beside[:, axis] + step, 0, count[axis] - 1)
            lattice[:, axis, side] = number[tuple(beside.T)]
    return Body(
        kind="block",
        x=local - edges / 2.0 + np.asarray(centre, dtype=float),
        material_coordinates=local,
        lattice=lattice,
        volume=float(np.prod(edges)) / len(cells),
        dx=dx,
        thickness=float(edges[2]),
        section=1,
        contact_radius=0.0,
    )


def clamp_beyond(point: ArrayLike, outwards: ArrayLike, reach: float) -> Gripper:
    """A gripper that holds all material beyond a plane: a sphere so wide that it looks flat.

    The free length of a rod or strip begins at the plane, whatever the phase of the grid.

    Args:
        point: [3] a point of the plane, on the object's axis [m].
        outwards: [3] unit vector into the held side.
        reach: Largest distance of material from the axis [m].
    """
    radius = 1000.0 * reach
    centre = np.asarray(point, dtype=float) + radius * np.asarray(outwards, dtype=float)
    return Gripper.still(centre, radius=radius)


def across(cells: float) -> str:
    """A resolution in words."""
    return f"{cells:g} cell{'s' * (cells != 1)} across"


def stations(body: Body) -> NDArray[np.floating]:
    """[S] distances of the cross sections from the body's first end [m]."""
    return np.unique(body.material_coordinates[:, 0])


def sections(values: NDArray[np.floating], body: Body) -> NDArray[np.floating]:
    """Means [..., S, 3] over the cross sections of particle values [..., N, 3]."""
    x = np.asarray(values, dtype=float)
    # all bodies list their particles section by section
    return x.reshape(*x.shape[:-2], len(stations(body)), -1, 3).mean(axis=-2)


def end(values: NDArray[np.floating], body: Body) -> NDArray[np.floating]:
    """[..., 3] where the axis ends: half a section's distance beyond the last section."""
    last = sections(values, body)[..., -2:, :]
    return 1.5 * last[..., 1, :] - 0.5 * last[..., 0, :]


def swing(t: NDArray[np.floating], y: NDArray[np.floating], omega: float) -> tuple[float, float]:
    """Angular frequency and decay rate of a damped oscillation, by least squares.

    y = exp(-gamma t) (a cos omega t + b sin omega t) + c; a, b and c are eliminated.

    Args:
        t: [T] times [s].
        y: [T] readings; any unit.
        omega: Where the search starts [rad/s]; a tenth off the answer does no harm.

    Returns:
        omega [rad/s] and gamma [1/s].

    Raises:
        SimulationError: If the fit explains less than 99 % of the readings' variance.
    """

    def misfit(p: NDArray[np.floating]) -> NDArray[np.floating]:
        decay = np.exp(-p[1] * omega * t)
        basis = np.stack(
            [decay * np.cos(p[0] * omega * t), decay * np.sin(p[0] * omega * t), np.ones_like(t)], 1
        )
        return basis @ np.linalg.lstsq(basis, y, rcond=None)[0] - y

    found = least_squares(misfit, [1.0, 0.0], xtol=1e-12, ftol=1e-12, gtol=1e-12)
    if np.var(found.fun) > 0.01 * np.var(y):
        raise SimulationError("the motion is no single damped oscillation", where="swing")
    return float(found.x[0]) * omega, float(found.x[1]) * omega


def momenta(simulator: Simulator) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Linear and angular momentum of world 0: [3] [kg m/s] and [3] about the origin [kg m^2/s].

    A particle carries the moment B = C dx^2 / 4 of its affine velocity beside x cross v.
    Source: Jiang et al. (2015), "The affine particle-in-cell method", section 5.
    """
    body = simulator.body
    m = simulator.materials[0].density * body.volume
    x, v = simulator.positions()[0].astype(float), simulator.velocities()[0].astype(float)
    B = simulator.affine_velocities()[0].astype(float).sum(axis=0) * body.dx**2 / 4.0
    own = np.array([B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]])
    return m * v.sum(axis=0), m * (np.cross(x, v).sum(axis=0) + own)


def spring_energy(simulator: Simulator) -> float:
    """Energy of the springs by which still grippers of world 0 hold material in part [J].

    With weight f they pull with k = f / (1 - f) b m / dt^2, b as in ``gendom.sim.mpm.boundary``.
    """
    grips, material = simulator.worlds.grips, simulator.materials[0]
    mu, lam = material.lame_of(simulator.body.lateral_constraint)
    dt = float(simulator.worlds.clock.dt.numpy()[0])
    _, stiff = grip_constants(simulator.body)
    b = min(stiff * dt**2 * (lam + 2.0 * mu) / material.density / simulator.body.dx**2, FOLLOWS)
    x = simulator.worlds.state.x.numpy()[0].astype(float)
    total = 0.0
    for g, gripper in enumerate(simulator.worlds.setting.grippers[0]):
        n = int(grips.count.numpy()[0, g])
        f = grips.weight.numpy()[0, g, :n].astype(float)
        centre = np.asarray(gripper.position)[0] - simulator.worlds.origin
        away = x[grips.particle.numpy()[0, g, :n]] - centre - grips.place.numpy()[0, g, :n]
        part = f < 1.0
        stiffness = f[part] / (1.0 - f[part]) * b / dt**2
        total += 0.5 * float(np.sum(stiffness * np.sum(away[part] ** 2, axis=1)))
    return total * material.density * simulator.body.volume


def energies(simulator: Simulator, gravity: ArrayLike) -> tuple[float, float, float]:
    """Kinetic, elastic and gravitational energy of world 0 [J].

    Kinetic: m (|v|^2 + dx^2 / 4 |C|^2) / 2, the affine velocity's share included (Jiang et al.
    2015). Elastic: psi = mu / 2 (tr F^T F - 3) - mu ln J + lam / 2 (ln J)^2 times the rest
    volume (Bonet and Wood 2008, chapter 6), whose Kirchhoff stress is the simulator's
    neo-Hookean law. Gravitational: -m g . x.
    """
    body, material = simulator.body, simulator.materials[0]
    mu, lam = material.lame_of(body.lateral_constraint)
    m = material.density * body.volume
    v, C = simulator.velocities()[0].astype(float), simulator.affine_velocities()[0].astype(float)
    kinetic = 0.5 * m * (np.sum(v**2) + body.dx**2 / 4.0 * np.sum(C**2))
    F = simulator.deformation_gradients()[0].astype(float)
    log_J = np.log(np.linalg.det(F))
    stretch = np.einsum("nij,nij->n", F, F) - 3.0
    psi = mu / 2.0 * stretch - mu * log_J + lam / 2.0 * log_J**2
    height = simulator.positions()[0].astype(float) @ np.asarray(gravity, dtype=float)
    return float(kinetic), float(body.volume * psi.sum()), float(-m * height.sum())
