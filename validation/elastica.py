"""Curves of slender rods and strips under their weight, solved without the simulator.

Lengths are in units of L, a weight in units of E I / L^3: Gamma = rho g A L^3 / (E I). Rods lie in
the plane of x and z, angles count from x upwards, and gravity points down.
"""

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid, solve_bvp, solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq

from gendom.arrays import Array
from gendom.errors import SimulationError

WARPING = 1.0 / 48.0
"""E C / (G J b^2) of a thin strip of width b over E / G; C = b^3 h^3 / 144, J = b h^3 / 3."""


def hung(
    loads: ArrayLike, *, curvature: float = 0.0, angle: float = 0.0, first: Any = None,
    tol: float = 1e-6,
) -> list[Any]:  # fmt: skip
    """Plane rods, clamped at ``angle`` [rad], under weights Gamma [K], raised bit by bit from
    0, or from that of the shape ``first``.

    theta'' = load (1 - s) cos theta, theta(0) = angle, theta'(1) = curvature (free of stress)
    [1 / L]. Source: Wang (1986), "A critical review of the heavy elastica".

    Returns:
        [K] functions from arc lengths [S] in [0, 1] to theta, theta', x and z [4, S].

    Raises:
        SimulationError: If the collocation does not converge.
    """

    def slopes(s, y, load):
        return np.stack([y[1], load * (1.0 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def at_ends(a, b):
        return np.array([a[0] - angle, b[1] - curvature, a[2], a[3]])

    s = np.linspace(0.0, 1.0, 51)
    theta = angle + curvature * s
    y = np.stack([theta, 0.0 * s + curvature, 0.0 * s, 0.0 * s])
    y[2:] = cumulative_trapezoid([np.cos(theta), np.sin(theta)], s, initial=0.0)
    if first is not None:
        s, y = first.x, first(first.x)
    shapes = []
    for load in np.atleast_1d(np.asarray(loads, dtype=float)):
        found = solve_bvp(partial(slopes, load=load), at_ends, s, y, tol=tol, max_nodes=50000)
        if not found.success:
            raise SimulationError(f"no shape was found ({found.message})", where=f"Gamma {load:g}")
        s, y = found.x, found.y
        shapes.append(found.sol)
    return shapes


def sag(loads: ArrayLike) -> Array:
    """[K] how far tips of level rods hang down over how far they reach out, at Gamma [K]."""
    wanted = np.atleast_1d(np.asarray(loads, dtype=float))
    path = np.unique(np.concatenate([np.geomspace(0.1, wanted.max(), 30), wanted]))
    tips = np.array([shape(1.0)[2:] for shape in hung(path)])[np.searchsorted(path, wanted)]
    return -tips[:, 1] / tips[:, 0]


def leaves_plane(shape: Any, load: float, curvature: float, torsion: float) -> float:
    """A determinant that is 0 where a rod at rest in a plane has another equilibrium beside it.

    A small turn phi2 about its normal and phi3 about its tangent changes curvature and twist by
    phi2' - k phi3 and phi3' + k phi2, k = -theta'; what the rod carries beyond s is its weight
    N = load (1 - s), whatever it does. With its moment M about the plane's normal:

        m2' = k m3 - N sin(theta) phi2       phi2' = k phi3 + m2 - M phi3
        m3' = -k m2 + N cos(theta) phi2      phi3' = -k phi2 + (m3 + M phi2) / torsion

    with m = 0 at the tip and phi = 0 at the clamp. Source: Kirchhoff's equations, linearised.

    ``torsion`` is its stiffness in torsion over that of bending; the others are as of ``hung``.
    """

    def slopes(s: float, y: Array) -> Array:
        theta, slope = shape(s)[:2]
        N, k, M = load * (1.0 - s), -slope, curvature - slope
        A = [
            [0.0, k, -N * np.sin(theta), 0.0],
            [-k, 0.0, N * np.cos(theta), 0.0],
            [1.0, 0.0, 0.0, k - M],
            [0.0, 1.0 / torsion, -k + M / torsion, 0.0],
        ]
        return (np.array(A) @ y.reshape(4, 2)).ravel()

    free = np.eye(4)[:, 2:].ravel()
    at_clamp = solve_ivp(slopes, (1.0, 0.0), free, rtol=1e-7, atol=1e-9).y[:, -1].reshape(4, 2)
    return float(np.linalg.det(at_clamp[2:]))


def critical_load(
    between: tuple[float, float], *, curvature: float, angle: float, torsion: float
) -> float:
    """Gamma at which a rod leaves its plane, or comes back to it; arguments as ``leaves_plane``.

    Raises:
        SimulationError: If a shape was not found, or none or two such loads lie in ``between``.
    """
    low, high = between
    first = hung(np.linspace(0.0, low, 9), curvature=curvature, angle=angle)[-1]

    def determinant(load: float) -> float:
        way = np.linspace(low, load, 3)
        shape = hung(way, curvature=curvature, angle=angle, first=first)[-1]
        return leaves_plane(shape, load, curvature, torsion)

    if determinant(low) * determinant(high) > 0.0:
        raise SimulationError("no critical load", where=f"between Gamma {low:g} and {high:g}")
    load = brentq(determinant, low, high, xtol=1e-4 * high)
    assert isinstance(load, float)
    return load


def lateral_load(warping: float = 0.0, parts: int = 400) -> float:
    """c of the critical weight c sqrt(E I G J) / L^3 of a cantilever that stands on its edge.

    The least of (phi'^2 + warping phi''^2) against (c (1 - s)^2 / 2)^2 phi^2, phi(0) = phi'(0) = 0,
    by finite differences; stiff in its plane. Source: Timoshenko and Gere, Theory of Elastic
    Stability, 6.3; of warping: Vlasov (1961), Thin-walled elastic beams.

    ``warping`` is E C / (G J L^2) of a section that may not warp at the clamp; 0 if it may.
    """
    h = 1.0 / parts
    first = np.diff(np.eye(parts + 1), axis=0) / h
    second = np.zeros((parts + 1, parts + 1))
    second[1:-1] = np.diff(np.eye(parts + 1), n=2, axis=0) / h**2
    second[0, 1] = 2.0 / h**2
    weight = np.full(parts + 1, h)
    weight[[0, -1]] = 0.5 * h
    stiffness = h * first.T @ first + warping * (second.T * weight) @ second
    s = np.linspace(0.0, 1.0, parts + 1)
    work = np.diag(0.25 * weight * (1.0 - s) ** 4)
    return float(eigh(work[1:, 1:], stiffness[1:, 1:], eigvals_only=True)[-1] ** -0.5)


def tip_friction(load: float, lowered: ArrayLike) -> Array:
    """[K] H / V at the tip of a rod clamped upright above a table that its tip touches.

    It is lowered by ``lowered`` [K] (over L, increasing) and buckles while its tip stands still:
    theta'' = H sin theta - (V - load (1 - s)) cos theta, theta(0) = -pi / 2, theta'(1) = 0, with H
    and V such that the tip is where it was. Where H / V reaches mu it slips.

    Raises:
        SimulationError: If the collocation does not converge.
    """

    def slopes(s, y, p):
        turn = p[0] * np.sin(y[0]) - (p[1] - load * (1.0 - s)) * np.cos(y[0])
        return np.stack([y[1], turn, np.cos(y[0]), np.sin(y[0])])

    def at_ends(a, b, p, by):
        return np.array([a[0] + math.pi / 2.0, b[1], a[2], a[3], b[2], b[3] + 1.0 - by])

    # from Euler's column, clamped and pinned, that is hardly bent
    s, root = np.linspace(0.0, 1.0, 101), 4.4934094579
    slope = root * np.cos(root * s) + root**2 * np.sin(root * s) - root
    slope *= 0.3 / np.abs(slope).max()
    across = cumulative_trapezoid(slope, s, initial=0.0)
    y = np.stack([slope - math.pi / 2.0, np.gradient(slope, s), across, -s])
    p, out = np.array([1.0, root**2 + 0.5 * load]), []
    for by in np.atleast_1d(np.asarray(lowered, dtype=float)):
        found = solve_bvp(slopes, partial(at_ends, by=by), s, y, p=p, tol=1e-6, max_nodes=20000)
        if not found.success or found.p is None:
            raise SimulationError(f"no shape was found ({found.message})", where=f"lowered {by:g}")
        s, y, p = found.x, found.y, found.p
        out.append(p[0] / p[1])
    return np.array(out)
