"""Robot: kinematics, paths, motions and distances beside products, differences and samples."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import XARM7, find_arm
from gendom.robot import collision as hits
from gendom.robot import kinematics as kin
from gendom.robot.motion import JointMotion, read_joints
from gendom.robot.path import DOWN, GripperEvent, TcpPath, TcpPaths, pointing
from gendom.robot.planning import in_time

RNG = np.random.default_rng(3)
MIDDLE = 0.5 * (XARM7.q_min + XARM7.q_max)


def turned(axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * np.asarray(axis, float)).as_matrix()
    return T


def angles(n, spread=1.0):
    q = XARM7.home + spread * RNG.uniform(-1.0, 1.0, (n, 7))
    return np.clip(q, XARM7.q_min, XARM7.q_max)


# ---- kinematics ----------------------------------------------------------------------------------


def test_links_stand_where_ufactory_s_standard_parameters_put_them():
    """Ours are modified ones."""
    half = np.pi / 2
    d = [0.267, 0.0, 0.293, 0.0, 0.3425, 0.0, 0.097]
    a = [0.0, 0.0, 0.0525, 0.0775, 0.0, 0.076, 0.0]
    alpha = [-half, half, half, half, half, -half, 0.0]
    for q in angles(3):
        T = np.eye(4)
        for angle, di, ai, al in zip(q, d, a, alpha, strict=True):
            tilt = turned([1.0, 0.0, 0.0], al)
            tilt[:3, 3] = ai, 0.0, di
            turn = turned([0.0, 0.0, 1.0], angle)
            T = T @ turn @ tilt
        np.testing.assert_allclose(kin.link_poses(XARM7, q)[7], T, atol=1e-12)


def test_the_jacobian_is_the_slope_of_poses():
    for q in angles(3):
        J = kin.jacobian(XARM7, q)
        h = 1e-6
        for j in range(7):
            a, b = (kin.tcp_pose(XARM7, q + s * h * np.eye(7)[j]) for s in (1.0, -1.0))
            turn = Rotation.from_matrix(a[:3, :3] @ b[:3, :3].T).as_rotvec()
            np.testing.assert_allclose(J[:3, j], (a - b)[:3, 3] / (2.0 * h), atol=1e-8)
            np.testing.assert_allclose(J[3:, j], turn / (2.0 * h), atol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-6, 1.0, 2.0, 3.0, 3.1412, math.pi - 1e-9])
def test_errors_of_poses_are_shifts_and_turns(angle):
    axis = np.array([0.6, -0.48, 0.64])
    start, T = turned([0.0, 0.8, 0.6], 0.7), turned(axis, angle)
    start[:3, 3] = 1.0, 2.0, 3.0
    to = start.copy()
    to[:3, :3], to[:3, 3] = T[:3, :3] @ start[:3, :3], (1.1, 1.8, 3.3)
    error = kin.pose_error(np.stack([to, start]), np.stack([start, start]))
    np.testing.assert_allclose(error[0], [0.1, -0.2, 0.3, *(angle * axis)], atol=1e-9)
    np.testing.assert_allclose(error[1], np.zeros(6), atol=1e-12)
    half = kin.pose_error(turned(axis, math.pi), np.eye(4))[3:]  # half a turn has two axes
    np.testing.assert_allclose(np.abs(half), np.abs(math.pi * axis), atol=1e-7)


def test_solutions_reach_their_pose_from_near_to_far():
    for q in angles(3, 0.6):
        T = kin.tcp_pose(XARM7, q)
        found = kin.solutions(XARM7, T)
        away = [np.linalg.norm(one - XARM7.home) for one in found]
        assert away == sorted(away) and len(found) >= 2
        for k, one in enumerate(found):
            error = kin.pose_error(T, kin.tcp_pose(XARM7, one))
            assert np.linalg.norm(error[:3]) < 1e-7 and np.linalg.norm(error[3:]) < 1e-6
            assert (one >= XARM7.q_min).all() and (one <= XARM7.q_max).all()
            assert all(np.abs(one - other).max() > 0.02 for other in found[:k])
    T = turned([1.0, 0.0, 0.0], math.pi)
    T[:3, 3] = 0.4, 0.2, 0.2
    q = kin.solutions(XARM7, T)[0]
    J = kin.jacobian(XARM7, q)
    left = (np.eye(7) - np.linalg.pinv(J) @ J) @ (XARM7.home - q)
    assert np.abs(left).max() < 1e-4  # none is nearer to home


def damped_step(q, T, homing):
    """One step of damped least squares, written for one arm: errors of at most 0.3 m (0.3 m a
    radian), joints at an end that would leave it held, home approached in the null space."""
    poses = kin.link_poses(XARM7, q)
    weight = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    J, e = weight[:, None] * kin.jacobian(XARM7, q), weight * kin.pose_error(T, poses[-1])
    far = min(np.linalg.norm(e), 0.3)
    e *= far / np.linalg.norm(e)
    free, low, high = np.ones(7), XARM7.q_min, XARM7.q_max
    for _ in range(3):
        Jf, wish = J * free, homing * (XARM7.home - q) * free
        inverse = Jf.T @ np.linalg.inv(Jf @ Jf.T + (0.01 * far + 1e-10) * np.eye(6))
        step = inverse @ (e - Jf @ wish) + wish
        out = ((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))
        if not (out & (free > 0.0)).any():
            break
        free[out] = 0.0
    step *= free
    return np.clip(q + step * min(1.0, 0.4 / np.abs(step).max()), low, high)


@pytest.mark.parametrize("iterations", [1, 2, 4, 5])
def test_descents_are_steps_of_damped_least_squares(iterations):
    start, aims = angles(5, 0.8), angles(5, 0.8)
    start[0] = aims[0] + 1e-3
    start[1, 1], start[2, 3], aims[2, 3] = XARM7.q_min[1], XARM7.q_max[3], XARM7.q_max[3]
    start[3], aims[3] = XARM7.q_max, XARM7.home
    T = kin.tcp_pose(XARM7, aims)
    for homing in (0.0, 0.5):
        how = {"homing": homing, "homed": 3, "iterations": iterations}
        found, error = kin.descend(XARM7, T, start, XARM7.home, **how)
        for q, aim, one, left in zip(start, T, found, error, strict=True):
            for k in range(iterations):
                q = damped_step(q, aim, homing if k < 3 else 0.0)
            np.testing.assert_allclose(one, q, atol=1e-7)
            missed = kin.pose_error(aim, kin.tcp_pose(XARM7, one))
            assert kin.reached(left) or np.abs(left - missed).max() < 1e-12


def test_whole_turns_are_taken_off_where_limits_allow_it():
    rest = np.zeros(7)
    q = np.array([3.3, -3.3, 6.0, 1.0, -6.0, 0.5, 3.1])
    found = kin._unwound(XARM7, q, rest)
    for a, b, low, high in zip(found, q, XARM7.q_min, XARM7.q_max, strict=True):
        every = [b + 2.0 * np.pi * k for k in (-1, 0, 1)]
        allowed = [x for x in every if low <= x <= high]
        assert a == pytest.approx(min(allowed, key=abs) if min(every, key=abs) in allowed else b)


def test_what_is_missed_is_said():
    q = MIDDLE.copy()
    q[1], q[3] = XARM7.q_min[1], XARM7.q_max[3]
    error = np.array([3e-3, 4e-3, 0.0, 0.0, np.radians(2.0), 0.0])
    T = np.eye(4)
    T[:3, 3] = 0.1, -0.2, 0.3
    words = "(0.100, -0.200, 0.300) m, quat_xyzw (0.000, 0.000, 0.000, 1.000), is out of reach: "
    words += "missed by 5 mm and 2 degrees"
    assert kin.out_of_reach(XARM7, T, q, error) == f"{words}, joint 2 and 4 at its end"
    assert kin.out_of_reach(XARM7, T, MIDDLE, error) == words
    bad = [np.eye(3), np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0])]
    bad += [np.diag([1.001, 1.0, 1.0, 1.0]), np.diag([1.0, 1.0, 1.0, 2.0])]
    for T in bad:
        with pytest.raises(RobotError, match="is no rigid transform"):
            kin.solutions(XARM7, T)
    for call, said in (
        (lambda: kin.solutions(XARM7, turned([0.0, 0.0, 1.0], 0.0)), "out of reach: missed by"),
        (lambda: kin.tcp_pose(XARM7, np.zeros(6)), "give 7 angles"),
        (lambda: kin.tcp_pose(XARM7, np.full(7, np.nan)), "not finite"),
        (lambda: find_arm("xarm9"), "have xarm7"),
    ):
        with pytest.raises(RobotError, match=said):
            call()


@pytest.mark.parametrize("opening", [0.005, 0.05])
def test_capsules_go_with_their_links_and_fingers(opening):
    (q,), g = angles(1), XARM7.gripper
    shape, poses = kin.arm_shape(XARM7, q, opening), kin.link_poses(XARM7, q)
    fixed = XARM7.capsules
    for k, c in enumerate(fixed):
        for end, own in ((shape.start, c.start), (shape.end, c.end)):
            np.testing.assert_allclose(end[k], (poses[c.link] @ [*own, 1.0])[:3], atol=1e-12)
    hand = poses[-1].copy()
    hand[:3, 3] -= g.length * hand[:3, 2]
    y = 0.5 * opening + g.face
    z = g.pivot_z + math.sqrt(g.knuckle**2 - (y - g.pivot_y) ** 2)
    along = np.array([y - g.pivot_y, z - g.pivot_z]) / g.knuckle
    for wide, kept in ((1.0, g.max_opening), (-1.0, 0.0)):
        np.testing.assert_array_equal(g.finger_pivot(wide), g.finger_pivot(kept))
    for side, name in ((1.0, "left"), (-1.0, "right")):
        for c in g.fingers:
            k = shape.names.index(f"{name} {c.name}")
            assert shape.radius[k] == c.radius and bool(shape.touches_object[k]) == c.touches_object
            for end, own in ((shape.start, c.start), (shape.end, c.end)):
                at = np.array(own)
                if c.pivot is not None:
                    at[1:] = c.pivot + own[1] * along + own[2] * np.array([-along[1], along[0]])
                else:
                    at[1:] += [y, z]
                at = at * [1.0, side, 1.0]
                np.testing.assert_allclose(end[k], (hand @ [*at, 1.0])[:3], atol=1e-12)
    assert shape.names[: len(fixed)] == tuple(c.name for c in fixed)
    np.testing.assert_array_equal(kin.arm_shape(XARM7, q).end, kin.arm_shape(XARM7, q, 0.0).end)


# ---- distances -----------------------------------------------------------------------------------


def segments(n):
    a, b, c, d = RNG.normal(size=(4, n, 3))
    d[0] = c[0] + 2.0 * (b[0] - a[0])  # parallel
    c[1:3], d[1:3] = a[1:3] + 0.3, b[1:3] + 0.3
    b[3], d[4] = a[3], c[4]  # points
    b[5], d[5] = a[5], c[5]
    d[6] = c[6] - 0.5 * (b[6] - a[6])
    return a, b, c, d


def test_segments_are_as_far_apart_as_their_nearest_points():
    a, b, c, d = segments(60)
    s = np.linspace(0.0, 1.0, 401)[:, None]
    for k in range(60):
        x, y = a[k] + s * (b[k] - a[k]), c[k] + s * (d[k] - c[k])
        least = np.linalg.norm(x[:, None] - y[None], axis=2).min()
        found = hits.segments_apart(a[k], b[k], c[k], d[k])
        assert least - 0.01 < found <= least + 1e-9
        assert found == pytest.approx(hits.segments_apart(a, b, c, d)[k], abs=1e-12)


def test_a_box_is_as_far_as_its_nearest_face():
    half = np.array([0.5, 0.3, 0.8])
    a, b = RNG.normal(size=(2, 80, 3))
    a[:20] *= 0.2
    b[:20] *= 0.2  # inside
    b[20:24] = a[20:24]
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    for k in range(80):
        beyond = np.abs(a[k] + s * (b[k] - a[k])) - half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        least = (outside + np.minimum(beyond.max(axis=1), 0.0)).min()
        assert hits.segment_to_box(a[k], b[k], half) == pytest.approx(least, abs=2e-3)
        assert hits.segment_to_box(a, b, half)[k] == pytest.approx(least, abs=2e-3)
    turn = Rotation.from_rotvec([0.2, -0.4, 0.9])
    box = hits.Box(name="b", position=np.array([1.0, 2.0, 3.0]), size=2.0 * half,
                   quat_xyzw=turn.as_quat())  # fmt: skip
    x, y = (turn.apply(p) + box.position for p in (a, b))
    np.testing.assert_allclose(box.distance(x, y), hits.segment_to_box(a, b, half), atol=1e-9)


POST = hits.Post(
    name="post", start=np.array([0.4, 0.3, 0.0]), end=np.array([0.4, 0.3, 0.5]), radius=0.02
)
BOX = hits.Box(name="box", position=np.array([0.5, -0.2, 0.2]), size=np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"position": [1.0, 2.0]}, "its position is [1.0, 2.0]; give 3 numbers"),
        ({"size": [1.0, np.nan, 1.0]}, "its size is [1.0, nan, 1.0]; give 3 numbers"),
        ({"quat_xyzw": [0.0] * 4}, "is turned by no quaternion; give four numbers, not all 0"),
        ({"size": [1.0, 0.0, 1.0]}, "its size is [1. 0. 1.]; give lengths above 0"),
    ],
)
def test_obstacles_are_made_of_numbers(changes, said):
    given = {"name": "b", "position": [0, 0, 0], "size": [1, 1, 1], "quat_xyzw": [0, 0, 0, 1]}
    with pytest.raises(RobotError) as caught:
        hits.Box(**{**given, **changes})
    assert str(caught.value) == f"b: {said}"
    for radius in (0.0, np.inf, np.nan):
        with pytest.raises(RobotError, match=f"its radius is {radius}; give metres above 0"):
            replace(POST, radius=radius)


@pytest.mark.parametrize("asked", [0.01, 0.3])
def test_a_checker_measures_all_pairs_that_may_collide(asked):
    """Of capsules more than two links apart, of those two apart that are free at home; of what
    moves with the table and obstacles."""
    around = hits.Surroundings(
        table_height=-0.05, obstacles=(BOX, POST), clearance=0.03, self_clearance=asked
    )
    check = hits.CollisionChecker(XARM7, around, opening=0.04)
    q = angles(6)
    closed = hits.CollisionChecker(XARM7, opening=0.0).distance(q)
    np.testing.assert_array_equal(hits.CollisionChecker(XARM7).distance(q), closed)
    shape, home = (kin.arm_shape(XARM7, x, 0.04) for x in (q, XARM7.home))
    links = [c.link for c in XARM7.capsules] + [7] * (2 * len(XARM7.gripper.fingers))
    names, found = list(shape.names), check.distance(q)

    def apart(s, a, b):
        gap = hits.segments_apart(s.start[..., a, :], s.end[..., a, :], s.start[..., b, :],
                                  s.end[..., b, :])  # fmt: skip
        return gap - s.radius[a] - s.radius[b]

    wanted, margins = {}, {}
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            between, free = abs(links[a] - links[b]), float(apart(home, a, b))
            if between > 2 or (between == 2 and free >= 0.0):
                wanted[names[a], names[b]] = apart(shape, a, b)
                margins[names[a], names[b]] = asked if between > 2 or free >= asked else 0.0
    for a in range(len(names)):
        if links[a] > 0:
            low = np.minimum(shape.start[:, a, 2], shape.end[:, a, 2]) - shape.radius[a]
            if links[a] > 1:  # the first link only turns above it
                wanted[names[a], "table"] = low + 0.05
                margins[names[a], "table"] = 0.0 if shape.touches_object[a] else 0.03
            for one in (BOX, POST):
                gap = one.distance(shape.start[:, a], shape.end[:, a]) - shape.radius[a]
                wanted[names[a], one.name], margins[names[a], one.name] = gap, 0.03
    assert set(check.pairs) == set(wanted) and len(check.pairs) == len(wanted)
    assert check.around == {"table", "box", "post"}
    for k, pair in enumerate(check.pairs):
        np.testing.assert_allclose(found[:, k], wanted[pair], atol=1e-9)
        assert check._margin[k] == margins[pair]
    gaps = check._gaps(q)
    exact = found - check._margin
    near = exact < hits._NEAR
    np.testing.assert_allclose(gaps[near], exact[near], atol=1e-9)
    assert (gaps[~near] <= exact[~near] + 1e-9).all() and (gaps[~near] >= hits._NEAR - 1e-9).all()
    for one, own in zip(q, exact, strict=True):
        hit, k = check.at(one), int(np.argmin(own))
        assert (hit is None) == (own.min() >= 0.0)
        if hit is not None:
            assert (hit.first, hit.second) == check.pairs[k]
            assert hit.depth == pytest.approx(-own[k])


def test_a_motion_s_first_collision_is_that_of_small_steps():
    down = XARM7.home + np.array([0.0, 0.55, 0.0, 0.0, 0.0, 0.0, 0.0])
    motion = JointMotion(time=np.array([1.0, 2.0, 4.0]),
                         q=np.stack([XARM7.home, XARM7.home + 0.02, down]))  # fmt: skip
    check = hits.CollisionChecker(XARM7, hits.Surroundings(table_height=0.1, clearance=0.01))
    t = np.linspace(1.0, 4.0, 301)
    gaps = check.distance(motion.at(t)) - check._margin
    hit = int(np.argmax((gaps < 0.0).any(axis=1)))
    fine = np.linspace(t[hit - 1], t[hit], 101)
    close = check.distance(motion.at(fine)) - check._margin
    first = int(np.argmax((close < 0.0).any(axis=1)))
    found = check.along(motion)
    assert found is not None and found.time == pytest.approx(fine[first], abs=3e-4)
    k = int(np.argmin(close[first]))
    assert (found.first, found.second) == check.pairs[k] and found.second == "table"
    assert found.depth == pytest.approx(-gaps[:, k].min(), abs=2e-4)
    with pytest.raises(RobotError, match="keep the path away from the table, or move that"):
        check.check(motion)
    assert check.along(replace(motion, q=np.stack([XARM7.home] * 2 + [XARM7.home + 0.01]))) is None
    words = "from t = 2.000 s on a and b are 5.0 mm too near"
    one = hits.Collision(first="a", second="b", depth=0.005, time=2.0)
    assert str(one) == words
    assert str(replace(one, time=None)) == "a and b are 5.0 mm too near"


# ---- paths ---------------------------------------------------------------------------------------


def some_path(**changes):
    time = np.array([0.5, 1.0, 1.2, 2.0])
    position = np.array([[0.0, 0.0, 0.1], [0.3, 0.0, 0.1], [0.3, 0.0, 0.1], [0.3, 0.4, 0.2]])
    return TcpPath(**{"time": time, "position": position, "quat_xyzw": DOWN, **changes})


def ideal(path, t):
    return np.stack([np.interp(t, path.time, c) for c in path.position.T], axis=-1)


def test_a_blend_is_the_mean_under_a_parabola():
    path, blend = some_path(), 0.3
    u = (np.arange(20000) + 0.5) / 20000
    kernel = 6.0 * u * (1.0 - u) / 20000
    for t in (0.4, 0.5, 0.95, 1.05, 1.21, 1.9, 2.1):
        wanted = kernel @ ideal(path, t + blend * (u - 0.5))
        np.testing.assert_allclose(path.position_at(t, blend), wanted, atol=1e-8)
        np.testing.assert_allclose(path.position_at(t), ideal(path, t), atol=1e-12)
    T = path.pose_at([0.4, 1.9], blend)
    np.testing.assert_allclose(T[:, :3, 3], path.position_at([0.4, 1.9], blend))
    np.testing.assert_allclose(T[1, :3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_array_equal(T[:, 3], [[0.0, 0.0, 0.0, 1.0]] * 2)
    np.testing.assert_array_equal(path.corners, path.time)
    # a corner is missed by 3/32 of the jump times the blend
    assert path.deviation(0.1) == pytest.approx(3.0 / 32.0 * 0.6 * 0.1, rel=0.01)
    bent = some_path(time=[0.0, 1.0, 2.0], position=[[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    assert bent.deviation(0.2) == pytest.approx(3.0 / 32.0 * math.sqrt(2.0) * 0.2, rel=0.01)
    assert replace(bent, blend=0.2).deviation(0.2) < 1e-12
    assert some_path(position=np.zeros((4, 3))).deviation(0.1) == 0.0


def test_many_paths_are_sampled_as_they_run():
    one = some_path(blend=0.2, events=(GripperEvent(time=1.1, closed=True),))
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    two, still = (some_path(time=[0.0, 1.0], position=p) for p in (ends, 0.0 * ends))
    paths = TcpPaths([one, two, still])
    np.testing.assert_allclose(paths.moves, [0.4, 0.0, np.inf])
    assert (one.moves, two.moves) == (pytest.approx(0.4), 0.0)
    t = np.linspace(-0.2, 2.5, 40)
    found = paths.position_at(t)
    for k, path in enumerate((one, two, still)):
        np.testing.assert_array_equal(found[k], path.position_at(t, path.blend or 0.0))
    time, position, count = paths.sampled(4)
    knots = np.unique(
        np.round([*one.time, *np.add.outer(one.time, [-0.1, -0.05, 0.05, 0.1]).ravel()], 9)
    )
    assert count.tolist() == [len(knots), 2, 2]
    np.testing.assert_allclose(time[0], knots, atol=1e-9)
    np.testing.assert_allclose(time[1], [0.0] + [1.0] * (len(knots) - 1))
    np.testing.assert_allclose(position[0], one.position_at(knots, 0.2), atol=1e-9)
    told = one.to_dict()
    assert told["events"] == [{"time": 1.1, "closed": True}]
    assert len(told["time"]) == len(one.sampled()[0]) > len(knots)
    later = one.shifted(2.0)
    np.testing.assert_allclose(later.time, one.time + 2.0)
    assert later.events[0].time == 3.1 and (one.start, one.end) == (0.5, 2.0)
    T = turned([0.0, 0.0, 1.0], 0.5)
    T[:3, 3] = 1.0, 2.0, 3.0
    np.testing.assert_allclose(
        one.moved(T).pose_at(1.7, 0.2), T @ one.pose_at(1.7, 0.2), atol=1e-12
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": [0.0, 0.0]}, "has times that do not increase from knot to knot"),
        ({"time": [0.0]}, "needs time [K >= 2] and position [K, 3], got (1,), (2, 3)"),
        ({"position": [[0, 0, np.nan], [0, 0, 1]]}, "holds a number that is not finite"),
        ({"quat_xyzw": [0.0] * 4}, "has a quaternion that is zero or not finite"),
        ({"events": (GripperEvent(time=1, closed=True), GripperEvent(time=0, closed=False))},
         "has gripper events that are not in order of time"),
        ({"max_blend": 0.0}, "has max_blend 0.0"),
        ({"max_blend": 0.4, "blend": 0.41}, "has blend 0.41, beyond its max_blend 0.4"),
        ({"blend": math.nan}, "has blend nan, beyond its max_blend inf"),
    ],
)  # fmt: skip
def test_paths_are_made_of_finite_numbers(changes, said):
    given = {"time": [0.0, 1.0], "position": [[0.4, 0, 0.2], [0.4, 0, 0.3]], "quat_xyzw": DOWN}
    twice = {"quat_xyzw": [2.0, 0, 0, 0], "events": 2 * (GripperEvent(time=1, closed=True),)}
    for blend, most in ((0.4, 0.4), (0.0, 1.0)):
        path = TcpPath(**{**given, **twice}, blend=blend, max_blend=most)
        assert path.quat_xyzw.tolist() == list(DOWN)
    with pytest.raises(RobotError) as caught:
        TcpPath(**{**given, **changes})
    assert str(caught.value) == f"path of the tool: {said}"


def test_a_gripper_points_by_its_axes():
    z, y = np.array([0.0, 0.6, -0.8]), np.array([1.0, 0.2, 0.1])
    R = Rotation.from_quat(pointing(3.0 * z, 2.0 * y)).as_matrix()
    np.testing.assert_allclose(R[:, 2], z, atol=1e-12)
    own = y - (y @ z) * z
    np.testing.assert_allclose(R[:, 1], own / np.linalg.norm(own), atol=1e-12)
    for approach, fingers in (([0, 0, 1], [0, 0, 2]), ([0, 0, 0], [1, 0, 0])):
        with pytest.raises(RobotError, match="are parallel or zero"):
            pointing(approach, fingers)


# ---- motions -------------------------------------------------------------------------------------


def swing(by, seconds=2.0, start=0.0, **changes):
    """From rest to rest in a cubic: at most 1.5 by / seconds fast, 6 by / seconds^2 at the ends."""
    q = np.stack([MIDDLE, MIDDLE + by])
    return JointMotion(time=np.array([start, start + seconds]), q=q, **changes)


def test_limits_are_used_as_a_cubic_does():
    by = np.array([0.4, -0.3, 0.2, 0.25, -0.1, 0.05, 0.6])
    motion = swing(by, 2.0, 1.0)
    uses = {(u.kind, u.joint): u for u in motion.limit_uses(XARM7)}
    for j in range(7):
        assert uses["speed", j + 1].value == pytest.approx(1.5 * abs(by[j]) / 2.0)
        assert uses["speed", j + 1].time == pytest.approx(2.0)
        assert uses["speed", j + 1].limit == XARM7.max_speed[j]
        assert uses["acceleration", j + 1].value == pytest.approx(6.0 * abs(by[j]) / 4.0)
        assert uses["acceleration", j + 1].time in (1.0, 3.0)
        angle = uses["angle", j + 1]
        assert angle.value == pytest.approx(MIDDLE[j] + by[j]) and angle.time == 3.0
        assert angle.limit == pytest.approx((XARM7.q_min if by[j] < 0.0 else XARM7.q_max)[j])
    t = np.array([1.0, 2.0, 3.0])
    rates = kin.jacobian(XARM7, motion.at(t))[:, :3] @ motion.speed_at(t)[..., None]
    fastest = np.linalg.norm(rates[..., 0], axis=1).max()
    assert uses["tool speed", None].value == pytest.approx(fastest)
    assert uses["tool speed", None].time == 2.0
    shares = [u.share if u.kind != "acceleration" else math.sqrt(u.share)
              for u in uses.values() if u.kind != "angle"]  # fmt: skip
    assert motion.slowdown(XARM7) == pytest.approx(max(shares))
    slow = motion.stretched(motion.slowdown(XARM7) * 1.001)
    slow.check_limits(XARM7)
    with pytest.raises(RobotError, match=r"take 1\.\d{3} times as long"):
        motion.stretched(0.999 * motion.slowdown(XARM7)).check_limits(XARM7)
    # how far a joint turns at most: the speed's parabola within its Bezier points
    bound = hits._rotation_bound(motion, np.array([1.0, 1.0]), np.array([3.0, 2.0]))
    np.testing.assert_allclose(bound[0], 3.0 * abs(by))
    # a turn between knots is found
    q = np.stack([MIDDLE, MIDDLE + by, MIDDLE + 0.9 * by])
    round_trip = JointMotion(time=np.array([0.0, 1.0, 1.3]), q=q)
    t = np.linspace(0.0, 1.3, 20001)
    *of_joints, of_tool = round_trip.limit_uses(XARM7)
    at = np.array([0.0, 0.5, 1.0, 1.15, 1.3])
    rates = kin.jacobian(XARM7, round_trip.at(at))[:, :3] @ round_trip.speed_at(at)[..., None]
    assert of_tool.value == pytest.approx(np.linalg.norm(rates[..., 0], axis=1).max())
    for use in of_joints:
        order, joint = ("angle", "speed", "acceleration").index(use.kind), use.joint or 0
        value = round_trip.spline(t, order)[:, joint - 1]
        centre = MIDDLE[joint - 1] if order == 0 else 0.0
        assert abs(use.value - centre) == pytest.approx(np.abs(value - centre).max(), rel=1e-5)


@pytest.mark.parametrize(
    ("time", "q", "said"),
    [
        ([0.0, np.nan], np.zeros((2, 7)), "holds a number that is not finite"),
        ([0.0, 0.0], np.zeros((2, 7)), "its times do not increase; sort them"),
        ([0.0], np.zeros((1, 7)), "needs time [K >= 2] and q [K, J], got (1,) and (1, 7)"),
        ([0.0, 1.0], np.zeros(2), "needs time [K >= 2] and q [K, J], got (2,) and (2,)"),
    ],
)
def test_motions_are_made_of_finite_numbers(time, q, said):
    with pytest.raises(RobotError) as caught:
        JointMotion(time=np.array(time), q=q)
    assert str(caught.value) == f"joint motion: {said}"


def test_a_motion_stands_still_beside_its_knots_and_is_moved_in_time(tmp_path):
    events = (GripperEvent(time=1.5, closed=True), GripperEvent(time=2.5, closed=False))
    motion = swing(np.full(7, 0.2), 2.0, 1.0, events=events)
    for t in (0.0, 0.999, 3.001, 9.0):
        assert not motion.speed_at(t).any() and not motion.acceleration_at(t).any()
    np.testing.assert_allclose(motion.at([0.0, 2.0, 9.0]), MIDDLE + np.array([[0.0], [0.1], [0.2]]))
    np.testing.assert_allclose(motion.acceleration_at([1.0, 3.0]), [[0.3] * 7, [-0.3] * 7])
    assert [motion.closed_at(t) for t in (1.4, 1.5, 2.4, 2.5)] == [None, True, True, False]
    slow = motion.stretched(3.0)
    assert slow.time.tolist() == [1.0, 7.0] and slow.slowed_by == 3.0
    assert [e.time for e in slow.events] == [2.5, 5.5]
    late = motion.shifted(-1.0)
    assert late.time.tolist() == [0.0, 2.0] and late.slowed_by == 1.0
    on = swing(np.full(7, 0.2), 1.0, 5.0)
    on = replace(on, q=on.q + 0.2)
    both = motion.then(on)
    assert both.time.tolist() == [1.0, 3.0, 4.0] and len(both.q) == 3 and both.events == events
    np.testing.assert_allclose(both.q[2], MIDDLE + 0.4)
    with pytest.raises(RobotError, match=r"ends 0.0001 rad from .*; put a joint move between"):
        by = np.zeros((1, 7))
        by[0, 3] = 1.1e-4
        motion.then(replace(on, q=on.q + by))
    motion.then(replace(on, q=on.q + 0.9e-4))
    assert motion.sampled(2.0).tolist() == [1.0, 1.5, 2.0, 2.5, 3.0]
    assert len(motion.sampled(2.1)) == 6 and len(motion.sampled(0.1)) == 2
    for factor in (0.0, -1.0, np.inf):
        with pytest.raises(RobotError, match="times as long; give a number > 0"):
            motion.stretched(factor)
    motion.write_joints(tmp_path / "joints.csv", opening=(0.01, 0.08))
    read = read_joints(tmp_path / "joints.csv", XARM7)
    assert len(read.time) == 201 and read.opening is not None
    np.testing.assert_allclose(read.q, motion.at(read.time), atol=1e-8)
    closed = (read.time >= 1.5 - 1e-9) & (read.time < 2.5 - 1e-9)
    np.testing.assert_array_equal(read.opening, np.where(closed, 0.01, 0.08))


@pytest.mark.parametrize("seconds", [0.2, 20.0])
def test_timing_is_as_fast_as_limits_allow_and_no_faster_than_asked(seconds):
    """Of one joint from rest to rest: half the way at full acceleration, or at the limit of speed;
    the same way is gone."""
    by = np.zeros(7)
    by[6] = 1.0
    motion = swing(by, seconds, 1.0, events=(GripperEvent(time=1.0 + 0.5 * seconds, closed=True),))
    done = in_time(XARM7, motion)
    a, v = XARM7.max_acceleration[6], XARM7.max_speed[6]
    least = 1.0 / v + v / a if v * v / a < 1.0 else 2.0 * math.sqrt(1.0 / a)
    wanted = max(seconds, least)
    assert done.end - done.start == pytest.approx(wanted, rel=0.03 if seconds < least else 1e-6)
    assert done.start == 1.0 and done.end - done.start >= wanted - 1e-9
    assert done.slowed_by == pytest.approx((done.end - 1.0) / seconds)
    assert done.events[0].time == pytest.approx(1.0 + 0.5 * (done.end - 1.0), rel=0.02)
    done.check_limits(XARM7)
    along = done.at(np.linspace(done.start, done.end, 300)) - MIDDLE
    assert np.abs(along[:, :6]).max() < 1e-12 and (np.diff(along[:, 6]) >= -1e-9).all()
    assert along[-1, 6] == pytest.approx(1.0)
