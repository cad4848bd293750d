"""Learning from executions: reached goals update the object's parameters and a discrepancy model.

After each execution of action a_n the reached goal y_n is seen. With f the simulator,

    y_n = f(a_n, theta) + b(a_n) + noise,    theta ~ N(mean, covariance),    b ~ GP(0, k),

the model discrepancy b of Kennedy and O'Hagan (2001), "Bayesian calibration of computer models".
Parameters are found by Gauss-Newton, b by the Gaussian process's mean given the residuals. One
execution that misses changes damping and E as far as they explain the miss; the rest is predicted
for similar actions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError, SimulationError
from gendom.materials import Item, size_of
from gendom.materials.estimate import Estimate
from gendom.policies.polishing import Discrepancy
from gendom.policies.rollouts import Asking, side_by_side
from gendom.reading import record_of
from gendom.tasks import Task
from gendom.tasks.task import World, numbers_of
from gendom.tasks.world import Simulation

MOST = 400
"""Executions: time and memory grow with their cube and square."""

STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
"""Of a Gauss-Newton step, simulated side by side."""

LARGEST_REACHED = 10.0
"""In sizes of the object; what was reached farther away was not given in metres."""

ITERATIONS, LEAST_GAIN = 6, 1e-3
"""Gauss-Newton steps, at most, and the gain in the sum of squares that ends the search."""

STEP = 0.05
"""Of differences by parameters, in their prior deviations."""

DISCREPANCY, REACH, NOISE = 0.008, 0.05, 0.002
"""Standard deviation of b, distance of actions over which it is alike, and standard deviation of
what is seen [units of similarity]. The discrepancy is what our simulator and a second reality
differ by (docs/tasks.md): 1.6 mm in the mean for ropes of 0.3 m."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Execution:
    """One action, and what it reached.

    Raises:
        ParameterError: A number is not finite.
    """

    action: Array
    """[A] in SI units."""
    reached: Array
    """[G] in SI units; of a task without goals the first number of its outcome."""

    def __post_init__(self) -> None:
        for name in ("action", "reached"):
            finite = np.isfinite(getattr(self, name)).all()
            require(finite, "must be finite numbers", where=f"execution's {name}")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"action": self.action.tolist(), "reached": self.reached.tolist()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Adapted:
    """What is known after N executions."""

    belief: Estimate
    """With only what the task depends on uncertain, see `gendom.policies.belief.believed`."""
    discrepancy: Discrepancy | None = field(repr=False)
    """What the simulator, with the most likely object, is wrong by; None: nothing was seen."""
    residuals: Array
    """[N, G] reached less simulated with the most likely object [SI]."""


def adapt(
    task: Task,
    belief: Estimate,
    executions: Sequence[Execution],
    *,
    world: World | None = None,
    refine: bool = True,
) -> Adapted:
    """A belief updated by executions in a world (default: our simulator); other arguments and
    errors as of `adapting`."""
    search = adapting(task, belief, executions, refine=refine)
    return side_by_side(task, world or Simulation(), [search])[0]


def adapting(
    task: Task, belief: Estimate, executions: Sequence[Execution], *, refine: bool = True
) -> Asking[Adapted]:
    """`adapt` as a search that asks for rollouts, for many at once (`side_by_side`).

    Args:
        task: What was done.
        belief: Before any of them.
        executions: All that were seen of this object.
        refine: Whether parameters are learnt; else the belief holds them already, and only the
            discrepancy is found.

    Raises:
        ParameterError: The task has no goals, or numbers do not agree.
        SimulationError: One of them cannot be simulated.
    """
    _check(task, executions, belief.item)
    G, item = len(task.goals), belief.item
    if not executions or not G:  # a policy weighs what was enough, see `belief.weighed`
        return Adapted(belief=belief, discrepancy=None, residuals=np.empty((0, G)))
    units, goal_units = task.action_units(item), task.goal_units(item)
    N = len(executions)
    A = np.array([e.action for e in executions]) / units
    y = np.array([e.reached for e in executions]) / goal_units
    K = _kernel(A, A) + NOISE**2 * np.eye(len(A))
    L = np.linalg.cholesky(K)
    prior = np.linalg.inv(belief.covariance)

    def simulated(vectors: Sequence[Array]) -> Asking[Array]:
        """[V, N, G] what executions reach with vectors of unknowns, in units of similarity; NaN
        where one cannot be simulated."""
        items = [belief.at(v) for v in vectors for _ in executions]
        outcomes = yield items, [e.action for _ in vectors for e in executions]
        return (numbers_of(outcomes, task.goals) / goal_units).reshape(len(vectors), N, G)

    def whitened(f: Array) -> Array:
        return np.asarray(solve_triangular(L, f, lower=True)).ravel()

    def cost(f: Array, v: Array) -> float:
        d, r = v - belief.mean, whitened(y - f)
        return float(r @ r + d @ prior @ d)

    vector, h = belief.mean.copy(), STEP * belief.sd
    (f,) = yield from simulated([vector])
    what, fix = "an execution cannot be simulated", "check the object's numbers and the action"
    require(np.isfinite(f).all(), what, fix=fix, error=SimulationError)
    H = prior
    for _ in range(ITERATIONS if refine else 0):
        ends = [vector + s * h * e for e in np.eye(len(h)) for s in (1.0, -1.0)]
        all_f = yield from simulated(ends)
        derivatives = np.nan_to_num((all_f[0::2] - all_f[1::2]) / (2.0 * h[:, None, None]))
        J = np.stack([whitened(one) for one in derivatives], axis=1)
        H = J.T @ J + prior
        step = np.linalg.solve(H, J.T @ whitened(y - f) - prior @ (vector - belief.mean))
        # the best of some steps, if it pays
        ends = [vector + share * step for share in STEP_LENGTHS]
        tried = yield from simulated(ends)
        costs = [cost(g, v) if np.isfinite(g).all() else np.inf
                 for g, v in zip(tried, ends, strict=True)]  # fmt: skip
        k = int(np.argmin(costs))
        gained = cost(f, vector) - costs[k]
        if not gained > 0.0:
            break
        vector, f = ends[k], tried[k]
        if gained < LEAST_GAIN:
            break
    weights = np.linalg.solve(K, y - f)

    def discrepancy(action: Array) -> tuple[Array, float]:
        k = _kernel(np.atleast_2d(np.asarray(action, dtype=float)) / units, A)
        variance = DISCREPANCY**2 - (k @ np.linalg.solve(K, k.T))[0, 0]
        return (k @ weights)[0] * goal_units, float(np.sqrt(max(variance, 0.0)) * goal_units[0])

    return Adapted(
        belief=belief.with_gaussian(vector, np.linalg.inv(H)),
        discrepancy=discrepancy,
        residuals=(y - f) * goal_units,
    )


def executions_from(rows: Sequence[Any], where: str) -> list[Execution]:
    """From JSON; inverse of `Execution.to_dict`.

    Raises:
        ParameterError: They are none.
    """
    fix = "give an action and what it reached, each a list of numbers"
    return [
        record_of(Execution, row, where=f"{where}: executions[{k}]", fix=fix, error=ParameterError)
        for k, row in enumerate(rows)
    ]


def _check(task: Task, executions: Sequence[Execution], item: Item) -> None:
    known = task.goals or task.outcomes[:1]
    require(known, f"{task.name} has no goals to learn from", where="adapt")
    what, few = f"are {len(executions)}, at most {MOST} are learnt from", len(executions) <= MOST
    require(few, what, where="executions", fix="give the latest")
    G, A, names = len(known), len(task.actions), ", ".join(q.name for q in known)
    for e in executions:
        what = f"an execution has {e.action.size} numbers of an action and {e.reached.size} "
        what += f"reached, {task.name} has {A} and {G}: {names}"
        require(e.reached.shape == (G,) and e.action.shape == (A,), what, where="executions")
        for quantity, value in zip(known, e.reached, strict=True):
            near = quantity.unit != "m" or abs(value) <= LARGEST_REACHED * size_of(item)
            what = f"{quantity.name} is {value:g} m, and the {item.kind} {size_of(item):g} m"
            fix = f"give metres: {value:g} mm are {1e-3 * value:g} m"
            require(near, what, where="reached", fix=fix)
            what, fix = f"{quantity.name} is {value:g}", "give a share from 0 to 1"
            require(bool(task.goals) or 0.0 <= value <= 1.0, what, where="reached", fix=fix)


def _kernel(a: Array, b: Array) -> Array:
    distance = np.linalg.norm(a[:, None] - b[None], axis=2) / REACH
    return DISCREPANCY**2 * np.exp(-0.5 * distance**2)
