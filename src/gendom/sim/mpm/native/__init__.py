"""The MPM's native code."""

from gendom.sim.native import module_options

MODULE_OPTIONS = module_options(__name__, "block.h", "bspline.h", "elasticity.h")
"""Options of every Warp module of the engine."""
