"""What tests of several folders need: recordings, new interpreters, the RealSense SDK."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gendom.errors import DeviceError
from gendom.perception.realsense import realsense_sdk


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test skips where there is none."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    folder = Path(os.environ.get("GENDOM_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}; set GENDOM_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def run_python() -> Callable[[str], str]:
    """Runs code in a new interpreter, in which nothing has been imported; gives what it prints."""

    def run(code: str) -> str:
        result = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        return result.stdout.strip()

    return run


@pytest.fixture(scope="session")
def sdk():
    """RealSense's module; without it the test is skipped."""
    try:
        return realsense_sdk()
    except DeviceError as error:
        pytest.skip(str(error))
