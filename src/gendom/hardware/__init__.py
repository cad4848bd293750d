"""Robots and depth cameras: what a device must do, and one file for each kind of device.

A vendor's SDK is imported when a device connects, never before. Devices of other packages are found
by the entry points ``gendom.robots`` and ``gendom.depth_cameras``.
"""

from gendom.hardware.contracts import DepthCamera, Robot, RobotState, find_depth_camera, find_robot

__all__ = ["DepthCamera", "Robot", "RobotState", "find_depth_camera", "find_robot"]
