"""A lift of the shared rope, and what one start finds of it."""

from dataclasses import dataclass, field

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gendom.estimation import EstimateSettings, FittedEstimate, Progress, estimate


@pytest.fixture(scope="session")
def settings(rope_lift):
    return EstimateSettings(starts=1, scene=rope_lift.settings)


@pytest.fixture(scope="session")
def lifted(rope_lift):
    return rope_lift.seen()


@dataclass
class Watched:
    """An estimate, and what was to be seen while it was made."""

    reports: list[Progress] = field(default_factory=list)
    threads: list[set[int]] = field(default_factory=lambda: [set()] * 3)
    """Of BLAS: before, during and after."""
    found: FittedEstimate | None = None


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture(scope="session")
def watched(lifted, settings):
    seen, during = Watched(), set()

    def told(progress):
        seen.reports.append(progress)
        during.update(blas_threads())

    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        seen.found = estimate(lifted, settings, on_progress=told)
        seen.threads = [before, during, blas_threads()]
    return seen


@pytest.fixture(scope="session")
def found(watched):
    return watched.found
