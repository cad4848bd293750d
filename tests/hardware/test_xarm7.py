"""The xArm 7 through the vendor's SDK, on a loopback box that checks what the real one does.

The machine that runs this may be busy: reports may be older here than `BLIND` says.
"""

import math
import socket
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("xarm", reason="pip install xarm-python-sdk")

from gendom.errors import DeviceError
from gendom.hardware import Robot, find_robot, streamed, streaming, xarm7
from gendom.hardware.streamed import StreamedRobot
from gendom.hardware.streaming import Streamer
from gendom.robot import XARM7, GripperEvent, joint_move
from hardware.xarm_box import AWAY, Box, Driver, cell, ended, patient, there_and


@pytest.fixture
def box():
    with Box() as box:
        yield box


@pytest.fixture
def robot(box):
    robot = StreamedRobot(cell(box.address, tool=0.5, share=1.0), patient)
    robot.connect()
    yield robot
    robot.disconnect()


@pytest.fixture
def streamer(box, monkeypatch):
    monkeypatch.setattr(streaming, "BLIND", (0.15, 0.5))
    monkeypatch.setattr(xarm7, "_QUICK", 0.3)
    here = cell(box.address, tool=0.5, share=1.0)
    driver = Driver(here)
    driver.connect()
    yield Streamer(driver, here)
    driver.disconnect()


# ---- in a process of its own ---------------------------------------------------------------------


def test_a_robot_moves_grips_stops_and_keeps_its_faults(box, robot):
    """One after the other, since each robot is a process of its own."""
    assert isinstance(cast(Any, robot), Robot)
    assert robot.state().q == pytest.approx(XARM7.home, abs=1e-4)
    assert robot.state().opening == pytest.approx(0.084, abs=1e-3)
    motion, ticks = there_and(), []
    robot.play(replace(motion, events=(GripperEvent(time=0.3, closed=True),)), on_tick=ticks.append)
    assert ticks[-1].command == pytest.approx(AWAY, abs=1e-6)
    assert np.diff([t.time for t in ticks]).min() > 0.004  # never a burst
    assert all(np.abs(t.measured - t.command).max() < 0.2 for t in ticks)
    assert robot.state().opening == pytest.approx(0.0, abs=2e-3)
    robot.gripper(0.04)
    assert box.gripper == pytest.approx(850.0 * 0.04 / 0.084, abs=12)
    with pytest.raises(DeviceError, match="approach it first"):
        robot.play(motion)

    def approach(q):
        robot.play(joint_move(XARM7, robot.state().q, q, share=0.4))

    def ends_by(error, match, share=0.4, after=None, on_tick=None):
        """From home, what is called in mid-motion, or a tick, ends it so."""
        approach(XARM7.home)
        if after:
            threading.Timer(0.5, *after).start()
        with pytest.raises(error, match=match):
            robot.play(there_and(share), on_tick=on_tick)

    approach(AWAY - 0.02)
    assert box.true == pytest.approx(AWAY - 0.02, abs=1e-3)
    assert box.orders("mode") == [1, 0, 1, 0]
    ends_by(DeviceError, "stopped", after=[robot.stop])
    assert_braked(box)
    ends_by(ZeroDivisionError, "division", on_tick=lambda tick: tick.time < 0.4 or 1 / 0)
    assert_braked(box)
    assert robot.state().fault is None
    ends_by(DeviceError, "C31: Collision.*clear it in UFACTORY Studio", 0.1, [box.fail, [31]])
    box.code = 0
    for order in (lambda: approach(AWAY), lambda: robot.gripper(0.0)):
        with pytest.raises(DeviceError, match="C31"):
            order()
    assert "C31" in (robot.state().fault or "")
    robot.connect()
    assert robot.state().fault is None
    ends_by(DeviceError, "gone or hangs.*emergency stop", after=[robot._process.kill])
    assert "gone" in (robot.state().fault or "")


def assert_braked(box):
    """The last motion ended before its end, along its path, without a jump."""
    commands = np.array(box.orders("servo"))
    assert np.abs(commands[-1] - AWAY).max() > 0.02
    changes = np.abs(np.diff(commands[-15:], n=2, axis=0)).max() / 0.01**2
    assert changes < 1.1 * XARM7.max_acceleration[0]
    assert np.abs(commands[-1] - commands[-2]).max() < 0.005
    assert box.orders("mode")[-1] == 0


PLAYED = (
    "from hardware.xarm_box import *; "
    "play_aloud(StreamedRobot(cell({!r}, tool=0.5, share=1.0), patient), there_and(0.2), 0.5)"
)


@pytest.mark.parametrize("end", ["SIGKILL", "SIGINT"])
def test_the_arm_brakes_when_its_program_ends(box, tmp_path, end):
    when, child = ended(tmp_path, PLAYED.format(box.address), end)
    state = Path(f"/proc/{child}/stat")
    while state.exists() and state.read_text().split()[2] != "Z":
        assert time.monotonic() < when + 10.0
        time.sleep(0.01)
    assert_braked(box)
    seconds, metres = box.stopping(when)
    assert seconds < 2.0 and metres < 0.3  # 0.2 s where nothing else runs: benchmarks/faults.py


@pytest.mark.parametrize(
    ("name", "module", "extra"), [("xarm7", "xarm.wrapper", "robot"), ("fr3", "franky", "franka")]
)
def test_without_its_sdk_a_robot_says_what_to_install(monkeypatch, name, module, extra):
    robot = find_robot(name)(replace(cell("127.0.0.1"), robot=name, arm=name))
    with pytest.raises(DeviceError, match="not connected"):
        robot.state()
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DeviceError, match=rf"cannot be imported .*\[{extra}\]"):
        robot._driver(robot.cell).connect()


# ---- connecting ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "prepare", "message"),
    [
        ("v1.12.10", Box.die, "it is not there"),
        ("v1.9.200", id, "firmware 1.9.200 .* update"),
        ("v1.12.10", lambda box: box.fail(1), "C1: The Emergency Stop Button"),
        ("v1.12.10", lambda box: setattr(box, "reports", 0), "no reports arrive"),
    ],
)
def test_what_is_said_when_connecting_fails(version, prepare, message):
    before = socket.getdefaulttimeout()
    with Box(version) as box:
        prepare(box)
        with pytest.raises(DeviceError, match=message):
            Driver(cell(box.address)).connect()
    assert socket.getdefaulttimeout() == before


def test_a_silent_box_is_given_up(box, monkeypatch):
    monkeypatch.setattr(streamed, "_CONNECTING", 1.0)
    box.silent = True
    robot = StreamedRobot(cell(box.address), Driver)
    with pytest.raises(DeviceError, match="does not answer; check power"):
        robot.connect()
    with pytest.raises(DeviceError, match="not connected"):
        robot.state()


# ---- faults in mid-motion, with the SDK in this process ------------------------------------------


FAULTS = {
    "silent": (lambda box: setattr(box, "silent", True), "does not answer|ms old"),
    "dies": (Box.die, "does not answer|refuses|ms old"),
    "off": (lambda box: setattr(box, "off", np.full(7, 0.1)), "degrees off its commands"),
    "C31": (lambda box: box.fail(31), "C31: Collision"),
    "other mode": (lambda box: setattr(box, "mode", 2), "something else set mode 2"),
    "paused": (lambda box: setattr(box, "state", 3), "state 3"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_the_box_in_mid_motion(box, streamer, name):
    """The arm stands, and what is said is what to do. True joints show that it does."""
    (inject, message), waiting = FAULTS[name], True
    streamer.start(there_and(0.2))
    while streamer.moving:
        due = time.monotonic() + streamer.driver.period
        if waiting and streamer.elapsed >= 0.3:
            waiting = inject(box)
        streamer.tick()
        time.sleep(max(0.0, due - time.monotonic()))
    with pytest.raises(DeviceError, match=message):
        streamer.start(there_and())
    time.sleep(0.15)
    first = box.true
    time.sleep(0.1)
    assert box.true == pytest.approx(first, abs=1e-4)
    assert np.abs(first - AWAY).max() > 0.05


def test_a_gripper_that_does_not_close(box, streamer):
    box.stuck = True
    with pytest.raises(DeviceError, match="gripper does not move, at 84 mm; check its power"):
        streamer.driver.grip(0.0)
    box.stuck = False
    streamer.driver.grip(0.0)
    assert box.gripper < 12.0
    assert math.isclose(streamer.driver.report().opening, 0.0, abs_tol=2e-3)
