"""Messages about written files."""

from __future__ import annotations

import sys
from pathlib import Path


def tell_written(path: Path, *, json: bool) -> None:
    """Name a file that was written: on stdout, or on stderr where stdout holds JSON."""
    print(f"written: {path}", file=sys.stderr if json else sys.stdout)
