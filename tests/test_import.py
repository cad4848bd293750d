"""`import gendom` is light, and its names are found."""

import importlib

import pytest

import gendom

PACKAGES = ("gendom", "gendom.datasets", "gendom.policies", "gendom.tasks")


HEAVY = {
    "gendom.cli": "numpy torch mujoco warp scipy tyro",
    "gendom.viz": "torch warp gendom.estimation gendom.policies gendom.sim gendom.datasets",
    "gendom.cli.estimate, gendom.cli.replay": "torch warp matplotlib",
    "gendom.policies, gendom.tasks": "torch onnx onnxruntime warp",
    ", ".join(PACKAGES): "torch pyarrow",
}
"""Modules, and what must not have been imported once they and those before them are."""


def test_nothing_heavy_is_imported_before_it_is_needed(run_python):
    lines = [f"import {m}; found += {{*{h.split()}}} & {{*sys.modules}}" for m, h in HEAVY.items()]
    assert run_python("\n".join(["import sys", "found = []", *lines, "print(found)"])) == "[]"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_no_other(package):
    for extra in ("torch", "onnx", "pyarrow"):
        pytest.importorskip(extra)
    module = importlib.import_module(package)
    assert all(getattr(module, name) is getattr(module, name) for name in module.__all__)
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


def test_names_of_the_top_level_are_those_of_rooms():
    assert set(gendom._EXPORTS) | {"__version__"} == set(gendom.__all__) <= set(dir(gendom))
