"""What is compared between a recording and a simulation: distances, breadth, visibility."""

from gendom.observation.breadth import breadth_across
from gendom.observation.clouds import chamfer, visible, visible_on_sheet

__all__ = ["breadth_across", "chamfer", "visible", "visible_on_sheet"]
