"""Methods that train a policy: each takes a `TrainingProblem`, and what comes between training and
fine-tuning (refining), and returns errors. Needs torch.

`distal` (default) trains through a forward model, after Jordan and Rumelhart (1992), "Forward
models: supervised learning with a distal teacher". First a forward model f(action, parameters) ->
goal is fitted: that map is a function. Then the policy pi is trained through the frozen f to make
f(pi(g, p), p) = g, so it may choose any action of the curve that reaches the goal, and has no
reason to average. What the policy does not see, f does: such a policy learns the action that is
best on average, one that hardly depends on it.

A forward model knows nothing where no demonstrations are, and a policy trained through it would
seek out such places. A pull brings actions that stray farther from the demonstrated ones than
these lie from each other back to the nearest. Where a task names a risk (rope reaching: falling out
of the plane), the forward model learns it too, and the policy is kept below its limit: beyond it
what is reached cannot be predicted. Here and there what is reached jumps, and no network follows.
Large errors count linearly (Huber 1964), so that both networks fit what can be fitted.

Demonstrations for fine-tuning, such as real ones, are few, and do not change the forward model:
what they reach beside what it says is a Gaussian process over actions and parameters (Kennedy and
O'Hagan 2001), which is nothing where none of them is near. Through both the policy is trained once
more, for the goals of both kinds of demonstrations, so that it forgets nothing.

`inverse` is the regression of the action on goal and parameters of Kuroki et al. (2024). The
minimiser of the mean squared error is the *mean* of all actions that lead to the goal. Two numbers
of a release make one distance, so a whole curve of releases reaches each goal, and where the curve
bends its mean lies beside it. No amount of data takes that error away.

`chance` is for tasks without goals, like cloth spreading, where an action is enough or is not: it
fits the probability that an action is enough to all that were tried, those that failed, too; those
for fine-tuning, of another world, count together as much as all others. What an action of a
crumpled cloth leads to is chance: the smallest disturbance decides. The policy then takes the
action that asks least of those that are enough with nearly the best probability, for all objects
that may be the one at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from gendom.arguments import require
from gendom.errors import PolicyError
from gendom.policies.demonstrations import SMALLEST
from gendom.policies.fitting import PhysicalNetwork, TrainingProblem, huber, rms, standardised

Between = Callable[[], dict[str, float]]
"""What comes between training and fine-tuning; gives errors."""

ANCHORS = 1024
"""Demonstrated actions, at most, that the pull looks for the nearest among."""

REPLAY = 4
"""How many demonstrations of the first kind each of those for fine-tuning is trained with."""

REACHES, NOISES = (0.25, 0.5, 1.0), (1e-3, 1e-2, 0.1, 1.0, 10.0, 1e3)
"""Distances of standardised inputs over which what is left of goals is alike, and variances of its
noise over its own, that are tried. Farther ones would tell of objects that nobody has seen."""

HUBER_THRESHOLD = 0.1
"""Error from which on it counts linearly [standard deviations of the goal]."""


def distal(problem: TrainingProblem, between: Between = dict) -> dict[str, float]:
    """Train forward model and policy; return their errors on held-out demonstrations.

    Raises:
        PolicyError: The task has no goals.
    """
    training, G = problem.training, len(problem.goals)
    what, fix = "the task has no goals to train through", "choose the method inverse"
    require(G, what, where="method", fix=fix, error=PolicyError)
    outputs, target = list(problem.goals), problem.goal
    if problem.log_risk is not None:
        outputs.append(standardised("risk", problem.log_risk.cpu().numpy()[:, 0].astype(float)))
        target = torch.cat([problem.goal, problem.log_risk], dim=1)
    model = PhysicalNetwork(
        [*problem.actions, *problem.parameters.values()], outputs, training.architecture
    )

    def seen(action: Tensor, rows: Tensor) -> list[Tensor]:
        return [*action.split(1, dim=1), *(problem.data[n][rows] for n in problem.parameters)]

    beside = None

    def predicted(action: Tensor, rows: Tensor) -> Tensor:
        found = model(*seen(action, rows))
        if beside is not None:
            found = found + nn.functional.pad(beside(seen(action, rows)), (0, found.shape[1] - G))
        return found

    # what is reached beyond the risk's limit is noise: only the risk itself is learnt there
    counts = torch.ones_like(target)
    counts[:, :G] = problem.within[:, None].float()

    def model_loss(rows: Tensor) -> Tensor:
        error = (predicted(problem.action[rows], rows) - target[rows]) / model.output_scale
        return (counts[rows] * huber(error, HUBER_THRESHOLD)).mean()

    problem.fit("forward model", model, model_loss)
    model.requires_grad_(False)
    scale = problem.policy.output_scale
    outside = _distance_outside(problem.action[problem.trained] / scale)

    def policy_loss(rows: Tensor) -> Tensor:
        action = problem.act(rows)
        found = predicted(action, rows)
        error = (found[:, :G] - problem.goal[rows]) / model.output_scale[:G]
        loss = huber(error, HUBER_THRESHOLD).mean() + outside(action / scale)
        if problem.log_risk is not None:
            loss = loss + problem.caution(found[:, G])
        return loss

    problem.fit("policy", problem.policy, policy_loss, only=problem.within)
    errors = between()
    tuned = problem.tuned
    if len(tuned) >= SMALLEST:
        at = seen(problem.action[tuned], tuned)
        with torch.no_grad():
            beside = GaussianProcess(model, at, problem.goal[tuned] - model(*at)[:, :G])
    problem.fit("policy", problem.policy, policy_loss, only=problem.within, replay=REPLAY)
    with torch.no_grad():
        rows = problem.held_out[problem.within[problem.held_out]]
        if not len(rows):
            return errors
        known = predicted(problem.action[rows], rows)[:, :G] - problem.goal[rows]
        own = predicted(problem.act(rows), rows)[:, :G] - problem.goal[rows]
        errors |= {"forward_model_rms": rms(known), "goal_rms_by_forward_model": rms(own)}
    return errors


def inverse(problem: TrainingProblem, between: Between = dict) -> dict[str, float]:
    """Train the policy; return its root mean square error on held-out demonstrations."""
    scale = problem.policy.output_scale

    def lacks(rows: Tensor) -> Tensor:
        return problem.action[rows] - problem.act(rows)

    def loss(rows: Tensor) -> Tensor:
        return ((lacks(rows) / scale) ** 2).mean()

    problem.fit("policy", problem.policy, loss)
    errors = between()
    problem.fit("policy", problem.policy, loss, replay=0)
    with torch.no_grad():
        return {**errors, "action_rms": rms(lacks(problem.held_out))}


def chance(problem: TrainingProblem, between: Between = dict) -> dict[str, float]:
    """Train the policy; return the share of held-out demonstrations of which it says the less
    likely of enough and not enough.

    Raises:
        PolicyError: The task has no risk by which to know, or no actions to choose among.
    """
    what = "the task has no risk, or no candidates to choose among"
    fix = "choose the method inverse"
    known = problem.log_risk is not None and problem.candidates
    require(known, what, where="method", fix=fix, error=PolicyError)
    enough = problem.within.float()[:, None]

    def loss(rows: Tensor) -> Tensor:
        worlds = [own for own in (rows, problem.tuned) if len(own)]
        lacks = [nn.functional.binary_cross_entropy(problem.act(w), enough[w]) for w in worlds]
        return torch.stack(lacks).mean()

    problem.fit("policy", problem.policy, loss)
    with torch.no_grad():
        rows = problem.held_out
        wrong = (problem.act(rows) > 0.5) != (enough[rows] > 0.5)
        return {"wrong_share": float(wrong.float().mean())}


class GaussianProcess:
    """What is left of goals beside a network, interpolated: of squared-exponential covariance, its
    reach, size and noise those of the largest marginal likelihood (Rasmussen and Williams 2006,
    equation 5.8).

    Args:
        network: Standardises its inputs.
        inputs: [N, 1] each, of the network.
        values: [N, G].
    """

    def __init__(self, network: PhysicalNetwork, inputs: Sequence[Tensor], values: Tensor):
        self._network, y = network, values.double()
        x = network.standardised(inputs).double()
        squares, (N, G) = torch.cdist(x, x) ** 2, y.shape
        best = torch.inf
        for reach in REACHES:
            for noise in NOISES:
                L = torch.linalg.cholesky(
                    torch.exp(-0.5 * squares / reach**2) + noise * torch.eye(N)
                )
                weights = torch.cholesky_solve(y, L)
                size = (y * weights).sum() / (N * G)
                lack = N * size.log() + 2.0 * L.diagonal().log().sum()
                if lack < best:
                    best, self._reach, self._weights = lack, reach, weights.float()
        self._x = x.float()

    def __call__(self, inputs: Sequence[Tensor]) -> Tensor:
        """[B, G] at [B, 1] each."""
        x = self._network.standardised(inputs)
        squares = ((x[:, None] - self._x) ** 2).sum(dim=2)
        return torch.exp(-0.5 * squares / self._reach**2) @ self._weights


def _distance_outside(demonstrated: Tensor) -> Callable[[Tensor], Tensor]:
    """Mean squared distance by which actions [B, A] lie outside the demonstrated ones [N, A], all
    standardised; up to the usual gap between neighbouring demonstrations they count as inside."""
    anchors = demonstrated[torch.randperm(len(demonstrated))[:ANCHORS]]
    between = torch.cdist(anchors, anchors)
    between.fill_diagonal_(torch.inf)
    gap = torch.quantile(between.min(dim=1).values, 0.95)

    def outside(actions: Tensor) -> Tensor:
        # cdist has no gradient at distance zero, and only the nearest one is needed
        with torch.no_grad():
            nearest = anchors[torch.cdist(actions, anchors).argmin(dim=1)]
        distance = ((actions - nearest) ** 2).sum(dim=1).clamp_min(1e-12).sqrt()
        return (torch.relu(distance - gap) ** 2).mean()

    return outside
