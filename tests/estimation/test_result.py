"""Posteriors and estimates as they are kept and shown."""

import math
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.estimation import (
    Estimate,
    EstimateSettings,
    IntervalCalibration,
    Posterior,
    Theta,
    estimate,
)
from gendom.files import write_json
from gendom.materials.posterior import prior_of
from gendom.reading import read_json

BASE = Theta(E_over_rho=700.0)


def posterior(sd=(0.1, 0.01), calibration=None):
    prior = prior_of(("E_over_rho", "nu"), {"E_over_rho": {"sd": 3.0}})
    covariance = np.diag(np.square(sd))
    covariance[0, 1] = covariance[1, 0] = 0.5 * sd[0] * sd[1]
    mean = np.array([math.log(500.0), 0.44])
    calibration = calibration or IntervalCalibration.none()
    return calibration.posterior(prior, mean, covariance, [BASE])


def test_intervals_are_those_of_a_gaussian():
    """In the transformed unknowns, cut at the ends of what is searched."""
    known = posterior()
    low, high = known.interval("E_over_rho", 0.9)
    assert np.log([low / 500.0, high / 500.0]) == pytest.approx([-0.16449, 0.16449], abs=1e-4)
    low, high = known.interval("nu", 0.9)
    assert low == pytest.approx(0.44 - 0.016449, abs=1e-5) and high == 0.45
    assert known.theta.E_over_rho == pytest.approx(500.0)
    assert known.theta == BASE.with_values({"E_over_rho": known.theta.E_over_rho, "nu": 0.44})
    assert known.determined("E_over_rho") and known.determined("nu")
    assert not known.determined("friction")


def test_calibration_widens_but_not_beyond_the_prior():
    calibration = IntervalCalibration(factor={"E_over_rho": 3.0, "nu": 100.0}, added={"nu": 0.02})
    known = posterior(calibration=calibration)
    assert known.sd("E_over_rho") == pytest.approx(0.3)
    assert known.sd("nu") == pytest.approx(0.06) and not known.determined("nu")
    correlation = known.covariance[0, 1] / known.sd("E_over_rho") / known.sd("nu")
    assert correlation == pytest.approx(0.5)


def test_a_posterior_comes_back_from_its_record():
    known = posterior()
    again = Posterior.from_dict(known.to_dict(), known.thetas)
    assert again.names == known.names and again.theta == known.theta
    assert np.array_equal(again.covariance, known.covariance)
    assert again.interval("nu", 0.5) == known.interval("nu", 0.5)


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_a_calibration_is_shipped(kind):
    shipped = IntervalCalibration.of(kind)
    assert all(value > 0.0 for value in shipped.factor.values())
    assert all(value >= 0.0 for value in shipped.added.values())


@pytest.fixture(scope="module")
def found(rope_lift):
    settings = EstimateSettings(starts=1, max_iterations=4, scene=rope_lift.settings)
    return estimate(rope_lift.seen(), settings)


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
    ],
)
def test_other_files_are_refused(found, tmp_path, changes, words):
    path = tmp_path / "estimate.json"
    write_json(path, found.record | changes)
    with pytest.raises(ParameterError, match=words):
        Estimate.load(path)


def test_a_refused_recording_s_file_says_why(tmp_path):
    path = tmp_path / "estimate.json"
    verdict = {"usable": False, "reasons": ["no frame holds a point"]}
    write_json(path, {"format": "gendom-estimate/1", "verdict": verdict})
    with pytest.raises(ParameterError, match="nothing was estimated: no frame holds a point"):
        Estimate.load(path)


def test_an_estimate_shows_itself_briefly(found):
    """A screen of it at most, with units and intervals."""
    text = repr(found)
    assert len(text) < 1200 and text.count("\n") < 15
    assert "Young's modulus" in text and "Pa" in text and "90% in [" in text
    table = found._repr_html_()
    assert table.count("<tr>") == len(found.rows()) and "usable" in table


def test_a_value_that_was_changed_by_hand_is_refused(found, tmp_path):
    path = tmp_path / "estimate.json"
    write_json(path, found.record | {"E": 2.0 * found.E})
    with pytest.raises(ParameterError, match=r"estimate\.json: E is .*, its posterior says"):
        Estimate.load(path)


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


def test_what_a_likelihood_is_wrong_by_brings_the_prior_back():
    """A product of Gaussians: the prior's, and the likelihood's with a wider deviation."""
    prior = prior_of(["nu"], {"nu": {"mean": 0.3, "sd": 0.06}})
    own, more = 0.02, 0.08
    alone = 1.0 / (own**-2 - 0.06**-2)
    peak = 0.3 + (0.36 - 0.3) * alone / own**2
    calibration = IntervalCalibration(factor={}, added={"nu": more})
    covariance = np.array([[own**2]])
    known = calibration.posterior(prior, np.array([0.36]), covariance, [BASE])
    precision = 0.06**-2 + 1.0 / (alone + more**2)
    assert known.sd("nu") == pytest.approx(precision**-0.5)
    mean = (0.3 * 0.06**-2 + peak / (alone + more**2)) / precision
    assert known.mean[0] == pytest.approx(mean)
