"""The network of `pointnet`, simulated lifts, and its training. Needs torch and onnx."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.learning import Epoch, FitSettings, export_onnx, fit  # explains a missing torch

# isort: split
import torch
from torch import Tensor, nn

from gendom.errors import ParameterError, SimulationError
from gendom.estimation.methods.pointnet import (
    FORMAT,
    METADATA_KEY,
    grouped,
    lift_of,
    normalised,
    read_network,
)
from gendom.estimation.replay import replay
from gendom.estimation.scene import LiftScene
from gendom.files import atomic_path
from gendom.materials.unknowns import Theta
from gendom.observation import visible

Array = NDArray[np.floating]

INPUTS = ("near", "which", "about", "at")
OUTPUTS = ("mean", "log_variance")

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch."""


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
class PointNetTraining:
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


def simulated_lifts(
    scene: LiftScene,
    thetas: Sequence[Theta],
    *,
    cameras: bool = False,
    together: int = 64,
) -> tuple[Array, Array]:
    """Last clouds of a lift with other parameters.

    Args:
        scene: The lift.
        thetas: L sets of parameters.
        cameras: Show only what the recording's cameras see; else all of the skin.
        together: Worlds in a batch.

    Returns:
        Normalised clouds [L, n, 3], points repeated where fewer are seen, and [L, 2]
        ln(bending length / size) and nu; without those that cannot be simulated.

    Raises:
        SimulationError: None can.
    """
    last = replace(scene, frames=scene.frames[-1:])
    clouds, targets = [], []
    for k in range(0, len(thetas), together):
        batch = thetas[k : k + together]
        x = replay(last, batch, keep_going=True)[0]
        for theta, skin in zip(batch, scene.body.surface(x), strict=True):
            if not np.isfinite(skin).all():
                continue
            if cameras:
                seen = skin[visible(skin, camera_positions=scene.recording.camera_positions)]
                skin = np.resize(seen, skin.shape)
            clouds.append(normalised(scene, skin, scene.frames[-1]))
            bending = scene.bending_length(theta.E_over_rho)
            targets.append((math.log(bending / scene.size), theta.nu))
    if not clouds:
        raise SimulationError("no lift could be simulated", fix="draw other parameters")
    return np.stack(clouds), np.array(targets)


def train_pointnet(
    scene: LiftScene,
    clouds: Array,
    targets: Array,
    path: Path,
    training: PointNetTraining | None = None,
    *,
    on_epoch: Callable[[int, float], None] | None = None,
) -> PointNet:
    """Train a network on simulated lifts and write it to an ONNX file, atomically.

    Args:
        scene: The lift.
        clouds, targets: Of `simulated_lifts`.
        path: File to write.
        training: How.
        on_epoch: Called with the number of epochs done and the mean loss.

    Raises:
        ParameterError: The training diverged, or the file's network is not the trained one.
    """
    training = training or PointNetTraining()
    made = {name: torch.from_numpy(array) for name, array in grouped(clouds).items()}
    target = torch.tensor(targets, dtype=torch.float32)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        mean, scale = targets.mean(axis=0), targets.std(axis=0)
        network = PointNet(mean.tolist(), scale.tolist())
        _fit(network, made, target, training, on_epoch)
    network.eval()
    _export(network, made, path, {"lift": lift_of(scene), "lifts": len(clouds)} | asdict(training))
    return network


def _fit(
    network: PointNet,
    made: dict[str, Tensor],
    target: Tensor,
    training: PointNetTraining,
    on_epoch: Callable[[int, float], None] | None,
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

    def count(epoch: Epoch) -> None:
        nonlocal done
        done = epoch.done
        if on_epoch is not None:
            on_epoch(epoch.done, epoch.loss)

    settings = FitSettings(
        epochs=training.epochs,
        batch_size=training.batch_size,
        learning_rate=training.learning_rate,
        weight_decay=training.weight_decay,
    )
    fit(
        network,
        loss_of,
        torch.arange(len(target)),
        settings,
        on_epoch=count,
        error=ParameterError,
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
        if not worst < AGREEMENT:
            raise ParameterError(
                f"the exported network differs from the trained one by {worst:.3g}",
                where=str(path),
                fix="report this, with the versions of torch and onnxruntime",
            )
