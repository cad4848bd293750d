"""Where compiled kernels are kept, what becomes of damaged ones, and that CUDA's compile, where
there is no GPU too."""

import os
import tempfile
from functools import partial

import pytest
import warp as wp

from gendom.sim import device, open_device
from gendom.sim.mpm.kernels import make_advance, make_reverse
from gendom.sim.mpm.particles import Variant
from gendom.sim.thin.step import make_kernels


@wp.kernel
def doubled(x: wp.array[float]):
    i = wp.tid()
    x[i] = 2.0 * x[i]  # pyright: ignore[reportIndexIssue]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    open_device("cpu")
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    doubled.module.unload()
    device.load_kernels(doubled.module, "cpu")
    return tmp_path


@pytest.mark.parametrize(("ending", "damage"), [(".o", "flipped"), (".meta", "empty")])
def test_damaged_kernels_are_made_anew(cache, ending, damage):
    (path,) = cache.rglob(f"*{ending}")
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(b"" if damage == "empty" else whole[:middle] + b"\xff" + whole[middle + 1 :])
    doubled.module.unload()
    device.load_kernels(doubled.module, "cpu")
    x = wp.array([1.5], dtype=float, device="cpu")
    wp.launch(doubled, dim=1, inputs=[x], device="cpu")
    assert x.numpy() == [3.0]
    (path,) = cache.rglob(f"*{ending}")
    assert len(path.read_bytes()) == len(whole)


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A process whose temporary files go to a folder, and whose cache is nowhere yet."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    for name in ("WARP_CACHE_PATH", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.mark.parametrize("name", ["HOME", "XDG_CACHE_HOME", "WARP_CACHE_PATH"])
def test_kernels_go_where_they_can_be_written(nowhere, monkeypatch, caplog, name):
    with monkeypatch.context() as m:
        m.setattr(os.path, "expanduser", lambda path: path)  # without a home: no folder "~"
        assert str(device._kernel_cache()).startswith(str(nowhere))
    caplog.clear()
    monkeypatch.setenv("HOME", str(nowhere))
    assert device._kernel_cache() is None and not caplog.records
    monkeypatch.setenv(name, "/dev/null/home")
    kept = device._kernel_cache()
    assert kept is not None and os.path.dirname(kept) == str(nowhere)
    assert [kept in record.getMessage() for record in caplog.records] == [True]


@pytest.mark.parametrize("kind", ["open", "link", "file"])
def test_code_of_others_is_not_run(nowhere, kind):
    """A folder that others can write is not taken, nor a link or a file of that name."""
    usual = nowhere / f"gendom-kernels-{os.geteuid()}"
    make = {"open": usual.mkdir, "link": lambda: usual.symlink_to(nowhere), "file": usual.touch}
    make[kind]()
    if kind == "open":
        usual.chmod(0o777)
    kept = device._folder_of_this_user()
    assert kept != str(usual) and os.stat(kept).st_mode & 0o077 == 0


FLOAT32 = Variant(wp.float32, damped=True, sorts=True, room=96_000, threads=128)
FLOAT64 = Variant(wp.float64, damped=False, sorts=True, threads=256)


def of_thin(kind, real, name, *more):
    return getattr(make_kernels(real, kind, *more), name)


SOURCES = {
    "mpm float32": partial(make_advance, FLOAT32, taped=True),
    "mpm float32 reverse": partial(make_reverse, FLOAT32),
    "mpm float64 without a tape": partial(make_advance, FLOAT64, taped=False),
    "mpm float64 reverse": partial(make_reverse, FLOAT64),
    **{
        f"{kind} {real.__name__} {name}": partial(of_thin, kind, real, name)
        for kind in ("rod", "shell")
        for real in (wp.float32, wp.float64)
        for name in ("advance", "reverse")
    },
    **{f"rods of {32 * held} points": partial(of_thin, "rod", wp.float64, "advance", held)
       for held in (1, 2, 4)},
    "shells in shared memory": partial(of_thin, "shell", wp.float32, "advance", 0, 22528, 2),
}  # fmt: skip
FAST = ("mpm float32", "rods of 32 points", "shell float32 reverse", "shells in shared memory")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in FAST else pytest.mark.slow) for n in SOURCES]
)
def test_kernels_compile_for_cuda(name, tmp_path, monkeypatch):
    open_device("cpu")
    kernel = SOURCES[name]()
    monkeypatch.setitem(kernel.module.options, "mode", "debug")  # takes less time
    wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    assert len(list(tmp_path.rglob("*.ptx"))) == 1
