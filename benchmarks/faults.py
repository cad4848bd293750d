"""How long an arm moves on after a fault, and how far its tool goes.

    PYTHONPATH=tests:. python benchmarks/faults.py [--repeats 3]    # in the repository's root

The xArm's driver and SDK stream at full speed (the tool at 0.8 m/s) to the tests' loopback box,
whose arm follows its commands with a lag of 15 ms. Time and travel are the arm's own, from the
fault to where it stands, at worst over the repeats. Run it where nothing else does: the box is
a program, too.
"""

import argparse
import os
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gendom.errors import DeviceError
from gendom.hardware.contracts import Tick
from gendom.hardware.streamed import StreamedRobot
from gendom.robot import XARM7, JointMotion, joint_move, tcp_pose
from hardware.xarm_box import Box, Driver, cell, ended, play_aloud

AWAY = XARM7.home + np.array([1.6, 0.1, 0.0, 0.2, 0.0, -0.2, 1.2])

FAULTS = {
    "stop() is called": None,
    "Ctrl-C, at the program and its child": "SIGINT",
    "kill -9 of the program": "SIGKILL",
    "reports end": lambda box: setattr(box, "reports", 0),
    "reports repeat themselves": lambda box: setattr(box, "frozen", True),
    "measured joints off by 6 degrees": lambda box: setattr(box, "off", np.full(7, 0.1)),
    "the arm no longer moves": lambda box: setattr(box, "unmoved", True),
    "the box is silent": lambda box: setattr(box, "silent", True),
    "the box dies": lambda box: box.die(),
    "its answers take 190 ms": lambda box: setattr(box, "delay", 0.19),
    "C31, collision": lambda box: box.fail(31),
    "another program sets mode 0": lambda box: setattr(box, "mode", 0),
    "the gripper does not close": lambda box: setattr(box, "stuck", True),
}


def motion() -> JointMotion:
    """A sweep at the limits."""
    return joint_move(replace(XARM7, max_tcp_speed=0.8), XARM7.home, AWAY)


def play(address: str) -> None:
    """What a program does that is ended."""
    robot = StreamedRobot(cell(address, tool=0.8, share=1.0), Driver)
    play_aloud(robot, motion(), 0.5 * motion().end)


def one(fault: object) -> tuple[float, float, float, str]:
    """Seconds, metres and metres a second of the tool at first, and what was said."""
    with Box() as box:
        if isinstance(fault, str):
            with TemporaryDirectory() as folder:
                call = f"from benchmarks.faults import play; play({box.address!r})"
                at, said = 0.0, "the arm braked"
                with suppress(StopIteration):  # it ended before it moved
                    at = ended(Path(folder), call, fault)[0]
            time.sleep(1.0)
        else:
            robot = StreamedRobot(cell(box.address, tool=0.8, share=1.0), Driver)
            robot.connect()
            at, said, half = 0.0, "nothing", 0.5 * motion().end

            def tick(tick: Tick) -> None:
                nonlocal at
                if tick.time >= half and not at:
                    at = time.monotonic()
                    if fault is None:
                        threading.Thread(target=robot.stop).start()
                    else:
                        fault(box)  # type: ignore[operator]
                        if box.stuck:
                            robot._send("grip", 0.0)

            try:
                robot.play(motion(), on_tick=tick)
            except DeviceError as error:
                said = str(error).removeprefix(f"{box.address}: ")
            time.sleep(0.3)
            with suppress(DeviceError):
                robot.disconnect()
        if not at:
            return one(fault)  # another fault came first: this computer was busy
        before = [(t, q) for t, q in box.path if at - 0.05 <= t <= at]
        ends = tcp_pose(XARM7, np.array([before[0][1], before[-1][1]]))[:, :3, 3]
        speed = float(np.linalg.norm(ends[1] - ends[0])) / (before[-1][0] - before[0][0])
        return *box.stopping(at), speed, said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=list(FAULTS))
    arguments = parser.parse_args()
    with suppress(AttributeError, OSError):  # the box is a device of its own
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    print("| fault | stands after [ms] | tool's travel [mm] | tool's speed [m/s] | said |")
    print("|---|---|---|---|---|", flush=True)
    for name in arguments.only:
        runs = [one(FAULTS[name]) for _ in range(arguments.repeats)]
        seconds, metres, speed = np.max([run[:3] for run in runs], axis=0)
        said = runs[0][3]
        print(
            f"| {name} | {1e3 * seconds:.0f} | {1e3 * metres:.0f} | {speed:.2f} | {said} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
