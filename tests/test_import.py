"""`import gendom` is light, and its names are found."""

import pytest

import gendom


def test_import_brings_nothing_heavy(run_python):
    code = (
        "import sys, gendom, gendom.cli; "
        "print(sorted({'numpy', 'torch', 'mujoco', 'warp', 'scipy', 'tyro'} & set(sys.modules)))"
    )
    assert run_python(code) == "[]"


def test_names_are_lazy_and_found():
    from gendom.datasets import Recording

    assert gendom.Recording is Recording
    assert set(gendom._EXPORTS) | {"__version__"} == set(gendom.__all__)
    assert set(gendom.__all__) <= set(dir(gendom))
    with pytest.raises(AttributeError, match="no attribute 'Recodring'"):
        gendom.Recodring  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_version_is_that_of_the_package():
    from importlib.metadata import PackageNotFoundError, version

    try:
        installed = version("gendom")
    except PackageNotFoundError:
        pytest.skip("gendom is not installed")
    assert installed == gendom.__version__


def test_the_citation_is_of_this_version():
    from gendom.installation import clone

    folder = clone()
    assert folder is not None
    assert f"\nversion: {gendom.__version__}\n" in (folder / "CITATION.cff").read_text(
        encoding="utf-8"
    )
