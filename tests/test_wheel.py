"""The wheel: what is in it, and that it works where there is nothing else of this repository."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from gendom import __version__

REPOSITORY = Path(__file__).parents[1]
PACKAGE = REPOSITORY / "src" / "gendom"

pytestmark = pytest.mark.slow


def run(*words, **options):
    """Run a program outside of the repository, without what this process has on its paths."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(word) for word in words]
    done = subprocess.run(words, capture_output=True, text=True, env=kept, **options)
    assert done.returncode == 0, f"{' '.join(words)}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    run(*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", out, REPOSITORY, cwd=out)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Makes an environment of Python 3.11 and so on that has the wheel, with the versions that the
    tests run with; gives its folder. It skips where there is no such Python."""

    @cache
    def make(minor: int) -> Path:
        root, name = tmp_path_factory.mktemp("place"), f"python3.{minor}"
        own = [sys.executable] * (minor == sys.version_info.minor)
        known = [shutil.which(name), *Path.home().glob(f".pyenv/versions/3.{minor}.*/bin/{name}")]
        words = ("-m", "venv", str(root / "venv"))
        tried = (subprocess.run([p, *words], capture_output=True) for p in (*own, *known) if p)
        if not any(done.returncode == 0 for done in tried):
            pytest.skip(f"there is no {name}")
        pip = [root / "venv/bin/python", "-m", "pip", "--disable-pip-version-check"]
        run(*pip, "install", "--quiet", "-c", REPOSITORY / "constraints.txt", wheel, cwd=root)
        return root

    return make


def test_the_wheel_has_every_file_of_the_package(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    ours = {p.relative_to(PACKAGE.parent).as_posix() for p in PACKAGE.rglob("*") if p.is_file()}
    assert {name for name in ours if "__pycache__" not in name} <= names
    endings = Counter(Path(name).suffix for name in names)
    assert endings[".onnx"] >= 5 and endings[".h"] >= 3
    assert {"gendom/py.typed", "gendom/assets/demo-rope-lift.npz"} <= names
    assert not [name for name in names if name.startswith(("tests", "docs", "src"))]


@pytest.mark.parametrize("minor", [11, 12, 13])
def test_the_program_works_without_a_clone(installed, minor):
    place = installed(minor)

    def gendom(*words):
        return run(place / "venv/bin/gendom", *words, cwd=place)

    assert gendom("--version") == f"gendom {__version__}\n"
    assert "usage: gendom COMMAND" in gendom("--help")
    # policies and materials are there
    policies = json.loads(gendom("policies", "--json"))["policies"]
    assert "rope-casting" in {policy["task"] for policy in policies}
    assert "cotton-rope: soft braided" in gendom("materials", "cotton-rope")
    # it acts
    rope = "--length 0.5 --diameter 0.012 --E 1e6 --density 900 --nu 0.35"
    told = gendom("act", "rope-casting", "--goal", "0.35", "0.07", *rope.split(), "--force")
    assert re.search(r"\d", told)
    # it reads the recording that it brings
    code = "from importlib.resources import files; print(files('gendom') / 'assets')"
    assets = Path(run(place / "venv/bin/python", "-c", code, cwd=place).strip())
    assert assets.is_relative_to(place)
    assert "can be used" in gendom("check", assets / "demo-rope-lift.npz")


def test_the_demo_runs_without_extras(installed):
    """The action in our own simulator; how to get the second reality is said."""
    place = installed(sys.version_info.minor)
    told = run(place / "venv/bin/gendom", "demo", "--starts", "1", cwd=place)
    assert "off by: with the estimate" in told and (place / "demo/report.html").exists()
    page = (place / "demo/report.html").read_text(encoding="utf-8")
    assert "carried out in our own simulator" in page
