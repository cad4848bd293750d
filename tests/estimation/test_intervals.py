"""Posteriors: calibrated, and as wide as what the simulator cannot explain."""

import importlib
import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, IntervalCalibration, Theta, estimate, intervals
from gendom.estimation.intervals import discrepancy, posterior_of
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


def posterior(sd=(0.1, 0.01), factor=None, added=None, more: Any = 0.0, correlation=0.5):
    prior = prior_of(("E_over_rho", "nu"), {"E_over_rho": {"sd": 3.0}})
    covariance = np.outer(sd, sd) * [[1.0, correlation], [correlation, 1.0]]
    calibration = IntervalCalibration(factor=factor or {}, added=added or {})
    return calibration.posterior(prior, np.array([math.log(500.0), 0.44]), covariance, [BASE], more)


def test_intervals_are_those_of_a_gaussian():
    """In the transformed unknowns, cut at the ends of what is searched."""
    known = posterior()
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


def test_deviations_are_multiplied_and_added_but_not_beyond_the_prior():
    assert posterior((0.03, 1e-3), {"E_over_rho": 2.0}).sd("E_over_rho") == pytest.approx(
        0.06, 1e-3
    )
    wider = posterior((0.03, 1e-3), {"E_over_rho": 2.0}, {"E_over_rho": 0.08})
    assert wider.sd("E_over_rho") == pytest.approx(0.1, rel=1e-3)
    assert wider.sd("nu") == pytest.approx(1e-3, rel=1e-3)
    more = posterior((0.03, 1e-3), more=np.array([0.04, 0.0]))
    assert more.sd("E_over_rho") == pytest.approx(0.05)
    known = posterior(factor={"E_over_rho": 3.0, "nu": 100.0}, added={"nu": 0.02})
    assert known.sd("E_over_rho") == pytest.approx(0.3, rel=0.01)
    assert known.sd("nu") == pytest.approx(0.06, rel=0.01) and not known.determined("nu")
    correlation = known.covariance[0, 1] / known.sd("E_over_rho") / known.sd("nu")
    assert correlation == pytest.approx(0.5)
    for kind in ("rope", "cloth"):
        shipped = IntervalCalibration.of(kind)
        assert all(value > 0.0 for value in shipped.factor.values())
        assert all(value >= 0.0 for value in shipped.added.values())


def test_what_a_likelihood_is_wrong_by_brings_the_prior_back():
    """A product of Gaussians: the prior's, and the likelihood's with a wider deviation, by a factor
    and by what is added."""
    prior = prior_of(["nu"], {"nu": {"mean": 0.3, "sd": 0.06}})
    own, factor, more = 0.02, 1.5, 0.08
    alone = 1.0 / (own**-2 - 0.06**-2)
    peak = 0.3 + (0.36 - 0.3) * alone / own**2
    calibration = IntervalCalibration(factor={"nu": factor}, added={"nu": more})
    known = calibration.posterior(prior, np.array([0.36]), np.array([[own**2]]), [BASE])
    worse = factor**2 * alone + more**2
    precision = 0.06**-2 + 1.0 / worse
    assert known.sd("nu") == pytest.approx(precision**-0.5)
    mean = (0.3 * 0.06**-2 + peak / worse) / precision
    assert known.mean[0] == pytest.approx(mean)


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


# ---- what the simulator cannot explain -----------------------------------------------------------


@dataclass
class Given:
    """A problem whose shapes have one point, whose x is a function of the first unknown."""

    x: Any
    held: int = 2
    static: bool = False
    shown: Any = (0, 1)

    def __post_init__(self):
        self.prior = SimpleNamespace(
            names=("E_over_rho", "grip_height"), sd=np.array([2.0, 0.01]),
            low=np.full(2, -9.0), high=np.full(2, 9.0),
        )  # fmt: skip
        scene = SimpleNamespace(
            size=0.5, held=[None] * self.held, static=self.static, thin=True, kind="rope"
        )
        self.parts = [SimpleNamespace(scene=scene, coarser=scene, shown=np.array(self.shown))]

    def positions(self, worlds, recording, scene):
        x = np.zeros((1, len(worlds), 1, 3))
        x[0, :, 0] = np.array([[self.x(w[0])] * 3 for w in worlds])
        return x


def linear(v):
    return 0.02 * v


SWINGS, ONE_WAY = (lambda v: 3e-3 * np.sin(1e3 * v)), (lambda v: 0.02 * min(v, 1.0))

DIVERGES = lambda v: 0.02 * v if v < 1.0 + 1e-9 else np.nan  # noqa: E731

LIFTS = IntervalCalibration(factor={}, added={}, displaced=0.01)
"""Of lifts that move by 5 mm otherwise."""


@pytest.mark.parametrize(
    ("model", "x", "calibration", "options", "expected"),
    [
        (0.004, linear, NONE, {}, 0.2),
        (0.004, linear, NONE, {"shown": (1,)}, 0.0),  # what no recording shows
        (1e-5, linear, NONE, {}, 5e-4),  # changes too small to be tried
        (0.004, SWINGS, NONE, {}, 2.0),  # a small change moves it as much as a large one
        (0.004, ONE_WAY, NONE, {}, 2.0),  # one direction that moves nothing is enough
        (0.004, DIVERGES, NONE, {}, 0.2),  # worlds that diverge say nothing
        # what calibrated lifts have too does not count; only lifts by one gripper were calibrated
        (0.0049, linear, LIFTS, {"held": 1}, 0.0),
        (0.013, linear, LIFTS, {"held": 1}, 0.6),
        (0.0049, linear, LIFTS, {}, 0.245),
        (1e-7, linear, NONE, {}, 0.0),  # the least that is looked for is none
        (0.0049, linear, NONE, {"static": True}, 0.15),  # of a shape at rest all 3 mm of its fit
    ],
)
def test_a_parameter_is_as_uncertain_as_the_displacement_that_it_makes(
    model, x, calibration, options, expected
):
    """How it is held is not the object's."""
    sd = deviations(model, x, calibration, **options)
    assert sd == pytest.approx([expected, 0.0], rel=1e-3)


def deviations(model, x, calibration=NONE, **options):
    fitted = SimpleNamespace(fit=lambda noise: SimpleNamespace(rms=0.003))
    best = SimpleNamespace(vector=np.array([1.0, 0.0]), comparison=SimpleNamespace(parts=[fitted]))
    noise = NoiseModel(model=model, least_model=1e-7)
    given, found = Given(x, **options), SimpleNamespace(noise=[noise], best=best)
    return discrepancy(given, found, np.diag([1e-4, 1e-4]) ** 2, calibration)  # type: ignore


@pytest.mark.parametrize(("astray", "sd"), [(False, 0.5), (True, 0.01)])
def test_intervals_hold_what_cannot_be_explained(monkeypatch, astray, sd):
    """But where nothing simulated moves like the object: that is refused."""
    monkeypatch.setattr(intervals, "discrepancy", lambda *_: np.array([0.5, 0.0]))
    monkeypatch.setattr(intervals, "displaced", lambda *_: astray)
    scene = SimpleNamespace(mesh_error=lambda theta: 0.0)
    prior = prior_of(("E_over_rho", "nu"), {"E_over_rho": {"sd": 3.0}})
    problem = SimpleNamespace(
        parts=[None], scene=scene, prior=prior, bases=[BASE], theta=lambda vector: BASE
    )
    best = SimpleNamespace(vector=np.array([math.log(500.0), 0.44]))
    covariance = np.diag([1e-4, 1e-6])
    found = SimpleNamespace(covariance=covariance, noise=[None], best=best, others=())
    known = posterior_of(problem, found, NONE)  # type: ignore
    assert known.sd("E_over_rho") == pytest.approx(sd, rel=1e-3)


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
