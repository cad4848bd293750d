"""The CUDA source of both engines compiles, where there is no GPU too."""

from functools import partial

import pytest
import warp as wp

from gendom.sim.device import open_device
from gendom.sim.mpm.kernels import make_advance, make_reverse
from gendom.sim.mpm.particles import Variant
from gendom.sim.thin.step import make_kernels

FLOAT32 = Variant(wp.float32, damped=True, sorts=True, room=96_000, threads=128)
FLOAT64 = Variant(wp.float64, damped=False, sorts=True, threads=256)


def of_thin(kind, real, name):
    return getattr(make_kernels(real, kind), name)


SOURCES = {
    "mpm float32": partial(make_advance, FLOAT32, taped=True),
    "mpm float32 without a tape": partial(make_advance, FLOAT32, taped=False),
    "mpm float32 reverse": partial(make_reverse, FLOAT32),
    "mpm float64": partial(make_advance, FLOAT64, taped=False),
    "mpm float64 with a tape": partial(make_advance, FLOAT64, taped=True),
    "mpm float64 reverse": partial(make_reverse, FLOAT64),
    **{
        f"{kind} {real.__name__} {name}": partial(of_thin, kind, real, name)
        for kind in ("rod", "shell")
        for real in (wp.float32, wp.float64)
        for name in ("advance", "reverse")
    },
}
FAST = ("mpm float32", "rod float64 advance", "shell float32 reverse")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in FAST else pytest.mark.slow) for n in SOURCES]
)
def test_kernels_compile_for_cuda(name, tmp_path, monkeypatch):
    open_device("cpu")
    kernel = SOURCES[name]()
    monkeypatch.setitem(kernel.module.options, "mode", "debug")  # takes less time
    wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == 1
