"""Cloths whose threads and hems bend otherwise than the rest."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, estimate
from gendom.estimation.replay import HEM, WorldInputs


@pytest.fixture(scope="module")
def scene(cloth_lift):
    return LiftScene.of(cloth_lift.at_rest(4), cloth_lift.settings)


def inputs(scene, cloth_lift, **values):
    return WorldInputs.of(scene, cloth_lift.truth.with_values(values))


def test_warp_and_weft_share_their_geometric_mean(scene, cloth_lift):
    material = inputs(scene, cloth_lift, warp_over_weft=4.0).material
    assert (material.warp, material.weft) == pytest.approx((2.0, 0.5))
    plain = inputs(scene, cloth_lift).material
    assert plain == replace(material, warp=1.0, weft=1.0)


def test_a_hem_counts_by_its_area(scene, cloth_lift):
    """A border of 10 mm of 0.2 m, whatever the points; the mass stays as stated."""
    side, counts = 0.2, scene.body.shape
    hemmed = inputs(scene, cloth_lift, hem_stiffness=5.0, hem_mass=2.0)
    weight = np.ones(counts)
    weight[[0, -1]] /= 2.0
    weight[:, [0, -1]] /= 2.0
    mean = weight.ravel() / weight.sum()
    area = 1.0 - (1.0 - 2.0 * HEM / side) ** 2
    assert hemmed.stiffness @ mean == pytest.approx(1.0 + 4.0 * area)
    assert hemmed.mass @ mean == pytest.approx(1.0)
    assert hemmed.mass is not None
    middle = hemmed.mass.reshape(counts)[counts[0] // 2, counts[1] // 2]
    assert middle == pytest.approx(1.0 / (1.0 + area))


@pytest.mark.slow
def test_threads_come_back(cloth_lift):
    """Within half of what they are."""
    seen = cloth_lift.seen(points=400, warp_over_weft=4.0)
    wanted = ("E_over_rho", "warp_over_weft")
    settings = EstimateSettings(starts=1, unknowns=wanted, scene=cloth_lift.settings)
    known = cloth_lift.truth.with_values({"warp_over_weft": 1.0})
    found = estimate(seen, settings, known=known)
    assert found.verdict.usable, found.verdict.reasons
    assert found.theta.warp_over_weft == pytest.approx(4.0, rel=0.5)
