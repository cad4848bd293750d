"""Material parameters and constitutive laws."""

from gendom.materials.parameters import Material

__all__ = ["Material"]
