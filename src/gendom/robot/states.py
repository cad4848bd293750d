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
from numpy.typing import ArrayLike, NDArray

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

    _, table, lines = read_number_table(
        path, header=form, check_header=check_header, on_cut=on_cut, error=RobotError
    )
    time, q, opening = table[:, 0], table[:, 1 : 1 + arm.joints], table[:, 1 + arm.joints :]
    beyond = np.maximum(arm.q_min - q, q - arm.q_max)
    j, widest = beyond.argmax(axis=1), arm.gripper.max_opening

    def wanted(holds: ArrayLike, what: Callable[[int], str], fix: str) -> None:
        for k in np.flatnonzero(~np.asarray(holds))[:1]:
            raise RobotError(what(k), where=f"{path}, line {lines[k]}", fix=fix)

    wanted(
        np.isfinite(table).all(axis=1),
        lambda k: "a number is not finite",
        "give seconds, radians and metres",
    )
    wanted(
        np.diff(time, prepend=-np.inf) > 0.0,
        lambda k: f"time goes from {time[k - 1]:g} to {time[k]:g} s",
        "sort the rows",
    )
    wanted(
        beyond.max(axis=1) <= 0.1,
        lambda k: (
            f"joint {j[k] + 1} is at {q[k, j[k]]:g} rad, its range on {arm.name} is "
            f"{arm.q_min[j[k]]:.3f} to {arm.q_max[j[k]]:.3f}"
        ),
        "give radians, from the base to the flange",
    )
    wanted(
        ((opening >= -0.005) & (opening <= widest + 0.005)).all(axis=1),
        lambda k: f"the gripper's opening is {opening[k, 0]:g} m, it goes to {widest:g}",
        "give metres between the fingers",
    )
    return JointStates(time, q, opening[:, 0] if opening.size else None)
