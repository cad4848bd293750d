"""Recordings and calibrations with faults, and the tables of what was said of them."""

import json
import re
from importlib.util import find_spec

import pytest

from experiments.calibration import FAULTS
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


def test_the_table_counts_and_resumes(rope_lift, tmp_path, table):
    """Cases that are kept are not estimated again."""
    for seed in range(3):
        row = {case: answers(False) for case in CORRUPTED}
        row[GOOD] = answers(True, right=True)
        row["mass x 10"] = answers(seed > 0, right=seed > 1, ratio=10.0)
        rope_lift.seen().write(tmp_path / f"rope-{seed:04d}.npz")
        for case, answer in row.items():
            name = re.sub(r"\W+", "-", f"verdict-rope-{seed:04d}-{case}")
            (tmp_path / f"{name}.json").write_text(json.dumps(answer))
    said = table("verdict", "--lifts", 3)
    assert "E / true E at worst" in said and "seed 1, mass x 10: E x 10.00" in said
    result = json.loads((tmp_path / "verdict-rope.json").read_text())
    assert result["cases"] == confusion(result["rows"])
    assert result["cases"][GOOD] == {"refused": 0, "right": 3, "wrong": 0}
    assert result["cases"]["mass x 10"] == {"refused": 1, "right": 1, "wrong": 1}


@pytest.mark.skipif(not find_spec("cv2"), reason="needs the extra `camera`")
def test_every_fault_of_a_calibration_is_named_or_covered(tmp_path, table):
    faults = table("calibration", "--lifts", 1, "--json")["faults"]
    assert list(faults) == list(FAULTS)
    for name, found in faults.items():
        assert found["held"] == 1.0, name
        if FAULTS[name] and "0.5 to 5" not in name and "principal" not in name:
            assert found["named"] == 1, name
    assert faults["none"]["refused"] == faults["one pose, 2 to 30 mm"]["refused"] == 0
    text = (tmp_path / "calibration.txt").read_text()
    assert all(name in text for name in FAULTS)
