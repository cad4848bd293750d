"""Native code: C++ headers that Warp's modules begin with.

One text for both kinds of device; what differs stands side by side in each header. Warp functions
call it by ``wp.func_native`` with one line; types are template arguments.
"""

from collections.abc import Mapping
from importlib.resources import files
from types import SimpleNamespace
from typing import Any

import warp as wp


def functions_of(names: Mapping[str, Any]) -> SimpleNamespace:
    """Warp's functions and kernels among ``locals()``, under their own names."""
    kinds = (wp.Function, wp.Kernel)
    return SimpleNamespace(**{n: of for n, of in names.items() if isinstance(of, kinds)})


def module_options(package: str, *headers: str) -> dict[str, Any]:
    """Options of Warp modules that begin with ``vectors.h`` and a package's headers.

    Compiler flags: products and sums become one rounding, a seventh faster, and sums that begin
    with 0 begin with their first term, a twelfth faster.
    """
    texts = [files(__name__) / "vectors.h", *(files(package) / name for name in headers)]
    text = "".join(of.read_text() for of in texts).replace("#pragma once\n", "")
    return {
        "enable_backward": False,
        "extra_build_options": wp.ModuleBuildOptions(
            extra_cpu_preamble=text, extra_cuda_preamble=text
        ),
        "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags or '-march=native'}"
        " -ffp-contract=fast -fno-signed-zeros",
    }
