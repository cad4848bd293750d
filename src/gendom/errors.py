"""Faults that the user can mend.

Every message is one line: where, what, and what to do about it. The command line prints it
without a traceback and exits with code 2.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

LONGEST = 4000
"""Most characters of a message's line."""


class GendomError(Exception):
    """Base of all faults that the user can mend.

    Args:
        what: What is wrong.
        where: The file, field, frame or flag it was found in.
        fix: What to do about it.

    `str()` gives "where: what; fix", without the parts left out.
    """

    def __init__(self, what: str, *, where: str | None = None, fix: str | None = None):
        self.what = what
        self.where = where
        self.fix = fix
        super().__init__(one_line(what, where=where, fix=fix))


class RecordingError(GendomError):
    """A recording cannot be read, written or used.

    `faults` lists everything that was found (`gendom.datasets.Fault`); the message then has one
    line for each.
    """

    def __init__(
        self,
        what: str = "",
        *,
        where: str | None = None,
        fix: str | None = None,
        faults: Sequence[Any] = (),
    ):
        super().__init__(what, where=where, fix=fix)
        self.faults = tuple(faults)

    def __str__(self) -> str:
        lines = [one_line(str(fault), where=self.where) for fault in self.faults]
        return "\n".join(lines) or super().__str__()


class ParameterError(GendomError):
    """A material, simulation or method parameter is out of its range."""


class DeviceError(GendomError):
    """A compute device, camera or robot is absent or refuses."""


class RobotError(GendomError):
    """A pose, path or motion is out of the robot's reach or limits."""


class SimulationError(GendomError):
    """A simulation left the range in which it means anything (NaN, inversion, escape).

    Attributes:
        world: Index of the world in the batch, or None.
        time: Simulated time of the fault [s], or None.
        parameters: That world's parameters by name, e.g. {"E": 5e3, "nu": 0.3}.
        particle: Index of the first particle concerned, or None.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        fix: str | None = None,
        world: int | None = None,
        time: float | None = None,
        parameters: Mapping[str, float] | None = None,
        particle: int | None = None,
    ):
        self.world = world
        self.time = time
        self.parameters = dict(parameters or {})
        self.particle = particle
        super().__init__(what, where=where, fix=fix)


class PolicyError(GendomError):
    """A policy file cannot be used, or a goal lies outside what the policy was trained on."""


class DatasetError(GendomError):
    """A set of demonstrations is missing, incomplete or of another kind."""


def one_line(what: str, *, where: str | None = None, fix: str | None = None) -> str:
    """ "where: what; fix", without the parts left out.

    It is `printable`, and what is longer than `LONGEST` is cut.
    """
    line = f"{where}: {what}" if where else what
    line = f"{line}; {fix}" if fix else line
    line = line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"
    return printable(line)


def printable(text: object) -> str:
    """A text in which what a terminal would not print but obey, newlines and bytes of names that
    are no text included, is escaped as in JSON. Names of files and words of files are shown by it.
    """
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in str(text))


def did_you_mean(word: str, names: Iterable[str], *, cutoff: float = 0.5) -> str:
    """A question that suggests the closest of several names; empty where none is as close as
    `cutoff`, of 1."""
    known = {name.strip("-").lower(): name for name in names}
    near = difflib.get_close_matches(word.strip("-").lower(), known, n=1, cutoff=cutoff)
    return f"did you mean {known[near[0]]!r}?" if near else ""
