"""A neural posterior beside the estimator's, on simulated lifts of one rope.

A network sees the clouds of a lift and states a mixture of Gaussians of the transformed unknowns
(a mixture density network, Bishop 1994; as amortised simulation-based inference, Papamakarios and
Murray 2016). It learns from lifts whose unknowns are drawn from the estimator's priors; then both
are asked about lifts that it has not seen. It knows one rope and one motion; the estimator any.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from experiments.coverage import LEVEL
from experiments.lifts import estimate_settings
from experiments.runs import Result, Runs, Table
from experiments.sbc import misplaced
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.estimation import LiftScene, estimate
from gendom.estimation.lift_plan import ObjectClass, drawn, imagined, recorded_lift
from gendom.materials.posterior import half_width
from gendom.reality import arm_motion, as_real, lift, lift_cameras
from gendom.robot import predefined_lift
from gendom.robot.motions import LIFT_FRAME_RATE

Array = NDArray[np.floating]

SIMULATIONS = {"small": 256, "full": 16384}
"""Lifts to learn from."""

BATCH = 32
"""Lifts that are simulated together, from one seed."""

FRAMES, POINTS, GAUSSIANS, WIDTH = 12, 96, 6, 128
"""Of a lift that the network sees, points of each, and its size."""

TARGETS = ("E_over_rho", "friction", "damping", "nu")
"""Unknowns whose posterior it states; others are drawn, too."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each unknown of the network's and the estimator's answers."""
    count, began = SIMULATIONS[flags.scale], time.perf_counter()
    seeds = range(runs.seed, runs.seed + -(-count // BATCH))
    made = [m for m in runs.each(simulated, seeds, "lifts") if m is not None]
    X, Y = (np.concatenate([m[k] for m in made]) for k in ("X", "Y"))
    took = {"simulating": time.perf_counter() - began, "simulations": len(X)}
    began = time.perf_counter()
    torch.manual_seed(runs.seed)
    network = trained(X, Y, runs.device)
    took["training"] = time.perf_counter() - began
    asked = range(900_000, 900_000 + flags.lifts)
    ours = [row for row in runs.each(estimated, asked, "estimates") if row]
    began = time.perf_counter()
    theirs = answered(network, np.stack([row["X"] for row in ours]), runs.device, runs.seed)
    took["an_answer"] = (time.perf_counter() - began) / len(ours)
    took["an_estimate"] = float(np.median([row["seconds"] for row in ours]))
    rows = compared(ours, theirs)
    texts = {}
    for name, r in rows.items():
        numbers = (f"{r[k]:.4f}" for k in ("median", "ninety", "half_width"))
        texts[name] = (*numbers, f"{r['covered']:.0%}")
    head = ("error, median", "90 % below", "half width", "covered")
    cost = (
        f"{took['simulations']} lifts simulated in {took['simulating']:.0f} s, trained in "
        f"{took['training']:.0f} s; an answer takes {1e3 * took['an_answer']:.1f} ms, an estimate "
        f"{took['an_estimate']:.1f} s and no training"
    )
    return Result(
        name="npe",
        figures={"rows": rows, "took": took, "lifts": len(ours)},
        shown=[Table(title=f"{len(ours)} lifts, in transformed units", head=head, rows=texts)],
        notes=[cost],
    )


def compared(ours: list[dict[str, Any]], theirs: Array) -> dict[str, dict[str, float]]:
    """Errors and intervals of estimates, and of draws [N, K, targets] of the network."""
    truth, rows = np.array([row["truth"] for row in ours]), {}
    tails = (1.0 - LEVEL) / 2.0
    for k, name in enumerate(TARGETS):
        middle = np.array([row["found"][k] for row in ours])
        half = half_width(LEVEL) * np.array([row["sd"][k] for row in ours])
        ends = {"estimator": (middle, middle - half, middle + half)}
        ends["network"] = tuple(np.quantile(theirs[..., k], (0.5, tails, 1.0 - tails), axis=1))
        for who, (middle, low, high) in ends.items():
            off = np.abs(middle - truth[:, k])
            rows[f"{name}, {who}"] = {
                "median": float(np.median(off)),
                "ninety": float(np.quantile(off, 0.9)),
                "half_width": float(np.median(high - low) / 2.0),
                "covered": float(np.mean((low <= truth[:, k]) & (truth[:, k] <= high))),
            }
    return rows


def scene_of(seed: int) -> LiftScene:
    """The lift of the one rope, before anything is drawn."""
    item = ObjectClass(kind="rope", size=(0.3, 0.3), thickness=(0.014, 0.014)).at(0.5)
    motion = predefined_lift("rope", "hold")
    trial = lift(as_real(item), motion)
    arm = arm_motion(trial, lift_cameras(trial.item))
    if isinstance(arm, GendomError):
        raise arm
    lying = recorded_lift(trial, arm, LIFT_FRAME_RATE[motion.end])
    return LiftScene.of(lying, estimate_settings(seed).scene)


def drawn_lifts(seed: int, count: int) -> list[tuple[Recording, Array]]:
    """Lifts and their truths [P] of `TARGETS`, transformed."""
    scene, rng = scene_of(seed), np.random.default_rng([91, seed])
    prior, base = scene.prior(also=("thickness",))
    vectors = [drawn(prior, rng) for _ in range(count)]
    noise = estimate_settings(seed).noise
    shown = imagined(scene, [prior.theta(v, base) for v in vectors], noise.sensor, rng)
    which = [prior.names.index(name) for name in TARGETS]
    pairs = zip(shown, vectors, strict=True)
    return [(misplaced(r, noise, rng), v[which]) for r, v in pairs if r is not None]


def simulated(seed: int) -> dict[str, Array] | None:
    """What the network sees of a batch of lifts, and their truths."""
    lifts = drawn_lifts(seed, BATCH)
    if not lifts:
        return None
    return {"X": np.stack([seen(r) for r, _ in lifts]), "Y": np.stack([y for _, y in lifts])}


def estimated(seed: int) -> dict[str, Any] | None:
    """A lift that the network has not seen, and the estimator's answer."""
    lifts = drawn_lifts(seed, 1)
    if not lifts:
        return None
    (recording, truth), began = lifts[0], time.perf_counter()
    try:
        found = estimate(recording, estimate_settings(seed))
    except GendomError:
        return None
    if not found.usable:
        return None
    p, seconds = found.posterior, time.perf_counter() - began
    at = [p.names.index(name) for name in TARGETS]
    sd = np.sqrt(np.diag(p.covariance))[at]
    return {"X": seen(recording), "truth": truth, "found": p.mean[at], "sd": sd, "seconds": seconds}


def seen(recording: Recording) -> Array:
    """[FRAMES, POINTS, 4] points from the first place of the gripper, and its rise, in 0.1 m."""
    frames = np.flatnonzero(recording.frame_valid)
    frames = frames[np.linspace(0, len(frames) - 1, FRAMES).round().astype(int)]
    rng, at = np.random.default_rng(0), recording.gripper_position[:, 0]
    found = np.zeros((FRAMES, POINTS, 4))
    for k, t in enumerate(frames):
        cloud = recording.frame(int(t))
        found[k, :, :3] = cloud[rng.choice(len(cloud), POINTS)] - at[frames[0]]
        found[k, :, 3] = at[t, 2] - at[frames[0], 2]
    return 10.0 * found


class Mixture(nn.Module):
    """Clouds [B, FRAMES, POINTS, 4] to a mixture of Gaussians with full covariances."""

    def __init__(self, targets: int):
        super().__init__()
        self.targets, self.size = targets, 1 + targets + targets * (targets + 1) // 2
        self.point = nn.Sequential(
            nn.Linear(4, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU()
        )
        self.frame = nn.Sequential(nn.Linear(2 * WIDTH, 32), nn.GELU())
        self.head = nn.Sequential(
            nn.Linear(32 * FRAMES, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU(),
            nn.Linear(WIDTH, GAUSSIANS * self.size),
        )  # fmt: skip

    def forward(self, x: torch.Tensor) -> torch.distributions.Distribution:
        h, P = self.point(x), self.targets
        h = self.frame(torch.cat([h.mean(dim=2), h.amax(dim=2)], dim=-1)).flatten(1)
        out = self.head(h).reshape(len(x), GAUSSIANS, self.size)
        weight, mean, rest = out[..., 0], out[..., 1 : 1 + P], out[..., 1 + P :]
        lower = torch.zeros(*mean.shape, P, device=x.device)
        i, j = torch.tril_indices(P, P)
        lower[..., i, j] = rest
        diagonal = nn.functional.softplus(lower.diagonal(dim1=-2, dim2=-1)) + 1e-3
        lower = lower.tril(-1) + torch.diag_embed(diagonal)
        normal = torch.distributions.MultivariateNormal(mean, scale_tril=lower)
        which = torch.distributions.Categorical(logits=weight)
        return torch.distributions.MixtureSameFamily(which, normal)


def trained(X: Array, Y: Array, device: str, passes: int = 600) -> tuple[Mixture, Array, Array]:
    """The network, and the mean and deviation of the targets; it stops where lifts that it does not
    learn from, a tenth, are no longer predicted better."""
    mean, sd = Y.mean(axis=0), Y.std(axis=0)
    x, y = (torch.tensor(v, dtype=torch.float32, device=device) for v in (X, (Y - mean) / sd))
    held = max(1, len(x) // 10)
    network = Mixture(Y.shape[1]).to(device)
    adam = torch.optim.AdamW(network.parameters(), lr=1e-3, weight_decay=1e-4)
    best, kept, patience = math.inf, network.state_dict(), 30
    for _ in range(passes):
        order = held + torch.randperm(len(x) - held, device=device)
        network.train()
        for rows in order.split(64):
            loss = -network(x[rows]).log_prob(y[rows]).mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            adam.step()
        network.eval()
        with torch.no_grad():
            value = float(-network(x[:held]).log_prob(y[:held]).mean())
        patience = 30 if value < best else patience - 1
        if value < best:
            best, kept = value, {k: v.clone() for k, v in network.state_dict().items()}
        if patience == 0:
            break
    network.load_state_dict(kept)
    return network, mean, sd


def answered(network: tuple[Mixture, Array, Array], X: Array, device: str, seed: int) -> Array:
    """[N, 2000, targets] draws from its posteriors of lifts."""
    model, mean, sd = network
    torch.manual_seed(seed)
    with torch.no_grad():
        draws = model(torch.tensor(X, dtype=torch.float32, device=device)).sample((2000,))
    return draws.cpu().numpy().swapaxes(0, 1) * sd + mean
