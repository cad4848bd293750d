"""Run jobs on a Ray cluster."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import Any

from gendom.errors import DeviceError, GendomError
from gendom.installation import how_to_install

RETRIES = 5
"""How often a job is restarted after its worker died."""


def on_cluster(
    simulate: Callable[..., Any], jobs: Sequence[range], address: str, device: str
) -> Iterator[tuple[range, Any]]:
    """Run jobs with one worker for each core or GPU, and yield jobs and results as they finish.

    If a worker dies, its job is restarted on another one.

    Args:
        simulate: Called as ``simulate(job, device=...)`` on a worker.
        jobs: Jobs to run.
        address: ``local``: cores or GPUs of this machine; ``auto`` or ``ray://HOST:PORT``: a
            running cluster.
        device: ``cpu`` or ``cuda``; on CUDA a worker has one GPU.

    Raises:
        DeviceError: Ray is not installed, or there is no such cluster, or it lacks GPUs.
        GendomError: What `simulate` raises.
    """
    with _connected(address) as ray:
        needs = {"num_gpus": 1} if device.startswith("cuda") else {"num_cpus": 1}
        kind = "GPU" if "num_gpus" in needs else "CPU"
        if not ray.cluster_resources().get(kind):
            raise DeviceError(f"the cluster has no {kind}", where=f"--cluster {address}")
        # a class loaded from a separate file cannot be imported on workers
        for name in {type(part).__module__ for part in _settings(simulate)}:
            if not name.startswith("gendom."):
                ray.cloudpickle.register_pickle_by_value(sys.modules[name])
        work = ray.remote(max_retries=RETRIES, **needs)(_work)
        shared = ray.put(simulate)
        waiting = {work.remote(shared, job, device): job for job in jobs}
        try:
            while waiting:
                for done in ray.wait(list(waiting))[0]:
                    yield waiting.pop(done), _result(ray, done, address)
        finally:
            for task in waiting:
                ray.cancel(task, force=True)


def _work(simulate: Callable[..., Any], job: range, device: str) -> Any:
    return simulate(job, device=device)


def _result(ray: Any, done: Any, address: str) -> Any:
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause if isinstance(error.cause, GendomError) else None
        raise cause or error from None
    except ray.exceptions.RayError as error:
        what = f"a job was lost {RETRIES + 1} times ({str(error).splitlines()[0]})"
        fix = "look at the cluster's log; run the same command again to go on"
        raise DeviceError(what, where=f"--cluster {address}", fix=fix) from None


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    # Ray's start-up messages and usage report
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        fix = how_to_install("cluster")
        raise DeviceError("Ray is not installed", where="--cluster", fix=fix) from None
    own = not ray.is_initialized()
    if own:
        where: dict[str, Any] = (
            {"address": address} if address != "local" else {"include_dashboard": False}
        )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the client warns of what is told below
                ray.init(logging_level=logging.ERROR, log_to_driver=False, **where)
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            reason = (str(error).splitlines() or ["no reason given"])[0]
            what = f"no cluster answers there ({reason})"
            fix = "start one with ray start --head, or give local"
            raise DeviceError(what, where=f"--cluster {address}", fix=fix) from None
    try:
        yield ray
    finally:
        if own:
            ray.shutdown()


def _settings(value: Any) -> Iterator[Any]:
    """Yield the dataclasses among the arguments of a partial call of `simulate`."""
    for inner in [*getattr(value, "args", ()), *getattr(value, "keywords", {}).values()]:
        if names := getattr(inner, "__dataclass_fields__", ()):
            yield inner
            yield from (part for n in names if is_dataclass(part := getattr(inner, n)))
