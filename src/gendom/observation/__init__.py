"""What is compared between a recording and a simulation: densities, distances, visibility."""

from gendom.observation.chamfer import chamfer
from gendom.observation.density import DensityGrid
from gendom.observation.visibility import visible, visible_on_sheet

__all__ = ["DensityGrid", "chamfer", "visible", "visible_on_sheet"]
