"""``python -m validation``: measure the simulator against mechanics with known solutions."""

import argparse
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict

from gendom.cli.outputs import columns
from gendom.errors import GendomError
from gendom.files import to_json
from gendom.sim import open_device
from validation import Bench, Result, Row, choose, run_case

log = logging.getLogger("validation")


def main(words: Sequence[str] | None = None) -> int:
    """Run the cases and print their rows.

    Returns:
        0: every error is within what is allowed; 1: at least one is not; 2: bad flags.
    """
    parser = argparse.ArgumentParser(prog="python -m validation", description=__doc__)
    add = parser.add_argument
    add("--only", nargs="+", default=[], metavar="NAME", help="names of the cases to run")
    add("--engine", choices=("mpm", "thin"), help="only cases of this engine")
    add("--list", action="store_true", help="list the cases and stop")
    add("--quick", action="store_true", help="small sizes, seconds instead of minutes")
    add("--device", default="cpu", help="cpu, cuda or cuda:0 and so on")
    add("--dtype", choices=("float32", "float64"), default="float64", help="default: float64")
    add("--threads", type=int, help="worlds side by side on the CPU; by default all cores")
    add("--json", action="store_true", help="print JSON")
    flags = parser.parse_args(words)
    logging.basicConfig(format="validation: %(message)s", level=logging.INFO)
    try:
        return _run(flags)
    except GendomError as error:
        print(f"validation: {error}", file=sys.stderr)
        return 2


def _run(flags: argparse.Namespace) -> int:
    cases = choose(flags.only, flags.engine)
    if flags.list:
        entries = [{"name": c.name, "title": c.title, "engine": c.engine} for c in cases]
        lines = [f"{case.name:<18}  {case.title}" for case in cases]
        print(to_json({"cases": entries}) if flags.json else "\n".join(lines))
        return 0
    open_device(flags.device)
    began = time.monotonic()
    settings = {name: getattr(flags, name) for name in ("device", "dtype", "quick", "threads")}
    results = []
    for one in cases:
        result = run_case(one, Bench(**settings))
        results.append(result)
        verdict = "passed" if result.passed else "FAILED"
        log.info("%s %s in %.1f s", one.name, verdict, result.seconds)
    passed, seconds = all(result.passed for result in results), time.monotonic() - began
    if flags.json:
        entries = []
        for one in results:
            rows = [{**asdict(row), "error": row.error, "passed": row.passed} for row in one.rows]
            head = {"name": one.case.name, "title": one.case.title, "passed": one.passed}
            more = {"failure": one.failure, "seconds": one.seconds, "checks": rows}
            entries.append(head | more)
        whole = {"settings": settings, "passed": passed, "seconds": seconds, "cases": entries}
        print(to_json(whole))
    else:
        print(_text(results))
        print(f"took {seconds:.3g} s")
    return 0 if passed else 1


def _text(results: Sequence[Result]) -> str:
    """Tables for people: one line a row, and where the expected values come from."""
    head, lines = ("quantity", "expected", "measured", "error", "allowed", ""), []
    for result in results:
        lines.append(f"{result.case.name}: {result.case.title}")
        table = columns(head, map(_cells, result.rows)).splitlines()
        lines += [f"  {line.rstrip()}" for line in table]
        if result.failure is not None:
            lines.append(f"  FAILED: {result.failure}")
        sources = dict.fromkeys(row.source for row in result.rows)
        lines += [f"  source: {source}" for source in sources] + [""]
    rows = [row for result in results for row in result.rows]
    stopped = sum(result.failure is not None for result in results)
    tail = f"{sum(row.passed for row in rows)} of {len(rows)} checks within what is allowed"
    if stopped:
        tail += f"; {stopped} case{'s' * (stopped > 1)} stopped"
    return "\n".join([*lines, tail])


def _cells(row: Row) -> tuple[str, ...]:
    unit = "" if row.unit == "-" else f" {row.unit}"
    if row.relative:
        error, allowed = f"{100.0 * row.error:.2g} %", f"{100.0 * row.allowed:.2g} %"
    else:
        error, allowed = f"{row.error:.2g}{unit}", f"{row.allowed:.2g}{unit}"
    verdict = "" if row.passed else "FAILED"
    expected, measured = f"{row.expected:.5g}{unit}", f"{row.measured:.5g}{unit}"
    return row.quantity, expected, measured, error, allowed, verdict


if __name__ == "__main__":
    sys.exit(main())
