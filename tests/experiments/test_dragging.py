"""The search for motions of cloth dragging."""

from dataclasses import dataclass

import numpy as np
import pytest

from experiments.dragging import START, Evolution, drawn, judged, search, worth
from gendom.materials import dimensionless_parameters
from gendom.tasks import ClothDragging
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation


def test_the_evolution_strategy_follows_a_narrow_valley():
    rng = np.random.default_rng(0)
    axes, _ = np.linalg.qr(rng.normal(size=(10, 10)))
    H, best = axes @ np.diag(np.logspace(0.0, 3.0, 10)) @ axes.T, np.full(10, 0.6)
    found = Evolution(np.full(10, 0.2), 0.15, 12, seed=1)
    for _ in range(250):
        points = found.ask()
        found.tell(points, -np.einsum("bi,ij,bj->b", points - best, H, points - best))
    assert np.abs(found.mean - best).max() < 1e-4


def test_what_is_enough_counts_most():
    assert worth(np.array([0.5, 0.74, 0.8, 1.0])) == pytest.approx(
        [0.15, 0.39, 0.56, 0.97], abs=0.01
    )


@dataclass(frozen=True, kw_only=True)
class Formula(Simulation):
    """Spreads best where the last x is 12 bending lengths."""

    def carry_out(self, task, items, actions, **_):
        last = np.asarray(actions)[:, -3] / np.array([i.side for i in items])
        ratio = np.array([dimensionless_parameters(i)["bending_ratio"] for i in items])
        return [Outcome(values={"share": s}) for s in 1.0 - np.abs(last - 12.0 * ratio)]


def test_cloths_of_a_family_are_as_limp_and_as_rough():
    cloths = drawn(20, (0.06, 0.08, 0.5, 0.7), seed=[3])
    ratio = [dimensionless_parameters(c)["bending_ratio"] for c in cloths]
    assert 0.06 <= min(ratio) and max(ratio) < 0.08
    assert all(0.5 <= c.friction < 0.7 for c in cloths)


def test_a_search_leads_each_family_to_a_better_motion():
    families = ((0.06, 0.09, 0.3, 0.8), (0.12, 0.17, 0.3, 0.8))
    found = search(
        Formula(), families, seconds=60.0, population=8, cloths=1, seed=0, generations=15,
        start=[np.array(START)] * 2,
    )  # fmt: skip
    motions = np.array([START, found[0][0]])
    share = judged(Formula(), motions, families, 4, seed=1)
    assert share.shape == (2, 2, 4)
    assert share[0, 0].mean() < 0.2 < 0.6 < share[0, 1].mean()
    assert len(ClothDragging.actions) == len(START)
