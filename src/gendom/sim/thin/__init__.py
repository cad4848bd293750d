"""Engines for thin bodies: ropes as rods, cloths as shells."""

from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.shells import Shells

THIN_ENGINES: dict[str, type[ThinEngine]] = {"rope": Rods, "cloth": Shells}
"""By kind of body."""
