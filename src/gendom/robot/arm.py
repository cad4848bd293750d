"""Model of a robot arm: joints, limits, shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import RobotError
from gendom.reading import read_toml, record_of


@dataclass(frozen=True)
class LinkCapsule:
    """A capsule that is fixed to one link."""

    name: str
    """Unique on its arm."""
    link: int
    """0: the base, i: the link that joint i moves; the last one carries the gripper."""
    start: tuple[float, float, float]
    """One end of its axis in the link's frame [m]."""
    end: tuple[float, float, float]
    """The other end [m]."""
    radius: float
    """[m]."""
    held: bool = False
    """Whether it is what the fingers hold, which may touch the table."""


@dataclass(frozen=True)
class FingerCapsule:
    """A capsule that moves with the finger at +y: of the finger itself, which shifts but
    does not turn, or of one of the parallel links that carry it."""

    name: str
    start: tuple[float, float, float]
    """One end from the finger's pivot, in the gripper's axes; of a link from its own pivot, y
    towards the finger's [m]."""
    end: tuple[float, float, float]
    """The other end [m]."""
    radius: float
    """[m]."""
    touches_object: bool = False
    """Whether its inner side holds the object."""
    pivot: tuple[float, float] | None = None
    """Of a link: (y, z) about which it turns, in the gripper's frame [m]."""


@dataclass(frozen=True, kw_only=True)
class ParallelGripper:
    """A gripper whose two fingers are carried by parallel links, so that they stay parallel.

    The finger on the side of +y is attached to a link, the knuckle, that rotates about (0, pivot_y,
    pivot_z) in the gripper's frame; the finger's inner face is closer to the middle than its pivot
    by `face`. With the knuckle's angle theta from y towards z,

        opening / 2 = pivot_y + knuckle cos(theta) - face,

    so the fingers move a little towards the flange as they open. The other finger is the mirror
    image.
    """

    length: float = 0.0
    """From the gripper's frame along z to the point between the fingertips, the tool point [m]."""
    max_opening: float
    """Largest distance of the fingers' inner faces [m]."""
    pivot_y: float
    """[m]."""
    pivot_z: float
    """[m]."""
    knuckle: float
    """Length of the knuckle [m]; 0: the fingers slide along y."""
    face: float
    """[m]."""
    fingers: tuple[FingerCapsule, ...] = ()

    def finger_pivot(self, opening: ArrayLike) -> Array:
        """[..., 2] y and z of the +y finger's pivot in the gripper's frame [m].

        Args:
            opening: [...] distance of the inner faces [m], limited to 0 and `max_opening`.
        """
        half = 0.5 * np.clip(np.asarray(opening, dtype=float), 0.0, self.max_opening)
        y = half + self.face
        reach = np.sqrt(np.maximum(self.knuckle**2 - (y - self.pivot_y) ** 2, 0.0))
        return np.stack([y, self.pivot_z + reach], axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Arm:
    """A serial arm of J revolute joints with a parallel gripper.

    Frame i is fixed to link i, its z is the axis of joint i, and

        T_(i-1)_i = T_links[i] Rot_z(q_i).

    Frame J lies in the flange's face; the gripper's fingers open along its y.
    """

    name: str
    T_links: Array
    """[J, 4, 4] each link's frame in the one before, at zero [m]."""
    T_flange_tcp: Array
    """[4, 4] the point between the fingertips [m]."""
    q_min: Array
    """[J] lowest joint angles [rad]."""
    q_max: Array
    """[J] highest joint angles [rad]."""
    max_speed: Array
    """[J] [rad/s]."""
    max_acceleration: Array
    """[J] [rad/s^2]."""
    max_jerk: Array
    """[J] [rad/s^3]."""
    max_tcp_speed: float
    """[m/s]."""
    home: Array
    """[J] resting configuration, far from the limits; inverse kinematics prefers it [rad]."""
    capsules: tuple[LinkCapsule, ...]
    """Capsules of the arm from base to flange, and of the gripper's body."""
    gripper: ParallelGripper

    @property
    def joints(self) -> int:
        """Number of joints, J."""
        return len(self.T_links)

    def holding(self, length: float, radius: float) -> Arm:
        """The arm with a capsule that stands out of its fingers: what it holds [m]; 0: nothing."""
        if length <= 0.0:
            return self
        start, along = self.T_flange_tcp[:3, 3], self.T_flange_tcp[:3, 2]
        ends = ((*p.tolist(),) for p in (start, start + length * along))
        held = LinkCapsule("held object", self.joints, *ends, radius=radius, held=True)
        return replace(self, capsules=(*self.capsules, held))

    def check_q(self, q: ArrayLike) -> Array:
        """Joint angles [..., J] as float64.

        Raises:
            RobotError: The shape is another, or a number is not finite.
        """
        q = np.asarray(q, dtype=float)
        fits, fix = q.shape[-1:] == (self.joints,), f"give {self.joints} angles in radians"
        what = f"joint angles have shape {q.shape}" if not fits else "a joint angle is not finite"
        good = fits and np.isfinite(q).all()
        require(good, what, where=self.name, fix=fix, error=RobotError)
        return q


def _shipped(name: str) -> Arm:
    """An arm of a file beside this one."""
    path = Path(__file__).with_name(f"{name}.toml")
    table = read_toml(path, error=RobotError)
    return record_of(Arm, table, where=str(path), fix="mend it", error=RobotError)


XARM7, FR3 = _shipped("xarm7"), _shipped("fr3")
"""Arms as their vendors sell them; `q` in radians, their base frame is the world."""
