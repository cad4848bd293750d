"""Markers of a cable that two hands hold, which are beside its axis, and its material's frames.

A ball of a motion capture on a sheath is up to two centimetres beside the axis, and turns with the
cable: `Theta.offsets` has where it is in the frame of its cross-section. Frames begin as the first
hand's, go along the rod without twist (Bishop 1975, "There is more than one way to frame a curve")
and turn about it evenly, such that the last one is the other hand's.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import interp1d
from scipy.linalg import null_space
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array
from gendom.estimation.placing import rod_near
from gendom.estimation.scene import LiftScene
from gendom.sim.thin import rotation

SMOOTH = 2
"""Half waves along a cable that are not those of markers."""

Offsets = tuple[tuple[float, ...], ...]


def material_frames(scene: LiftScene, x: Array, frames: Sequence[int] | None = None) -> Array:
    """[T, W, n, 3, 3] axes of cross-sections as columns, the last one along the rod, of its axis
    [T, W, n, 3] [m], between two hands in frames of the recording (default: the compared ones)."""
    at_first = _twist_free(scene, scene.initial[None, None], [scene.begins])[1]
    q, twist = _twist_free(scene, x, scene.frames if frames is None else frames)
    aligned = at_first - first_twist(scene, scene.initial)
    twist = np.unwrap(np.concatenate([np.broadcast_to(at_first, twist[:1].shape), twist]), axis=0)
    half = 0.5 * (twist[1:] - aligned)[..., None] * (np.arange(q.shape[2]) + 0.5) / q.shape[2]
    turn = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=-1)
    q = rotation.product(q, turn)
    q = np.concatenate([q[:, :, :1], q[:, :, 1:] + q[:, :, :-1], q[:, :, -1:]], axis=2)
    return Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*x.shape, 3)


def first_twist(scene: LiftScene, x: Array) -> float:
    """Twist of a rod [n, 3] in the first frame that would have none between hands along the world's
    axes, as they lie about: alike in all recordings of a rig [rad]."""
    twist = float(_twist_free(scene, x[None, None], [scene.begins])[1].item())
    return twist - 0.5 * math.pi * round(twist / (0.5 * math.pi))


def _twist_free(scene: LiftScene, x: Array, frames: Sequence[int]) -> tuple[Array, Array]:
    """[T, W, n - 1, 4] frames of edges from the first hand's on, and by how much the second hand's
    is turned about the last one [T, W] [rad]."""
    step, shape = np.diff(x, axis=2), (*x.shape[:2], 4)
    first, last = (np.broadcast_to(q[:, None], shape) for q in _hands(scene, tuple(frames)))
    q = rotation.transported(first, step)
    third = np.broadcast_to([0.0, 0.0, 1.0], (*x.shape[:2], 3))
    onto = rotation.shortest(rotation.turned(last, third), step[:, :, -1])
    off = rotation.between(q[:, :, -1], rotation.product(onto, last))
    return q, 2.0 * np.arctan2(off[..., 2], off[..., 3])


@functools.lru_cache(maxsize=64)
def _hands(scene: LiftScene, frames: tuple[int, ...]) -> list[Array]:
    """[T, 4] directions of both hands."""
    found, times = [], scene.sim_time(scene.recording.time[list(frames)])
    for g, axes in enumerate(scene.clamp_frames):
        own = Rotation.from_matrix(axes * [1.0, np.sign(np.linalg.det(axes)), 1.0])
        turned = scene.turned(g, times)
        every = Rotation.identity(len(times)) if turned is None else turned
        found.append((every * own).as_quat())
    return found


@functools.lru_cache(maxsize=64)
def spread(scene: LiftScene) -> Array:
    """[n, m] the smoothest change along a rod that is 1 at one of m markers and 0 at the others."""
    m, n = len(scene.markers[0]), len(scene.initial)
    at, bend = np.zeros((m, n)), np.diff(np.eye(n), 2, axis=0)
    np.put_along_axis(at, *scene.markers, axis=1)
    # the least bend with these values
    K = np.block([[bend.T @ bend, at.T], [at, np.zeros((m, m))]])
    return np.linalg.solve(K, np.concatenate([np.zeros((n, m)), np.eye(m)]))[:n]


@functools.lru_cache(maxsize=64)
def beside_axis(scene: LiftScene) -> Array:
    """[m, k] offsets of m markers, orthonormal, with which both hands are on the axis, and which do
    not bend it to one side, as a twist or a bend by nature does."""
    fine = np.linspace(0.0, 1.0, 16 * len(scene.initial))
    own = np.linspace(0.0, 1.0, len(scene.initial))
    x, along = (interp1d(own, v, axis=0)(fine) for v in (scene.initial, spread(scene)))
    at_hands = along[cdist(scene.held, x).argmin(axis=1)]
    s = np.linspace(0.0, math.pi, len(own))
    long = [np.sin(k * s) @ spread(scene) for k in range(1, SMOOTH + 1)]
    return null_space(np.stack([*at_hands, *long]))


def aside(scene: LiftScene, frames: Array, offsets: Array) -> Array:
    """[..., n, 3] by how much the line through markers [m, 3] is beside the axis, in frames
    [..., n, 3, 3] [m]."""
    what = f"the cable has {len(offsets)} markers, the recording shows {len(scene.markers[0])}"
    require(len(offsets) == len(scene.markers[0]), what, fix="estimate from such a recording")
    return np.einsum("...nab,nb->...na", frames, spread(scene) @ offsets)


@functools.lru_cache(maxsize=64)
def axis_beside(scene: LiftScene, offsets: Offsets, longer: float) -> tuple[Array, float]:
    """[n, 3] the axis in the first frame, which is so many times as long as stated and of which
    markers are beside [m], and its `first_twist`."""
    index, weight = scene.markers
    shown, x = scene.recording.frame(scene.begins).astype(float), scene.initial
    moved = np.zeros_like(shown)
    for _ in range(2 if offsets else int(longer != 1.0)):  # frames are those of the axis
        if offsets:
            frames = material_frames(scene, x[None, None], [scene.begins])[0, 0]
            by = aside(scene, frames, np.asarray(offsets))
            moved = np.einsum("mk,mka->ma", weight, by[index])
        x = rod_near(longer * scene.size, shown - moved, (index * weight).sum(axis=1), len(x))
    return x, first_twist(scene, x)
