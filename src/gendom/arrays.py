"""The type of arrays of floating point numbers; docstrings give their shapes and units."""

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]
