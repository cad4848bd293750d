"""Ropes that lie curved: their line, and how much of its curvature is natural."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, LiftScene, estimate, replay
from gendom.estimation.placing import lying_line
from gendom.sim import rope
from gendom.sim.lines import arc_length

LENGTH = 0.5

CURVATURES = {
    "straight": lambda s: 0.0 * s,
    "arc": lambda s: 2.0 + 0.0 * s,
    "S": lambda s: 10.0 * np.sin(2.0 * np.pi * s / LENGTH),
    "hook": lambda s: np.where(s > 0.7 * LENGTH, 18.0, 0.0),
    "spiral": lambda s: 4.0 + 34.0 * s,
}


def line_of(kind, length=LENGTH):
    """[400, 2] from the origin along x on [m]."""
    s = np.linspace(0.0, LENGTH, 400)
    turn = np.cumsum(CURVATURES[kind](s)) * s[1]
    steps = np.stack([np.cos(turn), np.sin(turn)], axis=1)[:-1] * (length * s[1] / LENGTH)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def seen_along(line, noise, rng):
    """Points about a line [k, 2] with a hole and 1 % of outliers."""
    own = rng.integers(12, len(line), 1500)
    own = own[(own < 150) | (own > 180)]
    points = line[own] + noise * rng.normal(size=(len(own), 2))
    stray = rng.random(len(points)) < 0.01
    points[stray] += rng.uniform(-0.2, 0.2, size=(stray.sum(), 2))
    return points


@pytest.mark.parametrize("kind", CURVATURES)
def test_a_smooth_line_is_followed_by_its_arc_length(kind):
    line = line_of(kind)
    found = lying_line(seen_along(line, 0.002, np.random.default_rng(0)), 50.0)
    off = np.linalg.norm(found[:, None] - line, axis=2).min(axis=1)
    assert off.mean() < 0.001 and off.max() < 0.01  # beyond its ends
    assert arc_length(found)[-1] == pytest.approx(LENGTH * 388 / 400, abs=0.012)


def test_a_straight_rope_is_seldom_an_arc_of_its_noise():
    straight, sag = np.linspace([0.0, 0.0], [LENGTH, 0.0], 400), []
    for seed in range(5):
        found = lying_line(seen_along(straight, 0.002, np.random.default_rng(seed)), 50.0)
        chord = found[-1] - found[0]
        across = (found - found[0]) @ [-chord[1], chord[0]] / np.linalg.norm(chord)
        sag.append(np.ptp(across))
    assert np.median(sag) < 5e-5


def lifted_from(rope_lift, line, **truth) -> Recording:
    """The lift of the shared fixture, of a rope that lies along a line [k, 2]."""
    radius = rope_lift.object.diameter / 2.0
    lying = np.pad(line, ((0, 0), (0, 1)), constant_values=radius)
    body = rope(
        diameter=2.0 * radius,
        length=rope_lift.object.length,
        centre_line=lying,
        points=rope_lift.settings.points,
    )
    scene = LiftScene.of(rope_lift.at_rest(12), rope_lift.settings)
    scene = replace(
        scene,
        body=body,
        initial=body.points,
        held=lying[:1] + np.array([radius, 0.0, 0.0]),
        frames=tuple(range(12)),
    )
    rng, clouds = np.random.default_rng(0), []
    for x in replay(scene, [rope_lift.truth.with_values(truth)])[:, 0]:
        skin = body.surface(x)
        skin = skin[rng.choice(len(skin), size=300, replace=False)]
        clouds.append(skin + 1e-3 * rng.normal(size=skin.shape))
    return rope_lift.recording(clouds)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_how_much_curvature_is_natural_is_found(rope_lift, share):
    """Taken as natural, that of a straight rope makes it softer."""
    line = line_of("arc", rope_lift.object.length)
    seen = lifted_from(rope_lift, line, natural_curvature=share)
    found = estimate(seen, EstimateSettings(starts=1, scene=rope_lift.settings))
    assert found.usable, found.verdict.reasons
    assert "natural_curvature" in found.posterior.names
    assert found.theta.natural_curvature == pytest.approx(share, abs=0.25)
    modulus = rope_lift.truth.E_over_rho
    assert found.theta.E_over_rho == pytest.approx(modulus, rel=0.06)
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < modulus < high
    low, high = found.interval("bending_length") or (
        0.0,
        0.0,
    )  # what the diameter's 5 % are no part of
    assert high < 1.07 * low


def test_a_stated_share_is_not_looked_for(rope_lift):
    seen = lifted_from(rope_lift, line_of("arc", rope_lift.object.length))
    described = replace(seen.object, extra={"natural_curvature": 0.25})
    prior, base = LiftScene.of(replace(seen, object=described), rope_lift.settings).prior()
    assert "natural_curvature" not in prior.names and base.natural_curvature == 0.25
    straight, _ = LiftScene.of(rope_lift.seen(), rope_lift.settings).prior()
    assert "natural_curvature" not in straight.names


@pytest.mark.parametrize("share", [-0.1, 1.5, "half"])
def test_a_share_outside_0_to_1_is_a_fault(rope_lift, share):
    seen = rope_lift.at_rest(5)
    faulty = replace(seen, object=replace(seen.object, extra={"natural_curvature": share}))
    assert any("natural_curvature" in str(fault) for fault in faulty.validate())


def test_a_rope_across_itself_is_refused(rope_lift):
    turn = np.linspace(-0.25 * math.pi, 1.75 * math.pi, 200)
    loop = 0.03 * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=1)
    ahead = np.linspace(0.0, 0.06, 60)[:, None]
    before = loop[0] + (ahead - 0.06) * (loop[1] - loop[0]) / np.linalg.norm(loop[1] - loop[0])
    after = loop[-1] + ahead * (loop[-1] - loop[-2]) / np.linalg.norm(loop[-1] - loop[-2])
    line = np.concatenate([before, loop[1:], after[1:]])
    line = (line - line[0]) * (rope_lift.object.length / arc_length(line)[-1])
    settings = EstimateSettings(starts=1, max_iterations=2, scene=rope_lift.settings)
    found = estimate(lifted_from(rope_lift, line), settings)
    assert any("crosses itself" in said for said in found.verdict.reasons), found.verdict.reasons
