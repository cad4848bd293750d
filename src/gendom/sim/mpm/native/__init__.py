"""The engine's native code: C++ headers that Warp's modules begin with.

One text for both kinds of device; what differs stands side by side in each header. Warp functions
call it by ``wp.func_native`` with one line; types are template arguments.
"""

from importlib.resources import files

import warp as wp

HEADERS = ("block.h", "bspline_transfer.h", "simd_elasticity.h")

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
"""Options of every Warp module of the engine.

Compiler flags: products and sums become one rounding, a seventh faster, and sums that begin with 0
begin with their first term, a twelfth faster.
"""
