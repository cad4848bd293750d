"""Packages of other people, installed beside ours for one test."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


class Outside:
    """A package that is not ours, and the command line that finds it."""

    def __init__(self, folder: Path):
        self.folder = folder

    def add(self, module: str, code: str, **points: str) -> None:
        """Install a module.

        Args:
            module: Its name.
            code: Its text.
            points: An object of the module for each kind of entry point, ``tasks="Dragging"``.
        """
        (self.folder / f"{module}.py").write_text(code, encoding="utf-8")
        info = self.folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        lines = [f"[gendom.{k}]\n{module} = {module}:{name}\n" for k, name in points.items()]
        (info / "entry_points.txt").write_text("".join(lines))

    def gendom(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Run a command that may use the package, and return it with its output."""
        path = os.pathsep.join([str(self.folder), *filter(None, sys.path)])
        return subprocess.run(
            [sys.executable, "-m", "gendom", *map(str, words)],
            capture_output=True,
            text=True,
            encoding="utf-8",
            env={**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"},
            cwd=self.folder,
            check=False,
        )


@pytest.fixture
def outside(tmp_path) -> Outside:
    folder = tmp_path / "site"
    folder.mkdir()
    return Outside(folder)
