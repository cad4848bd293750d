"""Pipelines around the policy: nothing is normalised."""

from __future__ import annotations

from typing import Any

from lerobot.processor import make_default_pre_post_processors


def make_gendom_pre_post_processors(config: Any, dataset_stats: Any = None) -> tuple[Any, Any]:
    """LeRobot's own; statistics have no effect."""
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
