"""Sets of demonstrations as LeRobot data sets.

A demonstration becomes an episode of one frame, at time 0: an action is a whole motion, chosen
before it begins, without observations during the motion. Failed demonstrations are left out.

    observation.state  [S] float32: the reached result as the goal, sizes, parameters, in the order
                       of `gendom.reality.envs`; parameters are those of `PARAMETERS`
    action             [A] float32: the task's action

meta/gendom.json is dataset.json of the set. In addition to the format's columns, rows of episodes
have `demonstration`, the number in the set, and `outcome/NAME` for all other measured results.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from gendom.arguments import require
from gendom.datasets.demonstrations import GOAL, load, read_description, succeeded
from gendom.datasets.lerobot.format import ACTION, STATE, write_lerobot
from gendom.errors import DatasetError
from gendom.materials import KINDS, PARAMETERS


def export_demonstrations(folder: str | os.PathLike, out: str | os.PathLike) -> dict[str, Any]:
    """Write the finished part of a set of demonstrations as a LeRobot data set.

    Args:
        folder: Folder of the set.
        out: Folder to create; it is written completely or not at all.

    Returns:
        The content of info.json.

    Raises:
        DatasetError: The folder holds no set, or one without a usable demonstration.
        GendomError: `out` is there already or cannot be written, or the disk is full.
    """
    where = str(folder)
    about = read_description(folder)
    table = load(folder, part=True)
    quantities = _quantities(about, where)
    names = [name for units in quantities.values() for name in units]
    apart = {*names, "demonstration", "E", "ok", "fault"}
    others = [name for name in table.column_names if name not in apart]
    columns = succeeded(table, ["demonstration", *names, *others], where=where)
    count, fix = len(columns["demonstration"]), "simulate more with gendom dataset"
    what = "holds no demonstration that did not fail"
    require(count, what, where=where, fix=fix, error=DatasetError)
    frames = {}
    for feature, units in quantities.items():
        values = np.stack([columns[name] for name in units], axis=1).astype(np.float32)
        what, fix = f"{feature} holds numbers that are not finite", "simulate the set again"
        require(np.isfinite(values).all(), what, where=where, fix=fix, error=DatasetError)
        frames[feature] = values
    extra = {f"outcome/{name}": pa.array(columns[name]) for name in others}
    extra["demonstration"] = pa.array(columns["demonstration"].astype(np.int64))
    lengths, task = np.ones(count, np.int64), about["task"]["name"]
    return write_lerobot(
        out, frames, lengths, task=task, units=quantities, about=about, extra=extra
    )


def _quantities(about: Mapping[str, Any], where: str) -> dict[str, dict[str, str]]:
    """Units by column name, for the state and the action."""
    try:
        kind = KINDS[about["kind"]]
        goals = dict(zip(about["goal_names"], about["goal_units"], strict=True))
        actions = dict(zip(about["action_names"], about["action_units"], strict=True))
    except (KeyError, TypeError, ValueError):
        what = "does not say what its actions and goals are"
        fix = "make it again with this version of gendom dataset"
        raise DatasetError(what, where=where, fix=fix) from None
    state = {GOAL + name: unit for name, unit in goals.items()}
    state |= dict.fromkeys(kind.sizes, "m")
    state |= {parameter.column: parameter.unit for parameter in PARAMETERS.values()}
    return {STATE: state, ACTION: actions}
