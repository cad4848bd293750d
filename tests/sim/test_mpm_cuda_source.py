"""The CUDA source of the MPM compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.mpm.kernels import make_advance, make_reverse
from gendom.sim.mpm.particles import Variant

FLOAT32 = Variant(wp.float32, damped=True, sorts=True, room=96_000, threads=128)
FLOAT64 = Variant(wp.float64, damped=False, sorts=True, threads=256)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(lambda: make_advance(FLOAT32, taped=True), id="float32"),
        *(
            pytest.param(make, id=name, marks=pytest.mark.slow)
            for name, make in {
                "float32 without a tape": lambda: make_advance(FLOAT32, taped=False),
                "float32 reverse": lambda: make_reverse(FLOAT32),
                "float64": lambda: make_advance(FLOAT64, taped=False),
                "float64 with a tape": lambda: make_advance(FLOAT64, taped=True),
                "float64 reverse": lambda: make_reverse(FLOAT64),
            }.items()
        ),
    ],
)
def test_kernels_compile_for_cuda(make, tmp_path):
    open_device("cpu")
    wp.compile_aot_module(make().module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == 1
