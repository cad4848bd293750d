"""Names that are imported when they are first used."""

import importlib
import subprocess
import sys

import pytest

PACKAGES = ("gendom", "gendom.datasets", "gendom.policies", "gendom.tasks")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there(package):
    for extra in ("torch", "onnx", "pyarrow"):
        pytest.importorskip(extra)
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is getattr(module, name)


@pytest.mark.parametrize("package", PACKAGES)
def test_other_names_are_not_there(package):
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = importlib.import_module(package).nothing


def test_extras_are_not_imported_before_they_are_needed():
    code = f"import {', '.join(PACKAGES)}, sys; print({{'torch', 'pyarrow'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
