"""Public names that are imported when first used: some need an extra, or take long."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def imported_later(package: str) -> Callable[[str], Any]:
    """A package's ``__getattr__``: it imports a name from where the package's file imports it for
    type checkers alone, ``if TYPE_CHECKING``, and keeps it there."""

    @cache
    def modules() -> dict[str, str]:
        """The module of each name."""
        tree = ast.parse(Path(str(own.__file__)).read_bytes())
        inner = [n for block in tree.body if isinstance(block, ast.If) for n in block.body]
        lines = [n for n in inner if isinstance(n, ast.ImportFrom)]
        return {alias.name: str(line.module) for line in lines for alias in line.names}

    own = sys.modules[package]

    def get(name: str) -> Any:
        if name not in modules():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(modules()[name]), name)
        setattr(own, name, value)
        return value

    return get
