"""Where frames of a ROS bag are over time: the tree of TF, as tf2 keeps it."""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from gendom.arrays import Array, rigid
from gendom.perception.camera import expect
from gendom.perception.poses import StatedPose

_DENORMAL = 0.01  # of a quaternion's squared length, as tf2 has it


def stamp(header: Any) -> float:
    """Time of a message's header since 1970, to a quarter of a microsecond [s]."""
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


class Track:
    """Pose of an object over time, in one frame; of static ones the last counts."""

    def __init__(self, where: str, still: bool = False):
        self.where, self.still = where, still
        self.frame = ""
        self.times: list[float] = []
        self._poses: list[list[float]] = []

    def add(self, frame: str, time: float, at: Any, turn: Any) -> None:
        """A place and an orientation of messages, in a frame at a time [s]."""
        what = f"is in {frame} after {self.frame}"
        expect(self.frame in ("", frame), what, self.where, "keep one")
        self.frame = frame
        self.times.append(time)
        self._poses.append([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])

    def set(self, frame: str, T: Array) -> None:
        """A place for all times, [4, 4] in a frame [m]."""
        turn = Rotation.from_matrix(np.array(T[:3, :3])).as_quat()
        self.frame, self.times, self._poses = frame, [0.0], [[*T[:3, 3], *turn]]

    @cached_property
    def _settled(self) -> tuple[Array, Array]:
        """Increasing times [M] [s] and poses [M, 7]; of equal times the last counts."""
        times, back = np.unique(self.times[::-1], return_index=True)
        poses = np.array(self._poses)[::-1][back]
        largest = np.abs(poses[:, 3:]).max(axis=1)  # at least half of a quaternion's length
        right = np.isfinite(poses).all() and ((largest >= 0.25) & (largest <= 2.0)).all()
        expect(right, "has a pose that is none", self.where, "record it again")
        return times, poses

    @property
    def moves(self) -> bool:
        """Whether it has a pose of its own at each time."""
        return not (self.still or len(self._settled[0]) == 1)

    def at(self, time: Array) -> Array:
        """[N, 4, 4] from its own axes to those of `frame` [m] at times [N] [s]; NaN where it moves,
        and a time lies before its first or after its last place."""
        times, poses = self._settled
        if not self.moves:
            T = rigid(Rotation.from_quat(poses[-1, 3:]).as_matrix(), poses[-1, :3])
            return np.broadcast_to(T, (len(time), 4, 4))
        known = (times[0] <= time) & (time <= times[-1])
        T = np.full((len(time), 4, 4), np.nan)
        if known.any():
            some = time[known]
            T[known] = np.eye(4)
            T[known, :3, :3] = Slerp(times, Rotation.from_quat(poses[:, 3:]))(some).as_matrix()
            T[known, :3, 3] = np.stack([np.interp(some, times, x) for x in poses[:, :3].T], axis=1)
        return T


class FrameTree:
    """The tree of TF."""

    def __init__(self, where: str):
        self.where = where
        self.tracks: dict[str, Track] = {}

    def add(self, stated: Any, *, still: bool) -> None:
        """As tf2 does: a static pose replaces all before, a moving one a static one, and what is
        no pose is ignored."""
        child, moved = stated.child_frame_id.lstrip("/"), stated.transform
        at, turn = moved.translation, moved.rotation
        q = turn.x, turn.y, turn.z, turn.w
        if (
            not np.isfinite([at.x, at.y, at.z, *q]).all()
            or abs(sum(x * x for x in q) - 1.0) > _DENORMAL
        ):
            return
        track = self.tracks.get(child)
        if still or track is None or track.still:
            self.tracks[child] = track = Track(f"{self.where}: frame {child}", still)
        track.add(stated.header.frame_id.lstrip("/"), stamp(stated.header), at, turn)

    def attach(self, pose: StatedPose) -> None:
        """Put a frame where a calibration says, with the tree that it belongs to; where that holds
        the other frame, too, the frame alone."""
        top = self.lineage(pose.child)[-1]
        track, T = Track(f"{self.where}: frame {pose.child}", still=True), pose.T
        if top == self.lineage(pose.parent)[-1]:
            top = pose.child
        elif top != pose.child:
            below = self.between(top, pose.child, np.zeros(1))
            what, fix = f"{pose.child} moves in {top}", "leave the pose's file out"
            expect(np.isfinite(below).all(), what, self.where, fix)
            T = T @ np.linalg.inv(below[0])
        track.set(pose.parent, T)
        self.tracks[top] = track

    @property
    def root(self) -> str:
        """The frame in which all others are; empty without TF."""
        parents = {track.frame for track in self.tracks.values()}
        roots = sorted(parents - set(self.tracks))
        what = f"TF has several roots: {', '.join(roots)}"
        fix = "name the frame of the recording with --world, or give the cameras' poses by --poses"
        expect(len(roots) <= 1, what, self.where, fix)
        return roots[0] if roots else ""

    def between(self, to: str, start: str, time: Array) -> Array:
        """[N, 4, 4] from the axes of `start` to those of `to` [m], as `Track.at`."""
        to, start = to.lstrip("/"), start.lstrip("/")
        up, down = self.lineage(start), self.lineage(to)
        shared = next((frame for frame in up if frame in down), "")
        what = f"TF does not say where {start} is in {to}"
        fix = f"give frames of one tree; it has {', '.join(sorted(self.tracks)) or 'none'}"
        expect(shared in down, what, self.where, fix)
        legs = []
        for way in (up, down):
            T = np.broadcast_to(np.eye(4), (len(time), 4, 4))
            for frame in way[: way.index(shared)]:
                T = self.tracks[frame].at(time) @ T
            legs.append(T)
        return np.linalg.inv(legs[1]) @ legs[0]

    def lineage(self, frame: str) -> list[str]:
        """The frame, what it is in, and so on to the root."""
        found = [frame.lstrip("/")]
        while found[-1] in self.tracks:
            parent = self.tracks[found[-1]].frame
            expect(parent not in found, f"TF has a loop at {parent}", self.where, "mend it")
            found.append(parent)
        return found

    def times(self, *frames: str) -> Array:
        """All times at which a frame or what it is in has a pose of its own [s]; [0]: they rest."""
        some = {f for frame in frames for f in self.lineage(frame)} & set(self.tracks)
        moving = [self.tracks[frame].times for frame in some if self.tracks[frame].moves]
        return np.unique(np.concatenate(moving)) if moving else np.zeros(1)
