"""The arm is taken out of the clouds by its joints; what it holds and what is near stays."""

import shutil

import numpy as np
import pytest

from gendom.errors import RecordingError
from gendom.perception import perceive, read_cameras
from gendom.perception.robot import FINGER_MARGIN, Capsules
from gendom.robot import XARM7, arm_shape, follow, lift, pointing, tcp_pose

DIAMETER = 0.01


def test_points_within_a_margin_of_capsules():
    """Of a length and of none, whose margin is at most 2 mm."""
    p = np.random.default_rng(0).uniform(-0.3, 0.3, (3000, 3))
    start, end = np.array([[0, 0, 0], [0.1, 0, 0]]), np.array([[0, 0, 0.2], [0.1, 0, 0]])
    capsules = Capsules(start, end, np.array([0.05, 0.08]), np.array([np.inf, 0.002]))
    along = np.clip(p[:, 2:], 0.0, 0.2) * [0, 0, 1]
    off = [np.linalg.norm(p - nearest, axis=1) for nearest in (along, start[1])]
    expected = (off[0] <= 0.06) | (off[1] <= 0.082)
    np.testing.assert_array_equal(capsules.contain(p, 0.01), expected)


@pytest.fixture(scope="module")
def seen(world, tmp_path_factory):
    """A lift by an arm in view of two cameras, and the ropes in it.

    Half the resolution and half the pixels' noise: depth noise is that of 640 x 480.
    """
    folder = tmp_path_factory.mktemp("arm") / "lift"
    # The fingers open across the cameras' view, so that these see what is between them.
    turned = pointing([0, 0, -1], [1, 0, 0])
    path = lift([0.45, 0.0, 0.2], height=0.02, speed=0.05, wait=0.1, quat_xyzw=turned)
    motion = follow(XARM7, path).shifted(-0.1)

    def scene(t):
        q = motion.at(0.1 * t)
        shape = arm_shape(XARM7, q, DIAMETER)
        tip = tcp_pose(XARM7, q)[:3, 3] + [0.0, 0.0, 0.02]
        links = zip(shape.start, shape.end, shape.radius, strict=True)
        arm = [world.Rope(np.array(ends), r, world.GREY) for *ends, r in links]
        return [*arm, world.lifted_rope(tip=tuple(tip))]

    eyes = {"left": (0.45, -0.65, 0.47), "right": (0.55, 0.65, 0.47)}
    world.write_lift(
        folder,
        frames=1,
        rope=False,
        things=scene,
        sensor=world.Sensor(subpixel=0.04, quantisation=1.0 / 64.0),
        cameras=[
            world.make_camera(name, eye=eye, target=(0.45, 0.0, 0.1), scale=0.5)
            for name, eye in eyes.items()
        ],
    )
    time = motion.sampled(100.0)
    closed = [bool(motion.closed_at(t)) for t in time]
    path = np.column_stack([time, motion.tcp_at(XARM7, time)[:, :3, 3], closed])
    header = "time,x,y,z,closed"
    np.savetxt(folder / "gripper.csv", path, "%.9g", ",", header=header, comments="")
    return folder, motion, scene(0)[-1]


@pytest.fixture
def folder(seen, tmp_path):
    """A copy to change."""
    return shutil.copytree(seen[0], tmp_path / "lift")


def test_the_arm_goes_and_the_rope_stays(seen, folder):
    """Without colour: little of the arm is left, and the rope is seen up into the grip. Without the
    joints, too, but not into the grip."""
    _, motion, rope = seen
    without = perceive(read_cameras(folder)).recording.frame(0)
    assert len(without) > 100 and (rope.distance(without) > 0.02).mean() < 0.05
    motion.write_joints(folder / "joints.csv", opening=(DIAMETER, 0.08))
    points = perceive(read_cameras(folder)).recording.frame(0)
    standing = points[points[:, 2] > 0.03]
    far = rope.distance(standing) > 0.012
    assert far.mean() < 0.06
    tip = motion.tcp_at(XARM7, 0.0)[2, 3]
    on_rope = standing[~far]
    for low in np.arange(0.04, tip - 0.02, 0.02):  # in every 2 cm
        assert ((on_rope[:, 2] >= low) & (on_rope[:, 2] < low + 0.02)).sum() >= 3
    assert (on_rope[:, 2] > tip).sum() >= 3  # between the fingers


def test_fingers_are_open_by_the_object(seen, folder):
    """Where their opening is not measured."""
    motion = seen[1]
    motion.write_joints(folder / "joints.csv")
    capsules = read_cameras(folder).capsules
    assert capsules is not None
    expected = arm_shape(XARM7, motion.at(0.0), DIAMETER)
    np.testing.assert_allclose(capsules(0.0).start, expected.start, atol=1e-4)
    margins = capsules(0.0).largest_margin
    assert margins is not None and sorted({*margins}) == [FINGER_MARGIN, np.inf]


def test_bad_joints_are_told(seen, folder):
    joints, described, warnings = folder / "joints.csv", folder / "object.toml", []
    joints.write_text("time,q0\n0,1\n")
    with pytest.raises(RecordingError, match=r"joints\.csv: has the header"):
        read_cameras(folder)
    rows = [f"{t / 30!r},0,0,0,0.4,0,0.4,0" for t in range(6)]
    joints.write_text("\n".join(["time,q0,q1,q2,q3,q4,q5,q6", *rows])[:-5])
    read_cameras(folder, on_warning=warnings.append)
    assert "joints.csv, line 7: is cut short" in str(warnings[0])
    seen[1].shifted(3.0).write_joints(joints)
    read_cameras(folder, on_warning=warnings.append)
    assert "the arm is taken to stand still" in str(warnings[-1])
    described.write_text(described.read_text() + 'robot = "r2d2"\n')
    with pytest.raises(RecordingError, match=r"robot: there is no robot 'r2d2'; have xarm7"):
        read_cameras(folder)
