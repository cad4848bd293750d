"""Posteriors of small problems beside what their formulas say."""

import json
import math
from dataclasses import replace
from importlib import resources
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, IntervalCalibration, Theta, intervals
from gendom.estimation.observed import NoiseModel
from gendom.estimation.problem import Found, Start
from gendom.materials.estimate import Estimate
from gendom.materials.objects import ASSUMED
from gendom.materials.posterior import prior_of

NS: Any = SimpleNamespace
PRIOR = prior_of(("E_over_rho", "grip_height", "damping"))
NOISE = NoiseModel(model=0.005, least_model=0.003)


@pytest.mark.parametrize(
    ("kind", "frames", "entry"),
    [("rope", "all", "rope"), ("rope", "last", "rope-last"), ("cable", "last", "cable")],
)
def test_the_shipped_calibration_is_that_of_the_kind_and_frames(kind, frames, entry):
    place = resources.files("gendom") / "assets" / "calibration.json"
    wanted = json.loads(place.read_text())[entry]
    found = IntervalCalibration.of(kind, frames)
    assert {"factor": found.factor, "added": found.added, "displaced": found.displaced} == {
        name: wanted[name] for name in ("factor", "added", "displaced")
    }


def test_intervals_are_those_of_a_gaussian():
    """In the transformed unknowns, cut at the ends of what is searched; of what is not determined
    an object has what is usual."""
    base, prior = Theta(E_over_rho=700.0), prior_of(("E_over_rho", "nu", "damping"))
    mean = np.array([math.log(500.0), 0.44, math.log(0.02)])
    for share, assumed in ((0.1, False), (0.9, True)):
        C = np.diag([1e-2, 1e-4, (share * prior.sd[2]) ** 2])
        known = IntervalCalibration().posterior(prior, mean, C, [base])
        low, high = known.interval("E_over_rho", 0.9)
        assert np.log([low / 500.0, high / 500.0]) == pytest.approx([-0.16449, 0.16449], abs=1e-3)
        low, high = known.interval("nu", 0.9)
        assert low == pytest.approx(0.44 - 0.016449, abs=1e-5) and high == 0.45
        assert known.determined("nu") and not known.determined("friction")
        sizes = {"length": 0.4, "diameter": 0.01, "density": 800.0}
        found = Estimate(kind="rope", known=sizes, posterior=known)
        assert ("damping" in found.assumed) == assumed
        wanted = ASSUMED["damping"] if assumed else 0.02
        assert found.rope().material.damping == pytest.approx(wanted)


def test_a_calibrated_posterior_is_a_product_of_gaussians():
    """Of the prior and the likelihood, whose deviations are wider by what is known to be wrong;
    what is added comes on top, up to the prior's deviation or, where the search said more, that."""
    factor, added = {"E_over_rho": 2.0}, {"grip_height": 0.4 * PRIOR.sd[1]}
    calibration = IntervalCalibration(factor=factor, added=added)
    own, more = PRIOR.sd * [0.3, 0.5, 1.5], PRIOR.sd * [0.1, 0.0, 0.0]
    correlation = np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 1.0]])
    covariance = correlation * np.outer(own, own)
    mean = PRIOR.mean + np.array([0.5, 0.01, 0.2])
    found = calibration.posterior(PRIOR, mean, covariance, [], more)
    sd = PRIOR.sd.copy()  # of what the likelihood says nothing of it stays
    for k, name in enumerate(PRIOR.names[:2]):
        tau, w = 1.0 / (own[k] ** -2 - PRIOR.sd[k] ** -2), PRIOR.sd[k] ** 2
        peak = PRIOR.mean[k] + (mean - PRIOR.mean)[k] * tau / own[k] ** 2  # of the likelihood alone
        worse = factor.get(name, 1.0) ** 2 * tau + added.get(name, 0.0) ** 2
        precision = 1.0 / w + 1.0 / worse
        assert found.mean[k] == pytest.approx((PRIOR.mean[k] / w + peak / worse) / precision)
        sd[k] = math.hypot(precision**-0.5, more[k])
    np.testing.assert_allclose(found.covariance, correlation * np.outer(sd, sd), rtol=1e-6)
    wide = calibration.posterior(PRIOR, mean, covariance, [], 5.0 * PRIOR.sd)
    np.testing.assert_allclose(np.diag(wide.covariance), np.maximum(PRIOR.sd, own) ** 2)


# ---- what is added -------------------------------------------------------------------------------


class Problem:
    """Shapes of two points that follow the first unknown, not the last, in some recordings."""

    def __init__(self, *kinds, x=lambda v: 0.1 * v, shown=(0, 1, 2)):
        self.prior = replace(PRIOR, low=np.full(3, -9.0), high=np.array([9.0, 9.0, 9.0]))
        self.bases, self.settings, self.seen = (), EstimateSettings(), []
        self.parts = [self.part(kind, shown) for kind in kinds]
        self.scene = NS(mesh_error=lambda theta: 0.0, held=[0])
        self.x = x

    def part(self, kind, shown):
        scene = NS(kind=kind, size=0.5, held=[0, 0], static=False, captured=False, thin=True)
        coarser = NS(**vars(scene))
        return NS(scene=scene, coarser=coarser, shown=np.array(shown))

    def theta(self, vector, recording=0):
        return Theta(E_over_rho=math.exp(vector[0]))

    def positions(self, worlds, recording, scene):
        part = self.parts[recording]
        assert scene is part.coarser
        x = np.zeros((2, len(worlds), 2, 3))
        for w, vector in enumerate(worlds):
            assert vector[1] == 0.2 and (vector[0] == 0.4 or vector[2] == 0.3)
            x[:, w] = self.x(vector[0])
        return x

    def gradient_and_hessian(self, start, noise):
        return np.array([1.0, -2.0, 0.0]), np.diag([100.0, 400.0, 25.0])


@pytest.fixture(autouse=True)
def points(monkeypatch):
    monkeypatch.setattr(intervals, "middle", lambda scene, x: x)


def found(*models, **changes) -> Found:
    fits = [NS(fit=lambda noise: NS(rms=0.007, pulls=None)) for _ in models]
    best = Start(initial=np.zeros(3), vector=np.array([0.4, 0.2, 0.3]), comparison=NS(parts=fits))
    noise = tuple(replace(NOISE, model=m) for m in models)
    return Found(best=best, starts=[best], noise=noise, **changes)


KNOWN = np.diag((PRIOR.sd * 0.1) ** 2)


def moves(sizes):
    """A shape that moves by so much at the changes that are simulated, whichever way."""
    every = PRIOR.sd[0] * np.array(intervals.SHARES)

    def x(v):
        k = np.flatnonzero(np.isclose(every, abs(v - 0.4)))
        return sizes[int(k[0])] if len(k) else 0.0

    return x


@pytest.mark.parametrize(
    ("sizes", "share"),
    [
        ((0.008, 0.1, 0.1, 0.1, 0.1, 0.1), 1 / 128),
        ((0.002, 0.006, 0.1, 0.1, 0.1, 0.1), 3 / 128),
        ((0.001, 0.001, 0.001, 0.002, 0.006, 0.1), 3 / 16),
        ((0.001, 0.001, 0.001, 0.001, 0.002, 0.006), 3 / 8),
        ((0.001, 0.001, 0.001, 0.001, 0.002, 0.0039), 1.0),
        ((0.008, 0.1, 0.1, 0.002, 0.006, 0.1), 3 / 16),  # a larger change moves it less again
    ],
)
def test_a_change_moves_the_shape_by_what_is_not_explained(sizes, share):
    """4 mm of 5 mm are more than the 3 mm that none is below; linear between what is simulated."""
    problem: Any = Problem("rope", x=moves(sizes))
    sd = intervals.discrepancy(problem, found(0.005), KNOWN, IntervalCalibration())
    # what moves nothing is not known; how it is held is not the object's
    np.testing.assert_allclose(sd, [share * PRIOR.sd[0], 0.0, PRIOR.sd[2]], rtol=1e-6)


def test_what_is_not_explained_is_that_of_the_best_recording():
    """What a recording does not show is none; a change beyond the range of the search, or one that
    diverges, says nothing."""
    none = IntervalCalibration()
    problem: Any = Problem("rope", "cloth")
    sd = intervals.discrepancy(problem, found(0.005, 0.0034), KNOWN, none)
    wanted = [10.0 * math.sqrt(0.0034**2 - 0.003**2), 0.0, PRIOR.sd[2]]
    assert sd == pytest.approx(wanted, rel=1e-3)
    assert not intervals.discrepancy(problem, found(0.005, 0.0029), KNOWN, none).any()
    for k in range(3):  # a parameter that is not determined
        wide = np.array([KNOWN[j, j] if j != k else (0.51 * PRIOR.sd[k]) ** 2 for j in range(3)])
        sd = intervals.discrepancy(problem, found(0.005, 0.005), np.diag(wide), none)
        assert (sd > 0.0).tolist() == [k != 0, False, k != 2]
    unseen: Any = Problem("rope", shown=(1,))
    assert not intervals.discrepancy(unseen, found(0.005), KNOWN, none).any()
    one: Any = Problem("rope")
    one.parts[0].scene.held = [0]
    usual = IntervalCalibration(displaced=0.0098)
    assert not intervals.discrepancy(one, found(0.0048), KNOWN, usual).any()
    sd = intervals.discrepancy(one, found(0.0051), KNOWN, usual)
    assert sd[0] == pytest.approx(10.0 * math.sqrt(0.0051**2 - 0.0049**2), rel=1e-3)
    one.parts[0].scene.static = True
    sd = intervals.discrepancy(one, found(0.001), KNOWN, usual)
    assert sd[0] == pytest.approx(0.07, rel=1e-3)
    up: Any = Problem("rope", x=lambda v: 0.1 * v if v > 0.4 - 1e-9 else np.nan)
    assert intervals.discrepancy(up, found(0.005), KNOWN, none)[0] == pytest.approx(0.04, rel=1e-3)
    up.prior.high[0] = 0.4 + 1e-9
    assert intervals.discrepancy(up, found(0.005), KNOWN, none)[0] < 1e-6
    far: Any = Problem("rope", x=lambda v: 0.1 * max(v, 0.4))  # down nothing moves
    far.prior.low[0] = 0.4 - 1e-9
    assert intervals.discrepancy(far, found(0.005), KNOWN, none)[0] == pytest.approx(0.04, rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "more", "extra"),
    [
        ({}, [0.0, 0.0, 0.0], 0.0),
        ({"method": "adam"}, [0.01, 0.005, 0.0], 0.0),
        ({"interrupted": True}, [0.01, 0.005, 0.0], 0.0),
        ({"kind": "cloth"}, [0.01, 0.005, 0.0], 0.0),  # of which steps were left to be taken
        ({"kind": "cloth", "done": True}, [0.0, 0.0, 0.0], 0.0),
        ({"others": (np.array([0.45, 0.2, 0.0]),)}, [0.05, 0.0, 0.3], 0.0),
        ({"others": (np.array([0.45, 0.2, 0.0]),)}, [0.2, 0.2, 0.3], 0.2),
        ({"covariance": np.diag([0.02, 0.01, 0.03]) ** 2}, [0.0, 0.0, 0.0], 0.0),
        ({"covariance": np.diag([0.02, 0.01, 0.03]) ** 2}, [0.1, 0.1, 0.1], 0.1),
        ({"mesh": 0.03}, [0.03, 0.0, 0.0], 0.0),
        ({"unexplained": [0.02, 0.01, 0.0]}, [0.02, 0.01, 0.0], 0.0),
        ({"unexplained": [0.02, 0.01, 0.0], "astray": True}, [0.0, 0.0, 0.0], 0.0),
    ],
)
def test_a_posterior_is_as_wide_as_all_that_is_not_known(monkeypatch, changes, more, extra):
    changes = dict(changes)
    problem: Any = Problem("rope")
    problem.scene.kind, done = changes.pop("kind", "rope"), changes.pop("done", False)
    problem.prior = replace(PRIOR, sd=np.full(3, 1e3), mean=np.array([0.4, 0.2, 0.3]))
    problem.settings = EstimateSettings(method=changes.pop("method", "gauss-newton"))
    mesh, off = changes.pop("mesh", 0.0), np.array(changes.pop("unexplained", [0.0] * 3))
    astray = changes.pop("astray", False)
    problem.scene.mesh_error = lambda theta: mesh * math.log(theta.E_over_rho) / 0.4
    monkeypatch.setattr(intervals, "discrepancy", lambda *_: off)
    monkeypatch.setattr(intervals, "displaced", lambda part, noise: astray)
    one = found(0.005, **changes)
    one.best.done = done
    own = np.array([0.1, 0.05, 0.2]) if one.covariance is None else np.array([0.02, 0.01, 0.03])
    got = intervals.posterior_of(problem, one, IntervalCalibration(), extra)
    sd = np.sqrt(np.diag(got.covariance))
    np.testing.assert_allclose(sd, np.hypot(own, more), rtol=1e-5)
    np.testing.assert_allclose(got.mean, one.best.vector)


def test_fingers_and_pulls_widen_what_they_move():
    """By a quarter of the turn in the fingers; by sums of ten parts of a motion capture."""
    prior = prior_of(("E_over_rho", "grip_turn", "nu"))
    C = np.array([[0.04, 0.012, 0.0], [0.012, 0.09, -0.003], [0.0, -0.003, 0.01]])
    problem = NS(prior=prior)
    turned = NS(best=NS(vector=np.array([5.0, 0.4, 0.3])))
    moved = np.clip(C[1] / 0.09 * 0.1, -prior.sd, prior.sd)
    wider = intervals.with_fingers(problem, turned, C)
    np.testing.assert_allclose(wider, C + np.outer(moved, moved), rtol=1e-12)
    rng = np.random.default_rng(0)
    pulls = [rng.normal(size=(40, 2)) * 3.0, rng.normal(size=(40, 3)) * 3.0]
    shown = [np.array([0, 2]), np.array([0, 1, 2])]
    parts = [NS(scene=NS(captured=True), shown=s) for s in shown]
    parts.append(NS(scene=NS(captured=False), shown=shown[0]))
    fits = [NS(fit=lambda noise, p=p: NS(pulls=p)) for p in (*pulls, 1e3 * pulls[0])]
    both = NS(best=NS(compared=NS(parts=fits)), noise=[None] * 3)
    total = np.zeros((3, 3))
    for p, s in zip(pulls, shown, strict=True):
        for k in range(10):
            g = np.zeros(3)
            g[s] = p[4 * k : 4 * k + 4].sum(axis=0)
            total += np.outer(g, g)
    sandwich = np.sqrt(np.maximum(np.diag(C @ total @ C) / np.diag(C), 1.0))
    wider = intervals.with_episodes(NS(parts=parts), both, C)
    np.testing.assert_allclose(wider, C * np.outer(sandwich, sandwich), rtol=1e-12)
    assert sandwich.max() > 1.2


def test_ends_apart_are_said():
    theta = lambda v: Theta(E_over_rho=v[0], thickness=v[1])  # noqa: E731
    scene = NS(bending_length=lambda modulus, thickness: modulus * thickness)
    problem, best = NS(theta=theta, scene=scene), NS(vector=(2.0, 0.03))
    both = intervals.told_apart(problem, NS(best=best, others=((4.0, 0.02),)))
    said = "starts end apart and fit about as well, with bending lengths of 0.06, 0.08 m: the "
    assert both == (f"{said}intervals hold all of them",)
    assert intervals.told_apart(problem, NS(best=best, others=())) == ()
