"""`gendom check`: what `gendom doctor` finds, without its picture; and an estimate beside what is
known of the object."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gendom.arguments import require
from gendom.cli.arguments import Json
from gendom.cli.doctor import examine
from gendom.cli.outputs import print_result
from gendom.errors import GendomError
from gendom.materials.estimate import Estimate


@dataclass(frozen=True, kw_only=True)
class Command:
    """Validate a recording, or whatever lies there, and print what is in it.

    Exit code 0: it can be used, perhaps with warnings. 2: it cannot; every fault is listed.

    With --bending-length an estimate is compared with what a cantilever test has measured of the
    same object, which checks the cameras, the gripper's path and the scale. Exit code 3: they
    disagree.

    For example: gendom check lift.npz
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A recording, or what gendom doctor takes."""
    bending_length: float | None = None
    """Measured of the object of an estimate [m]: half of the length that hangs over an edge when
    the line from there to its tip falls by 41.5 degrees (ASTM D1388)."""
    json: Json = False

    def run(self) -> int:
        if self.bending_length is not None:
            return compared(self.recording, self.bending_length, json=self.json)
        return examine(self.recording, json=self.json)


MEASURED = 0.05
"""Standard deviation of the logarithm of a bending length from a cantilever test: the two faces and
several strips of one sheet differ by as much."""


def compared(place: Path, measured: float, *, json: bool) -> int:
    """Print an estimate's bending length beside a measured one; the exit code.

    Args:
        place: File of an estimate that is usable, or its folder.
        measured: Bending length (E I / weight per length)^(1/3) [m].

    Raises:
        GendomError: One of them cannot be used.
    """
    fix = "give metres"
    require(0.0 < measured < math.inf, f"is {measured:g}", where="--bending-length", fix=fix)
    place = place / "estimate.json" if place.is_dir() else place
    found = Estimate.load(place, even_unusable=False)
    ends = found.interval("bending_length")
    if ends is None:
        what = "has no interval of the bending length"
        raise GendomError(what, where=str(place), fix="compare what gendom estimate wrote")
    # a strip of a sheet stays flat across, which stiffens it
    strip = 1.0 if found.kind == "rope" else (1.0 - found.nu**2) ** (-1.0 / 3.0)
    value, ends = strip * found.bending_length, [strip * end for end in ends]
    off = math.log(value / measured)
    # both ends of the interval and the measurement's own 90 %, in squares
    allowed = math.hypot(math.log(ends[off < 0.0] / value), 1.645 * MEASURED)
    agree = abs(off) <= allowed
    of = {"path": place, "bending_length": value, "interval": ends, "measured": measured}
    said = "they agree" if agree else f"they disagree, {math.expm1(allowed):.0%} would be usual"
    text = f"{place}: bending length {value:.4g} m [{ends[0]:.4g}, {ends[1]:.4g}], measured "
    text += f"{measured:.4g} m ({math.expm1(off):+.1%}): {said}"
    if not agree:
        text += "; check the mass, the sizes, the scale of the clouds and the cameras' poses"
    print_result({**of, "agree": agree}, text, [], json=json)
    return 0 if agree else 3
