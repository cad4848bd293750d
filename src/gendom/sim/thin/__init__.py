"""Engine for thin bodies: ropes as rods, cloths as shells."""

from gendom.sim.bodies import Body
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.shells import Shells


def thin_engine(body: Body) -> type[ThinEngine]:
    """Return the engine class for a rope or a cloth."""
    return Rods if body.kind == "rope" else Shells
