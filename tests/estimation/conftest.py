"""A lift of the shared rope, and what one start finds of it."""

from types import SimpleNamespace

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gendom.estimation import EstimateSettings, estimate


@pytest.fixture(scope="session")
def settings(rope_lift):
    return EstimateSettings(starts=1, scene=rope_lift.settings)


@pytest.fixture(scope="session")
def lifted(rope_lift):
    return rope_lift.seen()


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture(scope="session")
def watched(lifted, settings):
    """What is found, reports on the way, and threads of BLAS before, meanwhile and after."""
    reports, during = [], set()

    def told(progress):
        reports.append(progress)
        during.update(blas_threads())

    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        found = estimate(lifted, settings, on_progress=told)
        threads = before, during, blas_threads()
    return SimpleNamespace(found=found, reports=reports, threads=threads)


@pytest.fixture(scope="session")
def found(watched):
    return watched.found
