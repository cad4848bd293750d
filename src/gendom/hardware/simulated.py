"""The MuJoCo scene (`gendom.reality`) as a robot and depth cameras, through the devices' contracts.

Time is the scene's: a motion of 20 s is over as soon as it is simulated. All devices of one `Cell`
share one scene; `address` in cell.toml names the object (`gendom.reality.find_object`). What a
person does, laying the object down or hanging it up, `SimulatedRobot.arrange` does.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.errors import DeviceError, SimulationError
from gendom.hardware.cell import Cell, CellCamera
from gendom.hardware.contracts import Recorded, RobotState, Tick
from gendom.materials import thickness_of
from gendom.perception import Camera, PngWriter
from gendom.reality import (
    Reality,
    RealObject,
    RigErrors,
    Trial,
    default_cameras,
    find_object,
    lift,
)
from gendom.reality.arm import RobotArm
from gendom.reality.sensor import observe
from gendom.reality.trials import SETTLE, START_DELAY
from gendom.robot import JointMotion

TICKS, FRAMES = 100.0, 30.0
"""Rates of the robot's reports and of the cameras [1/s]."""

BRAKING = 0.12
"""In which the arm comes to rest along its path [s]."""

_scenes: WeakKeyDictionary[CellCamera, _Scene] = WeakKeyDictionary()
"""Where cameras are, once their cell's robot is there."""


class _Scene:
    """What the devices of one cell share: the world, its clock and who records."""

    def __init__(self, cell: Cell):
        self.cell = cell
        self.item = find_object(cell.address)
        self.cameras: list[SimulatedCamera] = []
        errors, rng = RigErrors.synchronised(), np.random.default_rng(0)
        usual = default_cameras()[0]
        self.believed = [
            replace(usual, name=c.name, T_world_camera=c.T_world_camera)
            for c in cell.camera
            if c.T_world_camera is not None
        ]
        self._true = errors.believed(self.believed, rng)
        self.errors = errors
        self.begin(lift(self.item), cell.model.home)

    def begin(self, trial: Trial, q: NDArray[np.float64]) -> None:
        """Put the object where a trial has it, with the arm at rest at joint angles [J] [rad]."""
        still = JointMotion(time=np.array([0.0, 1.0]), q=np.array([q, q]))
        self.arm = RobotArm(self.cell.model, still, opening=thickness_of(self.item))
        self.trial = trial
        self.world = Reality(
            trial.item,
            trial.layout,
            robot=self.arm,
            cameras=self._true,
            timestep=trial.timestep,
            slow_timestep=trial.slow_timestep,
            tolerance=trial.tolerance,
        )


class SimulatedRobot:
    """The arm of the MuJoCo scene as a `Robot`.

    Args:
        cell: Where it stands.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: The scene has no such object.
    """

    def __init__(self, cell: Cell):
        self.arm = cell.model
        self._scene = _Scene(cell)
        _scenes.update((camera, self._scene) for camera in cell.camera)
        self._widest = cell.tool.max_opening
        self._connected = False
        self._moving = False
        self._fault: str | None = None
        self._stopping = threading.Event()

    def connect(self) -> None:
        """Also forgets a fault."""
        self._connected, self._fault = True, None

    def disconnect(self) -> None:
        self._connected = False

    def state(self) -> RobotState:
        scene = self._scene
        q = scene.arm.measured(scene.world.data)
        return RobotState(
            time=time.monotonic(), q=q, opening=self._opening, moving=self._moving,
            fault=self._fault,
        )  # fmt: skip

    @property
    def item(self) -> RealObject:
        """The object that it handles."""
        return self._scene.item

    @property
    def _opening(self) -> float:
        held = len(self._scene.world.held) > 0
        return thickness_of(self._scene.item) if held else self._widest

    def arrange(self, trial: Trial | None = None) -> None:
        """What a person does before a motion: lay the object down in front of the arm (None), or
        put it where a trial has it, its end between the fingers."""
        q = self.state().q
        self._scene.begin(trial or lift(self._scene.item), q)
        self._scene.world.step_to(START_DELAY if trial else SETTLE)

    def approach(self, q: ArrayLike) -> None:
        cell = self._scene.cell
        move = cell.approach(self.state().q, np.asarray(q, dtype=float))
        self._follow(move, None)

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None] | None = None) -> None:
        self._check_connected()
        self._scene.cell.check_start(motion, self.state().q)
        self._follow(motion, on_tick)

    def gripper(self, opening: float) -> None:
        self._check_connected()
        self._grip(opening < 0.5 * (self._widest + thickness_of(self._scene.item)))

    def stop(self) -> None:
        self._stopping.set()

    # ---- motion ----------------------------------------------------------------------------------

    def _check_connected(self) -> None:
        where = "simulated robot"
        fix = "look at the cell, then connect again"
        require(self._fault is None, self._fault or "", where=where, fix=fix, error=DeviceError)
        fix = "connect it first"
        require(self._connected, "is not connected", where=where, fix=fix, error=DeviceError)

    def _grip(self, closed: bool) -> None:
        world = self._scene.world
        if not closed:
            world.release()
        elif len(world.held) == 0:
            try:
                world.attach(self._scene.trial.reach)
            except SimulationError as error:
                self._fail(error.what)

    def _fail(self, what: str) -> None:
        self._fault = what
        raise DeviceError(what, where="simulated robot", fix="look at the cell, then connect again")

    def _follow(self, motion: JointMotion, on_tick: Callable[[Tick], None] | None) -> None:
        """Simulate a motion; whatever ends it early, the arm brakes along its path."""
        self._check_connected()
        self._stopping.clear()
        scene, self._moving = self._scene, True
        begin = scene.world.time
        scene.arm.motion = motion.shifted(begin - motion.start)
        end = max([motion.end, *(e.time for e in motion.events)]) - motion.start
        todo = [(e.time - motion.start, e.closed) for e in motion.events]
        ticks = np.arange(math.floor(end * TICKS + 1e-9) + 1) / TICKS
        frames = np.arange(math.floor(end * FRAMES + 1e-9) + 1) / FRAMES
        recording = [c for c in scene.cameras if c.recording]
        try:
            for now in np.union1d(ticks, np.concatenate([frames if recording else [], [end]])):
                while todo and todo[0][0] <= now + 1e-9:
                    moment, closed = todo.pop(0)
                    scene.world.step_to(begin + moment)
                    self._grip(closed)
                scene.world.step_to(begin + now)
                if now in ticks and on_tick is not None:
                    on_tick(self._tick(now))
                if now in frames:
                    for camera in recording:
                        camera.take()
                if self._stopping.is_set():
                    self._brake()
                    return
        except SimulationError as error:
            self._fail(str(error))
        except BaseException:
            self._brake()
            raise
        finally:
            self._moving = False

    def _tick(self, now: float) -> Tick:
        scene = self._scene
        command = scene.arm.motion.at(scene.world.time)
        measured = scene.arm.measured(scene.world.data)
        return Tick(
            time=now, command=command, measured=measured, age=0.0, stamp=scene.world.time,
            opening=self._opening,
        )  # fmt: skip

    def _brake(self) -> None:
        """Slow down to rest along the path at a constant rate, and stay there."""
        world, motion = self._scene.world, self._scene.arm.motion
        before = motion.time[motion.time < world.time - 1e-6]
        after = np.linspace(0.0, BRAKING, 16)
        along = world.time + after - 0.5 * after**2 / BRAKING
        times = np.concatenate([before, world.time + after])
        q = np.concatenate([motion.at(before), motion.at(along)])
        self._scene.arm.motion = JointMotion(time=times, q=q)
        world.step_to(world.time + 2.0 * BRAKING)


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
        self.name = cell_camera.name
        pose, fix = cell_camera.T_world_camera, "give calibration or T_world_camera"
        self._require(pose is not None, "has no pose", fix)
        scene = _scenes.get(cell_camera)
        self._require(
            scene is not None, "has no simulated robot", 'give the cell robot = "simulated"'
        )
        assert scene is not None
        self._scene = scene
        self._index = [c.name for c in scene.believed].index(self.name)
        self._rng = np.random.default_rng(self._index + 1)
        self._writer: PngWriter | None = None
        self._written = 0
        self._connected = False

    def _require(self, holds: bool, what: str, fix: str) -> None:
        require(holds, what, where=f"camera {self.name}", fix=fix, error=DeviceError)

    @property
    def camera(self) -> Camera:
        return self._scene.believed[self._index]

    @property
    def recording(self) -> bool:
        """Whether pictures are written."""
        return self._writer is not None

    def connect(self) -> None:
        self._scene.world.render(self._index)  # where nothing can be rendered, before the work
        self._connected = True
        if self not in self._scene.cameras:
            self._scene.cameras.append(self)

    def start_recording(self, folder: Path) -> None:
        self._require(self._connected, "is not connected", "connect it first")
        self._writer, self._written = PngWriter(folder, self.camera), 0

    def wait_for_pictures(self) -> None:
        """They come when something moves."""

    def fault(self) -> None:
        """There is none."""

    def stop_recording(self) -> Recorded:
        self._writer = None
        return Recorded(pictures=self._written, missing=0)

    def disconnect(self) -> None:
        self._connected = False
        if self in self._scene.cameras:
            self._scene.cameras.remove(self)

    def take(self) -> None:
        """Write what it sees now."""
        assert self._writer is not None
        clean = self._scene.world.render(self._index)
        pictures = observe(*clean, self.camera, self._rng)
        self._writer.write(self._scene.errors.stamp(self._index, self._scene.world.time), pictures)
        self._written += 1
