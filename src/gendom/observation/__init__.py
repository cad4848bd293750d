"""What is compared between a recording and a simulation: densities, distances, visibility."""

from gendom.observation.chamfer import chamfer
from gendom.observation.density import DensityGrid, density_distance
from gendom.observation.visibility import visible

__all__ = ["DensityGrid", "chamfer", "density_distance", "visible"]
