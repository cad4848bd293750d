"""The file of an estimate: whatever stands in it is either used as it was written or refused."""

import copy
import json

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.files import write_json
from gendom.materials import Material, Rope
from gendom.materials.estimate import Estimate
from gendom.materials.posterior import Posterior, prior_of

ODD = [None, "x", -1e308, [[1]], "left out"]


@pytest.fixture(scope="module")
def found():
    material = Material(E=8e5, nu=0.3, density=800.0)
    rope = Rope(length=0.4, diameter=0.01, material=material)
    prior = prior_of(("E_over_rho", "nu"))
    posterior = Posterior(
        prior=prior,
        mean=np.array([np.log(1000.0), 0.3]),
        covariance=np.diag([1e-3, 1e-4]),
        bases=(),
    )
    return Estimate.of(rope, posterior.to_dict())


def places(value, at=()):
    """Of everything in a document, the first of each list alone."""
    yield at
    first = enumerate(value[:1]) if isinstance(value, list) else ()
    for name, inner in value.items() if isinstance(value, dict) else first:
        yield from places(inner, (*at, name))


def changed(document, at, value):
    document = copy.deepcopy(document)
    inner = document
    for name in at[:-1]:
        inner = inner[name]
    if value == "left out":
        del inner[at[-1]]
    else:
        inner[at[-1]] = value
    return document


def test_a_file_of_odd_types_is_refused_in_one_line(found, tmp_path):
    """Or means what it did: what is left out of files of earlier versions has no checksum."""
    path = tmp_path / "estimate.json"
    document = {**json.loads(json.dumps(found.record)), "simulation": {"material": "cotton-rope"}}
    del document["sha256"]
    for k, at in enumerate(list(places(document))[1:]):
        for value in (ODD[k % 5], ODD[(k + 2) % 5]):
            path.write_text(json.dumps(changed(document, at, value)))
            try:
                read = Estimate.load(path)
                assert read.record and read.rows() and read.draws(1, seed=0)
            except GendomError as error:
                assert "\n" not in str(error), (at, value)


@pytest.mark.parametrize(
    "at", [("E",), ("nu",), ("density",), ("intervals", "E", 0), ("bounds", "nu", 1),
           ("bending_length",), ("bending_stiffness",), ("posterior", "prior_sd", 0),
           ("posterior", "covariance", 0, 0), ("object", "length")],
)  # fmt: skip
def test_every_number_that_is_changed_by_hand_is_refused(found, tmp_path, at):
    path = tmp_path / "estimate.json"
    inner = found.record
    for name in at:
        inner = inner[name]
    write_json(path, changed(found.record, at, 1.01 * inner))
    with pytest.raises(GendomError, match=r"was changed|its posterior says"):
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
