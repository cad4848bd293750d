"""Materials and objects: what is estimated, simulated and shown to policies."""

from gendom.materials.objects import (
    AIR_DENSITY,
    KINDS,
    PARAMETERS,
    STANDARD_GRAVITY,
    Cloth,
    Item,
    Parameter,
    Rope,
    from_columns,
    likeness,
    likeness_of_columns,
    size_of,
    thickness_of,
    to_columns,
    unit_of,
    unit_of_size,
)
from gendom.materials.parameters import Material, bending_length, specific_modulus_of

__all__ = [
    "AIR_DENSITY",
    "KINDS",
    "PARAMETERS",
    "STANDARD_GRAVITY",
    "Cloth",
    "Item",
    "Material",
    "Parameter",
    "Rope",
    "bending_length",
    "from_columns",
    "likeness",
    "likeness_of_columns",
    "size_of",
    "specific_modulus_of",
    "thickness_of",
    "to_columns",
    "unit_of",
    "unit_of_size",
]
