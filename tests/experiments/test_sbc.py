"""Ranks of drawn truths, and the neural posterior beside the estimator's."""

import json
import math
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from experiments.lifts import Lifts, estimate_settings
from experiments.sbc import imagined_lift, uniformity
from gendom.estimation import estimate


@pytest.mark.parametrize(
    ("sd", "bias", "right"), [(1.0, 0.0, True), (2.0, 0.0, False), (1.0, 0.6, False)]
)
def test_tests_of_ranks_tell_wrong_posteriors(sd, bias, right):
    """Errors of a deviation and a bias, in those that posteriors state."""
    ranks = norm.cdf(bias + sd * np.random.default_rng(0).standard_normal(200))
    counts = np.histogram(ranks, 20, range=(0.0, 1.0))[0]
    tests = uniformity(SimpleNamespace(ranks=ranks, counts=counts))  # type: ignore
    assert (min(tests["chi_square_p"], tests["ecdf_p"]) > 0.01) == right
    assert (tests["ecdf_distance"] < tests["ecdf_band"]) == right


def test_imagined_lifts_repeat_and_are_not_alike():
    """Clouds of the rope, within the cameras' errors, in the frames that are compared."""
    (a, truth), (b, again), (_, other) = (imagined_lift(Lifts(), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.points, b.points)
    assert truth == again and truth["E_over_rho"] != other["E_over_rho"]
    first = a.frame(int(np.argmax(a.frame_valid)))
    length, d = a.object.length, a.object.diameter
    assert length is not None and d is not None
    assert np.ptp(first[:, 0]) == pytest.approx(length, abs=0.02)
    assert np.ptp(first[:, 2]) < 1.5 * d + 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [136, 128, 299, 195])
def test_limp_and_turned_stiff_ropes_are_found(seed):
    """Of the whole prior: coarse points and a firm grip have their best fits elsewhere."""
    recording, truth = imagined_lift(Lifts(), seed)
    found = estimate(recording, replace(estimate_settings(seed), starts=3))
    assert found.usable
    assert abs(math.log(found.record["bending_length"] / truth["bending_length"])) < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sbc", "npe"])
def test_the_command_makes_the_table(name, tmp_path, table, monkeypatch):
    if name == "npe":
        pytest.importorskip("sbi")
        monkeypatch.setitem(import_module("experiments.npe").SIMULATIONS, "small", 32)
    assert "covered" in table(name, "--lifts", 2, "--seed", 3)
    made = json.loads(next(tmp_path.glob(f"{name}*[!0-9].json")).read_text())
    assert made["lifts"] == 2
