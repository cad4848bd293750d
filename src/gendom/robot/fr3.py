"""The Franka Research 3 with the Franka Hand.

Sources: Franka's control interface documentation: modified Denavit-Hartenberg table and limits of
the FR3 (joint ranges, speeds, accelerations, jerks, the tool's speed), the hand's mounting at -45
degrees, its 80 mm of opening and its tool point 103.4 mm beyond the flange. Of the ranges that
Franka has given the narrower ones are taken. Near the ends of their ranges the real joints may be
slower than here.

The capsules are those of `fit_capsules`, rounded up to millimetres: they hold Franka's collision
meshes and stick out of flat ends by up to 5 cm, of the hand by 14 mm.
"""

from __future__ import annotations

import math

import numpy as np

from gendom.robot.arm import Arm, FingerCapsule, LinkCapsule, ParallelGripper, modified_dh

_HALF_PI = 0.5 * math.pi
_S = math.sqrt(0.5)
_TCP = 0.1034
_FINGER = 0.0584  # from the hand's flange to the fingers' frames [m]


_CAPSULES = (
    LinkCapsule("base", 0, (-0.003, 0.001, 0.063), (-0.024, 0.013, 0.046), 0.099),
    LinkCapsule("base right", 0, (0.002, -0.058, 0.043), (-0.077, -0.052, 0.044), 0.058),
    LinkCapsule("base back", 0, (-0.12, -0.026, 0.022), (-0.094, 0.055, 0.027), 0.056),
    LinkCapsule("link1 shoulder", 1, (-0.001, -0.056, -0.001), (-0.001, -0.047, -0.003), 0.076),
    LinkCapsule("link1 column", 1, (-0.015, -0.007, -0.149), (0.0, 0.001, -0.149), 0.071),
    LinkCapsule("link1 side", 1, (-0.007, -0.035, -0.072), (0.017, -0.03, -0.078), 0.060),
    LinkCapsule("link2 column", 2, (0.001, -0.144, 0.001), (0.0, -0.145, 0.0), 0.076),
    LinkCapsule("link2 shoulder", 2, (0.001, 0.002, 0.054), (0.001, -0.02, 0.031), 0.077),
    LinkCapsule("link2 side", 2, (-0.011, -0.081, 0.037), (0.014, -0.079, 0.037), 0.058),
    LinkCapsule("link3 elbow", 3, (0.067, 0.037, -0.011), (0.084, 0.043, -0.001), 0.071),
    LinkCapsule("link3 column", 3, (-0.002, 0.0, -0.065), (-0.003, 0.002, -0.063), 0.055),
    LinkCapsule("link3 bend", 3, (0.002, 0.007, -0.085), (0.002, 0.002, -0.089), 0.069),
    LinkCapsule("link4 column", 4, (-0.082, 0.081, 0.0), (-0.083, 0.079, -0.001), 0.072),
    LinkCapsule("link4 bend", 4, (-0.004, 0.007, 0.039), (-0.009, 0.005, 0.029), 0.073),
    LinkCapsule("link4 elbow", 4, (-0.005, -0.006, 0.067), (-0.004, -0.006, 0.075), 0.056),
    LinkCapsule("link5 column", 5, (0.0, 0.002, -0.239), (0.001, 0.06, -0.154), 0.061),
    LinkCapsule("link5 wrist", 5, (-0.001, 0.066, 0.0), (-0.001, 0.07, -0.019), 0.070),
    LinkCapsule("link5 side", 5, (-0.001, 0.085, -0.111), (0.001, 0.097, -0.067), 0.036),
    LinkCapsule("link6 wrist", 6, (-0.001, 0.0, 0.005), (0.01, -0.001, 0.015), 0.054),
    LinkCapsule("link6 side", 6, (0.018, 0.046, 0.015), (0.007, 0.045, 0.003), 0.039),
    LinkCapsule("link6 column", 6, (0.074, -0.018, 0.005), (0.075, 0.017, 0.001), 0.070),
    LinkCapsule("link7 flange", 7, (-0.005, -0.005, -0.034), (0.011, 0.012, -0.031), 0.051),
    LinkCapsule("link7 connector", 7, (0.029, 0.059, -0.029), (0.058, 0.031, -0.032), 0.030),
    LinkCapsule("hand mount", 7, (-0.06, -0.059, -0.006), (0.004, 0.002, -0.013), 0.021),
    LinkCapsule("hand left", 7, (-0.055, -0.054, 0.015), (0.023, 0.023, 0.01), 0.035),
    LinkCapsule("hand right", 7, (0.052, 0.051, 0.016), (0.034, 0.033, 0.009), 0.036),
    LinkCapsule("hand front", 7, (-0.057, -0.057, 0.042), (0.059, 0.059, 0.041), 0.031),
)


FR3 = Arm(
    name="fr3",
    T_links=modified_dh(
        a=[0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088],
        alpha=[0.0, -_HALF_PI, _HALF_PI, _HALF_PI, -_HALF_PI, _HALF_PI, _HALF_PI],
        d=[0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.107],
    ),
    T_flange_tcp=np.array(
        [[_S, _S, 0.0, 0.0], [-_S, _S, 0.0, 0.0], [0.0, 0.0, 1.0, _TCP], [0.0, 0.0, 0.0, 1.0]]
    ),
    q_min=np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159]),
    q_max=np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159]),
    max_speed=np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26]),
    max_acceleration=np.full(7, 10.0),
    max_jerk=np.full(7, 5000.0),
    max_tcp_speed=3.0,
    # Franka's ready pose: the hand points straight down, 0.31 m in front of the base.
    home=np.array([0.0, -0.25 * math.pi, 0.0, -0.75 * math.pi, 0.0, _HALF_PI, 0.25 * math.pi]),
    capsules=_CAPSULES,
    gripper=ParallelGripper(
        length=_TCP,
        max_opening=0.08,
        pivot_y=0.0,
        pivot_z=_FINGER,
        knuckle=0.0,
        face=0.0,
        knuckles=(),
        fingers=(
            FingerCapsule("finger mount", (-0.006, 0.017, 0.011), (0.006, 0.017, 0.011), 0.013),
            FingerCapsule("finger", (-0.003, 0.020, 0.021), (-0.003, 0.012, 0.036), 0.0085),
            FingerCapsule("finger front", (0.003, 0.020, 0.021), (0.003, 0.012, 0.036), 0.0085),
            FingerCapsule("pad left", (-0.003, 0.0077, 0.040), (-0.003, 0.0077, 0.047), 0.0077,
                    touches_object=True),
            FingerCapsule("pad right", (0.003, 0.0077, 0.040), (0.003, 0.0077, 0.047), 0.0077,
                    touches_object=True),
        ),
    ),
)  # fmt: skip
"""The arm as Franka sells it; `q` in radians, its base frame is the world."""
