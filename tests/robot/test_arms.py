"""Arms of files and their capsules, against published shapes, kinematics and MuJoCo."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import (
    FR3,
    XARM7,
    CollisionChecker,
    Surroundings,
    arm_shape,
    find_arm,
    follow,
    lift,
    link_poses,
    read_arm,
    tcp_pose,
)
from gendom.tasks import RopeCasting, RopeReaching

STEPS = np.load(Path(__file__).parent / "xarm_gripper.npz")  # from one to the next
POINTS = {name: 1e-4 * np.cumsum(STEPS[name], axis=0) for name in STEPS.files}
"""Places 2 mm apart on the outer surfaces of UFACTORY's meshes of the gripper [m], each in its
URDF link's frame, where the gripper is open."""


def gripper_surface(opening):
    """[N, 3] surface of the gripper in the flange's frame [m], by the URDF's joints."""
    start = np.arctan2(0.042039, 0.035465)
    turn = np.arccos((0.5 * opening + 0.026 - 0.035) / np.hypot(0.042039, 0.035465)) - start
    R = Rotation.from_rotvec([turn, 0.0, 0.0])
    pivot, inner = np.array([[0.0, 0.035, 0.059098], [0.0, 0.02, 0.074098]])
    left = (
        R.apply(POINTS["left_outer_knuckle"]) + pivot,
        R.apply(POINTS["left_inner_knuckle"]) + inner,
        POINTS["left_finger"] + pivot + R.apply([0.0, 0.035465, 0.042039]),
    )
    both = [points * [1.0, side, 1.0] for points in left for side in (1.0, -1.0)]
    return np.concatenate([POINTS["base_link"], *both])


def from_segments(points, a, b):
    """[N, C] distances of points from segments."""
    axis, length2 = b - a, ((b - a) ** 2).sum(axis=1)
    along = points @ axis.T - (a * axis).sum(axis=1)
    share = np.clip(along / np.maximum(length2, 1e-12), 0.0, 1.0)
    from_a2 = (points**2).sum(axis=1)[:, None] - 2.0 * points @ a.T + (a**2).sum(axis=1)
    return np.sqrt(np.maximum(from_a2 + share * (share * length2 - 2.0 * along), 0.0))


@pytest.mark.parametrize("opening", [0.0, 0.03, 0.084])
def test_the_gripper_s_capsules_and_its_meshes_are_within_5_mm(opening):
    """Both ways: the surface of the capsules together, a point a mm, and that of all meshes. The
    housing is hollow, with slots of 15 mm for the knuckles: inside its hull nothing sticks out."""
    shape = arm_shape(XARM7, XARM7.home, opening)
    T = np.linalg.inv(link_poses(XARM7, XARM7.home)[7])
    a, b = (p @ T[:3, :3].T + T[:3, 3] for p in (shape.start, shape.end))
    surface = gripper_surface(opening)
    outside = (from_segments(surface, a, b) - shape.radius).min(axis=1)
    assert outside.max() < 0.005, surface[outside.argmax()]
    assert (outside > 0.002).mean() < 0.04
    tree, housing = KDTree(surface), POINTS["base_link"]
    hull = ConvexHull(housing[(housing[:, 2] > 0.008) & (housing[:, 2] < 0.097)]).equations
    share = np.linspace(-0.3, 1.3, 161)[:, None].clip(0.0, 1.0)
    way = np.random.default_rng(0).normal(size=(161, 40, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    for c, name in enumerate(shape.names):
        if name.startswith(("gripper", "left", "right")):
            points = (a[c] + share * (b[c] - a[c]))[:, None] + shape.radius[c] * way
            points = points.reshape(-1, 3)
            points = points[tree.query(points)[0] >= 0.005]
            hidden = (from_segments(points, a, b) - shape.radius).min(axis=1) < -1e-6
            points = points[~hidden]
            assert np.all((points @ hull[:, :3].T + hull[:, 3]).max(axis=1) <= 0.0), name


# ---- files ---------------------------------------------------------------------------------------


def written(folder, arm, *, joints=7, extra=""):
    """A URDF of an arm's joints with a box on each link, as vendors write them."""
    rows = ['<robot name="r"><link name="l0"/>']
    for i, T in enumerate(arm.T_links[:joints], 1):
        rpy = " ".join(map(repr, map(float, Rotation.from_matrix(T[:3, :3]).as_euler("xyz"))))
        xyz = " ".join(map(repr, map(float, T[:3, 3])))
        rows.append(
            f'<link name="l{i}"><collision><origin xyz="0.01 0 -0.04"/><geometry>'
            '<box size="0.06 0.05 0.1"/></geometry></collision></link>'
            f'<joint name="j{i}" type="revolute"><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{arm.q_min[i - 1]}" upper="{arm.q_max[i - 1]}" effort="9" '
            'velocity="2.5"/></joint>'
        )
    path = folder / "made.urdf"
    path.write_text("".join(rows) + extra + "</robot>")
    return path


@pytest.mark.parametrize("joints", [6, 7])
def test_an_arm_of_a_urdf_turns_as_it_says_and_its_capsules_hold_its_shapes(tmp_path, joints):
    pytest.importorskip("mujoco", reason="needs the extra reality")
    arm = find_arm(str(written(tmp_path, XARM7, joints=joints)), files=True)
    assert arm.name == "made" and arm.joints == joints
    q = np.random.default_rng(0).uniform(arm.q_min, arm.q_max, (50, joints))
    told = np.concatenate([q, np.zeros((50, 7 - joints))], axis=1)
    ours = link_poses(XARM7, told)[:, : joints + 1]
    np.testing.assert_allclose(link_poses(arm, q)[:, : joints + 1], ours, atol=1e-9)
    np.testing.assert_allclose(arm.q_max, XARM7.q_max[:joints])
    np.testing.assert_allclose(arm.max_speed, 2.5)
    corners = np.array([*product((-0.02, 0.04), (-0.025, 0.025), (-0.09, 0.01))])
    for link in range(1, joints + 1):
        own = [c for c in arm.capsules if c.link == link]
        a, b = (np.array([getattr(c, end) for c in own]) for end in ("start", "end"))
        depth = from_segments(corners, a, b) - [c.radius for c in own]
        assert depth.min(axis=1).max() < 1e-9
    # The tool points along the last axis, beyond what the arm has.
    np.testing.assert_allclose(arm.T_flange_tcp[:3, :3], np.eye(3), atol=1e-12)
    T = tcp_pose(arm, arm.home)
    turned = Rotation.from_matrix(T[:3, :3]).as_quat()
    path = lift(T[:3, 3], height=0.02, speed=0.05, quat_xyzw=turned)
    motion = follow(arm, path)
    assert abs(motion.tcp_at(arm, motion.end)[2, 3] - path.position[-1, 2]) < 1e-5


def test_an_arm_ends_at_its_flange_and_a_jaw_that_turns_is_none_of_its_joints(tmp_path):
    pytest.importorskip("mujoco", reason="needs the extra reality")
    path = written(tmp_path, XARM7)
    path.with_suffix(".toml").write_text('flange = "l6"\ntool = 0.1\n')
    arm, q = read_arm(path), XARM7.home
    assert arm.joints == 6 and max(c.link for c in arm.capsules) == 6
    T = link_poses(XARM7, q)[6]
    np.testing.assert_allclose(tcp_pose(arm, q[:6])[:3, 3], T[:3, 3] + 0.1 * T[:3, 2], atol=1e-9)


MJCF = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="base" pos="1 2 3">
{}<site name="tip" pos="0 0 0.05" euler="0 0 90"/><geom type="sphere" size="0.04"/>
<body name="f1"><joint type="slide" axis="0 1 0"/><geom size="0.01" pos="0 0 0.2"/></body>
<body name="f2"><joint type="slide" axis="0 -1 0"/><geom size="0.01"/></body>
{}</body></worldbody></mujoco>"""
LINK = '<body pos="0.1 0 0.2"><joint axis="{}" range="-100 90"/><geom size="0.03" type="sphere"/>'


def test_an_arm_of_an_mjcf_with_fingers_and_a_file_beside_it(tmp_path):
    """Axes of any direction; fingers end the chain; the .toml adds what the file leaves out."""
    mujoco = pytest.importorskip("mujoco", reason="needs the extra reality")
    axes = ["0 0 1", "0 1 0", "0 -1 0", "1 0 0", "0 0 -1", "1 1 0"]
    text = MJCF.format("".join(LINK.format(axis) for axis in axes), "</body>" * 6)
    path = tmp_path / "six.xml"
    path.write_text(text)
    (tmp_path / "six.toml").write_text('flange = "tip"\ntool = 0.12\nopening = 0.05\n')
    arm = read_arm(path)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(1).uniform(arm.q_min, arm.q_max, (20, 6)):
        data.qpos[:6] = q
        mujoco.mj_kinematics(model, data)
        tip = data.site_xpos[0] + 0.12 * data.site_xmat[0].reshape(3, 3)[:, 2] - [1, 2, 3]
        T = tcp_pose(arm, q)
        np.testing.assert_allclose(T[:3, 3], tip, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], data.site_xmat[0].reshape(3, 3), atol=1e-9)
    np.testing.assert_allclose(arm.q_min, np.radians(-100))
    assert arm.gripper.max_opening == 0.05 and max(c.link for c in arm.capsules) == 6
    shape = arm_shape(arm, arm.home, 0.03)
    inner = [c for c in range(len(shape.names)) if shape.touches_object[c]]
    across = (shape.end[inner[0]] - shape.end[inner[1]]) @ tcp_pose(arm, arm.home)[:3, 1]
    assert across - 2 * shape.radius[inner[0]] == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("content", "beside", "fault"),
    [
        (b"<robot", "", "cannot be read"),
        (b"<!DOCTYPE r [<!ENTITY a 'aaaa'>]><robot>&a;</robot>", "", "declares entities"),
        (b"<mujoco><include file='/etc/hosts'/></mujoco>", "", "holds <include>"),
        (b"<mujoco><asset><mesh file='no.stl'/></asset></mujoco>", "", r"no\.stl: no such file"),
        (None, "grip = 1\n", "has the unknown key 'grip'"),
        (None, "opening = -1\n", "opening is -1"),
        (None, 'flange = "hand"\n', "no body or site 'hand'"),
    ],
)
def test_files_that_describe_no_arm_are_told(tmp_path, content, beside, fault):
    pytest.importorskip("mujoco", reason="needs the extra reality")
    path = written(tmp_path, XARM7)
    if content is not None:
        path.write_bytes(content)
    path.with_suffix(".toml").write_text(beside)
    with pytest.raises(RobotError, match=fault) as found:
        read_arm(path)
    assert "\n" not in str(found.value)


def test_a_path_in_a_file_is_no_arm(tmp_path):
    """Only a person may name a file: `robot` of object.toml is a registered name."""
    with pytest.raises(RobotError, match="there is no robot"):
        find_arm(str(written(tmp_path, XARM7)))


# ---- the FR3 -------------------------------------------------------------------------------------


def test_the_fr3_stands_as_franka_s_urdf_says():
    """The flange of its URDF's joints: origins (xyz, rpy about x alone)."""
    half, T = np.pi / 2, np.eye(4)
    origins = [
        ((0, 0, 0.333), 0), ((0, 0, 0), -half), ((0, -0.316, 0), half), ((0.0825, 0, 0), half),
        ((-0.0825, 0.384, 0), -half), ((0, 0, 0), half), ((0.088, 0, 0), half),
    ]  # fmt: skip
    q = np.random.default_rng(0).uniform(FR3.q_min, FR3.q_max)
    for (xyz, roll), angle in zip(origins, q, strict=True):
        step = np.eye(4)
        turn = Rotation.from_euler("x", roll) * Rotation.from_euler("z", angle)
        step[:3, :3], step[:3, 3] = turn.as_matrix(), xyz
        T = T @ step
    hand = np.eye(4)
    hand[:3, :3] = Rotation.from_euler("z", -np.pi / 4).as_matrix()
    hand[2, 3] = 0.107 + 0.1034
    np.testing.assert_allclose(tcp_pose(FR3, q), T @ hand, atol=1e-12)
    # the fr3 carries out the tasks
    assert find_arm("fr3") is FR3
    table = Surroundings(table_height=0.0, clearance=0.02, self_clearance=0.01)
    assert CollisionChecker(FR3, table).at(FR3.home) is None
    for task in (RopeReaching(), RopeCasting()):
        (action,) = task.sample_actions(task.item, np.random.default_rng(0), 1)
        path = task.tool_path(task.item, action).moved(task.T_world_task(task.item))
        motion = follow(FR3, path, surroundings=table)
        motion.check_limits(FR3)
        assert motion.slowed_by < 1.2
