"""A loopback control box of an xArm 7, as xarm-python-sdk 1.18 talks to it.

Frames: >H transaction, >H protocol, >H length, B function, parameters; answers repeat the head and
add a byte of state. Floats are little endian, other numbers big endian. What is checked as the box
does: servo commands only in mode 1 and after state 0, speed of joints (C24) and of the tool (C60),
errors stop the arm until they are cleared. Reports say where the arm was sent; where it is, which
lags by `LAG` and is `off`, is asked for by function 42 with a parameter.
"""

import itertools
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import numpy as np

from gendom.hardware import cell as cells
from gendom.hardware import streaming, xarm7
from gendom.hardware.streamed import StreamedRobot as StreamedRobot
from gendom.hardware.xarm7 import XArmDriver
from gendom.robot import XARM7, joint_move, tcp_pose

PORT = 15020
"""Of commands: the box's own, 502, asks for rights."""
LAG, MOST_SPEED, MOST_TOOL_SPEED = 0.015, math.pi, 1.0
BRAKED = 20.0
"""How fast the box itself stops joints [rad/s^2]."""
_hosts = itertools.count(1)


class Driver(XArmDriver):
    """The driver, at the port of these boxes."""

    def connect(self):
        from xarm.core.config.x_config import XCONF

        setattr(XCONF.SocketConf, "TCP_CONTROL_PORT", PORT)  # noqa: B010
        super().connect()


AWAY = XARM7.home + np.array([0.6, 0.1, 0.0, 0.2, 0.0, 0.1, 0.3])


def there_and(share=0.4, **changes):
    return replace(joint_move(XARM7, XARM7.home, AWAY, share=share), **changes)


def patient(here):
    """The driver, for a computer that has other work to do."""
    streaming.BLIND, xarm7._QUICK = (0.3, 1.0), 1.0
    return Driver(here)


def play_aloud(robot, motion, at):
    """Play a motion; when so many seconds of it are over, print the process that streams it."""
    robot.connect()
    told = iter([robot._process.pid])

    def tick(tick):
        for process in told if tick.time > at else ():
            print("moving", process, flush=True)

    robot.play(motion, on_tick=tick)


def ended(folder, call, how):
    """When a program of imports and one call, which plays a motion aloud, was ended in that by a
    signal; and the process that streamed it."""
    program = folder / "program.py"  # spawned children import it
    imports, _, call = call.rpartition("; ")
    program.write_text(f"{imports}\nif __name__ == '__main__':\n    {call}\n")
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    order, none = [sys.executable, str(program)], subprocess.DEVNULL
    with subprocess.Popen(order, stdout=-1, stderr=none, text=True, env=env) as parent:
        told = cast(Any, parent.stdout)
        child = next(int(line.split()[1]) for line in told if line.startswith("moving"))
        at = time.monotonic()
        parent.send_signal(getattr(signal, how))
        parent.wait(20)
    return at, child


def cell(address, **speed):
    """A cell with the given address and speed limits."""
    return cells.Cell(
        robot="xarm7",
        address=address,
        arm="xarm7",
        tool=cells.Tool(max_opening=0.084, latency=0.1),
        workspace=np.array([[-0.8, -0.8, 0.0], [0.8, 0.8, 1.2]]),
        speed=cells.SpeedLimits(**speed),
    )


class Box:
    """A box at an address of its own. Faults are injected by setting attributes."""

    off = np.zeros(7)  # of what is measured, from where the arm is
    silent = frozen = stuck = unmoved = False
    delay = 0.0  # of answers [s]
    reports = 100.0  # a second
    gripper = pulses = 850.0
    mode, state, code, alive = 0, 4, 0, True

    def __init__(self, version="v1.12.10"):
        pid = os.getpid()
        self.address = f"127.{pid >> 8 & 127}.{pid & 255}.{next(_hosts)}"
        self.version = version
        self.commanded = self.true = self.frozen_q = XARM7.home.copy()
        self.speed = np.zeros(7)
        self.log, self.path = [], []  # (time, what, value); (time, true joints)
        self.sockets, self.lock = [], threading.RLock()
        for port, talk in ((PORT, self._answer), (30003, self._report)):
            self.sockets.append(socket.create_server((self.address, port)))
            _thread(self._accept, self.sockets[-1], talk)
        _thread(self._move)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.die()

    def die(self):
        """Close everything, in the middle of whatever it is."""
        self.alive = False
        for s in self.sockets:
            with suppress(OSError):
                s.shutdown(socket.SHUT_RDWR)
            s.close()

    def fail(self, code):
        """An error: the arm stops."""
        with self.lock:
            self.code, self.state = code, 4

    def orders(self, name):
        """Values of the log's entries of one name."""
        return [value for _, what, value in self.log if what == name]

    def stopping(self, since):
        """Seconds and metres of the tool from a time until the arm stands."""
        rows = [(t, q) for t, q in self.path if t >= since]
        points = tcp_pose(XARM7, np.array([q for _, q in rows]))[:, :3, 3]
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        ends = np.nonzero(np.linalg.norm(points - points[-1], axis=1) > 5e-4)[0]
        return (rows[ends[-1]][0] - since if len(ends) else 0.0), float(steps.sum())

    # ---- threads -----------------------------------------------------------------------------

    def _accept(self, server, talk):
        while self.alive:
            link, _ = server.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.sockets.append(link)
            _thread(talk, link)

    def _report(self, link):
        due = time.monotonic()
        while self.alive:
            if not self.silent and self.reports:
                head = bytes([self.mode << 4 | self.state, 0, 0])
                body = head + struct.pack("<7f", *self.commanded) + bytes(24 + 28)
                link.sendall(struct.pack(">I", len(body) + 4) + body)
            due = max(due + 1.0 / (self.reports or 100.0), time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))

    def _move(self):
        last = time.monotonic()
        while self.alive:
            time.sleep(0.002)
            with self.lock:
                now, before = time.monotonic(), self.true
                dt, last = now - last, now
                if self.unmoved:
                    self.speed = np.zeros(7)
                elif self.state in (0, 1, 2):
                    self.true = before + (1.0 - math.exp(-dt / LAG)) * (self.commanded - before)
                    self.speed = (self.true - before) / dt
                else:
                    fall = max(0.0, 1.0 - BRAKED * dt / max(np.abs(self.speed).max(), 1e-9))
                    self.speed = fall * self.speed
                    self.commanded = self.true = before + self.speed * dt
                if not self.stuck:
                    self.gripper += np.clip(self.pulses - self.gripper, -1500 * dt, 1500 * dt)
                self.path.append((now, self.true))

    def _answer(self, link):
        stream = link.makefile("rb")
        while self.alive:
            transaction, protocol, length = struct.unpack(">HHH", stream.read(6))
            body = stream.read(length)
            if self.silent or protocol not in (2, 3):  # or a heartbeat
                continue
            time.sleep(self.delay)
            with self.lock:
                answer = self._do(body[0], body[1:])
                state = 0x40 * (self.code != 0) | 0x10 * (self.state >= 4)
            head = struct.pack(">HHHBB", transaction, protocol, len(answer) + 2, body[0], state)
            link.sendall(head + answer)

    # ---- orders ------------------------------------------------------------------------------

    def _do(self, function, values):
        if function == 1:
            return f"7,7,XS1300000000,AC1300000000,{self.version}".encode().ljust(40, b"\0")
        if function == 12 and not (self.code and values[0] == 0):
            self.state = {0: 2, 3: 3, 4: 4}[values[0]]
        if function == 19:
            self.log.append((time.monotonic(), "mode", values[0]))
            self.mode, self.state = values[0], 5  # until state 0 is asked for
        if function == 29:
            self._servo(np.array(struct.unpack("<7f", values[:28]), dtype=float))
        if function == 42 and not values:
            return struct.pack("<7f", *self.commanded)
        if function == 42:
            self.frozen_q = self.frozen_q if self.frozen else self.true + self.off
            return struct.pack("<7f", *self.frozen_q)
        if function == 124:
            return self._modbus(values)
        rate = struct.pack(">i", 11)  # of the gripper's line: 2 Mbit/s
        told = {13: bytes([self.state]), 14: bytes(2), 15: bytes([self.code, 0]), 128: rate}
        return told.get(function, b"")

    def _servo(self, q):
        if self.mode != 1 or self.state not in (0, 1, 2):
            return
        self.log.append((time.monotonic(), "servo", q))
        # The box interpolates over the time between commands, which is 10 ms here.
        step = (tcp_pose(XARM7, q) - tcp_pose(XARM7, self.commanded))[:3, 3]
        if np.any(np.abs(q - self.commanded) > MOST_SPEED * 0.0101):
            self.fail(24)
        elif np.linalg.norm(step) > MOST_TOOL_SPEED * 0.0101:
            self.fail(60)
        else:
            self.commanded = q

    def _modbus(self, frame):
        """RTU frames to the gripper, without checksums: host, 8, function, register, count."""
        host, line, function, register, count = struct.unpack(">BBBHH", frame[:7])
        assert (host, line) == (9, 8)
        if function == 0x10:
            if register == 0x0700:
                value = int.from_bytes(frame[8 : 8 + 2 * count], "big", signed=True)
                self.pulses = float(value)
            return frame[:7]
        value = {0x0702: round(self.gripper)}.get(register, 0)
        return frame[:3] + bytes([2 * count]) + value.to_bytes(2 * count, "big", signed=True)


def _thread(target, *args):
    """Runs until its box dies."""

    def run():
        with suppress(OSError, ValueError, struct.error):  # it is closed
            target(*args)

    threading.Thread(target=run, daemon=True).start()
