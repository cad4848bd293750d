"""The CUDA source of the MPM compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.mpm.kernels import make_advance, make_reverse
from gendom.sim.mpm.particles import Variant


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(
            Variant(wp.float32, damped=True, rows=False, room=96_000, threads=128), id="float32"
        ),
        pytest.param(
            Variant(wp.float64, damped=False, rows=False, threads=256),
            id="float64",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_kernels_compile_for_cuda(variant, tmp_path):
    open_device("cpu")
    forward = [make_advance(variant, taped=taped) for taped in (False, True)]
    made = [kernel.module for kernel in (*forward, make_reverse(variant))]
    for module in made:
        wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == len(made)
