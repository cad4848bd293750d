"""What a ROS bag holds: its topics, and the frames and topics that a gripper may be."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

from gendom.perception.ros_bag import RosBag
from gendom.perception.ros_cameras import topics_of
from gendom.perception.ros_frames import FrameTree
from gendom.perception.ros_messages import CLOUD, IMAGE, PACKED, POSES, TF

_LIKELY = ("tcp", "fingertip", "grasp", "tool", "gripper", "hand", "ee", "flange")
"""In names of the point between the fingertips, the likeliest first."""


@dataclass(frozen=True)
class BagContent:
    """What a bag holds."""

    topics: dict[str, tuple[str, int]]
    """Type, without its package, and number of messages of each topic."""
    cameras: list[str]
    """Topics of clouds, or else of depth."""
    grippers: list[str]
    """Frames of TF that move, and topics of poses, the likeliest first."""
    of_realsense: bool
    """Whether the SDK of RealSense cameras recorded it."""


def bag_content(path: str | os.PathLike) -> BagContent:
    """Look into a bag.

    Raises:
        RecordingError: It cannot be read.
        ModuleNotFoundError: There is no rosbags.
    """
    bag = RosBag(path)
    tree = FrameTree(bag.where)
    for name, message in bag.messages(*(n for n, kind in bag.topics.items() if kind in TF)):
        for stated in message.transforms:
            tree.add(stated, still=name.endswith("tf_static"))
    moving = [f for f in tree.tracks if len(tree.times(f)) > 1 and "optical" not in f]
    poses = [name for name, kind in bag.topics.items() if kind in POSES and bag.counts[name]]

    def likeliness(name: str) -> tuple[int, int, str]:
        words = re.split(r"[^a-z]+", name.lower())
        known = [k for k, word in enumerate(_LIKELY) if word in words or word in name.lower()]
        depth = 0 if name.startswith("/") else len(tree.lineage(name))
        return (min(known, default=len(_LIKELY)), -depth, name)

    cameras = next(filter(None, (topics_of(bag, k) for k in (IMAGE, PACKED, CLOUD))), [])
    topics = {n: (k.rpartition("/")[2], bag.counts[n]) for n, k in sorted(bag.topics.items())}
    of_realsense = any(name.startswith("/device_0/") for name in bag.topics)
    return BagContent(topics, cameras, sorted([*moving, *poses], key=likeliness), of_realsense)
