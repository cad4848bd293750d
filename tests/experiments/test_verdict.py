"""Recordings that are corrupted, and the table of what was said of them."""

import json
import re

import pytest

from experiments.__main__ import main
from experiments.verdict import CORRUPTED, GOOD, confusion
from gendom.datasets import Recording


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen()


@pytest.mark.parametrize("case", CORRUPTED)
def test_each_corrupts_a_recording(lifted, case):
    corrupted = CORRUPTED[case](lifted)
    assert isinstance(corrupted, Recording) and corrupted.digest != lifted.digest


def answers(usable, *, right=False, ratio=1.0):
    if not usable:
        return {"usable": False, "reasons": ["so"]}
    ratios = {"E_over_rho": 1.0, "E": ratio}
    return {"usable": True, "right": right, "ratios": ratios}


def test_the_table_counts_and_resumes(rope_lift, tmp_path, capsys):
    """Cases that are kept are not estimated again."""
    for seed in range(3):
        row = {case: answers(False) for case in CORRUPTED}
        row[GOOD] = answers(True, right=True)
        row["mass x 10"] = answers(seed > 0, right=seed > 1, ratio=10.0)
        rope_lift.seen().write(tmp_path / f"rope-{seed:04d}.npz")
        for case, answer in row.items():
            name = re.sub(r"\W+", "-", f"verdict-rope-{seed:04d}-{case}")
            (tmp_path / f"{name}.json").write_text(json.dumps(answer))
    words = ["verdict", "--lifts", "3", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "E / true E at worst" in said and "seed 1, mass x 10: E x 10.00" in said
    result = json.loads((tmp_path / "verdict-rope.json").read_text())
    assert result["cases"] == confusion(result["rows"])
    assert result["cases"][GOOD] == {"refused": 0, "right": 3, "wrong": 0}
    assert result["cases"]["mass x 10"] == {"refused": 1, "right": 1, "wrong": 1}
