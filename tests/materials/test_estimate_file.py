"""The file of an estimate: it is used as it was written, or refused."""

import copy
import json
import math

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.materials import Material, Rope
from gendom.materials.estimate import Estimate


@pytest.fixture(scope="module")
def found():
    rope = Rope(length=0.4, diameter=0.01, material=Material(E=8e5, nu=0.3, density=800.0))
    mean, covariance = [math.log(1000.0), 0.3], np.diag([1e-3, 1e-4]).tolist()
    names = ["E_over_rho", "nu"]
    return Estimate.of(rope, {"names": names, "mean": mean, "covariance": covariance})


def places(value, at=()):
    """Of everything in a document, the first of each list alone."""
    yield at
    first = enumerate(value[:1]) if isinstance(value, list) else ()
    for name, inner in value.items() if isinstance(value, dict) else first:
        yield from places(inner, (*at, name))


def test_whatever_is_changed_by_hand_is_refused_in_one_line(found, tmp_path):
    """Everything in the file, left out, of odd types, or 1 % off."""
    path, whole = tmp_path / "estimate.json", json.loads(json.dumps(found.record))
    for at in list(places(whole))[1:]:
        outer, last = at[: len(at) - 1], list(at).pop()
        for odd in (None, "x", -1e308, [[1]], "left out", "off"):
            inner = document = copy.deepcopy(whole)
            for name in outer:
                inner = inner[name]
            now = inner[last]
            inner[last] = 1.01 * now if odd == "off" and isinstance(now, float) else odd
            if odd == "left out":
                del inner[last]
            if document == whole:
                continue
            path.write_text(json.dumps(document))
            with pytest.raises(GendomError) as refused:
                Estimate.load(path)
            assert "\n" not in str(refused.value), (outer, last, odd)
    path.write_text(json.dumps({n: v for n, v in whole.items() if n != "sha256"}))
    with pytest.raises(GendomError, match=r"of a version before 0\.2; run gendom"):
        Estimate.load(path)


def test_intervals_end_where_the_search_did(found, tmp_path):
    """Of what follows from E over density, too."""
    wide = found.with_gaussian(found.mean, np.diag([100.0, 1e-4])).record
    for name in ("E_over_rho", "E", "bending_length"):
        assert wide["intervals"][name] == pytest.approx(wide["bounds"][name])
    # another layout of the text is no change
    path = tmp_path / "estimate.json"
    path.write_text(json.dumps(found.record, sort_keys=True).replace(".0,", ","))
    assert Estimate.load(path).E == pytest.approx(found.E)
