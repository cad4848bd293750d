"""Estimates as they are kept and shown."""

from typing import Any

import pytest

from gendom.errors import ParameterError
from gendom.estimation import Estimate
from gendom.files import write_json
from gendom.reading import read_json


def test_an_estimate_comes_back_from_its_file(found, tmp_path):
    path = tmp_path / "estimate.json"
    found.save(path)
    again = Estimate.load(path)
    assert again.theta == found.theta and again.verdict == found.verdict
    assert again.record == read_json(path) == found.record
    for key in ("E", "E_over_rho", "friction"):
        assert again.interval(key) == found.interval(key)
    assert again.interval("colour") is None
    assert repr(again) == repr(found)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "other/1"}, "not 'gendom-estimate/1'"),
        ({"posterior": {}}, "posterior: object missing required field names"),
        ({"theta": {"colour": 1.0}}, "cannot be used: TypeError"),
        ({"E": 1.0}, r"estimate\.json: E is .*, its posterior says"),
        (None, "nothing was estimated: no frame holds a point"),
    ],
)
def test_other_files_are_refused(found, tmp_path, changes, words):
    """Of other formats, changed by hand, or of a recording that was refused."""
    path = tmp_path / "estimate.json"
    verdict = {"usable": False, "reasons": ["no frame holds a point"]}
    refused = {"format": "gendom-estimate/1", "verdict": verdict}
    write_json(path, refused if changes is None else found.record | changes)
    with pytest.raises(ParameterError, match=words):
        Estimate.load(path)


def test_an_estimate_shows_itself_briefly(found):
    """A screen of it at most, with units and intervals."""
    text = repr(found)
    assert len(text) < 1200 and text.count("\n") < 15
    assert "Young's modulus" in text and "Pa" in text and "90% in [" in text
    table = found._repr_html_()
    assert table.count("<tr>") == len(found.rows()) and "usable" in table


def test_the_object_has_the_estimated_material(found):
    rope = found.rope()
    assert rope.material.E == pytest.approx(found.E) and rope.material.nu == found.nu
    assert rope.length == found.record["object"]["length"]
    with pytest.raises(ParameterError, match="is of a rope"):
        found.cloth()
    assert len({item.material.E for item in found.draws(5, seed=0)}) == 5


def test_files_of_earlier_versions_are_read(found, tmp_path):
    path = tmp_path / "estimate.json"
    old = {"E": "youngs_modulus", "nu": "poissons_ratio", "E_over_rho": "specific_modulus"}

    def renamed(read: Any) -> Any:
        if isinstance(read, dict):
            return {old.get(k, k) if k != "nu" else k: renamed(v) for k, v in read.items()}
        if isinstance(read, list):
            return [old["E_over_rho"] if v == "E_over_rho" else renamed(v) for v in read]
        return read

    record = renamed(found.record)
    record["poissons_ratio"] = record.pop("nu")
    write_json(path, record)
    assert Estimate.load(path).record["posterior"] == found.record["posterior"]
    assert Estimate.load(path).E == found.E
