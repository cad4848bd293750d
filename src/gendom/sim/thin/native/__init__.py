"""The thin engine's native code."""

from gendom.sim.native import module_options

MODULE_OPTIONS = module_options(
    __name__,
    "vectors.h", "ground.h", "hold.h", "contact_lists.h", "contact.h", "contact_adjoint.h",
    "rod.h", "rod_adjoint.h",
    "shell.h", "shell_adjoint.h",
)  # fmt: skip
"""Options of every Warp module of the engine."""
