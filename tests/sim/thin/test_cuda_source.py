"""The CUDA source of rods and shells compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.thin.step import make_kernels


@pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("kind", ["rod", "shell"])
def test_kernels_compile_for_cuda(kind, real, tmp_path):
    open_device("cpu")
    steps = make_kernels(real, kind)
    kernels = [steps.advance, steps.reverse]
    for kernel in kernels:
        wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == len(kernels)
