"""LeRobot data sets, format v3.0: of demonstrations, and of recordings."""

from gendom.datasets.lerobot.demonstrations import export_demonstrations
from gendom.datasets.lerobot.recordings import export_recording, read_lerobot

__all__ = ["export_demonstrations", "export_recording", "read_lerobot"]
