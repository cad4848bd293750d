"""Methods of estimation by name, each a function from a `Problem` to what it `Found`.

Other packages add methods by an entry point of the group ``gendom.methods`` whose object is such a
function; its name is that of the entry point.
"""

from collections.abc import Callable

from gendom.errors import ParameterError, did_you_mean
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.problem import Found, Problem
from gendom.plugins import plugins

METHODS: dict[str, Callable[[Problem], Found]] = {"gauss-newton": gauss_newton}


def find_method(name: str) -> Callable[[Problem], Found]:
    """The method of a name, those of other packages included.

    Raises:
        ParameterError: There is none of that name.
    """
    known = {**plugins("methods"), **METHODS}
    if name not in known:
        fix = did_you_mean(name, known) or f"choose from {', '.join(known)}"
        raise ParameterError(f"there is no method {name!r}", fix=fix)
    return known[name]
