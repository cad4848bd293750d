"""What is checked in a tick, on a clock and a controller of the test's own."""

import math
import re
from concurrent.futures import wait
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from gendom.errors import DeviceError, GendomError
from gendom.hardware.cell import SpeedLimits
from gendom.hardware.contracts import RobotState
from gendom.hardware.streaming import BLIND, LAG, Driver, Streamer
from gendom.robot import XARM7, GripperEvent, JointMotion, joint_move, tcp_pose
from hardware.xarm_box import cell

T = 0.01
BETWEEN_KNOTS = np.array([-1.19, -0.21, -0.86, -0.78, 0.71, 0.69, 0.56])
"""A way whose tool is quicker a quarter from its ends than in the middle [rad]."""
AWAY = XARM7.home + np.array([0.8, 0.2, -0.3, 0.3, 0.2, -0.3, 0.5])


class Controller(Driver):
    """A controller whose arm is where it was sent `lag` seconds ago."""

    period = T
    code = grips = broken = frozen = None

    def __init__(self):
        self.now, self.lag, self.age = 100.0, 0.02, 0.005
        self.sent = [(self.now - 10.0, XARM7.home)]
        self.calls, self.gripped = [], []
        self.begin, self.end, self.halt = (
            partial(self.calls.append, name) for name in ("begin", "end", "halt")
        )

    def report(self):
        seen = self.now - self.age
        q = [q for t, q in self.sent if t <= seen - self.lag][-1]
        return RobotState(time=seen, q=q if self.frozen is None else self.frozen, fault=self.code)

    def connect(self):
        pass

    begin = end = halt = disconnect = connect

    def servo(self, q):
        if self.broken:
            raise DeviceError(self.broken)
        self.sent.append((self.now, q))

    def grip(self, opening):
        self.gripped.append(opening)
        if self.grips:
            raise DeviceError(self.grips)

    def commands(self):
        return np.array([q for _, q in self.sent])


@pytest.fixture
def streamer():
    controller = Controller()
    return Streamer(controller, cell("nowhere", tool=0.8, share=1.0), clock=lambda: controller.now)


def run(streamer, motion=None, *, at=math.inf, then=lambda: None, late=()):
    """Play a motion, or go on; `then` is called once its clock has reached `at`, and `late` are
    ticks' numbers with their lateness. Gives the time since `then` in which the arm was sent on."""
    controller, since, k = streamer.driver, None, 0
    if motion is not None:
        streamer.start(motion)
    while streamer.moving:
        controller.now += T + dict(late).get(k, 0.0)
        if since is None and not streamer._next and streamer.s >= at:
            then()
            since = controller.now
        streamer.tick()
        k += 1
        assert k < 2000
    changed = np.abs(np.diff(controller.commands(), axis=0)).max(axis=1) > 0.0
    last = controller.sent[1 + int(np.nonzero(changed)[0][-1])][0] if changed.any() else 0.0
    wait(streamer.grips)
    streamer.tick()
    return last - since if since else math.nan


def motion_to(share=1.0, **changes):
    limits = replace(XARM7, max_tcp_speed=0.8)
    return replace(joint_move(limits, XARM7.home, AWAY, share=share), **changes)


def on_path(streamer, motion):
    """How far the commands are from the path, in the space of joints [rad]."""
    path = KDTree(motion.at(np.linspace(motion.start, motion.end, 20001)))
    return path.query(streamer.driver.commands(), p=math.inf)[0].max()


def test_a_motion_is_followed_and_the_gripper_is_told_its_latency_earlier(streamer):
    events = (GripperEvent(time=0.3, closed=True), GripperEvent(time=0.6, closed=False))
    motion, controller, told = motion_to(events=events), streamer.driver, []
    streamer.grip = lambda opening: told.append((controller.now, opening))
    run(streamer, motion)
    assert (streamer.fault, streamer.ended, controller.calls) == (None, None, ["begin", "end"])
    assert controller.commands()[-1] == pytest.approx(AWAY)
    begun = controller.sent[-1][0] - math.ceil(motion.end / T) * T
    assert told == [
        (pytest.approx(begun + e.time - 0.1, abs=1.5 * T), 0.0 if e.closed else 0.084)
        for e in events
    ]


def knots(way, seconds, number=9):
    time = np.linspace(0.0, seconds, number)
    return JointMotion(time=time, q=XARM7.home + np.outer(time / seconds, way))


ONE = np.eye(7)


@pytest.mark.parametrize(
    ("state", "changes", "motion", "message"),
    [
        ({"sent": [(0.0, XARM7.home + math.radians(1.5) * ONE[6])]}, {}, None, "1.5 degrees"),
        ({"sent": [(0.0, XARM7.home + 0.013 * ONE[0])]}, {}, None, "5 mm off"),
        ({"code": "the user stop is pressed"}, {}, None, "user stop"),
        ({"age": 0.15}, {}, None, "150 ms old"),
        ({}, {"speed": SpeedLimits(tool=0.8, share=0.3)}, None, "take .* times as long"),
        ({}, {"workspace": np.array([[-1, -1, 0.5], [1, 1, 1.2]])}, None, "leaves the workspace"),
        ({}, {}, knots(2.1 * ONE[5], 2.0), "limit 3.14"),
        ({}, {}, knots(BETWEEN_KNOTS, 0.84, 2), "moves at 0.89.*limit 0.8"),
    ],
)
def test_what_is_refused_before_the_arm_moves(streamer, state, changes, motion, message):
    controller = streamer.driver
    vars(controller).update(state)
    streamer = Streamer(controller, replace(streamer.cell, **changes), clock=streamer.clock)
    with pytest.raises(GendomError, match=message):
        streamer.start(motion or motion_to())
    assert not streamer.moving and controller.calls == []


def shown(**state):
    return lambda streamer: vars(streamer.driver).update(state)


def bad_grip(streamer):
    streamer.driver.grips = "it does not move"
    streamer.grip(0.0)
    wait(streamer.grips)


FAULTS = {
    "stopped": (lambda s: s.brake("stopped"), "stopped", "path"),
    "reports late": (shown(age=BLIND[0] + 0.005), "ms old", "path"),
    "frozen": (lambda s: shown(frozen=s.report.q)(s), "repeats itself", "path"),
    "gripper": (bad_grip, "does not move", "path"),
    "error": (shown(code="C31: collision"), "C31", "halt"),
    "dead": (shown(broken="no answer"), "no answer", "halt"),
    "tracking": (shown(lag=LAG + 0.06), "off its commands", "halt"),
    "late tick": (lambda s: shown(now=s.driver.now + 0.05)(s), "50 ms late", "halt"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_in_mid_motion_stop_the_arm(streamer, name):
    """At full speed: along the path within 0.16 s, or at once by the controller's own stop."""
    inject, message, way = FAULTS[name]
    motion, controller = motion_to(), streamer.driver
    soon = 0.5 * motion.end + streamer.cell.tool.latency + 0.03
    motion = replace(motion, events=(GripperEvent(time=soon, closed=False),))
    seconds = run(streamer, motion, at=0.5 * motion.end, then=lambda: inject(streamer))
    assert re.search(message, said := str(streamer.fault or streamer.ended)), said
    assert controller.calls == ["begin", "end" if way == "path" else "halt"]
    assert on_path(streamer, motion) < 1e-3
    assert seconds <= {"frozen": 0.19, "tracking": LAG + 0.03}.get(name, 0.16)
    if name == "stopped":
        assert (streamer.fault, controller.gripped) == (None, [])  # not while it brakes
    else:
        with pytest.raises(DeviceError, match=message):  # until it is connected again
            streamer.start(motion)


class Damaged:
    """A motion that gives a bad command once, whatever it was checked for."""

    def __init__(self, motion, add):
        self.motion, self.add = motion, add
        self.time = motion.time

    def __getattr__(self, name):
        return getattr(self.motion, name)

    def at(self, time):
        return self.motion.at(time) + (self.add if time > 0.5 * self.motion.end else 0.0)


@pytest.mark.parametrize(
    ("add", "limit"),
    [
        (math.nan, None),
        (math.inf, None),
        (3.0 * ONE[3], "angle"),
        (0.03 * ONE[6], "speed"),
        (0.004 * ONE[6], "acceleration"),
        (0.008 * ONE[0], "tool speed"),
        (None, "workspace"),
    ],
    ids=["nan", "inf", "angle", "speed", "acceleration", "tool speed", "workspace"],
)
def test_bad_commands_are_not_sent(streamer, add, limit):
    motion, controller = motion_to(), streamer.driver
    # Limits of acceleration are far above what the tool may do: those not asked about are lifted.
    lifted = {} if limit == "acceleration" else {"max_acceleration": np.full(7, 1e3)}
    streamer.limits = replace(streamer.limits, **lifted)
    streamer.start(motion)
    if add is None:
        edge = tcp_pose(XARM7, motion.at(0.5 * motion.end))[1, 3]
        low, high = streamer.cell.workspace
        streamer.cell = replace(streamer.cell, workspace=(low, np.array([high[0], edge, high[2]])))
    else:
        streamer._next[-1] = Damaged(motion, add)
    run(streamer)
    message = f"limit of {limit}" if limit else "not finite"
    assert message in streamer.fault and on_path(streamer, motion) < 1e-4
    assert controller.calls == ["begin", "halt"]
    if limit is None:  # nor while the arm brakes
        controller.sent = controller.sent[:1]
        again: Any = Streamer(controller, streamer.cell, clock=streamer.clock)
        again.start(motion)
        again._next[-1] = Damaged(motion, add)
        run(again, at=0.49 * motion.end, then=lambda: again.brake("stopped"))
        assert message in again.fault and np.isfinite(controller.commands()).all()


def test_a_slow_motion_s_reports_may_be_older(streamer):
    motion = motion_to(0.3)
    run(streamer, motion, at=0.5 * motion.end, then=lambda: setattr(streamer.driver, "age", 0.06))
    assert streamer.fault is None


def test_a_late_tick_moves_the_clock_and_never_bursts(streamer):
    motion = motion_to()
    run(streamer, motion, late={20: 0.025, 21: 0.01, 40: 0.028}.items())
    assert streamer.fault is None
    steps = np.abs(np.diff(streamer.driver.commands(), axis=0)).max()
    smooth = np.abs(motion.speed_at(motion.sampled(1000.0))).max() * T
    assert steps <= smooth * (1.0 + 1e-6)
    times = np.array([t for t, _ in streamer.driver.sent])
    assert times[-1] - times[1] == pytest.approx(motion.end + 0.063, abs=2.1 * T)


def test_braking_keeps_to_the_path_and_to_the_accelerations(streamer):
    """Random motions at the arm's limits, braked at random times."""
    rng, longest = np.random.default_rng(0), 0.0
    for _ in range(8):
        time = np.linspace(0.0, 2.0, 9)
        steps = rng.normal(size=(8, 7)) * [0.3, 0.2, 0.3, 0.2, 0.4, 0.2, 0.5]
        q = XARM7.home + np.concatenate([np.zeros((1, 7)), np.cumsum(steps, axis=0)])
        motion = JointMotion(time=time, q=np.clip(q, XARM7.q_min + 0.2, XARM7.q_max - 0.2))
        motion = motion.stretched(motion.slowdown(replace(XARM7, max_tcp_speed=0.68)))
        here = replace(streamer.cell, workspace=(np.full(3, -2.0), np.full(3, 2.0)))
        one = Streamer(controller := Controller(), here, clock=lambda c=controller: c.now)
        at = rng.uniform(0.2, 0.8) * motion.end
        seconds = run(one, motion, at=at, then=lambda one=one: one.brake("stopped"))
        assert (one.fault, one.ended) == (None, "stopped")
        longest = max(longest, seconds)
        assert on_path(one, motion) < 2e-3
        changes = np.abs(np.diff(controller.commands()[1:], n=2, axis=0)) / T**2
        assert np.all(changes <= 1.1 * XARM7.max_acceleration)
    assert longest < 0.2
