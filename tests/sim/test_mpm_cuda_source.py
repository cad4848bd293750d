"""The CUDA source of the MPM compiles, where there is no GPU too."""

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.mpm.adjoint.block_kernels import make_block_reverse
from gendom.sim.mpm.adjoint.graph import make_reverse_kernels
from gendom.sim.mpm.runners.block_kernels import make_block_kernels
from gendom.sim.mpm.runners.graph_kernels import make_graph_kernels
from gendom.sim.mpm.runners.records import Variant


def modules(kind, real, *, yields):
    """Warp modules of a runner and of its reverse."""
    law = "fixed-corotated" if yields else "neo-hookean"
    if kind == "stages":
        stages = make_graph_kernels(real, law, yields=yields)
        return [stages.p2g.module, make_reverse_kernels(real, law, yields=yields).p2g_back.module]
    variant = Variant(real, law, yields, True, room=0 if yields else 96_000, lanes=128)
    forward = [make_block_kernels(variant, taped=taped).advance for taped in (False, True)]
    return [kernel.module for kernel in (*forward, make_block_reverse(variant).reverse)]


@pytest.mark.parametrize(
    ("real", "yields"),
    [
        pytest.param(wp.float32, False, id="float32"),
        pytest.param(wp.float64, True, id="float64 yields", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("kind", ["stages", "blocks"])
def test_kernels_compile_for_cuda(kind, real, yields, tmp_path):
    open_device("cpu")
    made = modules(kind, real, yields=yields)
    for module in made:
        wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == len(made)
