"""Whether this package runs from a clone, its version, and how to install an extra."""

from __future__ import annotations

import subprocess
from pathlib import Path

from gendom import __version__


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
