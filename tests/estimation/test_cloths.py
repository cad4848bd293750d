"""What a cloth's search simulates with few points, and how its clouds are registered."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, Problem, SceneSettings
from gendom.estimation.problem import Start


@pytest.fixture(scope="module")
def problem(cloth_lift):
    settings = EstimateSettings(starts=1, scene=SceneSettings(threads=1))
    seen = cloth_lift.seen(frames=5, points=300)
    return Problem([LiftScene.of(seen, settings.scene)], settings)


@pytest.fixture(scope="module")
def places(problem, cloth_lift):
    """[P] the truth, half a deviation of how it is held beside it, and then 20 % stiffer, too."""
    prior = problem.prior
    at = prior.vector(*(b.with_values(dict(cloth_lift.truth)) for b in problem.bases))
    held = np.array([0.5 * name.startswith(("grip_height", "grip_along")) for name in prior.names])
    aside = at + held * prior.sd
    return [at, aside, aside + 0.2 * (np.array(prior.names) == "E_over_rho")]


def test_changes_with_few_points_are_those_with_many(problem, places):
    whole = problem.compare(places, derivatives=False)
    start = Start(initial=places[0], vector=places[0], comparison=whole[0])
    near = problem.about(start)
    few = near.compare(places, derivatives=False)
    fine, rough = (np.array([c.parts[0].axis for c in own]) for own in (whole, few))
    assert rough[0] == pytest.approx(fine[0], abs=1e-5)
    moved, off = (np.sqrt(np.mean(x**2, axis=(1, 2, 3))) for x in (fine - fine[0], rough - fine))
    assert (off[1:] < 0.4 * moved[1:]).all() and (moved[1:] > 1e-3).all()
    assert max(problem.parts[0].coarser.body.shape) < max(problem.scene.body.shape)


def test_a_registration_begins_where_it_follows_the_parameters(problem, places):
    """One round ends where many end from afar."""
    noise = replace(problem.first_noise()[0], model=1e-3)
    (here,) = problem.compare(places[:1], sketched=True)
    here.parts[0].fit(replace(noise, rounds=12))
    near, cold, whole = problem.compare([places[1]] * 3, derivatives=False)
    near.warm_start(here)
    few, many = replace(noise, rounds=1), replace(noise, rounds=15)
    value, usual, least = (c.parts[0].fit(n).value for c, n in
                           ((near, few), (cold, few), (whole, many)))  # fmt: skip
    assert value - least < 0.25 * (usual - least)
