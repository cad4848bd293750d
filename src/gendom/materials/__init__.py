"""Materials and objects: what is estimated, simulated and shown to policies."""

from gendom.materials.objects import (
    AIR_DENSITY,
    ASSUMED,
    KINDS,
    LARGEST,
    PARAMETERS,
    QUANTITIES,
    STANDARD_GRAVITY,
    Cloth,
    Item,
    Items,
    Parameter,
    Rope,
    dimensionless_columns,
    dimensionless_parameters,
    from_columns,
    items_from_columns,
    size_of,
    sizes_of,
    thickness_of,
    to_columns,
    unit_of,
    unit_of_size,
    with_dimensionless,
)
from gendom.materials.parameters import E_over_rho_of, Material, bending_length

__all__ = [
    "AIR_DENSITY", "ASSUMED", "KINDS", "LARGEST", "PARAMETERS", "QUANTITIES", "STANDARD_GRAVITY",
    "Cloth", "E_over_rho_of", "Item", "Items", "Material", "Parameter", "Rope", "bending_length",
    "dimensionless_columns", "dimensionless_parameters", "from_columns", "items_from_columns",
    "size_of", "sizes_of", "thickness_of", "to_columns", "unit_of", "unit_of_size",
    "with_dimensionless",
]  # fmt: skip
