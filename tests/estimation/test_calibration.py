"""What makes intervals honest: deviations added to the likelihood's own; and what they stand on."""

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import IntervalCalibration, LiftScene, Theta, estimate
from gendom.estimation.estimate import _posterior
from gendom.estimation.likelihood import NoiseModel, Observation
from gendom.estimation.replay import held_reach, middle
from gendom.materials import Material, Rope
from gendom.materials.estimate import Estimate
from gendom.materials.objects import ASSUMED
from gendom.materials.posterior import Posterior, prior_of

BASE = Theta(E_over_rho=700.0)


def posterior_of(calibration, added: Any = 0.0):
    prior = prior_of(("E_over_rho", "nu"))
    mean, covariance = np.array([6.0, 0.3]), np.diag([0.03**2, 0.001**2])
    return calibration.posterior(prior, mean, covariance, [BASE], added)


def test_a_deviation_is_added_in_squares_beside_the_factor():
    plain = posterior_of(IntervalCalibration(factor={"E_over_rho": 2.0}, added={}))
    wider = posterior_of(
        IntervalCalibration(factor={"E_over_rho": 2.0}, added={"E_over_rho": 0.08})
    )
    assert plain.sd("E_over_rho") == pytest.approx(0.06)
    # the prior, 1.4 wide, adds a little
    assert wider.sd("E_over_rho") == pytest.approx(0.1, rel=1e-3) and wider.sd("nu") == plain.sd(
        "nu"
    )
    more = posterior_of(IntervalCalibration.none(), added=np.array([0.04, 0.0]))
    assert more.sd("E_over_rho") == pytest.approx(0.05)


def test_what_the_simulator_cannot_explain_widens_intervals(monkeypatch):
    """Unless no interval is given at all."""
    said = np.array([0.04, 0.0])
    module = sys.modules["gendom.estimation.estimate"]
    monkeypatch.setattr(module, "discrepancy", lambda *_: said)
    problem: Any = SimpleNamespace(
        prior=prior_of(("E_over_rho", "nu")), parts=[None], bases=(BASE,),
        settings=SimpleNamespace(method="gauss-newton"),
        theta=lambda _: BASE,
        scene=SimpleNamespace(
            mesh_error=lambda _: 0.0,
            recording=SimpleNamespace(
                object=SimpleNamespace(kind="rope", diameter=0.01, thickness=None)
            )
        ),
    )  # fmt: skip
    found: Any = SimpleNamespace(
        covariance=np.diag([0.03**2, 0.001**2]), noise=[None], interrupted=False,
        best=SimpleNamespace(vector=np.array([6.0, 0.3])),
    )  # fmt: skip
    for displaced, sd in ((False, 0.05), (True, 0.03)):
        monkeypatch.setattr(module, "displaced", lambda *_, displaced=displaced: displaced)
        known = _posterior(problem, found, IntervalCalibration.none())
        assert known.sd("E_over_rho") == pytest.approx(sd)


def test_fingers_hide_what_they_hold(rope_lift):
    """Of a rope twice their reach beyond where it is held, and nothing of its far end."""
    scene = LiftScene.of(rope_lift.seen(), rope_lift.settings)
    observation = Observation(scene, NoiseModel())
    seen, (own, share) = observation.in_view, observation.shape.samples
    x = np.einsum("mk,mka->ma", share, middle(scene, scene.initial)[own])
    away = np.linalg.norm(x - scene.held[0], axis=1)
    assert not seen[away < 2.0 * held_reach(scene)].any() and (away < held_reach(scene)).any()
    assert seen[away > 0.1].all()


def test_damping_that_is_not_determined_is_assumed():
    """Of an estimate whose recording tells nothing of it; one that does is taken."""
    material = Material(E=8e5, nu=0.3, density=800.0)
    rope = Rope(length=0.4, diameter=0.01, material=material)
    prior = prior_of(("E_over_rho", "damping"))
    for share, assumed in ((0.9, True), (0.1, False)):
        covariance = np.diag([1e-4, (share * prior.sd[1]) ** 2])
        mean = np.array([np.log(1000.0), np.log(0.02)])
        gaussian = Posterior(prior=prior, mean=mean, covariance=covariance, bases=())
        found = Estimate(
            kind="rope", known={"length": rope.length, "diameter": 0.01, "density": 800.0},
            posterior=gaussian,
        )  # fmt: skip
        assert ("damping" in found.assumed) == assumed
        wanted = ASSUMED["damping"] if assumed else 0.02
        assert found.rope().material.damping == pytest.approx(wanted)


def test_recordings_that_were_made_are_checked_as_those_that_are_read(rope_lift):
    lift = rope_lift.seen()
    broken = replace(lift, time=lift.time[::-1].copy())
    with pytest.raises(RecordingError, match=r"recording 2: time"):
        estimate([lift, broken])
    with pytest.raises(RecordingError, match=r"time"):
        estimate(broken)
    others: list[Any] = [[lift, "lift.npz"], 3]
    for other in others:
        with pytest.raises(ParameterError, match="recordings"):
            estimate(other)
