"""How a cloth's corner is held, read off the clouds of its lift.

A recording states where the gripper was sent, not how the fingers hold the cloth: how far inside
the corner, below the stated point, turned which way, how much of it, and how late the cloud shows
the motion. None of it belongs to the material, but a large level grip looks like a stiff cloth: how
far the cloth bends is an unknown of the same search.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gendom.estimation.gauss_newton import (
    Bounds,
    Normal,
    Start,
    descend,
    posterior_covariance,
)
from gendom.sim import check_numbers

SMALL = 0.005
"""Distance below which points count by their square, above which by their distance [m]."""

EDGE = 0.01
"""Height over which particles enter the recorded space [m]."""

POINTS = 400
"""Recorded points of a frame that are compared, at most."""

EFFECTIVE = 250.0
"""Independent figures that the compared clouds contribute."""

LEAST_GAIN = 3e-3
"""Share of the summed distances that a step must still win."""

LEAST_DAMPING = 3e-3
"""Least damping of the search: pairs change with every step, so that long steps are often vain."""


@dataclass(frozen=True)
class Hold:
    """Where and how a gripper holds the corner of a cloth."""

    lag: float = 0.0
    """How late the clouds show the stated motion of the gripper [s]."""
    height: float = 0.0
    """How much higher than the stated point the cloth is held [m]."""
    inset: float = 0.0
    """How far inside the corner, along the diagonal, the held point lies [m]."""
    aside: float = 0.0
    """How far to the left of the diagonal, seen from the corner, the held point lies [m]."""
    turn: float = 0.0
    """Turn of the flat cloth about the held point, from the first guess on [rad]."""
    tilt: float = math.pi / 2.0
    """How far the held corner turns from level as it is lifted [rad]."""
    sink: float = 0.0
    """How far below the stated height the table lies [m]."""
    reach: float = 0.025
    """How far from the held point the cloth moves with the gripper as one: fingers and the folds
    between them [m]."""
    east: float = 0.0
    """How far along x the cloud lies from where the stated point would have it [m]."""
    north: float = 0.0
    """The same along y [m]."""
    pleat: float = 0.0
    """Steepest slope of the pleat that the fingers have pressed, 0 for none [rad]."""
    pleat_width: float = 0.045
    """Half the width of that pleat, measured in the cloth [m]."""
    pleat_turn: float = 0.0
    """Turn of the pleat from the diagonal, about the held point [rad]."""
    arch_along: float = 0.0
    """Curvature along the diagonal of a cloth free of stress, positive where it arches up [1/m]."""
    arch_across: float = 0.0
    """The same across the diagonal [1/m]."""
    crumple: float = 0.0
    """Share of the curvature in which the cloth lay that it keeps; 0: it lay flat."""

    def __post_init__(self) -> None:
        for field in fields(self):
            check_numbers(field.name, getattr(self, field.name))
        check_numbers("lag", self.lag, least=0.0)
        check_numbers("sink", self.sink, least=0.0)
        check_numbers("reach", self.reach, above=0.0)
        check_numbers("pleat_width", self.pleat_width, above=0.0)
        check_numbers("crumple", self.crumple, least=0.0)

    @property
    def shaped(self) -> bool:
        """Whether the cloth is other than flat without stress."""
        return any((self.pleat, self.arch_along, self.arch_across, self.crumple))


@dataclass(frozen=True, kw_only=True)
class Held:
    """A cloth in a grip: how it is held and how far it bends."""

    hold: Hold
    bending: float
    """Bending length [m]."""
    friction: float = 0.4
    """Coefficient of friction on the table."""
    doubt: float = 0.0
    """Standard deviation of log(bending) that not knowing the hold adds to that of a known one."""
    loss: float = math.inf
    """Summed distances from the clouds [m]."""

    @property
    def vector(self) -> NDArray[np.float64]:
        """The unknowns of the search, in the order of `NAMES`."""
        return np.array([*astuple(self.hold), self.friction, math.log(self.bending)])


NAMES = (*(field.name for field in fields(Hold)), "friction", "log_bending")
"""The unknowns of the search."""

STEPS = Held(
    hold=Hold(
        lag=0.01, height=0.003, inset=0.003, aside=0.003, turn=0.015, tilt=0.05, sink=0.0015,
        reach=0.004, east=0.003, north=0.003, pleat=0.06, pleat_width=0.002, pleat_turn=0.03,
        arch_along=0.8, arch_across=0.8, crumple=0.06,
    ),
    friction=0.05,
    bending=math.exp(0.06),
)  # fmt: skip
"""Differences for the Jacobian."""


def fit_hold(
    simulate: Callable[[Sequence[Held]], NDArray[np.floating]],
    clouds: Sequence[NDArray[np.floating]],
    floor: float | None,
    bounds: Bounds,
    starts: Sequence[Held],
    *,
    iterations: int = 10,
    on_iteration: Callable[[Held, float], None] | None = None,
) -> Held:
    """The held cloth whose simulated lift lies nearest to the clouds.

    Every recorded point is paired with the nearest particle and every particle in the recorded
    space with the nearest recorded point; Gauss-Newton steps on the distances of the pairs, which
    are found anew after each step, with differences of the simulation as Jacobian. Distances
    count linearly beyond ``SMALL``, so that a stray point pulls no more than any other. Source:
    Besl and McKay (1992) for the pairs, Huber (1964) for the weights.

    Args:
        simulate: Particles [T, W, N, 3] for W held cloths at the frames of the clouds [m].
        clouds: T recorded clouds [n, 3] [m].
        floor: Height below which the clouds show nothing, or None [m].
        bounds: Limits and prior in the order of ``NAMES``; a value whose limits coincide is given.
        starts: First guesses; the best of what they lead to is taken.
        iterations: Simulated batches that the search may spend.
        on_iteration: Called after each with the best so far and its summed distances.

    Raises:
        SimulationError: If a world diverges.
    """
    free = np.flatnonzero(bounds.high > bounds.low)
    steps = STEPS.vector
    thinned = [c[:: -(-len(c) // POINTS)].astype(float) for c in clouds]
    trees = [KDTree(c) for c in thinned]

    def model(x: NDArray[np.floating], step: NDArray[np.floating]) -> Normal:
        sse, gradient, hessian = 0.0, np.zeros(len(NAMES)), np.zeros((len(NAMES),) * 2)
        for t, (cloud, tree) in enumerate(zip(thinned, trees, strict=True)):
            here = x[t, 0]
            J = (x[t, 1:] - here) / step[free][:, None, None]
            shown, slope = _shown(here[:, 2], floor)
            all_seen = np.ones(len(cloud))
            for particle, point, share, change in (
                (KDTree(here).query(cloud)[1], cloud, all_seen, 0.0 * all_seen),
                (np.arange(len(here)), cloud[tree.query(here)[1]], shown, slope),
            ):
                r, J_r = here[particle] - point, J[:, particle]
                size = np.sqrt((r**2).sum(axis=1) + SMALL**2)
                share, change = share / share.sum(), change / share.sum()
                mean = float(share @ size)
                weight = share / size
                # gradient and hessian of half of sse, as descend has it
                sse += 2.0 * (mean - SMALL)
                gradient[free] += np.einsum("n,fna,na->f", weight, J_r, r)
                gradient[free] += J_r[:, :, 2] @ (change * (size - mean))
                hessian[np.ix_(free, free)] += np.einsum("n,fna,gna->fg", weight, J_r, J_r)
        return Normal(sse=sse, gradient=gradient, hessian=hessian)

    def models(thetas: list[NDArray[np.floating]]) -> list[Normal | None]:
        step = [np.where(theta + steps > bounds.high, -steps, steps) for theta in thetas]
        unit = np.eye(len(NAMES))
        worlds = [
            as_held(v)
            for theta, d in zip(thetas, step, strict=True)
            for v in [theta] + [theta + unit[k] * d[k] for k in free]
        ]
        x = simulate(worlds).astype(float)
        size = 1 + len(free)
        return [model(x[:, size * n : size * (n + 1)], d) for n, d in enumerate(step)]

    going = []
    for first in starts:
        theta = np.clip(first.vector, bounds.low, bounds.high)
        going.append(Start(initial=theta, theta=theta))
    best = going[0]
    for _ in descend(
        models,
        going,
        bounds,
        effective=EFFECTIVE,
        max_iterations=iterations,
        least_gain=LEAST_GAIN,
        least_damping=LEAST_DAMPING,
    ):
        best = min(going, key=lambda s: s.model.sse)  # pyright: ignore[reportOptionalMemberAccess]
        if on_iteration is not None and best.model is not None:
            on_iteration(as_held(best.theta), best.model.sse)
    assert best.model is not None
    information = np.linalg.inv(posterior_covariance(best.model, bounds, effective=EFFECTIVE))
    doubt = np.linalg.inv(information)[-1, -1] - 1.0 / information[-1, -1]
    held = as_held(best.theta)
    return replace(held, doubt=math.sqrt(max(doubt, 0.0)), loss=best.model.sse)


def _shown(
    z: NDArray[np.floating], floor: float | None
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """How far particles at heights z [N] lie in the recorded space, 0 to 1, and the slope of that.

    A sharp edge would have no slope, and a search would not see what it gains or loses there.
    """
    if floor is None:
        return np.ones(len(z)), np.zeros(len(z))
    share = np.clip((z - floor) / EDGE + 0.5, 0.0, 1.0)
    if not share.any():
        return np.ones(len(z)), np.zeros(len(z))
    return share, np.where((share > 0.0) & (share < 1.0), 1.0 / EDGE, 0.0)


def as_held(vector: NDArray[np.floating]) -> Held:
    """The held cloth that a vector in the order of ``NAMES`` stands for."""
    *hold, friction, log_bending = map(float, vector)
    return Held(hold=Hold(*hold), friction=friction, bending=math.exp(log_bending))
