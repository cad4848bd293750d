"""Baselines that learn from a lift's clouds alone, for ropes of the MuJoCo test scene: a network
to parameters, then the policy or CMA-ES in the simulator (as Wiggle and Go! plans), and one from
the lift and a goal straight to an action. Both learn from the same simulated lifts of ropes of one
size; true parameters serve only for the score.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from experiments.planning import GOALS, evolved, missed
from experiments.rope_real import ROPES
from experiments.runs import Result, Runs
from experiments.sbc import drawn_lifts, seen
from gendom.arrays import Array
from gendom.estimation.lift_plan import ObjectClass
from gendom.materials import Item, size_of
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.evaluation import choose, judge
from gendom.policies.rollouts import side_by_side
from gendom.robot import predefined_lift
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.world import Simulation

ROPE = ObjectClass(kind="rope", size=(0.3, 0.3), thickness=(0.016, 0.016)).at(0.5)
"""As long and thick as the three."""

LIFTS, BATCH, EPOCHS = {"small": 64, "full": 4096}, 32, 120
FRAMES, POINTS, WIDTH = 16, 64, 128
"""Lifts to learn from, of which so many are simulated together, and passes over all; frames of a
lift that networks see, points of each, and their width."""

ROLLOUTS, LABELS, UNKNOWNS = 40, 8, ("E_over_rho", "damping")
"""Of CMA-ES for a goal, goals with actions of each lift, and the parameters that are told."""


def simulated(seed: int) -> tuple[Array, Array]:
    """Clouds of a batch of lifts, and the logarithms of their `UNKNOWNS`."""
    lifts = drawn_lifts(ROPE, "swing", np.random.default_rng([92, seed]), BATCH)
    clouds = np.array([seen(recording, FRAMES, POINTS) for recording, _, _ in lifts])
    truths = np.log([[truth[n] for n in UNKNOWNS] for _, truth, _ in lifts])
    return clouds.reshape(-1, FRAMES, POINTS, 3), truths.reshape(-1, len(UNKNOWNS))


class FromClouds(nn.Module):
    """Clouds [B, FRAMES, POINTS, 3], in any order, and further numbers [B, N] to outputs."""

    def __init__(self, numbers: int, outputs: int):
        super().__init__()
        self.point = nn.Sequential(nn.Linear(3, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH))
        self.frame = nn.Sequential(nn.Linear(2 * WIDTH, 32), nn.GELU(), nn.Flatten(1))
        layers = nn.Linear(32 * FRAMES + numbers, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH)
        self.lift = nn.Sequential(*layers, nn.GELU(), nn.Linear(WIDTH, outputs))

    def forward(self, x: Tensor, numbers: Tensor) -> Tensor:
        h = self.point(x)
        h = self.frame(torch.cat([h.mean(dim=2), h.amax(dim=2)], dim=-1))
        return self.lift(torch.cat([h, numbers], dim=1))


def fitted(X: Array, numbers: Array, Y: Array, device: str, seed: int) -> Any:
    """A function of clouds and numbers [B, N] that gives Y, learnt from [M, FRAMES, POINTS, 3]
    lifts, each with K rows of numbers [M K, N] and outputs [M K, O]."""
    torch.manual_seed(seed)
    mean, scale = Y.mean(axis=0), np.maximum(Y.std(axis=0), 1e-9)
    given = X, numbers, (Y - mean) / scale
    x, n, y = (torch.tensor(a, dtype=torch.float32, device=device) for a in given)
    net, K = FromClouds(numbers.shape[1], Y.shape[1]).to(device), len(Y) // len(X)
    optimizer = torch.optim.AdamW(net.parameters())
    steps = EPOCHS * -(-len(y) // 256)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-3, total_steps=steps)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(y)).to(device).split(256):
            noise = 0.02 * torch.randn_like(x[rows // K])
            loss = nn.functional.smooth_l1_loss(net(x[rows // K] + noise, n[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()

    @torch.no_grad()
    def answer(*given: Array) -> Array:
        x, n = (torch.tensor(np.array(a), dtype=torch.float32, device=device) for a in given)
        return mean + scale * net(x, n).cpu().double().numpy()

    return answer


def rope_of(known: Item, logs: Array) -> Item:
    """A rope of another's density, with these `UNKNOWNS`."""
    (E_over_rho, damping), m = np.exp(logs).tolist(), known.material
    return replace(ROPE, material=replace(m, E=E_over_rho * m.density, damping=damping))


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Misses of goals in both realities, and parameters."""
    from gendom.reality import RealWorld, find_object

    policy = Policy.pretrained(flags.task)
    task, sim, real = policy.task(), Simulation(device=runs.device), RealWorld(jobs=runs.jobs)
    seeds = range(runs.seed, runs.seed + LIFTS[flags.scale] // BATCH)
    X, Y = map(np.concatenate, zip(*runs.each(simulated, seeds, "lifts"), strict=True))
    items, L = list(map(find_object, ROPES)), size_of(ROPE)
    motion, named = predefined_lift("rope", "swing"), zip(ROPES, items, strict=True)
    lifts = [runs.recorded(f"lift-{name}", item, motion) for name, item in named]
    shown = [seen(recording, FRAMES, POINTS) for recording in lifts]
    logs = fitted(X, np.empty((len(X), 0)), Y, runs.device, runs.seed)(shown, np.empty((3, 0)))
    taught = [rope_of(items[k % 3], row) for k, row in enumerate(Y) for _ in range(LABELS)]
    low, high = np.moveaxis(np.array([policy.goal_range(item) for item in taught]), 2, 0)
    goal = np.random.default_rng(runs.seed).uniform(low, high)
    labels = choose(policy, Cases(task=task, items=tuple(taught), goal=goal)) / L
    acts = fitted(X, goal / L, labels, runs.device, runs.seed)
    many, few, *_ = GOALS[flags.scale]
    cases = draw_cases(task, many, seed=runs.seed, simulation=sim, items=items)
    some = Cases(task=task, items=cases.items[:few], goal=cases.goal[:few])
    held = [rope_of(items[k % 3], logs[k % 3]) for k in range(many)]
    first = choose(policy, cases, known=held)
    rivals = [evolved(task, g, Estimate.of(item), a, ROLLOUTS)
              for g, item, a in zip(cases.goal, held, first, strict=True)]  # fmt: skip
    straight = acts([shown[k % 3] for k in range(many)], cases.goal / L) * L
    acted = {
        "network's parameters, policy": first,
        "network's parameters, CMA-ES": np.array(side_by_side(task, sim, rivals)),
        "clouds to action": np.array([task.nearest(ROPE, a) for a in straight]),
    }
    scores = {f"{way}, ours": judge(cases, a, world=sim) for way, a in acted.items()}
    scores |= {f"{way}, MuJoCo": judge(some, a[:few], world=real) for way, a in acted.items()}
    off = logs - np.log([[i.material.E_over_rho, i.material.damping] for i in items])
    notes = [f"{name}: E {100.0 * math.expm1(e):+.1f} %, damping times {math.exp(d):.2f}"
             for name, (e, d) in zip(ROPES, off, strict=True)]  # fmt: skip
    title = f"{len(X)} lifts to learn from"
    return replace(missed("wiggle", title, scores, {"task": task.name}), notes=notes)
