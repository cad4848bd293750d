"""Networks between physical quantities. Needs torch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from gendom.policies.policy import Column

ARCHITECTURES: dict[str, tuple[tuple[int, ...], type[nn.Module]]] = {
    "smooth": ((192, 192, 192), nn.SiLU),
    "paper": ((256, 128, 32), nn.ReLU),
}
"""Widths of the hidden layers, and what follows each. "paper" is that of Kuroki et al. (2024)."""


class PhysicalNetwork(nn.Module):
    """A multilayer perceptron whose inputs and outputs are physical quantities.

    Standardisation, and logarithms where a column asks for them, are part of it.

    Args:
        inputs, outputs: One column for each number; outputs are not logarithmic.
        architecture: A key of `ARCHITECTURES`.
    """

    input_mean: Tensor
    input_scale: Tensor
    output_mean: Tensor
    output_scale: Tensor

    def __init__(
        self, inputs: Sequence[Column], outputs: Sequence[Column], architecture: str = "smooth"
    ):
        super().__init__()
        self._log = [column.log for column in inputs]
        self.register_buffer("input_mean", torch.tensor([c.mean for c in inputs]))
        self.register_buffer("input_scale", torch.tensor([c.scale for c in inputs]))
        self.register_buffer("output_mean", torch.tensor([c.mean for c in outputs]))
        self.register_buffer("output_scale", torch.tensor([c.scale for c in outputs]))
        widths, activation = ARCHITECTURES[architecture]
        layers: list[nn.Module] = []
        before = len(inputs)
        for width in widths:
            layers += [nn.Linear(before, width), activation()]
            before = width
        self.layers = nn.Sequential(*layers, nn.Linear(before, len(outputs)))

    def forward(self, *columns: Tensor) -> Tensor:
        """[B, outputs] from one [B, 1] tensor for each input."""
        x = [torch.log(c) if log else c for c, log in zip(columns, self._log, strict=True)]
        z = (torch.cat(x, dim=1) - self.input_mean) / self.input_scale
        return self.layers(z) * self.output_scale + self.output_mean
