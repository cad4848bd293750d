"""Baselines that learn from a lift's clouds alone, for ropes of the MuJoCo test scene: a network
to parameters, then the policy or CMA-ES in the simulator (as Wiggle and Go! plans), and one from
the lift and a goal straight to an action. Both learn from the same simulated lifts of ropes of one
size; true parameters serve only for the score.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from experiments.lifts import estimate_settings
from experiments.planning import GOALS, evolved
from experiments.rope_real import ROPES
from experiments.runs import Misses, Result, Runs
from experiments.sbc import drawn_lifts, evenly, seen
from gendom.arrays import Array
from gendom.estimation import LiftScene
from gendom.estimation.lift_plan import ObjectClass
from gendom.materials import Item, size_of
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.evaluation import choose
from gendom.policies.rollouts import side_by_side
from gendom.robot import predefined_lift
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.world import Simulation

ROPE = ObjectClass(kind="rope", size=(0.3, 0.3), thickness=(0.016, 0.016)).at(0.5)
"""As long and thick as the three."""

LIFTS, BATCH, EPOCHS = {"small": 64, "full": 4096}, 32, 120
FRAMES, POINTS, WIDTH = 16, 64, 128
"""Lifts to learn from, how many are simulated together, and passes over all; frames of a
lift that networks see, points of each, and their width."""

ROLLOUTS, LABELS, UNKNOWNS = 40, 8, ("E_over_rho", "damping")
"""Of CMA-ES for a goal, goals with actions of each lift, and the parameters that are told."""


def simulated(seed: int) -> tuple[Array, Array]:
    """Clouds of a batch of lifts, and the logarithms of their `UNKNOWNS`."""
    rng = np.random.default_rng([92, seed])
    lifts = drawn_lifts(ROPE, "swing", rng, BATCH, frames=FRAMES)
    valid = [np.flatnonzero(recording.frame_valid) for recording, _, _ in lifts]
    clouds = [seen(recording, evenly(which, FRAMES), POINTS)
              for (recording, _, _), which in zip(lifts, valid, strict=True)]  # fmt: skip
    truths = np.log([[truth[n] for n in UNKNOWNS] for _, truth, _ in lifts])
    return np.array(clouds), truths


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


def logs_of(item: Item) -> list[float]:
    """Its `UNKNOWNS`."""
    return np.log([item.material.E_over_rho, item.material.damping]).tolist()


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Misses of goals in both realities, and parameters."""
    from gendom.reality import RealWorld, find_object

    policy = Policy.pretrained(flags.task)
    task, sim, real = policy.task(), Simulation(device=runs.device), RealWorld(jobs=runs.jobs)
    seeds = range(runs.seed, runs.seed + LIFTS[flags.scale] // BATCH)
    made = runs.each(simulated, seeds, "lifts")
    X, Y = map(np.concatenate, zip(*made, strict=True))
    items, L = list(map(find_object, ROPES)), size_of(ROPE)
    beliefs = list(runs.each(partial(runs.lifted, task=task), ROPES, "lifts"))
    motion, named = predefined_lift("rope", "swing"), zip(ROPES, items, strict=True)
    lifts = [runs.recorded(f"lift-{name}", item, motion) for name, item in named]
    # frames at the times of those that were simulated
    scenes = [LiftScene.of(recording, estimate_settings(0).scene) for recording in lifts]
    shown = [seen(s.recording, evenly(s.frames, FRAMES), POINTS) for s in scenes]
    logs = fitted(X, np.empty((len(X), 0)), Y, runs.device, runs.seed)(shown, np.empty((3, 0)))
    taught = [rope_of(items[k % 3], row) for k, row in enumerate(Y) for _ in range(LABELS)]
    low, high = np.moveaxis(np.array([policy.goal_range(item) for item in taught]), 2, 0)
    goal = np.random.default_rng(runs.seed).uniform(low, high)
    labels = choose(policy, Cases(task=task, items=tuple(taught), goal=goal)) / L
    acts = fitted(X, goal / L, labels, runs.device, runs.seed)
    many, _, few, _ = GOALS[flags.scale]
    cases = draw_cases(task, many, seed=runs.seed, simulation=sim, items=items)
    some = Cases(task=task, items=cases.items[:few], goal=cases.goal[:few])
    held = [rope_of(items[k % 3], logs[k % 3]) for k in range(many)]
    first = choose(policy, cases, known=held)
    rivals = [evolved(task, g, Estimate.of(item), a, ROLLOUTS, runs.seed)
              for g, item, a in zip(cases.goal, held, first, strict=True)]  # fmt: skip
    straight = acts([shown[k % 3] for k in range(many)], cases.goal / L) * L
    ours = [beliefs[k % 3].most_likely for k in range(many)]
    acted = {
        "our estimate, policy": choose(policy, cases, known=ours),
        "network's parameters, policy": first,
        "network's parameters, CMA-ES": np.array(side_by_side(task, sim, rivals)),
        "clouds to action": np.array([task.nearest(ROPE, a) for a in straight]),
    }
    rows = Misses(runs=runs, title=f"wiggle-{task.name}-{many}")
    for way, a in acted.items():
        rows.row(f"{way}, ours", cases, sim, partial(np.array, a))
    for way, a in acted.items():
        rows.row(f"{way}, MuJoCo", some, real, partial(np.array, a[:few]))
    told = {"network": logs, "our estimate": [logs_of(belief.most_likely) for belief in beliefs]}
    off = {who: np.array(found) - list(map(logs_of, items)) for who, found in told.items()}
    notes = [f"{name}, {who}: E {100.0 * math.expm1(e):+.1f} %, damping times {math.exp(d):.2f}"
             for who, rows in off.items()
             for name, (e, d) in zip(ROPES, rows, strict=True)]  # fmt: skip
    return Result(
        name=f"wiggle-{task.name}",
        figures={"task": task.name, "lifts": len(X), "misses": rows.errors},
        shown=rows.shown(f"{task.name}, {len(X)} lifts to learn from"),
        notes=notes,
    )
