"""Record the MuJoCo test scene as a real rig would: camera folders, the robot's path, the object.

    DIR/object.toml          description of the object, for perception
    DIR/gripper.csv          measured path of the hand, and whether it is closed
    DIR/joints.csv           measured joint angles, if there is a robot
    DIR/cameras/NAME/...     pictures of each camera, and its calibrated pose
    DIR/truth/truth.npz      time [M], vertices [M, V, 3] [m]: for evaluation only
    DIR/truth/truth.json     the object's parameters, the sensors' errors, the seed

Perception, estimation and control never read `truth`.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.files import atomic_path, check_folder, write_json
from gendom.perception import (
    CameraRecording,
    PerceptionSettings,
    PngWriter,
    perceive,
    read_cameras,
)
from gendom.reality.objects import RealObject
from gendom.reality.sensor import MAX_CLOCK_OFFSET, RigErrors, observe
from gendom.reality.trials import TrialRun, lift, lift_cameras
from gendom.reality.world import Reality
from gendom.robot import LiftMotion, tcp_pose

PATH_RATE = 100.0
"""Sampling rate of the robot's measured path [1/s]."""


def record(
    run: TrialRun,
    folder: str | os.PathLike,
    *,
    frame_rate: float = 30.0,
    seed: int = 0,
    noisy: bool = True,
    notes: str = "",
    errors: RigErrors | None = None,
    on_frame: Callable[[float], None] = lambda _: None,
) -> None:
    """Run a trial to its end, and write the measurements of the cameras and the robot.

    Time stamps start at 0 at the current time, so step the trial until the hand has closed before
    calling this. Pictures and the robot's path are written frame by frame: an interrupted recording
    can be used up to the interruption, even if the program was killed.

    Args:
        run: The trial, with cameras.
        folder: Output folder, created if missing; must not hold a recording.
        frame_rate: Of the cameras [1/s].
        seed: Of all sensor errors.
        noisy: Whether the cameras have the errors of a D435i (`gendom.reality.sensor.observe`).
        notes: Free text, stored with the recording.
        errors: Errors of the rig; by default the usual ones, or for a quick trial those of
            synchronised cameras.
        on_frame: Called with the recorded time [s] after each frame.

    Raises:
        GendomError: The folder holds a recording already, or cannot be written.
        ParameterError: There is no camera, or a number is out of its range.
        DeviceError: Nothing can be rendered here.
        SimulationError: The world diverged.
    """
    world, folder = run.world, Path(folder)
    _check(world, folder, frame_rate, seed)
    errors = errors or (RigErrors.synchronised() if run.trial.quick else RigErrors())
    # One stream of random numbers for each use: more frames do not change the calibration.
    rig, *eyes, encoders = [
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2 + len(world.cameras))
    ]
    believed = errors.believed(world.cameras, rig)
    writers = [PngWriter(folder / "cameras" / c.name, c) for c in believed]
    _write_object(folder / "object.toml", run, notes)
    truth = []

    def keep(c: int, moment: float, clean: tuple[np.ndarray, np.ndarray]) -> None:
        pictures = observe(*clean, world.cameras[c], eyes[c], noisy=noisy)
        writers[c].write(errors.stamp(c, moment), pictures)

    # OpenGL wants one thread; noise and files take one for each camera.
    with ExitStack() as closed, ThreadPoolExecutor(len(writers)) as pool:
        said = {"noisy": noisy, "errors": asdict(errors), "seed": seed}
        closed.callback(_write_truth, folder / "truth", world, said, truth)
        add = closed.enter_context(_path_files(folder, world, errors, encoders))
        for moment, clean in _rendered(run, frame_rate, add):
            list(pool.map(keep, range(len(writers)), [moment] * len(writers), clean))
            truth.append((moment, world.vertices()))
            on_frame(moment)


def _rendered(
    run: TrialRun, frame_rate: float, add: Callable[[float], None]
) -> Iterator[tuple[float, list[tuple[np.ndarray, np.ndarray]]]]:
    """Times [s] of a trial's pictures, and what each camera sees without noise; on the way there
    the robot's path is added to."""
    began, cameras = run.world.time, range(len(run.world.cameras))
    frames, samples = _moments(run.end - began, frame_rate)
    for moment in np.union1d(frames, samples):
        run.step_to(began + moment)
        if moment in samples:
            add(moment)
        if moment in frames:
            yield moment, [run.world.render(c) for c in cameras]


def _check(world: Reality, folder: Path, frame_rate: float, seed: int) -> None:
    """Refuse what cannot be recorded before anything is written, and make the folder."""
    within, fix = 0.0 < frame_rate <= PATH_RATE, f"give {PATH_RATE:g} or less"
    require(within, f"is {frame_rate}", where="frame_rate", fix=fix)
    require(seed >= 0, f"is {seed}", where="seed", fix="give 0 or more")
    require(world.cameras, "there is no camera", where="record", fix="give the trial cameras")
    what, fresh = "holds a recording already", not (folder / "cameras").exists()
    require(fresh, what, where=str(folder), fix="name another folder", error=GendomError)
    world.render(0)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)


def _moments(seconds: float, frame_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of the pictures and of the robot's path [s].

    The path lasts a little longer than the pictures, because some clocks are ahead.
    """
    frames = np.arange(int(seconds * frame_rate + 1e-9) + 1) / frame_rate
    samples = np.arange(int((seconds + MAX_CLOCK_OFFSET) * PATH_RATE + 1e-9) + 1) / PATH_RATE
    return frames, samples


@contextmanager
def _path_files(
    folder: Path, world: Reality, errors: RigErrors, encoders: np.random.Generator
) -> Iterator[Callable[[float], None]]:
    """Adds what is measured of the hand and of the arm's joints at a time [s] to gripper.csv and
    joints.csv; each row is on the disk at once."""
    robot = world.robot
    heads = {"gripper": "time,x,y,z,ax,ay,az,closed"}
    if robot is not None:
        heads["joints"] = ",".join(["time", *(f"q{k}" for k in range(robot.arm.joints))])
    with ExitStack() as files:
        tables = {}
        for name, head in heads.items():
            file = open(folder / f"{name}.csv", "w", buffering=1, encoding="utf-8")  # noqa: SIM115
            tables[name] = files.enter_context(file)
            file.write(f"{head}\n")

        def row(name: str, *numbers: float) -> None:
            tables[name].write(",".join(f"{float(x):.6f}" for x in numbers) + "\n")

        def add(moment: float) -> None:
            stamp, hand = moment + errors.robot_clock, world.hand
            if robot is not None:
                q = robot.measured(world.data)
                wrong = q + errors.encoders * encoders.standard_normal(len(q))
                hand = hand + tcp_pose(robot.arm, wrong)[:3, 3] - tcp_pose(robot.arm, q)[:3, 3]
                row("joints", stamp, *wrong)
            row("gripper", stamp, *hand, *world.hand_axis, len(world.held) > 0)

        yield add


def _write_object(path: Path, run: TrialRun, notes: str) -> None:
    trial, robot = run.trial, run.world.robot
    about = {
        "table_height": 0.0,
        "gripper_source": "measured",
        **({"robot": robot.arm.name} if robot else {}),
        "quasi_static": trial.quasi_static,
        "source": "a MuJoCo test scene (the second reality), seen by simulated depth cameras",
        "notes": notes,
    }
    held = {"grasp": trial.grasp, "grasp_radius": trial.reach, "grasp_inset": trial.inset}
    with atomic_path(path) as temporary:
        text = object_file(about, held | trial.item.description())
        temporary.write_text(text, encoding="utf-8")


def object_file(about: Mapping[str, Any], held: Mapping[str, Any]) -> str:
    """Content of object.toml: keys of a recording, and those of what is held."""
    lines = ([f"{key} = {json.dumps(value)}" for key, value in of.items()] for of in (about, held))
    return "\n\n[object]\n".join(map("\n".join, lines)) + "\n"


def _write_truth(folder, world, said, truth) -> None:
    item = world.item
    with atomic_path(folder / "truth.npz") as temporary:
        np.savez_compressed(
            temporary,
            time=np.array([t for t, _ in truth]),
            vertices=np.array([x for _, x in truth], dtype=np.float32),
        )
    write_json(
        folder / "truth.json",
        {
            "format": "gendom-truth/1",
            "object": {"name": item.name, **item.description()},
            "E": item.material.E,
            "nu": item.material.nu,
            "density": item.material.density,
            "damping": item.material.damping,
            "friction": item.friction,
            "air_density": world.air.density,
            "grip_force": world.grip_force if math.isfinite(world.grip_force) else None,
            **said,
        },
    )


def record_and_perceive(
    item: RealObject,
    folder: str | os.PathLike,
    *,
    frame_rate: float = 15.0,
    seed: int = 0,
    motion: LiftMotion | None = None,
) -> tuple[Recording, list[tuple[npt.NDArray[np.uint8], Array]]]:
    """Lift an object under two noisy cameras and perceive it by its colour.

    Args:
        item: The object.
        folder: For the pictures; an older recording there is replaced. The recording itself is
            written to recording.npz inside.
        frame_rate: [1/s].
        seed: Of all noise.
        motion: How it is lifted (default: the predefined lift).

    Returns:
        The perceived recording, and what each camera saw halfway: colour [height, width, 3] and
        depth [height, width] [m], 0 where there is none.

    Raises:
        DeviceError: MuJoCo is not installed, or nothing can be rendered.
        RobotError: The motion is for another kind, or beyond the arm.
        GendomError: The folder cannot be written.
    """
    folder = Path(folder)
    run = TrialRun(lift(item, motion), cameras=lift_cameras(item))
    for part in ("cameras", "truth"):
        shutil.rmtree(folder / part, ignore_errors=True)
    run.step_to(run.closes)
    notes = f"The predefined lift of {item.name}, seed {seed}."
    with run.world:
        record(run, folder, frame_rate=frame_rate, seed=seed, notes=notes)
    recorded = read_cameras(folder)
    perceived = perceive(recorded, PerceptionSettings(colour=item.colour))
    perceived.recording.write(folder / "recording.npz")
    return perceived.recording, _halfway(recorded)


def _halfway(
    recorded: CameraRecording,
) -> list[tuple[npt.NDArray[np.uint8], Array]]:
    """Colour and depth [m] of each camera's middle picture."""
    found = []
    for source in recorded.sources:
        frames = list(source)
        pictures = frames[len(frames) // 2].read()
        assert pictures.colour is not None
        found.append((pictures.colour, pictures.depth * source.camera.depth_unit))
    return found
