"""The thin engine's native code: C++ headers that Warp's modules begin with."""

from importlib.resources import files

import warp as wp

HEADERS = (
    "meet.h",
    "vectors.h",
    "ground.h",
    "contact.h",
    "rod.h",
    "rod_adjoint.h",
    "shell.h",
    "shell_adjoint.h",
)

_TEXT = "".join(files(__name__).joinpath(name).read_text() for name in HEADERS).replace(
    "#pragma once\n", ""
)

MODULE_OPTIONS = {
    "enable_backward": False,
    "extra_build_options": wp.ModuleBuildOptions(
        extra_cpu_preamble=_TEXT, extra_cuda_preamble=_TEXT
    ),
    "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags or '-march=native'}"
    " -ffp-contract=fast -fno-signed-zeros",
}
"""Options of every Warp module of the engine."""
