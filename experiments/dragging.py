"""Motions of cloth dragging, found by CMA-ES for families of cloths.

    python experiments/dragging.py --device cuda --seconds 400 --out motions.json

Each family is a range of bending lengths and friction. In every generation its motions are tried
with the same newly drawn cloths, in air or without, held a little elsewhere; what counts is how
much lies spread and whether that is enough. All families are searched side by side. The evolution
strategy is that of Hansen (2016), "The CMA evolution strategy: a tutorial".
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Item, dimensionless_parameters
from gendom.tasks.cloth_dragging import ClothDragging
from gendom.tasks.cloth_spreading import OFF_CENTRE
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

Family = tuple[float, float, float, float]
"""Lowest and highest bending length [sides] and friction."""

FAMILIES: tuple[Family, ...] = (
    (0.05, 0.064, 0.3, 0.5),
    (0.05, 0.064, 0.5, 0.8),
    (0.064, 0.082, 0.3, 0.5),
    (0.064, 0.082, 0.5, 0.8),
)
"""Those that few motions open: friction opens smooth limp cloths and keeps rough ones shut."""

START = (0.47, 0.5, 0.0, 1.25, 1.7, 1.0, 0.0, 0.8, 1.7, 1.45, 0.0, 0.02, 1.6, 1.9, 0.0, 0.02, 1.6,
         2.0, 0.0, 1.0)  # fmt: skip
"""Laid down along the diagonal, and dragged on."""

SIGMA = 0.15
"""Of the first generation [of the limits' width]."""

AIR = (0.0, 1.2)
"""Densities of the air [kg/m^3] of the generations."""

ENOUGH, SOFT = 0.75, 0.12
"""Share that is asked for, and over how much of it a motion counts as nearly enough."""


class Once(ClothDragging):
    """A drag alone: the pulls after it would open what it left folded."""

    tries = 1


class Evolution:
    """CMA-ES that maximises over the unit cube, N numbers.

    Args:
        mean: [N] where to begin.
        sigma: Standard deviation of the first generation.
        population: Points a generation.
        seed: Of all draws.
    """

    def __init__(self, mean: Array, sigma: float, population: int, seed: int):
        n, half = len(mean), population // 2
        self.mean, self.sigma, self.rng = np.array(mean), sigma, np.random.default_rng(seed)
        self.population, self.weights = (
            population,
            np.log(half + 0.5) - np.log(np.arange(1, half + 1)),
        )
        self.weights /= self.weights.sum()
        mu = 1.0 / float(np.sum(self.weights**2))
        self.mu, self.n, self.count = mu, n, 0
        self.c_path, self.c_sigma = (4 + mu / n) / (n + 4 + 2 * mu / n), (mu + 2) / (n + mu + 5)
        self.c_one = 2 / ((n + 1.3) ** 2 + mu)
        self.c_mu = min(1 - self.c_one, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))
        self.damping = 1 + 2 * max(0.0, math.sqrt((mu - 1) / (n + 1)) - 1) + self.c_sigma
        self.norm = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
        self.path, self.path_sigma, self.C = np.zeros(n), np.zeros(n), np.eye(n)

    def ask(self) -> Array:
        """[population, N] points to try."""
        values, self.axes = np.linalg.eigh(self.C)
        self.lengths = np.sqrt(np.maximum(values, 1e-12))
        z = self.rng.standard_normal((self.population, self.n))
        return np.clip(self.mean + self.sigma * (z * self.lengths) @ self.axes.T, 0.0, 1.0)

    def tell(self, points: Array, values: Array) -> None:
        """Values of these points, best first wanted."""
        order = np.argsort(-values, kind="stable")[: len(self.weights)]
        steps = (points[order] - self.mean) / self.sigma
        step = self.weights @ steps
        self.mean, self.count = self.mean + self.sigma * step, self.count + 1
        white = self.axes @ ((self.axes.T @ step) / self.lengths)
        self.path_sigma += (
            -self.c_sigma * self.path_sigma
            + math.sqrt(self.c_sigma * (2 - self.c_sigma) * self.mu) * white
        )
        size = float(np.linalg.norm(self.path_sigma))
        near = (
            size / math.sqrt(1 - (1 - self.c_sigma) ** (2 * self.count))
            < (1.4 + 2 / (self.n + 1)) * self.norm
        )
        self.path += -self.c_path * self.path
        if near:
            self.path += math.sqrt(self.c_path * (2 - self.c_path) * self.mu) * step
        kept = 1 - self.c_one - self.c_mu
        self.C = kept * self.C + self.c_one * np.outer(self.path, self.path)
        self.C += self.c_mu * (steps * self.weights[:, None]).T @ steps
        self.sigma *= math.exp(min(0.3, self.c_sigma / self.damping * (size / self.norm - 1)))


def drawn(count: int, family: Family, seed: Sequence[int]) -> list[Item]:
    """Cloths of a family."""
    limpest, stiffest, smoothest, roughest = family
    task, rng, found = ClothDragging(), np.random.default_rng(seed), []
    while len(found) < count:
        item = task.draw_items([rng])[0]
        bends = dimensionless_parameters(item)["bending_ratio"]
        if limpest <= bends < stiffest and smoothest <= item.friction < roughest:
            found.append(item)
    return found


def shares(world: World, task: ClothDragging, items: Sequence[Item], actions: Array) -> Array:
    """[W] how much lies spread; 0 where the simulation failed."""
    return np.array([o.values.get("share", 0.0) for o in world.carry_out(task, items, actions)])


def worth(share: Array) -> Array:
    """What a share counts [-]: nearly one step at what is enough."""
    with np.errstate(over="ignore"):
        return 0.3 * share + 0.7 / (1.0 + np.exp((ENOUGH + 0.5 * SOFT - share) / (0.5 * SOFT)))


def search(
    simulation: Simulation,
    families: Sequence[Family],
    *,
    seconds: float,
    population: int,
    cloths: int,
    seed: int,
    start: Sequence[Array],
    sigma: float = SIGMA,
    generations: float = math.inf,
    told: Path | None = None,
) -> list[list[Array]]:
    """For each family, the means of the search and its best motions [N], in units of similarity."""
    task = Once()
    units = task.action_units(task.item)
    low, high = (task.limits(task.item) / units[:, None]).T
    runs = [
        Evolution((np.asarray(s) - low) / (high - low), sigma, population, seed + k)
        for k, s in enumerate(start)
    ]
    began, generation = time.monotonic(), 0
    kept: list[list[tuple[float, list[float]]]] = [[] for _ in families]
    while time.monotonic() - began < seconds and generation < generations:
        rng = np.random.default_rng([seed, generation])
        world = replace(simulation, air_density=float(rng.choice(AIR)))
        held = tuple(np.array(OFF_CENTRE) + rng.uniform(-0.01, 0.01, 2))
        own = replace(task, off_centre=held)
        asked = [run.ask() for run in runs]
        items, actions = [], []
        for k, points in enumerate(asked):
            some = drawn(cloths, families[k], seed=[seed, generation, k])
            for p in points:
                motion = task.nearest(task.item, (low + (high - low) * p) * units)
                items += some
                actions += [motion] * cloths
        found = shares(world, own, items, np.array(actions))
        found = found.reshape(len(runs), population, cloths)
        line = []
        for k, (run, points, share) in enumerate(zip(runs, asked, found, strict=True)):
            value = worth(share).mean(axis=1)
            run.tell(points, value)
            best = int(value.argmax())
            kept[k].append((float(value[best]), (low + (high - low) * points[best]).tolist()))
            spread = share >= ENOUGH
            line.append(f"{share.mean():.2f} {spread.mean():.2f} {spread[best].mean():.2f}")
        generation += 1
        print(
            f"{time.monotonic() - began:5.0f} s  {generation:3d}  " + " | ".join(line), flush=True
        )
        means = [(low + (high - low) * np.clip(run.mean, 0.0, 1.0)).tolist() for run in runs]
        if told is not None:
            state = {"families": families, "means": means, "kept": [k[-6:] for k in kept]}
            told.write_text(json.dumps(state))
    late = [[np.array(m) for _, m in sorted(k[-8:], reverse=True)[:2]] for k in kept]
    return [[np.array(m), *more] for m, more in zip(means, late, strict=True)]


def judged(
    world: World, motions: Array, families: Sequence[Family], count: int, seed: int
) -> Array:
    """[F, M, count] shares of M motions [M, N] (units of similarity) with new cloths."""
    task = Once()
    units = task.action_units(task.item)
    items = [i for k, f in enumerate(families) for i in drawn(count, f, seed=[seed, 977, k])]
    every = [i for i in items for _ in motions]
    actions = np.tile([task.nearest(task.item, m * units) for m in motions], (len(items), 1))
    found = shares(world, task, every, actions).reshape(len(families), count, len(motions))
    return np.moveaxis(found, 2, 1)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--population", type=int, default=16)
    parser.add_argument("--cloths", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", type=Path, help="motions.json of an earlier search")
    parser.add_argument("--judge", type=int, default=12, help="new cloths of each family")
    parser.add_argument("--out", type=Path, default=Path("motions.json"))
    given = parser.parse_args()
    start = [np.array(START)] * len(FAMILIES)
    sigma = SIGMA
    if given.start:
        start = [np.array(m) for m in json.loads(given.start.read_text())["means"]]
        sigma = 0.6 * SIGMA
    simulation = Simulation(device=given.device, dtype="float32")
    found = search(
        simulation, FAMILIES, seconds=given.seconds, population=given.population,
        cloths=given.cloths, seed=given.seed, start=start, sigma=sigma, told=given.out,
    )  # fmt: skip
    motions = np.array([m for own in found for m in own])
    share = judged(Simulation(device=given.device), motions, FAMILIES, given.judge, given.seed)
    np.savez(given.out.with_suffix(".npz"), motions=motions, share=share, families=FAMILIES)
    print("motions by rows, families by columns: mean share, spread")
    for m in range(len(motions)):
        print(m, " | ".join(f"{s[m].mean():.2f} {(s[m] >= ENOUGH).mean():.2f}" for s in share))


if __name__ == "__main__":
    main()
