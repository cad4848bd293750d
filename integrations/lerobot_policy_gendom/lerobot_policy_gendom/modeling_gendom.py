"""A policy of GenDOM, by LeRobot's interface. It acts; ``gendom train`` trains it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_STATE

from gendom.errors import GendomError
from gendom.materials import KINDS, QUANTITIES, from_columns
from gendom.policies import Policy
from lerobot_policy_gendom.configuration_gendom import GendomConfig


class GendomPolicy(PreTrainedPolicy):
    """Chooses one action an episode from a state [B, goal, parameters and sizes]."""

    config_class = GendomConfig
    name = "gendom"

    def __init__(self, config: GendomConfig, **_: Any):
        super().__init__(config)
        self.policy = (
            Policy.read(Path(config.onnx))
            if config.onnx
            else Policy.pretrained(config.task, parameters=config.parameters)
        )

    @classmethod
    def from_pretrained(cls, *_: Any, config: GendomConfig, **__: Any) -> GendomPolicy:
        """What its settings name: its weights are in an ONNX file."""
        return cls(config)

    def reset(self) -> None:
        """It remembers nothing."""

    def select_action(self, batch: dict[str, torch.Tensor], **_: Any) -> torch.Tensor:
        """[B, A] actions in SI units."""
        state = batch[OBS_STATE].detach().cpu().double().numpy()
        return torch.tensor(np.array([self._act(row) for row in state]), dtype=torch.float32)

    def predict_action_chunk(self, batch: dict[str, torch.Tensor], **_: Any) -> torch.Tensor:
        """[B, 1, A]."""
        return self.select_action(batch)[:, None]

    def _act(self, row: np.ndarray) -> np.ndarray:
        task = self.policy.task()
        goal, rest = np.split(row, [len(task.goals)])
        known = dict(zip([*QUANTITIES, *KINDS[task.kind].sizes], rest.tolist(), strict=True))
        known["E"] = known["E_over_rho"] * known["density"]
        item = from_columns(task.kind, known)
        return np.array(self.policy.act(goal, item, force=True).values)

    def get_optim_params(self) -> dict[str, Any]:
        """None."""
        return {}

    def forward(self, batch: dict[str, torch.Tensor]) -> tuple[torch.Tensor, dict[str, Any] | None]:
        """Refused.

        Raises:
            GendomError: Always.
        """
        raise GendomError("is not trained by LeRobot", where="gendom", fix="use gendom train")
