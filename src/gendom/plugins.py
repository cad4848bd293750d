"""What other packages add, by entry points of the groups ``gendom.tasks``, ``gendom.materials``,
``gendom.unknowns``, ``gendom.methods``, ``gendom.cameras``, ``gendom.arms``, ``gendom.robots`` and
``gendom.depth_cameras``."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from importlib import metadata
from typing import Any

_log = logging.getLogger(__name__)


@cache
def plugins(kind: str, use: Callable[[Any], object] = lambda _: None) -> dict[str, Any]:
    """Load the objects that other packages add to a group, named without ``gendom.``, by the names
    of their entry points, and `use` each. One that cannot be imported or used is left out with a
    warning, so that it does not stop commands that have no use for it.
    """
    found = {}
    for point in metadata.entry_points(group=f"gendom.{kind}"):
        try:
            added = point.load()
            use(added)
            found[point.name] = added
        except Exception as error:  # whatever somebody else's module raises
            why = f"{type(error).__name__}: {error}"
            what = f"gendom.{kind} {point.name!r} ({point.value})"
            _log.warning("%s is left out: %s", what, why)
    return found
