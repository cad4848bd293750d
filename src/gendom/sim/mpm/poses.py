"""Gripper poses and velocities at the end of a substep, and their transposes."""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.types import Namespace, make_types
from gendom.sim.paths import make_paths

AHEAD = 32
"""Number of substeps for which gripper poses are computed at once."""


@functools.cache
def make_poses(real: Any) -> Namespace:
    """Build ``pose_gripper``, ``pose_ahead`` (many substeps, by the threads of a block) and their
    transposes ``pose_gripper_adjoint`` and ``close_poses``, for one scalar type."""
    types = make_types(real)
    Paths, Grips, ConditionsAdjoint = types.Paths, types.Grips, types.ConditionsAdjoint
    paths_of = make_paths(real)

    @wp.func
    def pose_gripper(
        row: int, w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, grips: Grips
    ):
        """Gripper g of world w in the substep from t to t + dt [s]."""
        grips.closed[row, g] = int(paths_of.is_closed(w, g, t, paths))
        here, _R, knot = paths_of.pose(w, g, t, paths)
        there, R, end = paths_of.pose(w, g, t + dt, paths)
        grips.centre[row, g] = paths_of.narrow(there)
        grips.orientation[row, g] = paths_of.narrow_matrix(R)
        grips.velocity[row, g] = paths_of.narrow((there - here) / dt)
        # each segment contributes a rotation for its part of the substep
        turned = wp.vec3d()
        if paths.turns[w, g] == 1:
            for k in range(knot, end + 1):
                turned += paths_of.share_of(w, g, k, t, dt, paths) * paths.turn[w, g, k]
        grips.spin[row, g] = paths_of.narrow(turned / dt)

    @wp.func
    def pose_gripper_adjoint(
        row: int, w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, by: ConditionsAdjoint
    ):
        """Transpose of ``pose_gripper``; resets the row's sums."""
        moved = by.velocity[row, g] / dt
        _here, _R, knot = paths_of.pose(w, g, t, paths)
        _there, _R_end, end = paths_of.pose(w, g, t + dt, paths)
        paths_of.pose_adjoint(w, g, t, -moved, wp.vec3d(), paths, by.position, by.turn)
        paths_of.pose_adjoint(
            w, g, t + dt, by.centre[row, g] + moved, by.rotation[row, g], paths,
            by.position, by.turn,
        )  # fmt: skip
        if paths.turns[w, g] == 1:
            for k in range(knot, end + 1):
                by_turn = (paths_of.share_of(w, g, k, t, dt, paths) / dt) * by.spin[row, g]
                paths_of.turn_adjoint(w, g, k, wp.float64(0.0), wp.vec3d(), by_turn, paths, by.turn)
        by.centre[row, g] = wp.vec3d()
        by.rotation[row, g] = wp.vec3d()
        by.velocity[row, g] = wp.vec3d()
        by.spin[row, g] = wp.vec3d()

    @wp.func
    def pose_ahead(
        w: int, thread: int, threads: int, first: int, count: int, t: wp.float64, dt: wp.float64,
        paths: Paths, grips: Grips,
    ):  # fmt: skip
        """Poses in ``count`` substeps from ``first`` on, side by side; substep 0 begins at t."""
        grippers = grips.closed.shape[1]
        for n in range(thread, count * grippers, threads):
            ahead = n // grippers
            at = t + wp.float64(first + ahead) * dt
            pose_gripper(w * AHEAD + ahead, w, n % grippers, at, dt, paths, grips)

    @wp.func
    def close_poses(
        w: int, thread: int, threads: int, first: int, count: int, t: wp.float64, dt: wp.float64,
        paths: Paths, grips: Grips, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``pose_ahead``."""
        grippers = grips.closed.shape[1]
        for n in range(thread, count * grippers, threads):
            row = w * AHEAD + n // grippers
            if grips.closed[row, n % grippers] == 1:
                at = t + wp.float64(first + n // grippers) * dt
                pose_gripper_adjoint(row, w, n % grippers, at, dt, paths, by)

    return Namespace(pose_gripper, pose_gripper_adjoint, pose_ahead, close_poses)
