"""Engine for thin bodies: ropes as rods, cloths as shells."""

from gendom.errors import ParameterError
from gendom.sim.bodies import Body
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.implicit import ImplicitRods
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.shells import Shells


def thin_engine(body: Body, *, implicit: bool) -> type[ThinEngine]:
    """Return the engine class for a rope or a cloth.

    Raises:
        ParameterError: If it has no implicit steps.
    """
    if body.kind == "rope":
        return ImplicitRods if implicit else Rods
    if implicit:
        raise ParameterError("shells have no implicit steps", fix="integrator='explicit'")
    return Shells
