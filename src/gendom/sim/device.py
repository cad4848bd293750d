"""Devices for simulations."""

import functools
import os
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from gendom.arguments import check_type
from gendom.errors import DeviceError

making = threading.RLock()
"""Lock for making a simulator and its kernels: Warp compiles in one thread at a time."""

_in_use: defaultdict[str, Any] = defaultdict(threading.RLock)


def open_device(name: str) -> Any:
    """Return the Warp device with this name.

    Raises:
        ParameterError: If the name is no text.
        DeviceError: If it does not exist; the error names an alternative.
    """
    check_type("device", name, str)
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
    """Return the aliases of the devices in a comma-separated list, or of ``all`` CUDA devices.

    Raises:
        DeviceError: If a device does not exist.
    """
    if names != "all":
        return [open_device(name.strip()).alias for name in names.split(",")]
    open_device("cuda")
    return [device.alias for device in wp.get_cuda_devices()]


@contextmanager
def claimed(name: str) -> Iterator[None]:
    """Reserve a GPU for the simulation of one thread; other threads wait.

    Work outside this context can overlap with another thread's simulation.
    """
    device = open_device(name)
    if not device.is_cuda:
        yield
        return
    with _in_use[device.alias]:
        yield


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _start_warp() -> None:
    """Start Warp without its banner and its message that the machine has no GPU."""
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    sys.stderr.flush()
    kept = os.dup(2)  # native code prints the message, not through sys.stderr
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
