"""Faults of calibrations: each named, or covered by what is stated."""

import json

import pytest

from experiments.__main__ import main
from experiments.calibration import FAULTS

pytest.importorskip("cv2", reason="needs the extra `camera`")


def test_every_fault_is_named_or_covered(tmp_path, capsys):
    out = tmp_path / "table"
    assert main(["calibration", "--lifts", "1", "--jobs", "1", "--out", str(out), "--json"]) == 0
    faults = json.loads(capsys.readouterr().out)["faults"]
    assert list(faults) == list(FAULTS)
    for name, found in faults.items():
        assert found["held"] == 1.0, name
        if FAULTS[name] and "0.5 to 5" not in name and "principal" not in name:
            assert found["named"] == 1, name
    assert faults["none"]["refused"] == faults["one pose, 2 to 30 mm"]["refused"] == 0
    text = (out / "calibration.txt").read_text()
    assert all(name in text for name in FAULTS)
