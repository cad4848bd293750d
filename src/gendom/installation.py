"""Whether this package runs from a clone, its version, and how to install an extra."""

import logging
import os
import subprocess
from pathlib import Path
from typing import Any

from gendom import __version__
from gendom.errors import DeviceError

_log = logging.getLogger(__name__)


def clone() -> Path | None:
    """The folder of the clone that this package runs from, None where it is installed."""
    folder = Path(__file__).parents[2]
    return folder if (folder / "pyproject.toml").is_file() else None


def version() -> str:
    """The version; in a clone with the commit, and a ``+`` where files differ from it."""
    folder = clone()
    if folder is None:
        return __version__
    words = ["git", "-C", str(folder), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        commit = subprocess.run(words, capture_output=True, text=True, timeout=5.0, check=True)
    except (OSError, subprocess.SubprocessError):  # no git, or no repository
        return __version__
    return f"{__version__} ({commit.stdout.strip()})"


def how_to_install(extra: str) -> str:
    """The command that installs an extra. The package is on no index: outside of a clone, pip uses
    the installed one."""
    folder = clone()
    return f"pip install -e '{folder}[{extra}]'" if folder else f"pip install 'gendom[{extra}]'"


gl_faults: list[tuple[str, str]] = []
"""What MUJOCO_GL asked for and what MuJoCo raised, if `load_mujoco` had to turn rendering off."""


def load_mujoco() -> Any:
    """Import the module `mujoco`.

    Rendering is off-screen if there is no screen. Warnings go to gendom's log; by default MuJoCo
    would write MUJOCO_LOG.TXT into the working directory.

    Raises:
        DeviceError: It is not installed.
    """
    if headless():
        # mujoco reads this variable on import, and the import fails if the library is missing
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except (ImportError, AttributeError, OSError, RuntimeError) as error:
        fault = os.environ.get("MUJOCO_GL", ""), f"{type(error).__name__}: {error}"
        os.environ["MUJOCO_GL"] = "disable"
        try:
            import mujoco
        except ImportError:
            what, fix = "MuJoCo is not installed", how_to_install("reality")
            raise DeviceError(what, where="reality", fix=fix) from None
        gl_faults.append(fault)
    module: Any = mujoco
    if module.get_mju_user_warning() is None:
        module.set_mju_user_warning(_log.debug)
    return module


def headless() -> bool:
    """Whether there is no screen."""
    return not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
