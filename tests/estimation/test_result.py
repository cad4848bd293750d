"""Estimates as they are kept and shown."""

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
        ({"E": 1.0}, r"estimate\.json: was changed after it was written"),
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
