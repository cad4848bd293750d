"""Material parameters: known values, ranges, and the bending length."""

import math

import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.materials.parameters import E_over_rho_of, bending_length


def test_moduli_speeds_and_lengths_are_known():
    """nu = 1/4 gives mu = lam = 2 E / 5; nu = 0 gives mu = E / 2, lam = 0."""
    assert Material(E=10.0, nu=0.25).lame == pytest.approx((4.0, 4.0))
    assert Material(E=10.0, nu=0.0).lame == pytest.approx((5.0, 0.0))
    assert Material(E=12.0, nu=0.25).lame_of(1.0) == pytest.approx((4.8, 3.2))
    # wave speed without lateral contraction
    rod = Material(E=9.0e4, nu=0.0, density=900.0)
    assert rod.wave_speed == pytest.approx(10.0)
    assert rod.E_over_rho == pytest.approx(100.0)
    assert Material(E=9.0e4, nu=0.3, density=900.0).wave_speed == pytest.approx(
        10.0 * math.sqrt(0.7 / (1.3 * 0.4))
    )
    # bending length and its inverse
    assert bending_length(1.0e4, 1.0e-3, 10.0) == pytest.approx(0.1)
    for modulus in (1.0, 450.0, 3.0e6):
        length = bending_length(modulus, 0.003, 9.81)
        assert E_over_rho_of(length, 0.003, 9.81) == pytest.approx(modulus)


@pytest.mark.parametrize("nu", [-0.5, 0.1, 0.3, 0.45])
def test_lame_gives_back_modulus_and_ratio(nu):
    """E = mu (3 lam + 2 mu) / (lam + mu) and nu = lam / (2 (lam + mu))."""
    mu, lam = Material(E=7.0e4, nu=nu).lame
    assert mu * (3.0 * lam + 2.0 * mu) / (lam + mu) == pytest.approx(7.0e4)
    assert lam / (2.0 * (lam + mu)) == pytest.approx(nu)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("E", [0.0, -1.0, math.nan, math.inf]),
        ("nu", [0.5, -1.0, 0.7, math.nan]),
        ("density", [0.0, -5.0, math.nan, math.inf]),
    ],
)
def test_out_of_range_is_refused_by_name(field, values):
    """The error names the parameter that lies outside its range."""
    for value in values:
        with pytest.raises(ParameterError, match=field):
            Material(**{field: value})
