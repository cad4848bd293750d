"""In a clone and elsewhere: the version, and how extras are added."""

import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from gendom import __version__, installation
from gendom.installation import clone, how_to_install, version


def test_a_clone_tells_its_commit(tmp_path, monkeypatch):
    """An installed package has none."""
    monkeypatch.setattr(installation, "__file__", str(tmp_path / "src" / "gendom" / "file.py"))
    assert clone() is None and version() == __version__
    assert how_to_install("train") == "pip install 'gendom[train]'"
    (tmp_path / "pyproject.toml").touch()
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init"], ["add", "."], [*who, "commit", "-m", "First"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True, capture_output=True)
    assert re.fullmatch(rf"{re.escape(__version__)} \([0-9a-f]{{7,}}\)", version())
    (tmp_path / "pyproject.toml").write_text("[project]")
    assert version().endswith("+)") and clone() == tmp_path
    assert how_to_install("train") == f"pip install -e '{tmp_path}[train]'"


ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_every_extra_is_imported_somewhere():
    from gendom.cli import _EXTRAS

    assert set(_EXTRAS.values()) == set(PROJECT["optional-dependencies"]) - {"dev", "docs"}
    source = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py"))
    for name in _EXTRAS:
        assert re.search(rf"^\s*(import|from) {name}\b", source, re.MULTILINE), name


def test_every_place_states_one_version():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None and PROJECT["version"] == cited[1] == __version__
    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    try:
        assert metadata.version("gendom") == __version__
    except metadata.PackageNotFoundError:
        pytest.skip("gendom is not installed")


def test_the_oldest_versions_are_those_that_are_tested():
    """Lower bounds of `pyproject.toml`, but for extras that `make test-lowest` leaves out."""
    extras = PROJECT["optional-dependencies"]
    bounds = [*PROJECT["dependencies"]]
    bounds += [b for extra in ("data", "reality", "camera", "viz", "ros") for b in extras[extra]]
    tested = dict(
        line.split("==")
        for line in (ROOT / "constraints-lowest.txt").read_text().splitlines()
        if "==" in line
    )
    for bound in bounds:
        name, lowest = bound.partition(";")[0].partition(",")[0].split(">=")
        assert f"{tested[name]}.".startswith(f"{lowest}."), bound
