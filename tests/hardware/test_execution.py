"""Planned actions as files, their execution, and what is left of it when something goes wrong."""

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.errors import DeviceError, RobotError
from gendom.files import write_json
from gendom.hardware.cell import Cell
from gendom.hardware.contracts import RobotState, Tick
from gendom.hardware.execution import (
    ACTION_FORMAT,
    ExecutionLog,
    execute,
    last_time,
    preview,
    read_action,
    read_log,
    write_trajectory,
)
from gendom.reading import read_json
from gendom.robot import DOWN, XARM7, Box, GripperEvent, TcpPath, lift, tcp_pose
from robot.test_arms import written
from simulated_cell import write_cell


class FakeRobot:
    """A robot that is where it is told to be, a tick every 10 ms of real time; it can fail."""

    arm = XARM7

    def __init__(self, fails=print, pace=0.0):
        self.q, self.calls, self.fails, self.pace = XARM7.home, [], fails, pace

    def state(self):
        return RobotState(time=time.monotonic(), q=self.q)

    def play(self, motion, *, on_tick=None):
        self.calls.append("play")
        for k, t in enumerate(np.arange(0.0, motion.end, 0.01)):
            self.q = motion.at(t)
            if k == 20 and self.calls.count("play") == 3:
                self.fails()
            (on_tick or print)(Tick(time=t, command=self.q, measured=self.q, age=0.001, stamp=t))
            time.sleep(self.pace)

    def __getattr__(self, name):
        return lambda *given: self.calls.append(name)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A cell, and an action that was planned in it: 0.1 m sideways, as a file."""
    folder = tmp_path_factory.mktemp("made")
    cell = Cell.read(write_cell(folder, cameras=False))
    path = TcpPath(
        time=np.array([0.0, 0.4]),
        position=np.array([[0.45, 0.0, 0.3], [0.45, 0.1, 0.3]]),
        quat_xyzw=np.array(DOWN),
        events=(GripperEvent(time=0.0, closed=True), GripperEvent(time=0.35, closed=False)),
    )
    said = {
        "format": ACTION_FORMAT,
        "task": "rope-reaching",
        "goal": {"x": 0.45},
        "action": {"release_x": 0.15, "release_z": 0.1},
        "object": {"kind": "rope", "length": 0.3},
        "trajectory": {"T_base_task": np.eye(4).tolist()},
        "plan": cell.plan(path, opening=0.016),
    }
    write_json(folder / "action.json", said)
    return cell, folder / "action.json", read_action(folder / "action.json").plan


def logged(made, folder, robot, said=None):
    """The log of the action, carried out by a robot."""
    cell, path, plan = made
    log = ExecutionLog(folder / "a.jsonl", said or read_json(path))
    execute(plan, cell, robot, log)
    return read_log(log.path)


def test_an_action_is_read_as_it_was_planned(made, tmp_path):
    cell, path, plan = made
    read, said = read_action(path), read_json(path)
    assert (read.task, read.goal, read.action) == (said["task"], said["goal"], said["action"])
    write_json(tmp_path / "again.json", {"plan": plan})
    assert read_json(tmp_path / "again.json")["plan"] == said["plan"]
    assert said["plan"]["surroundings"]["table_height"] == 0.0
    assert "approach" in " ".join(preview(plan, cell))
    # a ros trajectory's speeds are its positions differences
    write_trajectory(tmp_path / "t.json", plan.motion)
    said = read_json(tmp_path / "t.json")
    assert said["joint_names"] == [f"joint{j}" for j in range(1, 8)]
    q, v = (np.array([p[name] for p in said["points"]]) for name in ("positions", "velocities"))
    stamps = [p["time_from_start"] for p in said["points"]]
    t = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    assert t[0] == 0.0 and t[-1] == pytest.approx(plan.motion.end - plan.motion.start, abs=1e-8)
    assert np.abs(np.gradient(q, t, axis=0) - v).max() < 0.05 * np.abs(v).max()


def test_an_action_of_an_arm_from_a_file_is_read_back_with_its_cell(made, tmp_path):
    """The arm's file lies beside the cell's; actions name arms, and no files."""
    pytest.importorskip("mujoco", reason="needs the extra reality")
    written(tmp_path, XARM7)
    (tmp_path / "made.toml").write_text(f"home = {XARM7.home.tolist()}\ntool = 0.17\n")
    text = write_cell(tmp_path, cameras=False, max_opening="0.08").read_text()
    (tmp_path / "cell.toml").write_text('arm = "made.urdf"\nself_clearance = 0.0\n' + text)
    cell, action = Cell.read(tmp_path / "cell.toml"), tmp_path / "action.json"
    T = tcp_pose(cell.model, cell.model.home)
    turned = Rotation.from_matrix(T[:3, :3]).as_quat()
    path = lift(T[:3, 3], height=0.05, speed=0.1, quat_xyzw=turned)
    write_json(action, {**read_json(made[1]), "plan": cell.plan(path, opening=0.016)})
    assert read_action(action, cell.model).plan.arm == "made"
    with pytest.raises(RobotError, match="there is no robot 'made'"):
        read_action(action)
    assert cli.main(["execute", str(action), "--cell", str(cell.path)]) == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.update(format="gendom-action/4"), "not 'gendom-action/5'; make it again"),
        (lambda s: s.pop("plan"), "holds no plan"),
        (lambda s: s["plan"].pop("approach"), "plan: object missing required field approach"),
        (lambda s: s["plan"].update(arm="ur5"), "there is no robot 'ur5'"),
        (lambda s: s["plan"]["first"].__setitem__(0, 0.5), "approach does not end where it starts"),
        (lambda s: s["plan"]["motion"]["q"][7].__setitem__(1, 3.0), "joint 2"),
        (lambda s: s["plan"]["motion"]["q"][7].__setitem__(1, "a"), "plan.motion.q"),
        (lambda s: s["plan"]["motion"]["q"].pop(), "needs time"),
    ],
)
def test_a_damaged_action_is_refused_in_one_line(made, tmp_path, refused, change, words):
    said = read_json(made[1])
    change(said)
    write_json(tmp_path / "bad.json", said)
    err = refused("execute", tmp_path / "bad.json", "--cell", made[0].path)
    assert words in err and "bad.json" in err


def test_a_real_arm_wants_a_plan_of_its_cell_and_the_cell_is_checked_again(made):
    """A shelf that was put up after planning; an action that was planned for no cell at all."""
    plan, real = made[2], replace(made[0], robot="xarm7")
    assert preview(plan, real)
    with pytest.raises(RobotError, match="was planned without a cell; make it again"):
        preview(replace(plan, cell=None), real)
    shelf = Box(name="shelf", position=np.array([0.45, 0.1, 0.2]), size=np.full(3, 0.1))
    with pytest.raises(RobotError, match="shelf"):
        preview(plan, replace(real, box=(shelf,)))


# ---- execution -----------------------------------------------------------------------------------


def test_all_is_logged_in_order(made, tmp_path):
    robot, motion = FakeRobot(), made[2].motion
    seen = logged(made, tmp_path, robot)
    assert robot.calls == ["connect", "gripper", "play", "play", "gripper", "play", "disconnect"]
    assert [e["call"] for e in seen.events if "state" not in e and "call" in e] == robot.calls
    assert np.abs(seen.command - motion.at(seen.time + motion.start)).max() < 1e-12
    ticks = 100 * (motion.end - motion.start)
    assert seen.end == "done" and len(seen.time) == pytest.approx(ticks, abs=1)
    assert read_action(tmp_path / "a.jsonl").plan.motion.q.tolist() == motion.q.tolist()
    assert last_time(tmp_path) is None


@pytest.mark.parametrize(
    ("fault", "end"),
    [
        (KeyboardInterrupt(), "stopped by Ctrl-C"),
        (DeviceError("C31, collision", fix="look"), "stopped by DeviceError: C31, collision; look"),
    ],
)
def test_whatever_ends_it_the_arm_brakes_and_the_log_says_why(made, tmp_path, fault, end):
    robot = FakeRobot(Mock(side_effect=fault))
    with pytest.raises(type(fault)):
        logged(made, tmp_path, robot)
    assert robot.calls[-3:] == ["play", "stop", "disconnect"]
    seen = read_log(tmp_path / "a.jsonl")
    assert seen.end == end and len(seen.time) == 20
    assert [e["call"] for e in seen.events if "fault" in e] == ["play"]


def test_a_disk_that_fills_stops_the_arm_and_is_told(made, tmp_path):
    log = ExecutionLog(tmp_path / "a.jsonl", read_json(made[1]))
    with open("/dev/full", "w", buffering=1) as full:
        robot: Any = FakeRobot(lambda: setattr(log, "_file", full))
        said = r"a\.jsonl: cannot be written \(No space .* make room"
        with pytest.raises(DeviceError, match=said):
            execute(made[2], made[0], robot, log)
    assert robot.calls[-3:] == ["play", "stop", "disconnect"]
    assert "was killed" in (last_time(tmp_path) or "") and len(read_log(log.path).time) == 20


KILLED = """
from pathlib import Path
from hardware.test_execution import *
path = Path({action!r})
made = Cell.read({cell!r}), path, read_action(path).plan
logged(made, Path({folder!r}), FakeRobot(pace=0.01))
"""


def test_after_kill_9_the_log_is_whole_and_the_next_start_says_so(made, tmp_path):
    log, cell, action = tmp_path / "a.jsonl", str(made[0].path), str(made[1])
    code = KILLED.format(action=action, cell=cell, folder=str(tmp_path))
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    child, end = subprocess.Popen([sys.executable, "-c", code], env=env), time.monotonic() + 60.0
    while not (log.exists() and b'"t":0.3,' in log.read_bytes()) and time.monotonic() < end:
        time.sleep(0.01)
    with pytest.raises(DeviceError, match="another execution runs"):
        last_time(tmp_path)
    child.kill()
    child.wait()
    with open(log, "ab") as file:
        file.write(b'{"t":9.0,"comm')
    seen, said = read_log(log), last_time(tmp_path) or ""
    assert seen.end is None and seen.time[-1] >= 0.3 and len(seen.time) >= 31
    assert "the last execution was killed" in said and "(last call: play)" in said
    assert f"{seen.time[-1]:.2f} s into the motion" in said
    assert last_time(tmp_path) is None
    assert "told at the next start" in (read_log(log).end or "")


def test_nothing_moves_without_move_and_a_typed_word(made, monkeypatch, capsys):
    robots = Mock(side_effect=AssertionError("a robot was made"))
    monkeypatch.setattr(Cell, "devices", robots)
    words = ["execute", str(made[1]), "--cell", str(made[0].path)]
    assert cli.main(words) == 0 and "nothing moved: this was a dry run" in capsys.readouterr().out
    assert cli.main([*words, "--yes"]) == 2
    monkeypatch.setattr("builtins.input", lambda _: "yes")
    assert cli.main([*words, "--move"]) == 2
    assert "was not confirmed; nothing moved" in capsys.readouterr().err


def test_yes_moves_slowly_and_logs_can_be_looked_at(made, monkeypatch, capsys, tmp_path, refused):
    cell, path, plan = made
    monkeypatch.setattr(Cell, "devices", lambda self: (FakeRobot(), []))
    monkeypatch.setattr("gendom.cli.execute.bring", lambda *given, **others: None)
    assert cli.main(["execute", str(path), "--cell", str(cell.path), "--move", "--yes"]) == 0
    log = max((cell.path.parent / "executions").glob("*.jsonl"))
    slow, usual = read_log(log), plan.motion
    assert slow.time[-1] > 1.5 * (usual.end - usual.start)
    played = read_action(log).plan.motion  # what is observed is compared with it
    assert played.end - played.start == pytest.approx(slow.time[-1], abs=0.02)
    speed = np.abs(np.diff(slow.measured, axis=0)).max(axis=0) / 0.01
    assert np.all(speed <= 0.1001 * XARM7.max_speed)
    of_lift = logged(made, tmp_path, FakeRobot(), {"plan": read_json(path)["plan"]})
    capsys.readouterr()
    for seen, file in ((slow, log), (of_lift, tmp_path / "a.jsonl")):
        picture = tmp_path / f"{len(seen.time)}.png"
        words = ["execute", str(file), "--cell", str(cell.path), "--picture", str(picture)]
        assert cli.main(words) == 0 and picture.exists()
        assert f"{len(seen.time)} ticks; end: done" in capsys.readouterr().out
    assert "is the log of a lift; lift again" in refused(*words, "--move")


def test_two_threads_write_whole_lines(tmp_path):
    """A watch's stop is logged beside the ticks of a motion."""
    log, q = ExecutionLog(tmp_path / "a.jsonl", {}), np.zeros(7)
    tick = Tick(time=0.0, command=q, measured=q, age=0.0, stamp=0.0)
    thread = threading.Thread(target=lambda: [log.tick(tick) for _ in range(300)])
    thread.start()
    for _ in range(300):
        log.write(call="stop")
    thread.join()
    log.end("done")
    seen = read_log(log.path)
    assert len(seen.time) == 300 and sum("call" in e for e in seen.events) == 300
