"""Every example and notebook runs from top to bottom, and writes where it is told to only."""

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCRIPTS = {  # what is written into --out, and packages of extras that are needed
    "01_simulate_a_rope": ("rope.gif", ""),
    "02_your_own_recording": ("lift.npz", ""),
    "03_estimate": ("estimate.json report.html", ""),
    "04_differentiate_a_drag": ("", "torch"),
    "05_act_in_mujoco": ("", "mujoco"),
    "06_gymnasium_loop": ("", "mujoco gymnasium"),
    "07_your_own_object": ("rope.toml", "mujoco"),
    "08_train_a_policy": ("casting.onnx casts", "torch onnx"),
    "09_ppo": ("", "torch gymnasium"),
}
pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="no examples beside the tests")


def contents(folder: Path) -> set[Path]:
    """Files below a folder, but for caches."""
    return {p for p in folder.rglob("*") if "__pycache__" not in p.parts}


def test_examples_use_public_names():
    """Those of gendom or one level below; the one of PyTorch has a module of its own. They are
    short and say what they show; one holds a whole algorithm."""
    assert {path.stem for path in EXAMPLES.glob("[0-9]*.py")} == set(SCRIPTS)
    for path in EXAMPLES.glob("*.py"):
        text, most = path.read_text(encoding="utf-8"), 140 if path.stem == "09_ppo" else 75
        assert len(text.splitlines()) <= most and text.startswith('"""'), path.name
        assert path.stem not in SCRIPTS or " s" in text.split('"""')[1], path.name  # its run time
        for node in ast.walk(ast.parse(text)):
            module = str(node.module) if isinstance(node, ast.ImportFrom) else ""
            if module.startswith("gendom") and module not in ("gendom.cli", "gendom.sim.autograd"):
                assert module.count(".") <= 1, f"{path.name}: {module}"
                public = importlib.import_module(module).__all__
                names = {name.name for name in getattr(node, "names", ())}
                assert names <= set(public), f"{path.name}: {module}"


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """Where an example runs, with the tested code; it changes nothing beside itself."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    before = contents(EXAMPLES)
    yield tmp_path
    assert contents(EXAMPLES) == before


@pytest.mark.slow  # a step of its own in CI
@pytest.mark.parametrize("name", SCRIPTS)
def test_example_runs(name, alone):
    written, packages = map(str.split, SCRIPTS[name])
    for package in packages:
        pytest.importorskip(package)
    words = [sys.executable, str(EXAMPLES / f"{name}.py")]
    words += ["--out", "made"] if written else []
    words += ["--iterations", "2", "--worlds", "8"] if name == "09_ppo" else []
    run = subprocess.run(words, cwd=alone, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0 and run.stdout, run.stderr
    assert sorted(p.name for p in (alone / "made").glob("*")) == written
    assert [p.name for p in alone.iterdir()] == ["made"] * bool(written)


BOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, alone):
    names = ("nbformat", "nbclient", "ipykernel")
    nbformat, nbclient, _ = (pytest.importorskip(n, reason="needs the extra docs") for n in names)
    book, place = nbformat.read(path, as_version=4), {"metadata": {"path": str(alone)}}
    kept = [output for cell in book.cells for output in cell.get("outputs", ())]
    assert kept == []  # in the file
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3", resources=place).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", ())]
    assert outputs and all(output.output_type != "error" for output in outputs)
    assert list(alone.iterdir()) == []
