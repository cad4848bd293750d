"""A neural posterior beside the estimator's, on simulated lifts of one rope.

Neural posterior estimation of the library `sbi` (Greenberg et al. 2019; Boelts et al. 2024): a
network sees the clouds of a lift and states the distribution of the transformed unknowns, a masked
autoregressive flow. It learns from lifts whose unknowns are drawn from the estimator's priors,
from few and from many, each seen with new noise and by cameras that are off anew in every lesson;
then all are asked about lifts that none has seen. Networks know one rope and one motion; the
estimator any. Lifts and answers are kept.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
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
from gendom.files import atomic_path
from gendom.materials.posterior import half_width

Array = NDArray[np.floating]

ROPE = ObjectClass(kind="rope", size=(0.3, 0.3), thickness=(0.014, 0.014)).at(0.5)

SIMULATIONS = {"small": (256,), "full": (512, 2048, 8192)}
"""Lifts to learn from, each the first of the next."""

BATCH = 64
"""Lifts that are simulated together."""

TRAININGS = 3
"""Of each number of lifts, from as many seeds."""

STEPS, LESSON, RATE = 70, 128, 1e-3
"""Steps of the optimiser over the root of the number of lifts, lifts of a step, highest rate."""

KEPT_BACK, LOOKS = 0.1, 40
"""Share of the lifts that a network does not learn from, and how often it is asked about them: the
best network so far counts."""

FRAMES, POINTS, WIDTH, DRAWS = 12, 96, 128, 2000
"""Of a lift that the network sees, points of each, its size, draws from its posteriors."""

TARGETS = ("bending_length", "friction", "damping", "nu")
"""Unknowns whose posterior it states, the first by its logarithm; others are drawn, too."""

COLUMNS = ("median error", "90 % below", "half width", "covered")

TAILS = (0.5, 0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0)


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each unknown of the estimator's answers, and of networks by numbers of lifts."""
    counts, most, seeds = SIMULATIONS[flags.scale], flags.lifts, range(TRAININGS)
    jobs: list[partial[Any]] = [partial(estimated, runs, k) for k in range(most)]
    for n, fewer in zip(counts, (0, *counts), strict=False):
        # each training begins as soon as its lifts are there
        jobs += [partial(simulated, runs, k) for k in batches(n) if k not in batches(fewer)]
        jobs += [partial(learned, runs, most, n, k) for k in seeds]
    for _ in runs.each(_call, jobs, "lifts and trainings"):
        pass
    ours, simulating = _usable(runs, most), [simulated(runs, k) for k in batches(counts[-1])]
    networks = {(n, k): learned(runs, most, n, k) for n in counts for k in seeds}
    truth, mean, sd = (np.array([row[k] for row in ours]) for k in ("truth", "mean", "sd"))
    ends = mean + half_width(LEVEL) * sd * np.array([0.0, -1.0, 1.0])[:, None, None]
    rows = {f"{name}, estimator": row for name, row in compared(truth, ends).items()}
    for n in counts:
        each = [compared(truth, np.array(networks[n, k]["ends"])) for k in seeds]
        for name in TARGETS:
            middle = {c: float(np.median([one[name][c] for one in each])) for c in COLUMNS}
            rows[f"{name}, {n} lifts"] = middle
    order = sorted(rows, key=lambda row: TARGETS.index(row.partition(",")[0]))
    took = {
        "simulating_a_lift": sum(simulating) / (BATCH * len(simulating)),
        "learning": {n: networks[n, 0]["seconds"] for n in counts},
        "an_estimate": float(np.median([row["seconds"] for row in ours])),
    }
    texts = {name: tuple(f"{v:.4f}" for v in rows[name].values()) for name in order}
    learning = ", ".join(f"{s:.3g} s of {n}" for n, s in took["learning"].items())
    return Result(
        name="npe",
        figures={"rows": rows, "took": took, "lifts": len(ours), "trainings": TRAININGS},
        shown=[Table(title=f"{len(ours)} lifts, in transformed units", head=COLUMNS, rows=texts)],
        notes=[
            f"{took['simulating_a_lift']:.2g} CPU s a simulated lift; learning {learning}; "
            f"an estimate {took['an_estimate']:.2g} CPU s"
        ],
    )


def compared(truth: Array, ends: Array) -> dict[str, dict[str, float]]:
    """`COLUMNS` by unknown: truths [N, targets], the `TAILS` [3, N, targets] of posteriors."""
    middle, low, high = ends
    off, inside = np.abs(middle - truth), (low <= truth) & (truth <= high)
    half = np.median(high - low, axis=0) / 2.0
    found = np.median(off, axis=0), np.quantile(off, 0.9, axis=0), half, inside.mean(axis=0)
    by_name = zip(TARGETS, np.transpose(found).tolist(), strict=True)
    return {name: dict(zip(COLUMNS, values, strict=True)) for name, values in by_name}


def _call(job: partial[Any]) -> None:
    job()


def batches(n: int) -> range:
    """Numbers of the batches that hold so many lifts."""
    return range(-(-n // BATCH))


def simulated(runs: Runs, batch: int) -> float:
    """Keep exact clouds of a batch of lifts, and their truths [B, targets], transformed; CPU
    seconds that it took."""
    path = _kept(runs, batch)
    if not path.exists():
        began, rng = time.process_time(), np.random.default_rng([91, runs.seed, batch])
        lifts = drawn_lifts(ROPE, "hold", rng, BATCH, frames=FRAMES, exact=True)
        X = np.array([_seen(recording) for recording, _, _ in lifts], dtype=np.float32)
        Y = np.array([_truth(truth, drawn) for _, truth, drawn in lifts])
        with atomic_path(path) as temporary:
            np.savez(temporary, X=X, Y=Y, seconds=time.process_time() - began)
    with np.load(path) as found:
        return float(found["seconds"])


def _kept(runs: Runs, batch: int) -> Path:
    return runs.folder / f"lifts-{batch:06d}.npz"


def _seen(recording: Recording) -> Array:
    return seen(recording, evenly(np.flatnonzero(recording.frame_valid), FRAMES), POINTS)


def _truth(truth: dict[str, float], drawn: dict[str, float]) -> list[float]:
    return [drawn[name] if name in drawn else math.log(truth[name]) for name in TARGETS]


def estimated(runs: Runs, k: int) -> dict[str, Any]:
    """A lift that the network has not seen, and the estimator's answer."""
    return runs.kept(f"npe-estimate-{k}", partial(_estimated, runs.seed, k))


def _estimated(seed: int, k: int) -> dict[str, Any]:
    rng = np.random.default_rng([91, seed, 0, k])
    ((recording, *truth),) = drawn_lifts(ROPE, "hold", rng, 1)
    began = time.process_time()
    try:
        found = estimate(recording, estimate_settings(k))
    except GendomError as error:
        return {"usable": False, "reasons": [str(error)]}
    if not found.usable:
        return {"usable": False, "reasons": found.verdict.reasons}
    seconds, p, z = time.process_time() - began, found.posterior, half_width(LEVEL)
    mean, sd = [], []
    for name in TARGETS:
        if name in p.names:
            at = p.names.index(name)
            mean.append(p.mean[at])
            sd.append(math.sqrt(p.covariance[at, at]))
        else:
            low, high = np.log(found.record["intervals"][name])
            mean.append(math.log(found.record[name]))
            sd.append((high - low) / (2.0 * z))
    truth = _truth(*truth)
    X = _seen(recording)
    return {"usable": True, "X": X, "truth": truth, "mean": mean, "sd": sd, "seconds": seconds}


def _usable(runs: Runs, most: int) -> list[dict[str, Any]]:
    return [row for k in range(most) if (row := estimated(runs, k))["usable"]]


def learned(runs: Runs, most: int, n: int, k: int) -> dict[str, Any]:
    """What a network of n lifts says of the others, and seconds that it learned; it waits for lifts
    that other processes simulate."""
    return runs.kept(f"npe-{n}-{k}", partial(_learned, runs, most, n, k))


def _learned(runs: Runs, most: int, n: int, k: int) -> dict[str, Any]:
    wanted = [_kept(runs, batch) for batch in batches(n)]
    wanted += [runs.folder / f"npe-estimate-{lift}.json" for lift in range(most)]
    while not all(path.exists() for path in wanted):
        time.sleep(0.2)
    read = []
    for path in wanted[: len(batches(n))]:
        with np.load(path) as found:
            read.append((found["X"], found["Y"]))
    X, Y = (np.concatenate(each)[:n] for each in zip(*read, strict=True))
    shown = np.stack([row["X"] for row in _usable(runs, most)])
    began = time.perf_counter()
    flow = trained(X, Y, runs.device, runs.seed + k)
    seconds = time.perf_counter() - began
    draws = answered(flow, shown, runs.device)
    return {"lifts": len(X), "seconds": seconds, "ends": np.quantile(draws, TAILS, axis=1)}


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


def shaken(x: torch.Tensor) -> torch.Tensor:
    """Exact clouds [B, FRAMES, POINTS, 3] of `seen`, with noise, by cameras that are off."""
    noise, draw = estimate_settings(0).noise, partial(torch.randn, device=x.device)
    turn, shift = noise.turn * draw(len(x), 1, 1, 3), 10.0 * noise.shift * draw(len(x), 1, 1, 3)
    from_centre = x - x.mean(dim=(1, 2), keepdim=True)
    turned = x + torch.linalg.cross(turn.expand_as(x), from_centre)
    return turned + shift + 10.0 * noise.sensor * torch.randn_like(x)


def trained(X: Array, Y: Array, device: str, seed: int) -> Any:
    """The flow that learned from N lifts X and their truths Y [N, targets]."""
    torch.manual_seed(seed)
    x, y = (torch.tensor(a, dtype=torch.float32) for a in (X, Y))
    flow = posterior_nn("maf", z_score_x="none", embedding_net=Clouds())(y, x).to(device)
    x, y = x.to(device), y.to(device)
    order = torch.randperm(len(x), device=device)
    asked, own = order.split([n := round(KEPT_BACK * len(x)), len(x) - n])
    lesson, shown = min(LESSON, len(own)), shaken(x[asked])
    steps, least, best = round(STEPS * math.sqrt(len(x))), math.inf, flow
    optimizer = torch.optim.AdamW(flow.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    for step in range(1, steps + 1):
        rows = own[torch.randint(len(own), (lesson,), device=device)]
        optimizer.zero_grad()
        flow.loss(y[rows], shaken(x[rows])).mean().backward()
        nn.utils.clip_grad_norm_(flow.parameters(), 5.0)
        optimizer.step()
        schedule.step()
        if step % (steps // LOOKS) == 0:
            with torch.no_grad():
                off = float(flow.loss(y[asked], shown).mean())
            if off < least:
                least, best = off, copy.deepcopy(flow)
    return best


@torch.no_grad()
def answered(flow: Any, X: Array, device: str) -> Array:
    """[N, DRAWS, targets] of it, given N lifts."""
    x = torch.tensor(X, dtype=torch.float32, device=device)
    return flow.sample((DRAWS,), x).cpu().numpy().swapaxes(0, 1)
