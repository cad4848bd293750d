"""The numerical references and the readings, against what is known without a simulator."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq
from scipy.special import jn_zeros

from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import cloth, rope
from validation.bench import Bench, absolute, relative
from validation.elastica import hung, lateral_load, leaves_plane, sag, tip_friction
from validation.readings import mechanics, swing
from validation.references import (
    ROOT,
    damped_frequency,
    first_mode,
    lowest_frequency,
)
from validation.specimens import block, end, sections, stations


def test_elasticas_have_known_limits():
    """Gamma / 8 of a beam; a rod that is mere weight but for its clamp reaches out to
    sqrt(2 / Gamma), as E I theta'^2 / 2 = w L (1 + sin theta) there."""
    assert sag([0.01])[0] == pytest.approx(0.01 / 8.0, rel=1e-4)
    assert 1.0 / sag([3000.0])[0] == pytest.approx(math.sqrt(2.0 / 3000.0), rel=0.05)
    # strip on its edge falls over as in the book
    free = lateral_load()
    assert free == pytest.approx(12.85, rel=1e-3)
    assert lateral_load(1e-4) / free == pytest.approx((1.0 - 0.01) ** -3, rel=2e-3)
    # curl without weight stays in its plane
    for curvature in (1.0, 4.0, 6.0):
        shape = hung([0.0], curvature=curvature)[0]
        assert leaves_plane(shape, 0.0, curvature, 0.7) > 0.0
    # tip of a column that hardly bends
    q = brentq(lambda q: math.tan(q) - q, 4.4, 4.6)
    assert isinstance(q, float)
    s = np.linspace(0.0, 1.0, 2001)
    slope = q * np.cos(q * s) + q**2 * np.sin(q * s) - q
    a = math.sqrt(2.0 * 1e-3 / trapezoid(slope**2, s))
    assert tip_friction(0.0, [1e-3])[0] == pytest.approx(q * a, rel=2e-3)


def test_hanging_ropes_are_chains_or_cantilevers():
    """Frequencies tend to (j01 / 2) sqrt(g / L) from above where ropes are thin; without gravity
    they are 1.8751^2 sqrt(E / density) k / L^2. The terms suffice."""
    chain = jn_zeros(0, 1)[0] / 2.0 * math.sqrt(9.81 / 0.4)
    found = [lowest_frequency(1e9, k, 0.4, 9.81, terms=50) for k in (1e-6, 1e-7)]
    assert chain < found[1] < found[0] and found[1] == pytest.approx(chain, rel=0.005)
    beam = ROOT**2 * math.sqrt(2.0e3) * 0.003 / 0.4**2
    assert lowest_frequency(2.0e3, 0.003, 0.4, 0.0) == pytest.approx(beam, rel=1e-6)
    few, many = (lowest_frequency(200.0, 0.00125, 0.5, 9.81, terms=n) for n in (30, 60))
    assert few == pytest.approx(many, rel=1e-4)


@pytest.mark.parametrize("tau", [1e-5, 0.003, 0.1])
def test_linear_solid_solves_its_equation(tau):
    """s^2 + omega^2 (1 + s tau / (1 + s tau)) = 0, an oscillation that decays."""
    omega = 30.0
    frequency, rate = damped_frequency(omega, tau)
    s = complex(-rate, frequency)
    assert abs(s**2 + omega**2 * (1.0 + s * tau / (1.0 + s * tau))) < 1e-6 * omega**2
    assert frequency > 0.0 and rate > 0.0


def test_first_mode_of_a_cantilever():
    """Clamped at 0, 1 at the tip and free there; an eigenfunction of the fourth derivative."""
    L, h = 0.3, 1e-3
    x = np.arange(0.0, L + h / 2, h)
    y, slope, bend = first_mode(x, L)
    assert abs(math.cos(ROOT) * math.cosh(ROOT) + 1.0) < 1e-9
    assert (y[0], slope[0], y[-1], bend[-1]) == pytest.approx((0.0, 0.0, 1.0, 0.0), abs=1e-7)
    assert np.allclose(np.gradient(y, h)[1:-1], slope[1:-1], atol=1e-3)
    assert np.allclose(np.gradient(slope, h)[1:-1], bend[1:-1], atol=1e-2)
    fourth = np.gradient(np.gradient(bend, h), h)[5:-5]
    assert np.allclose(fourth, (ROOT / L) ** 4 * y[5:-5], atol=1e-3 * (ROOT / L) ** 4)
    assert np.all(first_mode(np.array([-0.1]), L)[0] == 0.0)


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


@pytest.mark.parametrize(
    "body",
    [
        block((0.05, 0.02, 0.02), 0.01, centre=(0.025, 0.0, 0.0)),
        rope(diameter=0.02, length=0.05, cells_across=2.0),
        cloth(width=0.05, height=0.02, thickness=0.01, dx=0.01, corner=(0.0, -0.01, 0.0)),
    ],
)
def test_sections_and_end(body):
    """Section means lie on the axis at their stations, the end at the body's length."""
    expected = np.stack([stations(body), 0 * stations(body), 0 * stations(body)], axis=1)
    assert np.allclose(sections(body.x, body), expected, atol=1e-12)
    assert np.allclose(sections(np.stack([body.x] * 2), body), expected, atol=1e-12)
    assert end(body.x, body) == pytest.approx([0.05, 0.0, 0.0], abs=1e-12)


def test_mechanics_of_a_block():
    """P = M v and m v^2 / 2 of one that only moves; E strain^2 / 2 for each volume of one that is
    stretched by 1 %, with Poisson's contraction."""
    body, strain = block((0.04, 0.03, 0.02), 0.01, centre=(0.1, 0.2, 0.3)), 0.01
    volume, material = 0.04 * 0.03 * 0.02, Material(E=1.0e4, nu=0.3, density=500.0)
    bench = Bench(threads=1)
    s = bench.simulate(body, [material], gravity=(0, 0, 0))
    s.set_velocities((1.0, 2.0, 3.0))
    m, mass = mechanics(s), 500.0 * volume
    assert m.mass == pytest.approx(mass) and m.centre == pytest.approx([0.1, 0.2, 0.3])
    assert m.P == pytest.approx(mass * np.array([1.0, 2.0, 3.0]))
    assert m.L == pytest.approx(np.zeros(3), abs=1e-12)
    assert (m.kinetic, m.elastic) == pytest.approx((mass * 7.0, 0.0), abs=1e-15)
    x = body.x * (1.0 + strain * np.array([1.0, -0.3, -0.3]))
    m = mechanics(bench.simulate(body, [material], gravity=(0, 0, 0), positions=x))
    assert m.elastic == pytest.approx(1.0e4 * strain**2 / 2.0 * volume, rel=0.02)
