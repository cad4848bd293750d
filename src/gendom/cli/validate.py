"""`gendom validate`: measure the simulator against analytic mechanics."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

from gendom.files import to_json

if TYPE_CHECKING:
    from gendom.validation import Check, Result

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Measure the simulator against problems of mechanics with known solutions.

    Exit code 0: every error is within what is allowed. 1: at least one is not.

    For example: gendom validate --only cantilever torsion --quick
    """

    only: tuple[str, ...] = ()
    """Names of the cases to run; by default all."""
    engine: Literal["mpm", "thin"] | None = None
    """Only cases of this engine."""
    list: bool = False
    """List the cases and stop."""
    quick: bool = False
    """Small sizes, seconds instead of minutes."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    dtype: Literal["float32", "float64"] = "float64"
    """Precision of the simulations."""
    threads: int | None = None
    """Worlds simulated side by side on the CPU; by default all cores."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.sim import open_device
        from gendom.validation import Settings, choose, run_cases

        cases = choose(self.only, self.engine)
        if self.list:
            entries = [
                {"name": case.name, "title": case.title, "engine": case.engine} for case in cases
            ]
            width = max(len(case.name) for case in cases)
            lines = [f"{case.name:<{width}}  {case.title}" for case in cases]
            print(to_json({"cases": entries}) if self.json else "\n".join(lines))
            return 0
        open_device(self.device)
        began = time.monotonic()
        settings = Settings(
            device=self.device, dtype=self.dtype, quick=self.quick, threads=self.threads
        )
        results = []
        for result in run_cases(cases, settings):
            results.append(result)
            verdict = "passed" if result.passed else "FAILED"
            log.info("%s %s in %.1f s", result.case.name, verdict, result.seconds)
        passed = all(result.passed for result in results)
        if self.json:
            summary = {
                "settings": settings,
                "passed": passed,
                "seconds": time.monotonic() - began,
                "cases": [result_entry(result) for result in results],
            }
            print(to_json(summary))
        else:
            print(results_text(results))
            print(f"took {time.monotonic() - began:.3g} s")
        return 0 if passed else 1


def result_entry(result: Result) -> dict[str, Any]:
    """A case's result for JSON."""
    return {
        "name": result.case.name,
        "title": result.case.title,
        "passed": result.passed,
        "failure": result.failure,
        "seconds": result.seconds,
        "checks": [{**asdict(check), "passed": check.passed} for check in result.checks],
    }


def results_text(results: Sequence[Result]) -> str:
    """A table for people: one line a check, and where the expected values come from."""
    head = ("quantity", "expected", "measured", "error", "allowed", "")
    rows = [_cells(check) for result in results for check in result.checks]
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return "  ".join([first, *rest]).rstrip()

    lines = []
    for result in results:
        lines += [f"{result.case.name}: {result.case.title}", "  " + line(head)]
        lines += ["  " + line(_cells(check)) for check in result.checks]
        if result.failure is not None:
            lines.append(f"  FAILED: {result.failure}")
        sources = dict.fromkeys(check.source for check in result.checks)
        lines += [f"  source: {source}" for source in sources] + [""]
    checks = [check for result in results for check in result.checks]
    short = sum(not check.passed for check in checks)
    stopped = sum(result.failure is not None for result in results)
    tail = f"{len(checks) - short} of {len(checks)} checks within what is allowed"
    if stopped:
        tail += f"; {stopped} case{'s' * (stopped > 1)} stopped"
    return "\n".join([*lines, tail])


def _cells(check: Check) -> tuple[str, ...]:
    unit = "" if check.unit == "-" else f" {check.unit}"
    if check.relative:
        error, allowed = f"{100.0 * check.error:.2g} %", f"{100.0 * check.allowed:.2g} %"
    else:
        error, allowed = f"{check.error:.2g}{unit}", f"{check.allowed:.2g}{unit}"
    return (
        check.quantity,
        f"{check.expected:.5g}{unit}",
        f"{check.measured:.5g}{unit}",
        error,
        allowed,
        "" if check.passed else "FAILED",
    )
