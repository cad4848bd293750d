"""The CUDA source of rods and shells compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.thin.step import make_kernels

FAST = [("rod", wp.float64, "advance"), ("shell", wp.float32, "reverse")]


@pytest.mark.parametrize(
    ("kind", "real", "name"),
    [
        pytest.param(
            kind, real, name, id=f"{kind}-{real.__name__}-{name}",
            marks=() if (kind, real, name) in FAST else pytest.mark.slow,
        )
        for kind in ("rod", "shell") for real in (wp.float32, wp.float64)
        for name in ("advance", "reverse")
    ],
)  # fmt: skip
def test_kernels_compile_for_cuda(kind, real, name, tmp_path):
    open_device("cpu")
    kernel = getattr(make_kernels(real, kind), name)
    wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == 1
