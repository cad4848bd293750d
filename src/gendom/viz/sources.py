"""What reports, animations and the viewer draw of lifts, replays, estimates and actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gendom.arrays import Array, placed
from gendom.materials import thickness_of
from gendom.viz.clouds import CloudSequence

if TYPE_CHECKING:
    from gendom.estimation import LiftScene, Theta
    from gendom.reality.trials import TrialRun
    from gendom.tasks import Observed


def clouds_of(
    scene: LiftScene,
    x: Array,
    theta: Theta,
    chamfer: Array,
) -> CloudSequence:
    """Recorded clouds and simulated skins.

    Args:
        scene: What was recorded.
        x: [T, N, 3] positions at its frames [m].
        theta: With which these were simulated.
        chamfer: [T] distance of both [m].
    """
    recording, frames = scene.recording, list(scene.frames)
    return CloudSequence(
        recorded=recording.frames(frames),
        simulated=list(scene.body_of(theta).surface(x)),
        times=recording.time[frames],
        table_height=recording.table_height,
        gripper=recording.gripper_position[frames],
        chamfer=chamfer,
        oblique=scene.kind == "cloth",
    )


def arm_poses(run: TrialRun, times: Array, T_world_frame: Array) -> tuple[Array, Array] | None:
    """[T, C, 2, 3] ends of the arm's capsules in a frame [4, 4], and [C] their radii [m].

    None where a free hand moves. `times` [T] [s] are the run's own.
    """
    from gendom.robot import XARM7, arm_shape

    if run.motion is None:
        return None
    shape = arm_shape(XARM7, run.motion.at(times), thickness_of(run.trial.item))
    ends = np.stack([shape.start, shape.end], axis=-2)
    T = np.linalg.inv(T_world_frame)
    return placed(T, ends), shape.radius


def goal_mark(goal: Array, seen: Observed) -> Array:
    """A goal in its task's frame: [1, 3] the place of a goal (x, z) beside where the tip hung, or
    [2, 3] an upright line at the distance x, as high as the rope comes [m]."""
    if len(goal) == 1:
        heights = float(seen.points[..., 2].min()), float(seen.points[..., 2].max())
        return np.array([[goal[0], 0.0, z] for z in heights])
    return np.array([[seen.tip[0, 0] + goal[0], seen.tip[0, 1], seen.tip[0, 2] + goal[1]]])
