"""One simulator in a process of its own: runs when told to, answers in lines of JSON."""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from scene import Scene


class Runner(Protocol):
    """A simulator holding the scene."""

    version: str

    def reset(self) -> None:
        """Back to the start (not timed)."""
        ...

    def run(self) -> None:
        """All substeps, and the way back where a gradient is asked (timed)."""
        ...

    def figures(self) -> dict[str, float]:
        """What came out of the last run, to see that every simulator did the same."""
        ...


def serve(make: Callable[..., Runner]) -> None:
    """Make the runner, run it once so that it compiles, then once for each line of input.

    ``make`` is called with scene, dtype, threads and whether gradients are asked. It does its
    imports itself: the process has been pinned to its cores before.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--dtype", required=True)
    parser.add_argument("--threads", type=int, required=True)
    parser.add_argument("--gradient", action="store_true")
    args, _ = parser.parse_known_args()

    # what libraries print goes to stderr, away from the answers
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: args.threads])

    def answer(**values: Any) -> None:
        print(json.dumps(values), file=answers, flush=True)

    began = time.perf_counter()
    runner = make(Scene.load(args.scene), args.dtype, args.threads, args.gradient)
    runner.reset()
    runner.run()
    first = time.perf_counter() - began
    answer(version=runner.version, first_seconds=first, peak_rss=peak_rss())
    for _ in sys.stdin:
        runner.reset()
        began = time.perf_counter()
        runner.run()
        seconds = time.perf_counter() - began
        answer(seconds=seconds, peak_rss=peak_rss(), **runner.figures())


def peak_rss() -> int:
    """Largest resident memory of this process so far [bytes]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    raise RuntimeError("/proc/self/status has no VmHWM")
