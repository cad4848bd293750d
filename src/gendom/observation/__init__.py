"""What is compared between a recording and a simulation: densities, distances, visibility."""

from gendom.observation.breadth import breadth_across
from gendom.observation.clouds import DensityGrid, chamfer, visible, visible_on_sheet

__all__ = ["DensityGrid", "breadth_across", "chamfer", "visible", "visible_on_sheet"]
