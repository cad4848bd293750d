"""What pictures of a lift are drawn from: a recorded cloud and a simulated one, and from where they
are seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gendom.arguments import check_numbers, require


@dataclass(frozen=True, kw_only=True)
class Projection:
    """An orthographic projection."""

    turn: float
    """Angle about z from x to the direction that points right in the picture [rad]."""
    tilt: float
    """Angle by which the picture looks downwards [rad]: 0 from the side, pi / 2 from above."""

    @property
    def axes(self) -> np.ndarray:
        """[2, 3] unit vectors in the world that point right and up in the picture."""
        (c, s), (cos_tilt, sin_tilt) = ((math.cos(a), math.sin(a)) for a in (self.turn, self.tilt))
        return np.array([[c, s, 0.0], [-s * sin_tilt, c * sin_tilt, cos_tilt]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] right and up [m] of points [..., 3] [m]."""
        return points @ self.axes.T


@dataclass(frozen=True, kw_only=True)
class CloudSequence:
    """T frames of a recorded cloud and of the simulated object.

    World frame, z up. Arrays are converted to float64.

    Raises:
        ParameterError: Lengths differ, an array has another shape, or a number is not finite.
    """

    recorded: Sequence[np.ndarray]
    """T clouds [n_t, 3] [m]; n_t may be 0."""
    simulated: Sequence[np.ndarray]
    """T clouds [m_t, 3] [m], or one array [T, m, 3]."""
    times: np.ndarray
    """[T] increasing [s]."""
    gripper: np.ndarray | None = None
    """[T, G, 3], or [T, 3] for one gripper [m]."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    chamfer: np.ndarray | None = None
    """[T] Chamfer distance of the two clouds [m]."""
    rms: np.ndarray | None = None
    """[T] distance of the recorded cloud from the simulated surface, root mean square [m]."""
    labels: tuple[str, str] = ("recorded", "simulated")
    """What legends call the two clouds."""
    arm: np.ndarray | None = None
    """[T, C, 2, 3] ends of the axes of the robot arm's capsules [m]."""
    arm_radius: np.ndarray | None = None
    """[C] their radii [m]; goes with `arm`."""
    goal: np.ndarray | None = None
    """[1, 3] a point to be reached, or [2, 3] the ends of a line [m]."""
    oblique: bool = False
    """Seen from 25 degrees above, as suits cloths; else from the side that shows most, z upwards
    and the longer of x and y to the right, or from above where the object hardly rises."""

    def __post_init__(self):
        times = check_numbers("times", self.times, ("T",))
        T = len(times)
        require(T > 0, "is empty", where="times", fix="give at least one frame")
        require((np.diff(times) > 0.0).all(), "does not increase", where="times", fix="sort it")
        values: dict[str, Any] = {"times": times}
        for name in ("recorded", "simulated"):
            clouds = getattr(self, name)
            what = f"has {len(clouds)} frames, but times has {T}"
            require(len(clouds) == T, what, where=name, fix="give one each")
            values[name] = tuple(
                check_numbers(f"{name}[{t}]", cloud, ("n", 3)) for t, cloud in enumerate(clouds)
            )
        shapes = {
            "gripper": ((T, "G", 3), (T, 3)),
            "table_height": ((),),
            "chamfer": ((T,),),
            "rms": ((T,),),
            "arm": ((T, "C", 2, 3),),
            "goal": (("n", 3),),
        }
        for name, allowed in shapes.items():
            if getattr(self, name) is not None:
                values[name] = check_numbers(name, getattr(self, name), *allowed)
        if "gripper" in values:
            values["gripper"] = values["gripper"].reshape(T, -1, 3)
        if "arm" in values:
            shape = (values["arm"].shape[1],)
            values["arm_radius"] = check_numbers("arm_radius", self.arm_radius, shape)
        if "table_height" in values:
            values["table_height"] = float(values["table_height"])
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.times)

    @property
    def distance(self) -> tuple[str, np.ndarray] | None:
        """How far both clouds are apart: what it is, and [T] [m]; the fit's if it is known."""
        known = {"rms": self.rms, "Chamfer": self.chamfer}
        return next(((name, of) for name, of in known.items() if of is not None), None)

    def spread(self, max_frames: int) -> list[int]:
        """Indices of at most `max_frames` frames, evenly spaced, with the first and the last."""
        count = min(max_frames, self.num_frames)
        return np.linspace(0, self.num_frames - 1, count).round().astype(int).tolist()

    def box(self) -> np.ndarray:
        """[2, 3] lowest and highest corner of all that is drawn, without stray points [m].

        Raises:
            ParameterError: There are no points at all.
        """
        # A depth camera's flying pixels would shrink everything else.
        ends = [
            np.quantile(cloud, (0.005, 0.995), axis=0)
            for clouds in (self.recorded, self.simulated)
            for cloud in clouds
            if len(cloud)
        ]
        require(ends, "has no points at all", where="recorded", fix="record it again")
        if self.gripper is not None:
            ends.append(self.gripper.reshape(-1, 3))
        ends = np.concatenate(ends)
        return np.stack([ends.min(axis=0), ends.max(axis=0)])

    def projection(self) -> Projection:
        """From where it is seen.

        Raises:
            ParameterError: There are no points at all.
        """
        x, y, z = np.ptp(self.box(), axis=0).tolist()
        turn, tilt = (0.0, 90.0) if z < 0.25 * min(x, y) else (0.0 if x >= y else 90.0, 0.0)
        if self.oblique:
            turn, tilt = 30.0, 25.0
        return Projection(turn=math.radians(turn), tilt=math.radians(tilt))
