"""Methods of estimation by name, each a function from a `Problem` to what it `Found`."""

from collections.abc import Callable

from gendom.estimation.methods.adam import adam
from gendom.estimation.methods.differential_evolution import differential_evolution
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.problem import Found, Problem

METHODS: dict[str, Callable[[Problem], Found]] = {
    "gauss-newton": gauss_newton,
    "adam": adam,
    "differential-evolution": differential_evolution,
}
