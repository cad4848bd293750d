"""Posteriors: calibrated, and as wide as what the simulator cannot explain."""

import importlib
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, IntervalCalibration, Theta, estimate, intervals
from gendom.estimation.intervals import posterior_of
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.observed import NoiseModel
from gendom.estimation.problem import Found, Start
from gendom.materials.estimate import Estimate
from gendom.materials.objects import ASSUMED
from gendom.materials.posterior import Posterior, prior_of

steps = importlib.import_module("gendom.estimation.methods.gauss_newton")

BASE = Theta(E_over_rho=700.0)

NONE = IntervalCalibration()


# ---- calibration ---------------------------------------------------------------------------------


def test_intervals_are_those_of_a_gaussian():
    """In the transformed unknowns, cut at the ends of what is searched."""
    prior = prior_of(("E_over_rho", "nu"), {"E_over_rho": {"sd": 3.0}})
    known = NONE.posterior(prior, np.array([math.log(500.0), 0.44]), np.diag([1e-2, 1e-4]), [BASE])
    low, high = known.interval("E_over_rho", 0.9)
    assert np.log([low / 500.0, high / 500.0]) == pytest.approx([-0.16449, 0.16449], abs=1e-4)
    low, high = known.interval("nu", 0.9)
    assert low == pytest.approx(0.44 - 0.016449, abs=1e-5) and high == 0.45
    assert known.theta == BASE.with_values({"E_over_rho": known.theta.E_over_rho, "nu": 0.44})
    assert known.theta.E_over_rho == pytest.approx(500.0)
    assert known.determined("E_over_rho") and known.determined("nu")
    assert not known.determined("friction")
    again = Posterior.from_dict(known.to_dict(), known.thetas)
    assert again.names == known.names and again.theta == known.theta
    assert np.array_equal(again.covariance, known.covariance)
    assert again.interval("nu", 0.5) == known.interval("nu", 0.5)


def test_damping_that_is_not_determined_is_assumed():
    """Of an estimate whose recording tells nothing of it; one that does is taken."""
    sizes = {"length": 0.4, "diameter": 0.01, "density": 800.0}
    prior, mean = prior_of(("E_over_rho", "damping")), np.log([1000.0, 0.02])
    for share, assumed in ((0.9, True), (0.1, False)):
        covariance = np.diag([1e-4, (share * prior.sd[1]) ** 2])
        gaussian = Posterior(prior=prior, mean=mean, covariance=covariance, bases=())
        found = Estimate(kind="rope", known=sizes, posterior=gaussian)
        assert ("damping" in found.assumed) == assumed
        wanted = ASSUMED["damping"] if assumed else 0.02
        assert found.rope().material.damping == pytest.approx(wanted)


# ---- starts that end apart ----------------------------------------------------------------------


def ended(*lnE: float, **values: float) -> list[Start]:
    """Starts that have ended at such moduli, of deviations of 0.1, with values by number."""
    starts = []
    for k, x in enumerate(lnE):
        at = np.array([x, 0.002 * k])
        start = Start(initial=at, vector=at, done=True, comparison=Comparisons(()))
        start.value = values.get(f"v{k}", 0.0)
        starts.append(start)
    return starts


class Hollows:
    """A problem whose likelihood is what a start says."""

    parts: tuple = ()
    settings = EstimateSettings()
    bases = (BASE,)
    scene = SimpleNamespace(
        mesh_error=lambda theta: 0.0, bending_length=lambda modulus, thickness: modulus
    )
    prior = prior_of(("E_over_rho", "grip_height"), {"E_over_rho": {"sd": 3.0}})

    def __init__(self, starts):
        self.values = {tuple(s.vector): s.value for s in starts}

    def gradient_and_hessian(self, start, noise):
        return np.zeros(2), np.diag([100.0, 1e4])

    def value(self, vector, comparison, noise):
        return self.values[tuple(vector)]

    def theta(self, vector):
        return BASE.with_values({"E_over_rho": math.exp(vector[0])})


@pytest.mark.parametrize(
    ("starts", "hold"),
    [
        (ended(6.0, 6.8, v1=2.0), (6.0, 6.8)),
        (ended(6.0, 6.8, v0=2.0), (6.0, 6.8)),  # the second one is the more likely one
        (ended(6.0, 6.05, v1=2.0), (6.0,)),  # within a deviation
        (ended(6.0, 6.8, v1=12.0), (6.0,)),  # far less likely
    ],
)
def test_intervals_hold_all_ends_of_starts_that_are_about_as_likely(starts, hold):
    """And the result says so; nothing changes where all starts end alike."""
    problem: Any = Hollows(starts)
    first, *others = sorted(starts, key=lambda s: s.value)
    assert steps._apart(problem, first, others, [], 3.0) == (others if len(hold) > 1 else [])
    noise = (NoiseModel(),)
    best, _, apart = steps._likeliest(problem, [(s, noise) for s in starts])
    found = Found(best=best, starts=starts, noise=(), others=apart)
    known = posterior_of(problem, found, NONE)
    low, high = np.log(known.interval("E_over_rho", 0.9))
    assert best is first and all(low < end < high for end in hold)
    assert len(hold) > 1 or known.sd("E_over_rho") == pytest.approx(0.1, rel=1e-3)
    said = intervals.told_apart(problem, found)
    assert len(said) == len(hold) - 1 and all("hold all of them" in line for line in said)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cable", "names"),
    [
        (1, ["train_048", "eval_054"]),
        (3, ["train_001", "train_002", "train_006", "train_011"]),
        (4, ["train_001", "eval_035"]),
    ],
)
def test_recordings_of_one_cable_do_not_contradict_each_other(real_data, cable, names):
    """Each alone says of the bending length what the others say, too."""
    ends = []
    for name in names:
        path = real_data / f"cable_dlo{cable}_{name}.npz"
        if not path.is_file():
            pytest.skip(f"no {path.name} in {real_data}")
        recording = Recording.read(path, on_warning=lambda _: None)
        ends.append(estimate(recording, EstimateSettings(starts=1)).interval("bending_length"))
    assert max(low for low, _ in ends) < min(high for _, high in ends)
