"""Whether a lifted rope's free end is heavier than the rest: a knot, a sheath.

Such a rope hangs like a uniform one that is softer, or stiffer where its end stays on the table:
heavier tips are tried along that valley, each with a step of all other unknowns. One of 5 % of the
mass is not told from none (docs/notes/reality.md), so the others are always uncertain by it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gendom.arrays import Array
from gendom.estimation.methods.gauss_newton import Descent, GaussNewtonSettings, refined
from gendom.estimation.problem import Found, Problem, Start
from gendom.estimation.verdict import displaced

TIPS, GAIN = (0.05, 0.1, 0.15, 0.2, 0.3), 1.0
"""Shares of the mass at the tip that are tried as long as they fit better, the first by so much of
-2 log likelihood. One for which the first fits best is none."""

VALLEY = (-1.0, 1.9)
"""Change of ln(E) that makes up for a tip, over its share, where it stays on the table or not."""

UNSURE = 0.035
"""Deviation of a tip's share, found or not: simulators differ by tenths of a millimetre."""


def with_tip(problem: Problem, found: Found) -> tuple[Found, Array | float, tuple[str, ...]]:
    """What was found, of one lift of a rope with a heavier tip if clouds show one; deviations of
    the unknowns [P] for it, transformed; and what to say of it."""
    settings, prior, best = problem.settings, problem.prior, found.best
    stated = settings.unknowns or "tip_mass" in prior.names or problem.bases[0].tip_mass
    searched = settings.method == "gauss-newton" and not found.interrupted and problem.lifted_rope
    if stated or not searched or displaced(problem.parts[0], found.noise[0]):
        return found, 0.0, ()
    more, uniform = problem.with_unknown("tip_mass"), np.append(best.vector, 0.0)
    descent = Descent(more, GaussNewtonSettings(), found.noise, 0.2, range(len(best.vector)))
    (compared,), table = best.compared.parts, problem.scene.recording.table_height
    leaves = table is None or compared.axis[-1, -1, 2] - table > 1.5 * compared.radius
    way = np.append((np.array(prior.names) == "E_over_rho") * VALLEY[int(leaves)], 1.0)
    most, tried = more.value(uniform, best.compared, found.noise) - GAIN, []
    for tip in TIPS:
        vector = more.prior.clipped(uniform + tip * way)
        tried.append(start := Start(initial=vector, vector=vector, precise=False))
        descent.step([start])
        way = (start.vector - uniform) / tip
        if start.value > most:
            break
        most, heavier = start.value, start
    sd = UNSURE * np.abs(tried[0].vector - uniform) / TIPS[0]
    if len(tried) < 3:
        return found, sd[:-1], ()
    ends = [(s, np.append(s.initial, 0.0), np.append(s.vector, 0.0)) for s in found.starts]
    starts = [replace(s, initial=initial, vector=vector) for s, initial, vector in ends]
    found = refined(more, replace(found, best=heavier, starts=starts, others=()))
    said = f"the free end weighs {heavier.vector[-1]:.0%} of the mass more than that of a uniform"
    said = f"{said} rope (a knot, a sheath?): E and the bending length hold with that"
    return found, sd, (said,)
