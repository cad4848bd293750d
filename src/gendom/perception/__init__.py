"""From depth pictures to point clouds: cameras, segmentation, fusion, calibration."""

from gendom.perception.calibration import Board, BoardView, Calibration, calibrate, find_board
from gendom.perception.camera import Camera, read_camera, write_camera
from gendom.perception.cloud import STAGES, CloudSettings, FusedCloud, View, perceive_frame
from gendom.perception.folder import PngCamera, PngWriter, RobotPath, Sighting, read_sighting
from gendom.perception.frames import (
    Frame,
    FrameSource,
    FrameWriter,
    Pictures,
    match_frames,
)
from gendom.perception.live import RealSenseCamera, record_cameras
from gendom.perception.perceive import Perceived, PerceptionSettings, perceive, read_seen_by
from gendom.perception.realsense import RealSenseRecording, RealSenseWriter
from gendom.perception.robot import CapsulePath, Capsules
from gendom.perception.ros import RosSettings, is_ros_bag, read_ros_bag

__all__ = [
    "STAGES",
    "Board",
    "BoardView",
    "Calibration",
    "Camera",
    "CapsulePath",
    "Capsules",
    "CloudSettings",
    "Frame",
    "FrameSource",
    "FrameWriter",
    "FusedCloud",
    "Perceived",
    "PerceptionSettings",
    "Pictures",
    "PngCamera",
    "PngWriter",
    "RealSenseCamera",
    "RealSenseRecording",
    "RealSenseWriter",
    "RobotPath",
    "RosSettings",
    "Sighting",
    "View",
    "calibrate",
    "find_board",
    "is_ros_bag",
    "match_frames",
    "perceive",
    "perceive_frame",
    "read_camera",
    "read_ros_bag",
    "read_seen_by",
    "read_sighting",
    "record_cameras",
    "write_camera",
]
