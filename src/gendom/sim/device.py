"""The devices that simulations run on."""

import functools
import os
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from gendom.errors import DeviceError

making = threading.RLock()
"""Held while a simulator and its kernels are made: Warp compiles for one thread at a time."""

_in_use: defaultdict[str, Any] = defaultdict(threading.RLock)


def open_device(name: str) -> Any:
    """The Warp device of that name.

    Raises:
        DeviceError: If there is none, with what to use instead.
    """
    _start_warp()
    try:
        if name.startswith("cuda") and not wp.is_cuda_available():
            raise ValueError(name)
        return wp.get_device(name)
    except (ValueError, RuntimeError):
        raise DeviceError(
            f"there is no device {name!r} on this machine",
            where="device",
            fix="use --device cpu, or install an NVIDIA driver for cuda",
        ) from None


def list_devices(names: str) -> list[str]:
    """The devices that a list with commas names, or ``all`` CUDA devices.

    Raises:
        DeviceError: If one is not there.
    """
    if names != "all":
        return [open_device(name.strip()).alias for name in names.split(",")]
    open_device("cuda")
    return [device.alias for device in wp.get_cuda_devices()]


@contextmanager
def claimed(name: str) -> Iterator[None]:
    """Reserve a GPU for the simulation of one thread; others wait.

    What a thread does before and after then goes on beside another's simulation.
    """
    device = open_device(name)
    if not device.is_cuda:
        yield
        return
    with _in_use[device.alias]:
        yield


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _start_warp() -> None:
    """Start Warp without its banner and its remark that a machine has no GPU."""
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    sys.stderr.flush()
    kept = os.dup(2)  # the remark comes from native code, past sys.stderr
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
