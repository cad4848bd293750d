"""Record the MuJoCo test scene as a real rig would: camera folders, the robot's path, the object.

    DIR/object.toml          description of the object, for perception
    DIR/gripper.csv          measured path of the hand, and whether it is closed
    DIR/joints.csv           measured joint angles, if there is a robot
    DIR/cameras/NAME/...     pictures of each camera, and its calibrated pose
    DIR/truth/truth.npz      time [M], vertices [M, V, 3] [m]: for evaluation only
    DIR/truth/truth.json     the object's parameters, the sensors' errors, the seed

Perception, estimation and control never read `truth`.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import GendomError
from gendom.files import atomic_path, check_folder, write_json
from gendom.materials import to_columns
from gendom.perception import PngWriter
from gendom.perception.folder import append_row
from gendom.reality.objects import description
from gendom.reality.sensor import RigErrors, observe
from gendom.reality.trials import TrialRun

PATH_RATE, PATH_LONGER = 100.0, 0.1
"""Sampling rate of the robot's measured path [1/s], and how much longer than the pictures it is
recorded, for cameras whose clocks are ahead [s]."""


def record(
    run: TrialRun,
    folder: str | os.PathLike,
    *,
    frame_rate: float = 30.0,
    seed: int = 0,
    exact: bool = False,
    notes: str = "",
    on_frame: Callable[[float], None] = lambda _: None,
) -> None:
    """Run a trial to its end, and write the measurements of the cameras and the robot.

    Time stamps start at 0 now, so step the trial until the hand has closed before. All is written
    frame by frame: what was interrupted, even killed, can be used up to there.

    Args:
        run: The trial, with cameras.
        folder: Output folder, created if missing; must not hold a recording.
        frame_rate: Of the cameras [1/s].
        seed: Of all sensor errors.
        exact: Whether cameras and rig have no errors; else those of `gendom.reality.sensor`, of a
            quick trial with synchronised cameras.
        notes: Free text, stored with the recording.
        on_frame: Called with the recorded time [s] after each frame.

    Raises:
        GendomError: The folder holds a recording already, or cannot be written.
        ParameterError: There is no camera, or a number is out of its range.
        DeviceError: Nothing can be rendered here.
        SimulationError: The world diverged.
    """
    world, folder = run.world, Path(folder)
    within, fix = 0.0 < frame_rate <= PATH_RATE, f"give {PATH_RATE:g} or less"
    require(within, f"is {frame_rate}", where="frame_rate", fix=fix)
    require(seed >= 0, f"is {seed}", where="seed", fix="give 0 or more")
    require(world.cameras, "there is no camera", where="record", fix="give the trial cameras")
    what, fresh = "holds a recording already", not (folder / "cameras").exists()
    require(fresh, what, where=str(folder), fix="name another folder", error=GendomError)
    errors = RigErrors.synchronised() if run.trial.quick else RigErrors()
    errors = RigErrors(translation=0.0, rotation=0.0, clock_offset=0.0) if exact else errors
    world.render(0)  # refuses before anything is written
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _write_object(folder / "object.toml", run, notes)
    (folder / "gripper.csv").write_text("time,x,y,z,ax,ay,az,closed\n", encoding="utf-8")
    if world.robot is not None:
        names = ",".join(f"q{k}" for k in range(world.robot.arm.joints))
        (folder / "joints.csv").write_text(f"time,{names}\n", encoding="utf-8")
    began, truth = world.time, []
    frames = np.arange(int((run.end - began) * frame_rate + 1e-9) + 1) / frame_rate
    samples = np.arange(int((run.end - began + PATH_LONGER) * PATH_RATE + 1e-9) + 1) / PATH_RATE
    with ExitStack() as closed:
        said = {"noisy": not exact, "errors": asdict(errors), "seed": seed}
        closed.callback(_write_truth, folder / "truth", run, said, truth)
        take = closed.enter_context(_pictures(folder, run, errors, seed, not exact))
        for moment in np.union1d(frames, samples):
            run.step_to(began + moment)
            if moment in samples:
                _add_to_path(folder, run, moment)
            if moment in frames:
                take(moment)
                truth.append((moment, world.vertices()))
                on_frame(moment)


@contextmanager
def _pictures(
    folder: Path, run: TrialRun, errors: RigErrors, seed: int, noisy: bool
) -> Iterator[Callable[[float], None]]:
    """Writes what all cameras see now, as of a time [s]."""
    world, cameras = run.world, run.world.cameras
    # One stream of random numbers for each use: more frames do not change the calibration.
    rig, *eyes = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(1 + len(cameras)))
    believed = errors.believed(cameras, rig)
    writers = [PngWriter(folder / "cameras" / camera.name, camera) for camera in believed]

    def keep(c: int, moment: float, clean: tuple[np.ndarray, np.ndarray]) -> None:
        pictures = observe(*clean, cameras[c], eyes[c], noisy=noisy)
        writers[c].write(errors.stamp(c, moment), pictures)

    # OpenGL wants one thread; noise and files take one for each camera.
    with ThreadPoolExecutor(len(cameras)) as pool:

        def take(moment: float) -> None:
            clean = [world.render(c) for c in range(len(cameras))]
            list(pool.map(keep, range(len(cameras)), [moment] * len(cameras), clean))

        yield take


def _add_to_path(folder: Path, run: TrialRun, moment: float) -> None:
    """Add what is measured of the hand and of the arm's joints at a time [s] to gripper.csv and
    joints.csv."""
    world, robot = run.world, run.world.robot
    holds = len(world.held) > 0
    append_row(folder / "gripper.csv", (moment, *world.hand, *world.hand_axis, holds))
    if robot is not None:
        append_row(folder / "joints.csv", (moment, *robot.measured(world.data)))


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
        text = object_file(about, held | description(trial.item))
        temporary.write_text(text, encoding="utf-8")


def object_file(about: Mapping[str, Any], held: Mapping[str, Any]) -> str:
    """Content of object.toml: keys of a recording, and those of what is held."""
    lines = ([f"{key} = {json.dumps(value)}" for key, value in of.items()] for of in (about, held))
    return "\n\n[object]\n".join(map("\n".join, lines)) + "\n"


def _write_truth(
    folder: Path, run: TrialRun, said: Mapping[str, Any], truth: list[tuple[float, Array]]
) -> None:
    item, world = run.trial.item, run.world
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
            "object": {"name": item.name, **description(item)},
            **to_columns(item),
            "air_density": world.air.density,
            **said,
        },
    )
