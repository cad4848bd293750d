"""Poses of cameras as other programs' calibrations write them.

    easy_handeye, easy_handeye2   YAML: parameters, and transformation (x, y, z, qx, qy, qz, qw) or
                                  transform (translation and rotation), from the camera's frame to
                                  robot_base_frame, or robot_effector_frame for an eye in hand
    MoveIt Calibration            a launch file (XML or Python) that starts
                                  static_transform_publisher

A launch file is read as text and never run.
"""

import math
import os
import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.arrays import Array, rigid
from gendom.errors import RecordingError
from gendom.perception.camera import expect
from gendom.reading import decoded, number_of, read_bytes

_LARGEST = 1 << 17  # [bytes]
_ENTRY = re.compile(r"([A-Za-z_]\w*)[ \t]*:[ \t]*([^\s,{}#]*)")  # of YAML
_PUBLISHER = re.compile(
    r"static_transform_publisher[\"']?(.*?)(?:/>|</node>|\n\s*\)|\Z)", re.DOTALL
)
_QUOTED = re.compile(r"\"([^\"]*)\"|'([^']*)'")
_FIX = "give a file of easy_handeye (YAML), or the launch file of MoveIt's calibration"


@dataclass(frozen=True, eq=False)
class StatedPose:
    """Where a frame is in another one."""

    parent: str
    child: str
    T: Array
    """[4, 4] from the axes of `child` to those of `parent` [m]."""


def read_poses(path: str | os.PathLike) -> list[StatedPose]:
    """The poses that a calibration's file states, one at least.

    Raises:
        RecordingError: It cannot be read, or states none.
    """
    data = read_bytes(path, RecordingError, most=_LARGEST)
    text, where = decoded(data, "replace"), str(path)
    if "static_transform_publisher" in text:
        text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
        text = re.sub(r"^\s*#.*$", "", text, flags=re.MULTILINE)
        found = [_published(part, where) for part in _PUBLISHER.findall(text)]
    else:
        found = [_handeye(text, where)]
    expect(found, "states no pose", where, _FIX)
    return found


def camera_pose(path: str | os.PathLike) -> Array:
    """`T_world_camera` [4, 4] [m] of a file that states one pose, of a frame with a camera's axes.

    Raises:
        RecordingError: As of `read_poses`, or the pose is of another frame.
    """
    poses, where = read_poses(path), str(path)
    what = f"states the poses of {', '.join(pose.child for pose in poses)}"
    expect(len(poses) == 1, what, where, "leave that of the camera")
    (pose,) = poses
    what = f"states the pose of {pose.child}, whose axes need not be a camera's (z forward)"
    fix = "calibrate with the frame of the pictures (..._optical_frame), or record a ROS bag with "
    fix += "/tf_static and give the file there by --poses"
    expect("optical" in pose.child, what, where, fix)
    what = f"states a pose in {pose.parent}: the camera is in the hand"
    in_hand = re.search(r"tool|effector|_ee\b|eef|flange|hand|tcp|gripper|link[678]\b", pose.parent)
    expect(not in_hand, what, where, "mount it beside the robot")
    return pose.T


def _handeye(text: str, where: str) -> StatedPose:
    """Of easy_handeye: entries of all levels, rotation's x as qx."""
    entries, section = {}, ""
    for name, value in _ENTRY.findall(text):
        if not value:
            section = name
        turned = section == "rotation" and name in ("x", "y", "z", "w")
        entries[f"q{name}" if turned else name] = value.strip("\"'")
    in_hand = entries.get("calibration_type") == "eye_in_hand"
    in_hand |= entries.get("eye_on_hand", "").lower() == "true"
    parent = entries.get("robot_effector_frame" if in_hand else "robot_base_frame", "")
    child = entries.get("tracking_base_frame", "")
    numbers = [entries.get(name, "") for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    return _stated(parent, child, numbers, where)


def _published(text: str, where: str) -> StatedPose:
    """Of what stands behind the publisher's name in a launch file."""
    words = [word for pair in _QUOTED.findall(text) for word in "".join(pair).split()]
    if "--frame-id" in words:
        flags = {w.lstrip("-"): value for w, value in pairwise(words)}
        shift = [flags.get(axis, "0") for axis in "xyz"]
        names = ["qx", "qy", "qz", "qw"] if "qw" in flags else ["yaw", "pitch", "roll"]
        turn = [flags.get(name, "0") for name in names]
        return _stated(flags["frame-id"], flags.get("child-frame-id", ""), shift + turn, where)
    at = next((k for k, word in enumerate(words) if _is_number(word)), 0)
    numbers = []
    while at + len(numbers) < len(words) and _is_number(words[at + len(numbers)]):
        numbers.append(words[at + len(numbers)])
    frames = [*words[at + len(numbers) :], "", ""]
    return _stated(frames[0], frames[1], numbers, where)


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(number_of(word))
    except ValueError:
        return False


def _stated(parent: str, child: str, numbers: list[str], where: str) -> StatedPose:
    """A pose of x, y, z and qx, qy, qz, qw, or yaw, pitch and roll [rad]."""
    expect(parent and child, "does not say which frame is in which", where, _FIX)
    expect(all(map(_is_number, numbers)), "holds no numbers for a pose", where, _FIX)
    shift, turn = np.array(numbers[:3], float), np.array(numbers[3:], float)
    right = len(shift) == 3 and (
        len(turn) == 3 or (len(turn) == 4 and abs(np.linalg.norm(turn) - 1.0) < 0.01)
    )
    expect(right, "states no place and unit quaternion", where, _FIX)
    what, near = f"places {child} {np.linalg.norm(shift):.4g} m from {parent}", shift @ shift < 400
    expect(near, what, where, "give metres, not millimetres")
    R = Rotation.from_quat(turn) if len(turn) == 4 else Rotation.from_euler("ZYX", turn)
    return StatedPose(parent.lstrip("/"), child.lstrip("/"), rigid(R.as_matrix(), shift))
