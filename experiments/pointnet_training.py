"""Trains PointNet++ on simulated lifts of the paper, and measures it on fresh ones:

    python -m experiments.pointnet_training

The paper's baseline is trained on 998 simulated sets, with E over [500, 10500] in its units and nu
over [0.2, 0.4] (Kuroki et al. 2024). Needs the extra train.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.policies.fitting import (  # explains a missing torch
    descend,
    export_onnx,
)

# isort: split
import torch
from torch import Tensor, nn

from experiments.pointnet import (
    ASSET,
    FORMAT,
    METADATA_KEY,
    grouped,
    lift_of,
    normalised,
    read_network,
)
from experiments.sim2sim import (
    E_RANGE,
    NU_RANGE,
    paper_E,
    scene_settings,
    sim2sim_recording,
    truth_of,
)
from gendom.arguments import require
from gendom.errors import SimulationError
from gendom.estimation.replay import replay
from gendom.estimation.scene import LiftScene
from gendom.files import atomic_path
from gendom.materials.unknowns import Theta

Array = NDArray[np.floating]

INPUTS = ("near", "which", "about", "at")
OUTPUTS = ("mean", "log_variance")

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch."""

WORLDS = 64
"""Lifts that are simulated in a batch."""


class PointNet(nn.Module):
    """PointNet++ after its sampling and grouping: two layers of set abstraction and one of all.

    Source: Qi et al. (2017), "PointNet++: deep hierarchical feature learning on point sets in a
    metric space".

    Args:
        mean, scale: [2] of ln(bending length / size) and nu in training.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, mean: Sequence[float] = (0.0, 0.0), scale: Sequence[float] = (1.0, 1.0)):
        super().__init__()
        self.register_buffer("mean", torch.tensor(mean, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))
        self.first = _shared(3, 32, 32, 64)
        self.second = _shared(3 + 64, 64, 64, 128)
        self.whole = _shared(3 + 128, 128, 256)
        self.head = nn.Sequential(nn.Linear(256, 128), nn.SiLU(), nn.Linear(128, 4))

    def forward(
        self, near: Tensor, which: Tensor, about: Tensor, at: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Means and log variances [B, 2] of ln(bending length / size) and nu.

        Arguments are those of `grouped`.
        """
        features = self.first(near).amax(dim=2)
        B, m, K = which.shape
        C = features.shape[2]
        index = which.reshape(B, m * K, 1).expand(B, m * K, C)
        of_centres = torch.gather(features, 1, index).reshape(B, m, K, C)
        features = self.second(torch.cat([about, of_centres], dim=3)).amax(dim=2)
        found = self.head(self.whole(torch.cat([at, features], dim=2)).amax(dim=1))
        log_variance = found[:, 2:].clamp(-14.0, 4.0) + 2.0 * torch.log(self.scale)
        return found[:, :2] * self.scale + self.mean, log_variance


def _shared(*widths: int) -> nn.Sequential:
    """A multilayer perceptron that every point passes alone."""
    layers: list[nn.Module] = []
    for a, b in pairwise(widths):
        layers += [nn.Linear(a, b), nn.SiLU()]
    return nn.Sequential(*layers)


@dataclass(frozen=True, kw_only=True)
class Training:
    """How to train."""

    epochs: int = 120
    batch_size: int = 16
    learning_rate: float = 2e-3
    """Its peak; it then falls to zero along a cosine."""
    weight_decay: float = 1e-4
    means_first: float = 0.5
    """Share of the epochs that train the means only: variances from the start would mask hard
    cases."""
    seed: int = 0


def simulated_lifts(scene: LiftScene, thetas: Sequence[Theta]) -> tuple[Array, Array]:
    """Last clouds of a lift with L other sets of parameters.

    Returns:
        Normalised clouds [L, n, 3] and [L, 2] ln(bending length / size) and nu; without those that
        cannot be simulated.

    Raises:
        SimulationError: None can.
    """
    last = replace(scene, frames=scene.frames[-1:])
    clouds, targets = [], []
    for k in range(0, len(thetas), WORLDS):
        batch = thetas[k : k + WORLDS]
        x = replay(last, batch, keep_going=True)[0]
        for theta, skin in zip(batch, scene.body.surface(x), strict=True):
            if np.isfinite(skin).all():
                clouds.append(normalised(scene, skin, scene.frames[-1]))
                bending = scene.bending_length(theta.E_over_rho)
                targets.append((math.log(bending / scene.size), theta.nu))
    if not clouds:
        raise SimulationError("no lift could be simulated", fix="draw other parameters")
    return np.stack(clouds), np.array(targets)


def train(
    scene: LiftScene, clouds: Array, targets: Array, path: Path, training: Training
) -> PointNet:
    """Train a network on `simulated_lifts` of a scene and write it to an ONNX file, atomically.

    Raises:
        GendomError: The training diverged, or the file's network is not the trained one.
    """
    made = {name: torch.from_numpy(array) for name, array in grouped(clouds).items()}
    target = torch.tensor(targets, dtype=torch.float32)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        network = PointNet(targets.mean(axis=0).tolist(), targets.std(axis=0).tolist())
        _fit(network, made, target, training)
    network.eval()
    about = {"lift": lift_of(scene), "lifts": len(clouds)} | asdict(training)
    _export(network, made, path, about)
    return network


def _fit(
    network: PointNet,
    made: dict[str, Tensor],
    target: Tensor,
    training: Training,
) -> None:
    done = 0

    def loss_of(rows: Tensor) -> Tensor:
        mean, log_variance = network(*(made[name][rows] for name in INPUTS))
        off = ((mean - target[rows]) / network.scale) ** 2
        if done < training.means_first * training.epochs:
            # variances wait
            return off.mean() + 0.0 * log_variance.sum()
        own = log_variance - 2.0 * torch.log(network.scale)
        # weighted by their own deviation, so that hard cases keep their weight (Seitzer et al.
        # 2022)
        weight = torch.exp(0.5 * own).detach()
        return (weight * (off * torch.exp(-own) + own)).mean()

    def count(epochs: int, _: float) -> None:
        nonlocal done
        done = epochs

    descend(
        network,
        loss_of,
        torch.arange(len(target)),
        epochs=training.epochs,
        batch_size=training.batch_size,
        rate=training.learning_rate,
        weight_decay=training.weight_decay,
        on_epoch=count,
    )


def _export(network: PointNet, made: dict[str, Tensor], path: Path, about: dict) -> None:
    with atomic_path(path) as temporary:
        export_onnx(
            network,
            temporary,
            inputs={name: made[name][:2] for name in INPUTS},
            outputs=OUTPUTS,
            metadata={METADATA_KEY: json.dumps({"format": FORMAT, **about})},
        )
        session, _ = read_network(temporary)
        chosen = {name: made[name][:64] for name in INPUTS}
        with torch.no_grad():
            expected = network(*chosen.values())
        found = session.run(list(OUTPUTS), {name: t.numpy() for name, t in chosen.items()})
        worst = max(
            float(np.abs(a - b.numpy()).max()) for a, b in zip(found, expected, strict=True)
        )
        what = f"the exported network differs from the trained one by {worst:.3g}"
        fix = "report this, with the versions of torch and onnxruntime"
        require(worst < AGREEMENT, what, where=str(path), fix=fix)


def main() -> None:
    """Train and measure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ASSET, help="file to write")
    parser.add_argument("--lifts", type=int, default=998)
    parser.add_argument("--held-out", type=int, default=200, help="fresh lifts to measure it on")
    parser.add_argument("--epochs", type=int, default=Training.epochs)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, help="of the simulator (default: all cores)")
    given = parser.parse_args()
    settings = scene_settings(threads=given.threads)
    scene = LiftScene.of(sim2sim_recording(5000.0, 0.3, settings=settings), settings)
    rng = np.random.default_rng(given.seed)

    def lifts(count: int) -> tuple[Array, Array]:
        drawn = [truth_of(rng.uniform(*E_RANGE), rng.uniform(*NU_RANGE)) for _ in range(count)]
        return simulated_lifts(scene, drawn)

    began = time.perf_counter()
    clouds, targets = lifts(given.lifts)
    simulated = time.perf_counter() - began
    train(scene, clouds, targets, given.out, Training(epochs=given.epochs, seed=given.seed))
    trained = time.perf_counter() - began - simulated
    session, _ = read_network(given.out)
    fresh, truth = lifts(given.held_out)
    mean, log_variance = session.run(["mean", "log_variance"], grouped(fresh))
    E, true_E = (
        np.array([paper_E(scene.E_over_rho(math.exp(b) * scene.size)) for b in each])
        for each in (mean[:, 0].astype(float), truth[:, 0])
    )
    z = (mean - truth) / np.exp(0.5 * log_variance)
    result = {
        "lifts": len(clouds),
        "held_out": len(fresh),
        "mean_absolute_error_of_E": float(np.abs(E - true_E).mean()),
        "sd_of_that": float(np.abs(E - true_E).std()),
        "mean_absolute_error_of_ln_E": float(np.abs(np.log(E / true_E)).mean()),
        "mean_absolute_error_of_nu": float(np.abs(mean[:, 1] - truth[:, 1]).mean()),
        "nu_by_its_mean_alone": float(np.abs(truth[:, 1] - targets[:, 1].mean()).mean()),
        "errors_over_claimed_deviations": z.std(axis=0).tolist(),
        "simulation_seconds": simulated,
        "training_seconds": trained,
        "bytes": given.out.stat().st_size,
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
