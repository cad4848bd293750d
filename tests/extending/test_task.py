"""A new task is one class, in a file that is named or in a package with an entry point."""

import json
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "rope_dragging.py"


def test_a_package_adds_a_task(outside, tmp_path):
    outside.add("dragging", EXAMPLE.read_text(encoding="utf-8"), tasks="RopeDragging")
    drags = tmp_path / "drags"
    made = outside.gendom("dataset", "rope-dragging", "--size", 3, "--out", drags, "--seed", 1)
    assert made.returncode == 0, made.stderr
    assert json.loads((drags / "dataset.json").read_text())["task"]["name"] == "rope-dragging"


def test_a_package_that_cannot_be_imported_stops_nothing(outside):
    outside.add("broken", "import no_such_module", tasks="Task")
    listed = outside.gendom("act", "knitting")
    assert listed.returncode == 2
    assert "'broken' (broken:Task) is left out: ModuleNotFoundError" in listed.stderr
    assert "choose rope-reaching" in listed.stderr
    assert "Traceback" not in listed.stderr
