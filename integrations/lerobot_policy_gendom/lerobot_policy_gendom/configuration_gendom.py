"""Settings of the policy, as LeRobot keeps them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode
from lerobot.optim.optimizers import AdamWConfig, OptimizerConfig


@PreTrainedConfig.register_subclass("gendom")
@dataclass
class GendomConfig(PreTrainedConfig):
    """``--policy.type=gendom --policy.task=rope-casting``: a shipped policy, or an ONNX file of
    ``gendom train``.

    Its state is that of ``--env.type=gendom``: the goal, the object's parameters and its sizes, SI.
    """

    task: str = "rope-casting"
    onnx: str | None = None
    """A policy's file; None: the shipped one of the task."""
    parameters: bool = True
    """Whether the shipped one that sees parameters is taken."""
    device: str | None = "cpu"
    push_to_hub: bool = False
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(FeatureType.__members__, NormalizationMode.IDENTITY)
    )

    observation_delta_indices = action_delta_indices = reward_delta_indices = None

    def get_optimizer_preset(self) -> OptimizerConfig:
        """LeRobot asks for one; ``gendom train`` trains."""
        return AdamWConfig()

    def get_scheduler_preset(self) -> Any:
        """None."""

    def validate_features(self) -> None:
        """Whatever has a state fits."""
