"""Readings and rows of the suite; its references stand in ``test_suite``, which simulators pass."""

import math

import numpy as np
import pytest

from gendom.errors import SimulationError
from validation.bench import absolute, relative
from validation.elastica import lateral_load, sag
from validation.readings import swing


def test_elasticas_have_known_limits():
    """Gamma / 8 of a beam; a rod that is mere weight but for its clamp reaches out to
    sqrt(2 / Gamma), as E I theta'^2 / 2 = w L (1 + sin theta) there. A strip on its edge."""
    assert sag([0.01])[0] == pytest.approx(0.01 / 8.0, rel=1e-4)
    assert 1.0 / sag([3000.0])[0] == pytest.approx(math.sqrt(2.0 / 3000.0), rel=0.05)
    assert lateral_load() == pytest.approx(12.85, rel=1e-3)


def test_swing_reads_frequency_and_decay_and_refuses_noise():
    t = np.linspace(0.0, 3.0, 90)
    y = 0.3 + np.exp(-0.4 * t) * (2.0 * np.cos(5.0 * t) - np.sin(5.0 * t))
    assert swing(t, y, 5.5) == pytest.approx((5.0, 0.4), rel=1e-6)
    with pytest.raises(SimulationError, match="no single"):
        swing(t, np.random.default_rng(0).normal(size=90), 5.0)
    # errors of rows
    share = relative("a", "m", -2.0, -2.1, 0.05, "s")
    assert share.error == pytest.approx(0.05) and share.relative
    assert not relative("a", "m", 2.0, 2.2, 0.05, "s").passed
    own = absolute("a", "m", 0.0, -0.3, 0.3, "s")
    assert own.error == 0.3 and own.passed and not own.relative
    with pytest.raises(SimulationError, match="a: measured nan"):
        absolute("a", "m", 0.0, math.nan, 0.3, "s")
