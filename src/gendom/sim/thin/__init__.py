"""Rods and shells: thin bodies simulated as what they are."""

from gendom.sim.bodies import Body
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.shells import Shells


def thin_engine(body: Body) -> type[ThinEngine]:
    """The model of a rope or of a cloth."""
    return Rods if body.kind == "rope" else Shells
