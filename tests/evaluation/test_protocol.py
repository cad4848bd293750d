"""Scores of policies whose errors are known, in a task that is solved in closed form."""

from dataclasses import dataclass

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError, SimulationError
from gendom.evaluation import draw_cases, score
from gendom.policies import Column, Description, GoalRange, Policy
from gendom.tasks import Outcomes, RopeReaching


def reach_of(release_x, modulus):
    """Goal from release, both in rope lengths."""
    return 2.0 - 0.8 * release_x + 0.05 * np.log(modulus / 1000.0)


@dataclass(frozen=True, kw_only=True)
class Quick(RopeReaching):
    """`reach_of` instead of a simulation; releases at the top fail."""

    fails_above: float = 2.0

    def demonstrate(self, draws, *, device="cpu", dtype="float32", on_frame=None):
        own = RopeReaching()
        goal = np.empty(len(draws))
        for i, d in enumerate(draws):
            modulus = own.conditioned_on(
                d["specific_modulus"],
                length=d["length"],
                diameter=d["diameter"],
                gravity=self.gravity,
            )
            goal[i] = self.length * reach_of(d["release_x"] / self.length, modulus)
            if d["release_z"] > self.fails_above * self.length:
                goal[i] = np.nan
        return Outcomes(
            columns={"goal_x": goal},
            faults=tuple("failed" if bad else None for bad in np.isnan(goal)),
        )


class Inverse:
    """The exact inverse of `reach_of`, for the modulus it is told or else 1000 m^2/s^2."""

    def __init__(self, release_z=0.45):
        self.release_z = release_z

    def run(self, names, feed):
        modulus = feed.get("specific_modulus", np.full_like(feed["goal"], 1000.0))
        x = (2.0 + 0.05 * np.log(modulus / 1000.0) - feed["goal"]) / 0.8
        return [np.concatenate([x, np.full_like(x, self.release_z)], axis=1)]


def make_policy(conditioned_on=("specific_modulus",), task=None, **session) -> Policy:
    names = ("release_x", "release_z")
    description = Description(
        task=task or {"name": "rope-reaching", "length": 0.25, "diameter": 0.014, "gravity": 9.81},
        method="inverse",
        conditioned_on=conditioned_on,
        inputs=(),
        outputs=tuple(
            Column(name=n, unit="rope length", mean=m, scale=0.1)
            for n, m in zip(names, (0.55, 0.5), strict=True)
        ),
        goals=GoalRange(at=(1000.0,), low=(1.4,), high=(1.7,)),
        parameters={"specific_modulus": (100.0, 1e4), "poissons_ratio": (0.2, 0.4)},
    )
    return Policy(Inverse(**session), description, where="inverse.onnx")


def free(result) -> np.ndarray:
    """Cases in which the policy's action was within the limits; most are."""
    own = np.isclose(result.action[:, 1], 0.45 * result.length)
    assert own.mean() > 0.5
    return own


def test_exact_policy_has_no_error_and_blind_policy_has():
    cases = draw_cases(Quick(), 60, seed=3)
    exact = score(make_policy(), cases)
    assert exact.error[free(exact)].max() < 1e-6
    blind = score(make_policy(conditioned_on=()), cases)
    modulus = np.array([d["specific_modulus"] for d in cases.draws])
    expected = 0.25 * np.abs(0.05 * np.log(modulus / 1000.0))
    assert blind.error[free(blind)] == pytest.approx(expected[free(blind)], abs=1e-6)
    summary = blind.summary()
    assert summary["error"]["mean"] == pytest.approx(blind.error.mean())
    assert summary["error_over_length"]["p95"] == pytest.approx(summary["error"]["p95"] / 0.25)


@pytest.mark.parametrize("gravity", [9.81, 3.7])
def test_cases_may_have_ropes_of_another_size(gravity):
    task = Quick(length=0.6, diameter=0.01, gravity=gravity)
    result = score(make_policy(), draw_cases(task, 30, seed=3))
    assert result.error[free(result)].max() < 1e-6
    assert result.length == pytest.approx(np.full(30, 0.6))


def test_summary_counts_failures_and_goals_outside():
    cases = draw_cases(Quick(fails_above=0.8), 40, seed=1)
    assert np.isfinite(cases.goal).all()
    result = score(make_policy(release_z=0.45), cases)
    summary = result.summary()
    reach = cases.goal / 0.25
    assert summary["failed"] == 0
    assert summary["outside_range"] == int(((reach < 1.4) | (reach > 1.7)).sum()) > 0

    high = score(make_policy(release_z=0.85), cases)
    failed = int(np.isnan(high.reached).sum())
    assert high.summary()["failed"] == failed > 0
    figures = high.error[np.isfinite(high.error)]
    if len(figures):
        assert high.summary()["error"]["mean"] == pytest.approx(figures.mean())
    else:
        assert high.summary()["error"]["mean"] is None


def test_case_depends_on_seed_and_number_alone():
    few, many = draw_cases(Quick(), 5, seed=3), draw_cases(Quick(), 9, seed=3)
    assert few.draws == many.draws[:5]
    assert np.array_equal(few.goal, many.goal[:5])
    assert few.draws[0] != draw_cases(Quick(), 1, seed=4).draws[0]


def test_ranges_can_be_replaced():
    ranges = {"specific_modulus": (50.0, 60.0), "poissons_ratio": (0.30, 0.33)}
    for draw in draw_cases(Quick(), 20, seed=0, ranges=ranges).draws:
        assert 50.0 <= draw["specific_modulus"] <= 60.0
        assert draw["youngs_modulus"] == pytest.approx(draw["specific_modulus"] * draw["density"])
        assert 0.30 <= draw["poissons_ratio"] <= 0.33


def test_faults_are_told():
    with pytest.raises(ParameterError, match="0 cases"):
        draw_cases(Quick(), 0, seed=0)
    with pytest.raises(ParameterError, match="positive range"):
        draw_cases(Quick(), 1, seed=0, ranges={"poissons_ratio": (0.4, 0.3)})
    with pytest.raises(ParameterError, match="no range of 'density'"):
        draw_cases(Quick(), 1, seed=0, ranges={"density": (1.0, 2.0)})
    with pytest.raises(SimulationError, match="3 of 3 cases failed"):
        draw_cases(Quick(fails_above=0.0), 3, seed=0)
    with pytest.raises(PolicyError, match="unknown here"):
        score(make_policy(task={"name": "knitting"}), draw_cases(Quick(), 1, seed=0))
