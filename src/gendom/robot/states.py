"""Joint angles over time as a file.

joints.csv has one row for each time, in order of time, under `time,q0,...,q6` or
`time,q0,...,q6,gripper`: seconds, joint angles in radians from the base to the flange, and the
distance of the fingers' inner faces in metres.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.errors import RobotError
from gendom.files import is_cut
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
    path = Path(path)
    expected = ["time", *(f"q{j}" for j in range(arm.joints))]
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, [text.strip() for text in row]) for row in reader if row]
            file.seek(0)
            whole = file.read().endswith(("\n", "\r"))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RobotError(
            f"cannot be read ({error})", where=str(path), fix="save it as CSV"
        ) from None
    header = lines[0][1] if lines else []
    if header not in (expected, [*expected, "gripper"]) or len(lines) < 2:
        raise RobotError(
            f"has the header {','.join(header)[:60]!r}" if len(lines) != 1 else "has no rows",
            where=str(path),
            fix=f"write rows under {','.join(expected)}[,gripper]",
        )
    number, last = lines[-1]
    if on_cut is not None and not whole and len(lines) > 2 and is_cut(last, len(header)):
        on_cut(number)
        del lines[-1]
    table = np.empty((len(lines) - 1, len(header)))
    for i, (number, row) in enumerate(lines[1:]):
        where = f"{path}, line {number}"
        try:
            table[i] = [float(text) for text in row]
        except ValueError:
            table[i] = np.nan
        said = f"is no joint state: {','.join(row)[:60]!r}"
        fix = "give seconds, radians and metres"
        require(np.isfinite(table[i]).all(), said, where=where, fix=fix, error=RobotError)
        if i:
            before, time = table[i - 1 : i + 1, 0]
            said = f"time goes from {before:g} to {time:g} s"
            require(time > before, said, where=where, fix="sort the rows", error=RobotError)
        _check_state(arm, table[i, 1:], where)
    opening = table[:, -1] if len(header) > len(expected) else None
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
