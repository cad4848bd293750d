"""Joint angles over time as a file.

joints.csv has one row for each time, in order of time, under `time,q0,...,q6` or
`time,q0,...,q6,gripper`: seconds, joint angles in radians from the base to the flange, and the
distance of the fingers' inner faces in metres.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.errors import RobotError
from gendom.reading import read_number_table
from gendom.robot.arm import Arm


@dataclass(frozen=True, eq=False)
class JointStates:
    """Measured joint angles of a robot over time."""

    time: NDArray[np.float64]
    """[M] increasing times [s]."""
    q: NDArray[np.float64]
    """[M, J] joint angles [rad]."""
    opening: NDArray[np.float64] | None = None
    """[M] distance of the fingers' inner faces [m]; None: unknown."""


def read_joints(
    path: str | os.PathLike, arm: Arm, *, on_cut: Callable[[int], None] | None = None
) -> JointStates:
    """The joint angles of a file joints.csv; see the top of this module.

    Args:
        path: The file.
        arm: The arm to which the joints belong.
        on_cut: Called with the number of the last line if it is incomplete because the recording
            was interrupted. The line is then skipped; None: an incomplete line is an error.

    Raises:
        RobotError: The file cannot be read, a row is malformed or out of order, or a joint is
            out of its range by more than 0.1 rad, as angles in degrees are.
    """
    expected = ["time", *(f"q{j}" for j in range(arm.joints))]
    form = f"{','.join(expected)}[,gripper]"

    def check_header(names: list[str]) -> None:
        known, what = (expected, [*expected, "gripper"]), f"has the header {','.join(names)[:60]!r}"
        fix = f"write rows under {form}"
        require(names in known, what, where=str(path), fix=fix, error=RobotError)

    names, table, lines = read_number_table(
        path, header=form, check_header=check_header, on_cut=on_cut, error=RobotError
    )
    before = -np.inf
    for line, row in zip(lines, table, strict=True):
        where, fix = f"{path}, line {line}", "give seconds, radians and metres"
        finite = np.isfinite(row).all()
        require(finite, "a number is not finite", where=where, fix=fix, error=RobotError)
        what = f"time goes from {before:g} to {row[0]:g} s"
        require(row[0] > before, what, where=where, fix="sort the rows", error=RobotError)
        before = row[0]
        _check_state(arm, row[1:], where)
    opening = table[:, -1] if len(names) > len(expected) else None
    return JointStates(table[:, 0], table[:, 1 : 1 + arm.joints], opening)


def _check_state(arm: Arm, state: NDArray[np.float64], where: str) -> None:
    """Check that joint angles, and the gripper's opening if it is there, are in the arm's ranges.

    Raises:
        RobotError: One is beyond, as angles in degrees are.
    """
    q, opening = state[: arm.joints], state[arm.joints :]
    beyond = np.maximum(arm.q_min - q, q - arm.q_max)
    j = int(beyond.argmax())
    require(
        beyond[j] <= 0.1,
        f"joint {j + 1} is at {q[j]:g} rad, its range on {arm.name} is "
        f"{arm.q_min[j]:.3f} to {arm.q_max[j]:.3f}",
        where=where,
        fix="give radians, from the base to the flange",
        error=RobotError,
    )
    widest = arm.gripper.max_opening
    require(
        np.all((opening >= -0.005) & (opening <= widest + 0.005)),
        f"the gripper's opening is {opening.sum():g} m, it goes to {widest:g}",
        where=where,
        fix="give metres between the fingers",
        error=RobotError,
    )
