"""Whether intervals hold, from posteriors made by hand."""

import json
import math

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.coverage import covered, rank_band, shown_of


def rows_of(lifts, *, stated=1.0, bias=0.0, seed=0):
    """Lifts whose ln E is found with a deviation of 0.05, and said to have `stated` times that."""
    rng, sd = np.random.default_rng(seed), 0.05
    return [
        {
            "seed": n,
            "truth": {"E_over_rho": truth, "nu": 0.3, "damping": 0.005, "friction": 0.4},
            "verdict": {"usable": True, "reasons": []},
            "posterior": {
                "names": ["E_over_rho"],
                "log": [True],
                "mean": [math.log(truth) + bias + sd * rng.standard_normal()],
                "covariance": [[(stated * sd) ** 2]],
            },
        }
        for n, truth in enumerate(rng.uniform(100.0, 4000.0, lifts))
    ]


@pytest.mark.parametrize("seed", range(5))
def test_ranks_of_right_posteriors_stay_in_the_band(seed):
    (found,) = covered(rows_of(100, seed=seed), 0.9)
    assert found.uniform and len(found.ranks) == sum(found.counts) == 100
    assert "in the band" in str(shown_of(rows_of(100, seed=seed), [found])[0])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("wrong", "piles"),
    [({"stated": 0.35}, (0, -1)), ({"bias": 0.06}, (0,)), ({"bias": -0.06}, (-1,))],
)
def test_ranks_of_narrow_or_shifted_posteriors_leave_it(wrong, piles, seed):
    """Too narrow: both ends are too high. An estimate that is too large: truths rank low."""
    (found,) = covered(rows_of(100, seed=seed, **wrong), 0.9)
    assert not found.uniform
    for end in piles:
        assert found.counts[end] > found.band[1]
    assert "not uniform" in str(shown_of(rows_of(100, seed=seed, **wrong), [found])[0])


def test_ranks_of_wide_posteriors_leave_it_in_the_middle():
    (found,) = covered(rows_of(200, stated=3.0), 0.9)
    assert max(found.counts) > found.band[1]
    assert found.counts[0] == found.counts[-1] == 0 < found.band[0]


@pytest.mark.parametrize("stated", [0.1, 0.35])
def test_what_is_added_makes_intervals_hold(stated):
    """Errors have a deviation of 0.05, of which a part is stated; the rest is found."""
    rows = rows_of(2000, stated=stated)
    (found,) = covered(rows, 0.9)
    assert found.added == pytest.approx(0.05 * math.sqrt(1.0 - stated**2), rel=0.05)
    assert found.covered < 0.5
    for row in rows:
        row["posterior"]["covariance"] = [[(stated * 0.05) ** 2 + found.added**2]]
    assert covered(rows, 0.9)[0].covered == pytest.approx(0.9, abs=1e-3)
    assert f"{found.added:.4f}" in str(shown_of(rows, [found])[0])


@pytest.mark.parametrize("stated", [0.5, 2.0])
def test_a_factor_makes_intervals_hold_as_often_as_they_say(stated):
    """Those that are too wide become narrower."""
    (found,) = covered(rows_of(2000, stated=stated), 0.9)
    assert found.factor == pytest.approx(1.0 / stated, rel=0.05)


def test_nothing_is_added_to_wide_posteriors():
    assert covered(rows_of(500, stated=2.0), 0.9)[0].added == 0.0


def test_a_rank_is_the_share_of_the_posterior_below_the_truth():
    """0.05 above the mean of a posterior whose deviation is 0.05: Phi(1)."""
    (row,) = rows_of(1)
    row["posterior"]["mean"] = [math.log(row["truth"]["E_over_rho"]) - 0.05]
    (found,) = covered([row], 0.9)
    assert found.ranks == pytest.approx((0.8413,), abs=1e-4)
    assert found.counts == (0, 0, 0, 1)


@pytest.mark.parametrize(("count", "bins"), [(40, 8), (100, 20), (21, 4)])
def test_the_band_holds_uniform_ranks_as_often_as_it_says(count, bins):
    low, high = rank_band(count, bins)
    ranks = np.random.default_rng(0).random((4000, count))
    counts = np.array([np.histogram(r, bins, range=(0.0, 1.0))[0] for r in ranks])
    inside = ((counts >= low) & (counts <= high)).all(axis=1).mean()
    assert 0.95 <= inside + 0.01 and inside < 0.999
    narrower = ((counts >= low + 1) & (counts <= high - 1)).all(axis=1).mean()
    assert narrower < 0.95


def test_the_command_writes_ranks_and_a_picture(tmp_path, monkeypatch, capsys):
    """Rows that are kept are not made again."""
    rows = rows_of(40, stated=0.4)
    for row in rows:
        (tmp_path / f"rope-swing-{row['seed']:04d}.json").write_text(json.dumps(row))
    words = ["coverage", "--end", "swing", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "40 lifts, 40 usable" in told and "not uniform" in told
    result = json.loads((tmp_path / "coverage-rope-swing.json").read_text())
    (unknown,) = result["unknowns"]
    assert len(unknown["ranks"]) == 40 and unknown["band"] == list(rank_band(40, 8))
    made = json.loads((tmp_path / "calibration-rope-swing.json").read_text())["rope"]
    assert made["lifts"] == 40 and made["factor"] == {}
    assert made["added"]["E_over_rho"] == unknown["added"] > 0.0
    assert "coverage --end swing" in (tmp_path / "coverage-rope-swing.txt").read_text()
    assert (tmp_path / "coverage-rope-swing.png").stat().st_size > 1000
