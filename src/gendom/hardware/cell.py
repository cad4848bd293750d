"""A cell: a robot, its cameras and what stands around them, as cell.toml describes them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.robot import Surroundings

CELL_FORMAT = "gendom-cell/1"


@dataclass(frozen=True, kw_only=True)
class Tool:
    """The gripper, as measured at setup."""

    max_opening: float
    """[m]."""
    latency: float
    """From the command until the fingers move [s]."""
    mass: float = 0.0
    """[kg]."""


@dataclass(frozen=True, kw_only=True)
class SpeedLimits:
    """How fast the arm may move."""

    tool: float = 0.25
    """[m/s]; at most 0.8."""
    share: float = 0.3
    """Of the arm's own joint speeds and accelerations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellCamera:
    """One depth camera of a cell."""

    name: str
    device: str
    """A name that `gendom.hardware.find_depth_camera` knows."""
    serial: str
    T_world_camera: NDArray[np.float64] | None
    """[4, 4] camera to world [m]; None: not calibrated."""
    calibrated: str | None = None
    """Date of the calibration, YYYY-MM-DD."""
    stated_error: float = math.nan
    """Of the pose, as gendom calibrate states it [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A robot and the space in which it works. The world is the robot's base frame, z up."""

    robot: str
    """A name that `gendom.hardware.find_robot` knows."""
    address: str
    """Of the robot's controller."""
    arm: str
    """As `gendom.robot.find_arm` takes it."""
    tool: Tool
    surroundings: Surroundings
    """Table, keep-out boxes, camera stands."""
    workspace: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Lowest and highest corner [3] of a box that the tool point never leaves [m]."""
    cameras: tuple[CellCamera, ...] = ()
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    scene_clearance: float = 0.02
    """Least distance of the arm from its surroundings [m]."""
    self_clearance: float = 0.01
    """Least distance of the arm's parts from each other [m]."""
    path: Path | None = None
    """The file that it was read from."""
