"""Run jobs on a Ray cluster."""

from __future__ import annotations

import logging
import os
import secrets
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import Any
from unittest.mock import patch

from gendom.errors import DeviceError, GendomError
from gendom.installation import how_to_install

RETRIES = 5
"""How often a job is restarted after its worker died."""

# Variables that keep Ray from its usage report and a warning, and those by which a cluster of this
# machine listens on its own address alone, as Ray does on Windows and macOS, and asks for a token.
QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_AUTH_MODE": "token"}


def on_cluster(
    simulate: Callable[..., Any],
    jobs: Sequence[range],
    address: str,
    device: str,
    settings: Iterable[Any] = (),
) -> Iterator[tuple[range, Any]]:
    """Run jobs with one worker for each core or GPU, and yield jobs and results as they finish.

    If a worker dies, its job is restarted on another one.

    Args:
        simulate: Called as ``simulate(job, device=...)`` on a worker.
        jobs: Jobs to run.
        address: ``local``: cores or GPUs of this machine; ``auto`` or ``ray://HOST:PORT``: a
            running cluster.
        device: ``cpu`` or ``cuda``; on CUDA a worker has one GPU.
        settings: Objects that `simulate` holds; workers need not be able to import their classes.

    Raises:
        DeviceError: Ray is not installed, or there is no such cluster, or it lacks GPUs.
        GendomError: What `simulate` raises.
    """
    needs = {"num_gpus": 1} if device.startswith("cuda") else {"num_cpus": 1}
    kind = "GPU" if "num_gpus" in needs else "CPU"
    with _connected(address) as ray:
        if not ray.cluster_resources().get(kind):
            raise DeviceError(f"the cluster has no {kind}", where=f"--cluster {address}")
        for name in {type(part).__module__ for part in settings if is_dataclass(part)}:
            if not name.startswith("gendom."):
                ray.cloudpickle.register_pickle_by_value(sys.modules[name])
        work = ray.remote(max_retries=RETRIES, **needs)(lambda run, job: run(job, device=device))
        shared = ray.put(simulate)
        waiting = {work.remote(shared, job): job for job in jobs}
        try:
            while waiting:
                for done in ray.wait(list(waiting))[0]:
                    yield waiting.pop(done), ray.get(done)
        except ray.exceptions.RayTaskError as error:
            cause = error.cause if isinstance(error.cause, GendomError) else None
            raise cause or error from None
        except ray.exceptions.RayError as error:
            what = f"a job was lost {RETRIES + 1} times ({str(error).splitlines()[0]})"
            fix = "look at the cluster's log; run the same command again to go on"
            raise DeviceError(what, where=f"--cluster {address}", fix=fix) from None
        finally:
            for task in waiting:
                ray.cancel(task, force=True)


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Ray, connected to a cluster, or with one that it starts."""
    own = "ray" not in sys.modules or not sys.modules["ray"].is_initialized()
    local = own and address == "local"
    closed = LOOPBACK | {"RAY_AUTH_TOKEN": secrets.token_hex(32)} if local else {}
    variables = {n: v for n, v in (QUIET | closed).items() if n not in os.environ}
    with patch.dict(os.environ, variables):  # those that somebody has set stay as they are
        try:
            import ray  # reads the variables
        except ImportError:
            fix = how_to_install("cluster")
            raise DeviceError("Ray is not installed", where="--cluster", fix=fix) from None
        where: dict[str, Any] = {"include_dashboard": False}
        where = where if address == "local" else {"address": address}
        try:
            if own:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # the client warns of what is told below
                    ray.init(logging_level=logging.ERROR, log_to_driver=False, **where)
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            what = f"no cluster answers there ({str(error).partition(chr(10))[0]})"
            fix = "start one with ray start --head, or give local"
            raise DeviceError(what, where=f"--cluster {address}", fix=fix) from None
        try:
            yield ray
        finally:
            if own:
                ray.shutdown()
