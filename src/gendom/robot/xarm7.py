"""The UFACTORY xArm 7 with its parallel gripper.

Sources: UFACTORY's "Kinematic and dynamic parameters of xArm 7" (modified Denavit-Hartenberg
table), "Robot specifications" in its developer manual (joint ranges, speeds, accelerations,
jerk, the tool's 1 m/s), "xArm Gripper technical specifications" (opening of 84 mm), and the URDF
of xarm_ros (joint limits in radians, gripper's pivots, tool point 172 mm beyond the flange). The
table and the URDF agree to the digit.

The capsules are our own: fitted to the outer dimensions of the links' published shapes, of
which nothing sticks out by more than 5 mm; their round ends reach up to 3 cm beyond flat ends,
mostly into the neighbouring link. The gripper's and the surface of its published shapes are within
6 mm of each other.
"""

from __future__ import annotations

import math

import numpy as np

from gendom.robot.arm import (
    Arm,
    FingerCapsule,
    KnuckleCapsule,
    LinkCapsule,
    ParallelGripper,
    modified_dh,
)

_HALF_PI, _TWO_PI = 0.5 * math.pi, 2.0 * math.pi

TCP_DISTANCE = 0.172
"""From the flange's face to the tips of the closed fingers [m]."""


_GRIPPER = (
    ((0.0095, 0.0315, 0.0189), (0.0095, -0.0315, 0.0189), 0.0172),
    ((0.0090, 0.0285, 0.0415), (0.0090, -0.0285, 0.0415), 0.0190),
    ((0.0082, 0.0265, 0.0649), (0.0082, -0.0265, 0.0649), 0.0190),
    ((0.0066, 0.0235, 0.0862), (0.0066, -0.0235, 0.0862), 0.0145),
    ((-0.0123, 0.0329, 0.0191), (-0.0123, -0.0329, 0.0191), 0.0161),
    ((-0.0110, 0.0345, 0.0404), (-0.0110, -0.0345, 0.0404), 0.0192),
    ((-0.0118, 0.0285, 0.0640), (-0.0118, -0.0285, 0.0640), 0.0195),
    ((-0.0166, 0.0252, 0.0848), (-0.0166, -0.0252, 0.0848), 0.0159),
    ((0.0160, 0.0412, 0.0420), (0.0160, 0.0390, 0.0930), 0.0088),
    ((0.0160, -0.0412, 0.0420), (0.0160, -0.0390, 0.0930), 0.0088),
    ((-0.0172, 0.0405, 0.0350), (-0.0202, 0.0399, 0.0885), 0.0108),
    ((0.0, 0.0440, 0.0400), (0.0, 0.0440, 0.0500), 0.0062),
    ((0.0, -0.0440, 0.0400), (0.0, -0.0440, 0.0500), 0.0062),
    ((-0.0172, -0.0405, 0.0350), (-0.0202, -0.0399, 0.0885), 0.0108),
)
"""Capsules of its body: ends and radius [m]."""

_CAPSULES = (
    LinkCapsule("base", 0, (0.0, 0.0, 0.025), (0.0, 0.0, 0.109), 0.065),
    LinkCapsule("base connector", 0, (-0.046, 0.0, 0.021), (-0.063, 0.0, 0.025), 0.029),
    LinkCapsule("link1 column", 1, (0.0, 0.0, -0.082), (0.0, -0.008, 0.0), 0.054),
    LinkCapsule("link1 shoulder", 1, (0.0, -0.007, 0.0), (0.0, 0.048, 0.0), 0.054),
    LinkCapsule("link2 shoulder", 2, (0.0, 0.005, 0.097), (0.0, -0.116, 0.082), 0.047),
    LinkCapsule("link2 bend", 2, (0.0, -0.108, 0.060), (0.0, -0.112, 0.010), 0.050),
    LinkCapsule("link2 column", 2, (0.0, -0.104, 0.004), (0.0, -0.164, 0.0), 0.049),
    LinkCapsule("link3 column", 3, (0.0, 0.0, -0.074), (0.026, 0.028, -0.008), 0.049),
    LinkCapsule("link3 bend", 3, (0.027, 0.025, -0.022), (0.060, 0.009, 0.003), 0.036),
    LinkCapsule("link3 elbow", 3, (0.052, -0.041, 0.0), (0.049, 0.024, 0.002), 0.048),
    LinkCapsule("link4 elbow", 4, (-0.004, 0.004, 0.087), (0.080, -0.089, 0.072), 0.042),
    LinkCapsule("link4 bend", 4, (0.078, -0.081, 0.066), (0.077, -0.083, -0.002), 0.043),
    LinkCapsule("link4 column", 4, (0.078, -0.086, 0.006), (0.078, -0.142, 0.0), 0.048),
    LinkCapsule("link5 column", 5, (0.0, 0.0, -0.155), (0.0, 0.0, -0.140), 0.047),
    LinkCapsule("link5 side", 5, (-0.001, 0.022, -0.146), (-0.001, 0.066, -0.033), 0.039),
    LinkCapsule("link5 wrist", 5, (0.0, 0.041, -0.002), (0.0, 0.038, 0.001), 0.048),
    LinkCapsule("link6 wrist", 6, (0.0, 0.0, 0.019), (0.016, 0.0, 0.028), 0.043),
    LinkCapsule("link6 column", 6, (0.075, -0.004, 0.0), (0.076, 0.046, 0.0), 0.042),
    LinkCapsule("link7 flange", 7, (0.0, -0.007, -0.011), (0.0, 0.007, -0.012), 0.037),
    LinkCapsule("link7 connector", 7, (0.0, -0.030, -0.014), (0.0, -0.038, -0.015), 0.015),
    *(LinkCapsule(f"gripper {k}", 7, *capsule) for k, capsule in enumerate(_GRIPPER, 1)),
)


def _knuckle(name, pivot, start, end, radius) -> KnuckleCapsule:
    """A knuckle's capsule, its ends (x, y, z) as in the URDF, where the gripper is open."""
    u = np.array([0.035465, 0.042039]) / math.hypot(0.035465, 0.042039)
    a, b = ((x, u[0] * y + u[1] * z, u[0] * z - u[1] * y) for x, y, z in (start, end))
    return KnuckleCapsule(name, pivot, a, b, radius)


_OUTER, _INNER = (0.035, 0.059098), (0.02, 0.074098)
_KNUCKLES = (
    _knuckle("knuckle tail", _OUTER, (0.0, -0.0200, -0.002), (0.0, 0.008, 0.002), 0.0065),
    _knuckle("knuckle", _OUTER, (0.0, 0.008, 0.004), (0.0, 0.045, 0.0237), 0.0076),
    _knuckle("knuckle tip", _OUTER, (0.0, 0.0353, 0.0422), (0.0, 0.043, 0.030), 0.0064),
    _knuckle("inner front", _INNER, (0.0115, -0.0013, 0.0013), (0.0087, 0.0368, 0.0432), 0.0048),
    _knuckle("inner back", _INNER, (-0.0115, -0.0013, 0.0013), (-0.0087, 0.0368, 0.0432), 0.0048),
    _knuckle("inner middle", _INNER, (0.0, 0.015, 0.022), (0.0, 0.021, 0.026), 0.0035),
)


_FINGERS = (
    FingerCapsule("finger front", (0.0057, 0.0, 0.0), (0.0, -0.019, 0.020), 0.006, True),
    FingerCapsule("finger back", (-0.0057, 0.0, 0.0), (0.0, -0.019, 0.020), 0.006, True),
    # The pad is a flat plate, 32 mm wide, with a rib behind it.
    FingerCapsule("finger rib", (0.0, -0.0195, 0.026), (0.0, -0.0195, 0.047), 0.0065, True),
    FingerCapsule("pad front", (0.011, -0.021, 0.024), (0.011, -0.021, 0.055), 0.005, True),
    FingerCapsule("pad middle", (0.0, -0.021, 0.024), (0.0, -0.021, 0.055), 0.005, True),
    FingerCapsule("pad back", (-0.011, -0.021, 0.024), (-0.011, -0.021, 0.055), 0.005, True),
)


XARM7 = Arm(
    name="xarm7",
    T_links=modified_dh(
        a=[0.0, 0.0, 0.0, 0.0525, 0.0775, 0.0, 0.076],
        alpha=[0.0, -_HALF_PI, _HALF_PI, _HALF_PI, _HALF_PI, _HALF_PI, -_HALF_PI],
        d=[0.267, 0.0, 0.293, 0.0, 0.3425, 0.0, 0.097],
    ),
    T_flange_tcp=np.eye(4) + np.outer([0.0, 0.0, TCP_DISTANCE, 0.0], [0.0, 0.0, 0.0, 1.0]),
    q_min=np.array([-_TWO_PI, -2.059, -_TWO_PI, -0.19198, -_TWO_PI, -1.69297, -_TWO_PI]),
    q_max=np.array([_TWO_PI, 2.0944, _TWO_PI, 3.927, _TWO_PI, math.pi, _TWO_PI]),
    max_speed=np.full(7, math.radians(180.0)),
    max_acceleration=np.full(7, math.radians(1145.0)),
    max_jerk=np.full(7, math.radians(28647.0)),
    max_tcp_speed=1.0,
    # The gripper points straight down, 0.41 m in front of the base and 0.21 m above it.
    home=np.array([0.0, -0.2, 0.0, 0.9, 0.0, 1.1, 0.0]),
    capsules=_CAPSULES,
    gripper=ParallelGripper(
        length=TCP_DISTANCE,
        max_opening=0.084,
        pivot_y=0.035,
        pivot_z=0.059098,
        knuckle=0.055,
        face=0.026,
        knuckles=_KNUCKLES,
        fingers=_FINGERS,
    ),
)
"""The arm as UFACTORY sells it; `q` in radians, its base frame is the world."""
