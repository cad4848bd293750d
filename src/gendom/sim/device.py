"""Devices for simulations."""

import contextlib
import functools
import hashlib
import logging
import os
import shutil
import stat
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import warp as wp

from gendom.arguments import check_type
from gendom.errors import DeviceError, GendomError, printable
from gendom.files import check_folder, write_json
from gendom.reading import read_json

making = threading.RLock()
"""Lock for making a simulator and its kernels: Warp compiles in one thread at a time."""

SEAL = "gendom.json"
"""File of checksums beside compiled kernels."""

_log = logging.getLogger(__name__)


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
    """Aliases of the devices in a comma-separated list, or of ``all`` CUDA devices; errors as of
    ``open_device``."""
    if names != "all":
        return [open_device(name.strip()).alias for name in names.split(",")]
    open_device("cuda")
    return [device.alias for device in wp.get_cuda_devices()]


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_kernels(module: Any, device: Any, block_dim: int | None = None) -> None:
    """Compile kernels, or load them from Warp's cache, before threads call them, for blocks of so
    many threads (1 on the CPU). What is damaged in the cache is made anew."""
    _start_warp()
    with making:
        on = wp.get_device(device)
        size = 1 if on.is_cpu else block_dim or module.options["block_dim"]
        loaded = module.execs.get((on.context, size))
        if loaded is not None and loaded.module_hash == module.get_module_hash(size):
            return
    with making, _alone(module):
        for kept in _folders(module):
            if not _is_whole(kept):
                shutil.rmtree(kept, ignore_errors=True)
        try:
            wp.load_module(module, device=device, block_dim=block_dim)
        except Exception:  # Warp's own has no class, and what is read has several
            for kept in _folders(module):
                shutil.rmtree(kept, ignore_errors=True)
            wp.load_module(module, device=device, block_dim=block_dim)
        for kept in _folders(module):
            _seal(kept)


@contextmanager
def _alone(module: Any) -> Iterator[None]:
    """One process at a time makes a module's kernels: several would write the same files."""
    file = None
    with contextlib.suppress(ImportError, OSError):  # Windows, or a folder that is read alone
        import fcntl

        file = open(Path(str(wp.config.kernel_cache_dir)) / f"{module.name}.lock", "a")  # noqa: SIM115
        fcntl.flock(file, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if file is not None:
            file.close()


def _folders(module: Any) -> list[Path]:
    """A module's in Warp's cache, one for each version of its code."""
    return list(Path(str(wp.config.kernel_cache_dir)).glob(f"wp_{module.name}_*/"))


def _checksums(folder: Path) -> dict[str, str]:
    """Of compiled kernels: a process that runs damaged ones ends without a word."""
    compiled = [path for path in folder.iterdir() if path.suffix not in (".cpp", ".cu", ".json")]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(compiled)}


def _is_whole(folder: Path) -> bool:
    """Whether what is sealed has not changed."""
    try:
        sealed = read_json(folder / SEAL) if (folder / SEAL).exists() else {}
        return sealed.items() <= _checksums(folder).items()
    except (OSError, GendomError):
        return False


def _seal(folder: Path) -> None:
    """Keep the checksums of what was loaded."""
    with contextlib.suppress(OSError, GendomError):  # another process may make it anew
        found = _checksums(folder)
        if not (folder / SEAL).exists() or read_json(folder / SEAL) != found:
            write_json(folder / SEAL, found)


def _kernel_cache() -> str | None:
    """Where compiled kernels are kept if Warp's own folder cannot be written; None: it can."""
    given = wp.config.kernel_cache_dir or os.environ.get("WARP_CACHE_PATH")
    own = given or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    try:
        if not given and not os.path.isabs(own):  # a user without a home has "~"
            raise GendomError("there is no home")
        check_folder(os.path.join(own, wp.__version__ if given else f"warp/{wp.__version__}"))
        return None
    except (GendomError, OSError):
        kept = _folder_of_this_user()
        why, fix = f"{own} cannot be written", "set WARP_CACHE_PATH to a folder that lasts"
        _log.warning("compiled kernels go to %s, since %s; %s", kept, printable(why), fix)
        return kept


def _folder_of_this_user() -> str:
    """A folder for code below that for temporary files, where nobody else can put any."""
    user = os.geteuid() if hasattr(os, "geteuid") else 0
    kept = Path(tempfile.gettempdir(), f"gendom-kernels-{user}")
    try:
        kept.mkdir(mode=0o700, exist_ok=True)
        found = kept.lstat()
        others = hasattr(os, "geteuid") and (found.st_uid != user or found.st_mode & 0o022)
        if stat.S_ISDIR(found.st_mode) and not others:
            return str(kept)
    except FileExistsError:  # no folder
        pass
    _lent.append(tempfile.TemporaryDirectory(prefix="gendom-kernels-"))
    return _lent[-1].name


_lent: list[tempfile.TemporaryDirectory] = []
"""Folders that are removed when the process ends."""


@functools.cache
def _start_warp() -> None:
    """Start Warp without its banner and its message that the machine has no GPU."""
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    if cache := _kernel_cache():
        wp.config.kernel_cache_dir = cache
    sys.stderr.flush()
    kept = os.dup(2)  # native code prints the message, not through sys.stderr
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
