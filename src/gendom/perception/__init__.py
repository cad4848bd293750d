"""From depth pictures to point clouds: cameras, segmentation, fusion, calibration."""

from gendom.perception.calibration import Board, BoardView, Calibration, calibrate
from gendom.perception.camera import Camera
from gendom.perception.camera_file import read_camera, write_camera
from gendom.perception.cloud import (
    STAGES,
    CameraView,
    FusedCloud,
    PerceptionSettings,
    perceive_frame,
)
from gendom.perception.folder import CameraRecording, PngCamera, PngWriter, RobotPath, read_cameras
from gendom.perception.frames import CameraReader, Frame, FrameSource, MatchedFrames, Pictures
from gendom.perception.perceive import Perceived, perceive
from gendom.perception.realsense import RealSenseRecording
from gendom.perception.robot import Capsules
from gendom.perception.ros import RosSettings, read_ros_bag, read_ros_cameras

__all__ = [
    "STAGES", "Board", "BoardView", "Calibration", "Camera", "CameraReader", "CameraRecording",
    "CameraView", "Capsules", "Frame", "FrameSource", "FusedCloud", "MatchedFrames", "Perceived",
    "PerceptionSettings", "Pictures", "PngCamera", "PngWriter", "RealSenseRecording", "RobotPath",
    "RosSettings", "calibrate", "perceive", "perceive_frame", "read_camera", "read_cameras",
    "read_ros_bag", "read_ros_cameras", "write_camera",
]  # fmt: skip
