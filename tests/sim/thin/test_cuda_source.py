"""The CUDA source of rods and shells compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.thin.step import make_kernels


@pytest.mark.parametrize(
    ("kind", "real"),
    [
        pytest.param("rod", wp.float64, id="rod-float64"),
        pytest.param("shell", wp.float32, id="shell-float32"),
        pytest.param("rod", wp.float32, id="rod-float32", marks=pytest.mark.slow),
        pytest.param("shell", wp.float64, id="shell-float64", marks=pytest.mark.slow),
    ],
)
def test_kernels_compile_for_cuda(kind, real, tmp_path):
    open_device("cpu")
    steps = make_kernels(real, kind)
    kernels = [steps.advance, steps.reverse]
    for kernel in kernels:
        wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == len(kernels)
