"""A new robot is one `Arm`, in a package with an entry point."""

import json

import numpy as np
from PIL import Image

from extending.lifts import FRAMES, depth_pictures, write_lift
from gendom.datasets import Recording

CODE = '''"""A post on a turntable: one joint, about the vertical."""

import numpy as np

from gendom.robot import Arm, LinkCapsule, ParallelGripper

turntable = Arm(
    name="turntable",
    T_links=np.eye(4)[None],
    T_flange_tcp=np.eye(4),
    q_min=np.array([-3.2]),
    q_max=np.array([3.2]),
    max_speed=np.ones(1),
    max_acceleration=np.ones(1),
    max_jerk=np.ones(1),
    max_tcp_speed=1.0,
    home=np.zeros(1),
    capsules=(
        LinkCapsule(
            name="post", link=1, start=(0.12, 0.0, 0.0), end=(0.12, 0.0, 0.4), radius=0.02
        ),
    ),
    gripper=ParallelGripper(
        max_opening=0.05, pivot_y=0.03, pivot_z=0.0, knuckle=0.05, face=0.02
    ),
)
'''


def test_a_package_adds_a_robot(outside, tmp_path):
    """A lift in which the turntable's post stands beside the rope."""
    folder, out = tmp_path / "lift", tmp_path / "lift.npz"
    camera = write_lift(folder, robot="turntable")
    times = [f"{t / 30}" for t in range(FRAMES)]
    for t, depth in enumerate(depth_pictures(post=True)):
        Image.fromarray(depth).save(camera / f"{t}.png")
    rows = [f"{time},{t}.png\n" for t, time in enumerate(times)]
    (camera / "frames.csv").write_text("time,depth\n" + "".join(rows))
    (folder / "joints.csv").write_text("time,q0\n" + "".join(f"{time},0\n" for time in times))
    outside.add("turntable", CODE, arms="turntable")
    made = outside.gendom("perceive", folder, "--no-table", "--out", out, "--json")
    assert made.returncode == 0, made.stderr
    points = json.loads(made.stdout)["points"]
    assert points["robot"]["median"] < 0.5 * points["support"]["median"]
    assert np.abs(Recording.read(out).frame(0)[:, 0]).max() < 0.01
