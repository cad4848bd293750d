"""The devices that simulations run on."""

import functools
import os
import sys
from typing import Any

import warp as wp

from gendom.errors import DeviceError


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
