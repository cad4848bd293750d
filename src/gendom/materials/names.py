"""Names that quantities had in files of earlier versions, and what they are called now."""

from collections.abc import Mapping
from typing import Any

OLD_NAMES: dict[str, dict[str, str]] = {
    "quantity": {"youngs_modulus": "E", "poissons_ratio": "nu", "specific_modulus": "E_over_rho"},
    # policies and ranges of tasks had the same letter for two other quantities
    "network": {"E": "bending_ratio"},
    "range": {"E": "E_over_rho"},
}
"""Old to new names: of quantities in SI units (estimates, data sets, tasks), of a policy's inputs,
and of what a task's objects are drawn from."""


def current_name(name: str, kind: str = "quantity") -> str:
    """What a quantity is called now."""
    return OLD_NAMES[kind].get(name, name)


def with_current_names(read: Any, kind: str = "quantity") -> Any:
    """What was read from a file, with the present names as keys and in lists of names."""
    if isinstance(read, Mapping):
        return {current_name(k, kind): with_current_names(v, kind) for k, v in read.items()}
    if isinstance(read, (list, tuple)):
        return type(read)(
            current_name(v, kind) if isinstance(v, str) else with_current_names(v, kind)
            for v in read
        )
    return read
