"""The Franka driver on franky-sim, which speaks libfranka's protocol.

The simulation's clock is the test's, since it may be slower than the real one.
"""

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from gendom.hardware.franky import FrankaDriver
from gendom.hardware.streaming import Streamer
from gendom.robot import FR3, tcp_pose
from gendom.tasks import RopeReaching
from hardware import xarm_box

pytest.importorskip("franky", reason="pip install franky-control")
pytest.importorskip("franky_sim", reason="pip install franky-sim")
ADDRESS = "127.0.78.1"


class Driver(FrankaDriver):
    realtime = "Ignore"

    def __init__(self, cell):
        super().__init__(cell, clock=self.simulated)

    def simulated(self):
        return self._robot.state.time.to_sec()


def cell(address):
    """Without a table, which franky-sim has not."""
    usual, space = xarm_box.cell(address), np.outer([-1.5, 1.5], np.ones(3))
    tool = replace(usual.tool, max_opening=0.08, latency=0.05)
    return replace(usual, robot="fr3", arm="fr3", tool=tool, workspace=space)


@pytest.fixture(scope="module")
def address():
    order = [sys.executable, "-m", "franky_sim.run_server", "-s", "mujoco", "--hostname", ADDRESS]
    server = subprocess.Popen(order, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    for line in server.stdout:
        if "Connect to" in line:
            break
    yield ADDRESS
    server.kill()
    server.wait()


@pytest.fixture
def streamer(address):
    driver = Driver(cell(address))
    driver.connect()
    yield Streamer(driver, driver.cell, clock=driver.simulated)
    driver.disconnect()


def play(streamer, motion, also=lambda: None):
    streamer.start(motion)
    end = time.monotonic() + 60.0
    while streamer.moving and time.monotonic() < end:
        due = streamer.clock() + streamer.driver.period
        while streamer.clock() < due:
            time.sleep(0.0005)
        streamer.tick()
        also()


def test_an_action_on_the_second_arm(streamer):
    """Rope reaching by Franka's own library: the tool keeps to the task's path."""
    task = RopeReaching()
    action = task.sample_actions(task.item, np.random.default_rng(3), 1)[0]
    path = task.tool_path(task.item, action).moved(task.T_world_task(task.item))
    over_table = replace(streamer.cell, table_height=0.0)
    motion, seen = over_table.plan(path, opening=0.016).motion, []
    play(streamer, over_table.approach(streamer.driver.report().q, motion.q[0]))
    play(streamer, motion.shifted(-motion.start), lambda: seen.append(streamer.report.q))
    assert streamer.fault is None
    line = motion.tcp_at(FR3, motion.sampled(500.0))[:, :3, 3]
    assert KDTree(line).query(tcp_pose(FR3, np.array(seen))[:, :3, 3])[0].max() < 5e-3
    for opening in (0.05, 0.02):
        streamer.driver.grip(opening)
        assert streamer.driver.report().opening == pytest.approx(opening, abs=5e-3)
