"""A neural posterior beside the estimator's, on simulated lifts of one rope.

Neural posterior estimation of the library `sbi` (Greenberg et al. 2019; Boelts et al. 2024): a
network sees the clouds of a lift and states the distribution of the transformed unknowns, a masked
autoregressive flow. It learns from lifts whose unknowns are drawn from the estimator's priors;
then both are asked about lifts that it has not seen. It knows one rope and one motion; the
estimator any.
"""

from __future__ import annotations

import argparse
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sbi.inference import NPE  # pyright: ignore[reportMissingImports]
from sbi.neural_nets import posterior_nn  # pyright: ignore[reportMissingImports]
from torch import nn

from experiments.coverage import LEVEL
from experiments.lifts import estimate_settings
from experiments.runs import Result, Runs, Table
from experiments.sbc import drawn_lifts, evenly, seen
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.estimation import estimate
from gendom.estimation.lift_plan import ObjectClass
from gendom.materials.posterior import half_width

Array = NDArray[np.floating]

ROPE = ObjectClass(kind="rope", size=(0.3, 0.3), thickness=(0.014, 0.014)).at(0.5)

SIMULATIONS = {"small": 256, "full": 8192}
"""Lifts to learn from."""

BATCH = 32
"""Lifts that are simulated together, from one seed."""

FRAMES, POINTS, WIDTH, DRAWS = 12, 96, 128, 2000
"""Of a lift that the network sees, points of each, its size, draws from its posteriors."""

TARGETS = ("E_over_rho", "friction", "damping", "nu")
"""Unknowns whose posterior it states; others are drawn, too."""

COLUMNS = ("median error", "90 % below", "half width", "covered")


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each unknown of the network's and the estimator's answers."""
    asked = range(900_000, 900_000 + flags.lifts)
    ours = [row for row in runs.each(estimated, asked, "estimates") if row]
    count, times = SIMULATIONS[flags.scale], [time.perf_counter()]
    seeds = range(runs.seed, runs.seed + -(-count // BATCH))
    made = list(runs.each(simulated, seeds, "lifts"))
    X, Y = (np.concatenate([m[k] for m in made]) for k in ("X", "Y"))
    times.append(time.perf_counter())
    posterior = trained(X, Y, runs.device, runs.seed)
    times.append(time.perf_counter())
    draws = answered(posterior, np.stack([row["X"] for row in ours]), runs.device)
    times.append(time.perf_counter())
    median = float(np.median([row["seconds"] for row in ours]))
    names = ("simulating", "learning", "answers", "an_estimate")
    took = dict(zip(names, [*np.diff(times).tolist(), median], strict=True))
    rows = compared(ours, draws)
    texts = {name: tuple(f"{v:.4f}" for v in row.values()) for name, row in rows.items()}
    cost = ", ".join(f"{name.replace('_', ' ')} {value:.3g} s" for name, value in took.items())
    return Result(
        name="npe",
        figures={"rows": rows, "took": took, "simulations": len(X), "lifts": len(ours)},
        shown=[Table(title=f"{len(ours)} lifts, in transformed units", head=COLUMNS, rows=texts)],
        notes=[f"{len(X)} lifts to learn from; {cost}"],
    )


def compared(ours: list[dict[str, Any]], draws: Array) -> dict[str, dict[str, float]]:
    """`COLUMNS` of estimates, and of draws [N, DRAWS, targets] of the network."""
    truth, mean, sd = (np.array([row[k] for row in ours]) for k in ("truth", "mean", "sd"))
    tails, rows = (1.0 - LEVEL) / 2.0, {}
    ends = {
        "estimator": mean + half_width(LEVEL) * sd * np.array([0.0, -1.0, 1.0])[:, None, None],
        "network": np.quantile(draws, (0.5, tails, 1.0 - tails), axis=1),
    }
    for who, (middle, low, high) in ends.items():
        off, inside = np.abs(middle - truth), (low <= truth) & (truth <= high)
        half = np.median(high - low, axis=0) / 2.0
        found = np.median(off, axis=0), np.quantile(off, 0.9, axis=0), half, inside.mean(axis=0)
        for name, values in zip(TARGETS, np.transpose(found).tolist(), strict=True):
            rows[f"{name}, {who}"] = dict(zip(COLUMNS, values, strict=True))
    return rows


def simulated(seed: int) -> dict[str, Array]:
    """What the network sees of a batch of lifts, and their truths [B, targets], transformed."""
    rng = np.random.default_rng([91, seed])
    lifts = drawn_lifts(ROPE, "hold", rng, BATCH, frames=FRAMES)
    return {
        "X": np.array([_seen(recording) for recording, _, _ in lifts]),
        "Y": np.array([[v[n] for n in TARGETS] for _, _, v in lifts]),
    }


def _seen(recording: Recording) -> Array:
    return seen(recording, evenly(np.flatnonzero(recording.frame_valid), FRAMES), POINTS)


def estimated(seed: int) -> dict[str, Any] | None:
    """A lift that the network has not seen, and the estimator's answer."""
    try:
        ((recording, _, drawn),) = drawn_lifts(ROPE, "hold", np.random.default_rng([91, seed]), 1)
        began = time.perf_counter()
        found = estimate(recording, estimate_settings(seed))
    except (GendomError, ValueError):  # of one that cannot be simulated there is none
        return None
    if not found.usable:
        return None
    p, seconds = found.posterior, time.perf_counter() - began
    at, truth = [p.names.index(name) for name in TARGETS], [drawn[name] for name in TARGETS]
    sd = np.sqrt(np.diag(p.covariance))[at]
    return {
        "X": _seen(recording),
        "truth": truth,
        "mean": p.mean[at],
        "sd": sd,
        "seconds": seconds,
    }


class Clouds(nn.Module):
    """Clouds [B, FRAMES, POINTS, 3] to features [B, WIDTH], whatever the order of points."""

    def __init__(self) -> None:
        super().__init__()
        layers = lambda n: (nn.Linear(n, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU())  # noqa: E731
        self.point = nn.Sequential(*layers(3))
        self.frame = nn.Sequential(nn.Linear(2 * WIDTH, 32), nn.GELU(), nn.Flatten(1))
        self.lift = nn.Sequential(*layers(32 * FRAMES))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        h = self.point(x)
        return self.lift(self.frame(torch.cat([h.mean(dim=2), h.amax(dim=2)], dim=-1)))


def trained(X: Array, Y: Array, device: str, seed: int) -> Any:
    """The posterior that learned from N lifts X and their truths Y [N, targets]."""
    torch.manual_seed(seed)
    x, y = (torch.tensor(a, dtype=torch.float32) for a in (X, Y))
    build = posterior_nn("maf", z_score_x="none", embedding_net=Clouds())
    silent = SimpleNamespace(log_metric=lambda *_, **__: None, flush=lambda: None)
    inference = NPE(None, build, device, tracker=silent, show_progress_bars=False)
    inference.append_simulations(y, x).train()
    return inference.build_posterior()


def answered(posterior: Any, X: Array, device: str) -> Array:
    """[N, DRAWS, targets] of it, given N lifts."""
    x = torch.tensor(X, dtype=torch.float32, device=device)
    draws = posterior.sample_batched((DRAWS,), x, show_progress_bars=False)
    return draws.cpu().numpy().swapaxes(0, 1)
