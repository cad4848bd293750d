"""Checks of arguments: what they let pass, and what they say of the rest."""

import math
from fractions import Fraction

import numpy as np
import pytest

from gendom.arguments import (
    check_choice,
    check_integers,
    check_list,
    check_number,
    check_numbers,
    check_type,
    require,
)
from gendom.errors import DatasetError, ParameterError


def test_numbers_of_many_types_and_arrays_come_back():
    for value in (2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0)):
        found = check_number("x", value, above=0.0)
        assert found == 2.0 and type(found) is float
    a = np.zeros((4, 3))
    assert check_numbers("x", a, (3,), ("K", 3)) is a
    assert check_numbers("x", [1, 2, 3], (3,)).dtype == float
    assert check_integers("x", [], ("P",)).shape == (0,)
    assert check_number("x", -math.inf, finite=False) == -math.inf


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: check_number("x", "1.5"), "x must be a number, got '1.5'"),
        (lambda: check_number("x", True), "x must be a number, got True"),
        (lambda: check_number("x", Fraction(1, 2)), "x must be a number, got Fraction(1, 2)"),
        (lambda: check_number("x", -1, above=0.0), "x must be positive and finite, got -1.0"),
        (lambda: check_number("x", math.nan, finite=False), "x must be a number, got nan"),
        (lambda: check_number("x", 1.0, above=2.0), "x must be finite and above 2.0, got 1.0"),
        (lambda: check_numbers("x", [1.0, -1.0], ("W",), least=0.0),
         "x must be finite and at least 0, got -1.0 at [1]"),
        (lambda: check_numbers("x", [1.0], (3,), ("W", 3)),
         "x must be [3] or [W, 3] numbers, got shape [1]"),
        (lambda: check_numbers("x", [[1], [1, 2]], (), ("W",)),
         "x must be a number or [W] numbers, got [[1], [1, 2]]"),
        (lambda: check_numbers("x", "a" * 99), f"x must be numbers, got '{'a' * 56}..."),
        (lambda: check_integers("x", 1.0, ()), "x must be an integer, got 1.0"),
        (lambda: check_integers("x", [3, 9], ("P",), most=8), "x must be 0 to 8, got 9 at [1]"),
        (lambda: check_integers("x", 0, (), least=1), "x must be at least 1, got 0"),
        (lambda: check_type("x", 1, bool), "x must be True or False, got 1"),
        (lambda: check_type("x", 1, str, optional=True), "x must be a str or None, got 1"),
        (lambda: check_list("x", "ab", str), "x must be a list of str, got 'ab'"),
        (lambda: check_list("x", ["a", 1], str), "x[1] must be a str, got 1"),
    ],
)  # fmt: skip
def test_what_is_refused_is_named(check, message):
    with pytest.raises(ParameterError) as found:
        check()
    assert str(found.value) == message


def test_requirements_and_choices_end_in_one_line():
    require(True, "never said")
    with pytest.raises(DatasetError, match=r"^a file: is empty; fill it$"):
        require(False, "is empty", where="a file", fix="fill it", error=DatasetError)
    check_choice("engine", "thin", ("mpm", "thin"))
    with pytest.raises(ParameterError, match=r"^unknown engine 'thinn'; did you mean 'thin'\?$"):
        check_choice("engine", "thinn", ("mpm", "thin"))
    with pytest.raises(ParameterError, match=r"choose one of mpm, thin$"):
        check_choice("engine", 7, ("mpm", "thin"))
