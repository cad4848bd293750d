"""The MuJoCo scene (`gendom.reality`) as a robot and depth cameras, through the devices' contracts.

Time is the scene's: a motion of 20 s is over as soon as it is simulated. All devices of one `Cell`
share one scene; `address` in cell.toml names the object (`gendom.reality.find_object`), and with
another `serial` a camera has other noise and another error of its calibration. What a
person does, laying the object down or hanging it up, `SimulatedRobot.arrange` does.
"""

from __future__ import annotations

import math
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError, SimulationError
from gendom.hardware.cell import Cell, CellCamera
from gendom.hardware.contracts import Recorded, RobotState, Tick
from gendom.materials import thickness_of
from gendom.perception import PngWriter
from gendom.reality import Reality, RealObject, RigErrors, Trial, default_cameras, find_object, lift
from gendom.reality.arm import RobotArm
from gendom.reality.sensor import observe
from gendom.reality.trials import SETTLE, START_DELAY
from gendom.robot import JointMotion

TICKS, FRAMES = 100.0, 30.0
"""Rates of the robot's reports and of the cameras [1/s]."""

BRAKING = 0.12
"""In which the arm comes to rest along its path [s]."""

_robots: WeakKeyDictionary[CellCamera, SimulatedRobot] = WeakKeyDictionary()
"""The robot whose scene a camera looks at."""


def _seed(camera: CellCamera) -> int:
    """Of a camera's errors: its serial number says which camera it is."""
    return zlib.crc32(camera.serial.encode())


class SimulatedRobot:
    """The arm of the MuJoCo scene as a `Robot`, with the scene.

    Args:
        cell: Where it stands.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: The scene has no such object.
    """

    def __init__(self, cell: Cell):
        self.cell, self.arm = cell, cell.model
        self.item: RealObject = find_object(cell.address)
        """The object that it handles."""
        self.cameras: list[SimulatedCamera] = []
        """Those that are connected."""
        _robots.update((camera, self) for camera in cell.camera)
        usual, self.errors = default_cameras()[0], RigErrors.synchronised()
        self.believed = [
            replace(usual, name=c.name, T_world_camera=c.T_world_camera)
            for c in cell.camera
            if c.T_world_camera is not None
        ]
        seeds = [_seed(camera) for camera in cell.camera]
        self._true = self.errors.believed(self.believed, np.random.default_rng([0, *seeds]))
        self._connected = self._moving = False
        self._fault: str | None = None
        self._stopping = threading.Event()
        self._begin(lift(self.item), cell.model.home)

    def _begin(self, trial: Trial, q: Array) -> None:
        """Put the object where a trial has it, with the arm at rest at joint angles [J] [rad]."""
        still = JointMotion(time=np.array([0.0, 1.0]), q=np.array([q, q]))
        self.servos = RobotArm(self.arm, still, opening=thickness_of(self.item))
        self.trial = trial
        self.world = Reality(
            trial.item, trial.layout, robot=self.servos, cameras=self._true,
            timestep=trial.timestep, adaptive=trial.adaptive,
        )  # fmt: skip

    def connect(self) -> None:
        """Also forgets a fault."""
        self._connected, self._fault = True, None

    def disconnect(self) -> None:
        self._connected = False

    def state(self) -> RobotState:
        held = len(self.world.held) > 0
        return RobotState(
            time=time.monotonic(),
            q=self.servos.measured(self.world.data),
            opening=thickness_of(self.item) if held else self.cell.tool.max_opening,
            moving=self._moving,
            fault=self._fault,
        )

    def arrange(self, trial: Trial | None = None) -> None:
        """What a person does before a motion: lay the object down in front of the arm (None), or
        put it where a trial has it, its end between the fingers."""
        self._begin(trial or lift(self.item), self.state().q)
        self.world.step_to(START_DELAY if trial else SETTLE)

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None] | None = None) -> None:
        self._check_connected()
        self.cell.check_start(motion, self.state().q)
        self._follow(motion, on_tick)

    def gripper(self, opening: float) -> None:
        self._check_connected()
        self._grip(opening < 0.5 * (self.cell.tool.max_opening + thickness_of(self.item)))

    def stop(self) -> None:
        self._stopping.set()

    # ---- motion ----------------------------------------------------------------------------------

    def _check_connected(self) -> None:
        what = self._fault or "is not connected"
        fix = "look at the cell, then connect again" if self._fault else "connect it first"
        good = self._connected and self._fault is None
        require(good, what, where="simulated robot", fix=fix, error=DeviceError)

    def _grip(self, closed: bool) -> None:
        if not closed:
            self.world.release()
        elif len(self.world.held) == 0:
            try:
                self.world.attach(self.trial.reach)
            except SimulationError as error:
                self._fault = error.what
                self._check_connected()

    def _follow(self, motion: JointMotion, on_tick: Callable[[Tick], None] | None) -> None:
        """Simulate a motion; whatever ends it early, the arm brakes along its path."""
        self._check_connected()
        self._stopping.clear()
        self._moving, begin = True, self.world.time
        self.servos.motion = motion.shifted(begin - motion.start)
        end = max([motion.end, *(e.time for e in motion.events)]) - motion.start
        todo = [(e.time - motion.start, e.closed) for e in motion.events]
        recording = [c for c in self.cameras if c.recording]
        ticks = np.arange(math.floor(end * TICKS + 1e-9) + 1) / TICKS
        frames = np.arange(math.floor(end * FRAMES + 1e-9) + 1) / FRAMES
        try:
            for now in np.union1d(ticks, np.concatenate([frames if recording else [], [end]])):
                while todo and todo[0][0] <= now + 1e-9:
                    moment, closed = todo.pop(0)
                    self.world.step_to(begin + moment)
                    self._grip(closed)
                self.world.step_to(begin + now)
                if now in ticks and on_tick is not None:
                    on_tick(self._tick(now))
                if now in frames:
                    for camera in recording:
                        camera.take()
                if self._stopping.is_set():
                    self._brake()
                    return
        except SimulationError as error:
            self._fault = str(error)
            self._check_connected()
        except BaseException:
            self._brake()
            raise
        finally:
            self._moving = False

    def _tick(self, now: float) -> Tick:
        state, stamp = self.state(), self.world.time
        command = self.servos.motion.at(stamp)
        return Tick(time=now, command=command, measured=state.q, age=0.0, stamp=stamp,
                    opening=state.opening)  # fmt: skip

    def _brake(self) -> None:
        """Slow down to rest along the path at a constant rate, and stay there."""
        motion, now = self.servos.motion, self.world.time
        before = motion.time[motion.time < now - 1e-6]
        after = np.linspace(0.0, BRAKING, 16)
        along = now + after - 0.5 * after**2 / BRAKING
        q = np.concatenate([motion.at(before), motion.at(along)])
        self.servos.motion = JointMotion(time=np.concatenate([before, now + after]), q=q)
        self.world.step_to(now + 2.0 * BRAKING)


class SimulatedCamera:
    """A noisy depth camera of the MuJoCo scene as a `DepthCamera`.

    It stands where the cell says but for the usual error of a calibration; pictures are stamped
    with the scene's time. Its cell's robot is made before it.

    Args:
        cell_camera: Which it is.

    Raises:
        DeviceError: It is not calibrated: where it stands is not known; or there is no robot.
    """

    def __init__(self, cell_camera: CellCamera):
        self.name, robot = cell_camera.name, _robots.get(cell_camera)
        placed, fix = cell_camera.T_world_camera is not None, "give calibration or T_world_camera"
        self._require(placed, "has no pose", fix)
        self._require(robot, "has no simulated robot", 'give the cell robot = "simulated"')
        assert robot is not None
        self._robot = robot
        self._index = [c.name for c in robot.believed].index(self.name)
        self._camera = robot.believed[self._index]
        self.pixels = self._camera.width * self._camera.height
        self._rng = np.random.default_rng([_seed(cell_camera), self._index + 1])
        self._writer: PngWriter | None = None
        self._written = 0

    def _require(self, holds: Any, what: str, fix: str) -> None:
        require(holds, what, where=f"camera {self.name}", fix=fix, error=DeviceError)

    @property
    def recording(self) -> bool:
        """Whether pictures are written."""
        return self._writer is not None

    def connect(self) -> None:
        self._robot.world.render(self._index)  # where nothing can be rendered, before the work
        if self not in self._robot.cameras:
            self._robot.cameras.append(self)

    def start_recording(self, folder: Path) -> None:
        self._require(self in self._robot.cameras, "is not connected", "connect it first")
        self._writer, self._written = PngWriter(folder, self._camera), 0

    def wait_for_pictures(self) -> None:
        """They come when something moves."""

    def fault(self) -> None:
        """There is none."""

    def stop_recording(self) -> Recorded:
        self._writer = None
        return Recorded(pictures=self._written, missing=0)

    def disconnect(self) -> None:
        if self in self._robot.cameras:
            self._robot.cameras.remove(self)

    def take(self) -> None:
        """Write what it sees now."""
        assert self._writer is not None
        robot = self._robot
        pictures = observe(*robot.world.render(self._index), self._camera, self._rng)
        self._writer.write(robot.errors.stamp(self._index, robot.world.time), pictures)
        self._written += 1
