"""Central differences of losses that jump where a contact begins or ends in another step, and the
model of a sheet."""

import numpy as np
import pytest

from gendom.materials import Material
from gendom.sim import Simulator
from gendom.sim.thin.shells import Shells

SIZES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


def difference(loss, h):
    """Derivative at 0 of a loss by a central difference, and its uncertainty by rounding.

    Steps are up to 3 h. Short ones are rounded, in inverse proportion; how much is seen where next
    to nothing changes. Long ones cross jumps: the longest one is taken that differs from all
    shorter ones by no more than those are rounded.
    """
    at = 1e-3 * SIZES[0] * h * np.arange(-3.0, 4.0)
    near = np.array([loss(a) for a in at])
    noise = 6.0 * np.std(near - np.polyval(np.polyfit(at / h, near, 1), at / h)) / h
    found = []
    for size in SIZES:
        near, far = (loss(k * size * h) - loss(-k * size * h) for k in (1.0, 2.0))
        value = (8.0 * near - far) / (12.0 * size * h)
        rounded = noise / size
        if any(abs(value - other) > rounded + other_rounded for other, other_rounded in found):
            break
        found.append((value, rounded))
    return found[-1]


def check_derivative(by, loss, h, rel, name):
    """Assert that a derivative is that of central differences, which must tell to 0.1 %."""
    expected, rounded = difference(loss, h)
    assert rounded <= 1e-3 * abs(expected), name
    assert by == pytest.approx(expected, abs=rounded + rel * abs(expected)), name


def model_of(body):
    """The shell model of a cloth."""
    engine = Simulator(body, [Material()]).engine
    assert isinstance(engine, Shells)
    return engine.model
