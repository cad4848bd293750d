"""How two hands hold a rope: axes in which clamps turn it, alike in all recordings of a rig.

Recordings do not say how hands are turned about the rope. Their axes are those of the rig: from
one hand to the other, across, and up. Results then do not depend on where it stands.
"""

from __future__ import annotations

import math

import numpy as np

from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.materials.unknowns import UNKNOWNS
from gendom.sim.thin import rotation


def along(recording: Recording, inwards: Array) -> Array:
    """[T, 2, 3] directions of a rope at both hands from the first frame with points on, from its
    first end to the last one, given those in it from each hand on [2, 3]."""
    ahead, axes = inwards * [[1.0], [-1.0]], recording.gripper_axis
    if axes is None:
        return ahead[None]
    own = axes[int(np.argmax(recording.frame_valid)) :].astype(float)
    return own * np.where((own[0] * ahead).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]


def rig_axes(recording: Recording) -> Array:
    """[3, 3] as rows: level from the first hand to the last in the mean, level across, and up."""
    ahead = np.diff(recording.gripper_position.mean(axis=0), axis=0)[0, :2]
    size = float(np.linalg.norm(ahead))
    x, y = ahead / size if size > 0.0 else (1.0, 0.0)
    return np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])


def clamp_frame(recording: Recording, inwards: Array, g: int) -> Array:
    """[3, 3] axes of a hand as columns: x and y, and that along the rope; the rig's, turned the
    shortest way so that the nearest one lies along it."""
    rig, own = rig_axes(recording), along(recording, inwards)
    k, sign = _nearest(rig, own[:, g])
    turn, others = rotation.shortest(sign * rig[k], own[0, g]), np.delete(rig, k, axis=0)
    return np.stack([*rotation.turned(turn, others), own[0, g]], axis=1)


def _nearest(rig: Array, own: Array) -> tuple[int, float]:
    """Which of the rig's axes lies along a hand's directions [T, 3] in the mean, and its sign."""
    mean = rig @ own.mean(axis=0)
    k = int(np.abs(mean).argmax())
    return k, math.copysign(1.0, mean[k])


def clamp_steps(recording: Recording, inwards: Array) -> dict[str, dict[str, float]]:
    """Steps of clamps' turns for differences, as changes to their priors: they change sign as turns
    do when a recording is mirrored, or its ends are swapped, so that its result is the same."""
    rig, own = rig_axes(recording), along(recording, inwards)
    hands = recording.gripper_position.mean(axis=(0, 1))
    ahead, aside, _ = np.sign(rig @ (recording.points.mean(axis=0) - hands))
    ways, found = (aside, ahead, ahead * aside), {"clamp_twist": ahead * aside}
    for g, end in enumerate(("first", "last")):
        both = np.delete(ways, _nearest(rig, own[:, g])[0])
        found |= {f"{end}_clamp_{axis}": way for axis, way in zip("xy", both, strict=True)}
    return {n: {"step": math.copysign(UNKNOWNS[n].step, way)} for n, way in found.items()}
