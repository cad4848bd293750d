"""A robot: a post on a turntable, one joint about the vertical (`gendom.arms`)."""

import numpy as np

from gendom.robot import Arm, LinkCapsule, ParallelGripper

ONE = np.ones(1)
post = LinkCapsule(name="post", link=1, start=(0.12, 0.0, 0.0), end=(0.12, 0.0, 0.4), radius=0.02)
turntable = Arm(
    name="turntable",
    T_links=np.eye(4)[None],
    T_flange_tcp=np.eye(4),
    home=0.0 * ONE,
    q_min=-3.2 * ONE,
    q_max=3.2 * ONE,
    max_speed=ONE,
    max_acceleration=ONE,
    max_jerk=ONE,
    max_tcp_speed=1.0,
    capsules=(post,),
    gripper=ParallelGripper(max_opening=0.05, pivot_y=0.03, pivot_z=0.0, knuckle=0.05, face=0.02),
)
