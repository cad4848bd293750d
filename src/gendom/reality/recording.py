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
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
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
from gendom.reality.trials import TrialRun, lift_cameras, lifted_by
from gendom.reality.world import Reality
from gendom.robot import LiftMotion, predefined_lift, tcp_pose

PATH_RATE = 100.0
"""Sampling rate of the robot's measured path [1/s]."""


@dataclass(frozen=True, kw_only=True)
class RecordSettings:
    """Settings of a recording.

    Raises:
        ParameterError: A value is out of its range.
    """

    frame_rate: float = 30.0
    """Frame rate of the cameras [1/s]."""
    notes: str = ""
    """Free text, stored with the recording."""
    seed: int = 0
    """Seed of all sensor errors."""
    noisy: bool = True
    """Whether the cameras have the errors of a D435i (`gendom.reality.sensor.observe`)."""

    def __post_init__(self) -> None:
        within, fix = 0.0 < self.frame_rate <= PATH_RATE, f"give {PATH_RATE:g} or less"
        require(within, f"is {self.frame_rate}", where="frame_rate", fix=fix)
        require(self.seed >= 0, f"is {self.seed}", where="seed", fix="give 0 or more")


def record(
    run: TrialRun,
    folder: str | os.PathLike,
    settings: RecordSettings | None = None,
    *,
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
        settings: Settings of the recording.
        errors: Errors of the rig; by default the usual ones, or for a quick trial those of
            synchronised cameras.
        on_frame: Called with the recorded time [s] after each frame.

    Raises:
        GendomError: The folder holds a recording already, or cannot be written.
        ParameterError: There is no camera.
        DeviceError: Nothing can be rendered here.
        SimulationError: The world diverged.
    """
    settings = RecordSettings() if settings is None else settings
    world, folder = run.world, Path(folder)
    require(world.cameras, "there is no camera", where="record", fix="give the trial cameras")
    if (folder / "cameras").exists():
        raise GendomError("holds a recording already", where=str(folder), fix="name another folder")
    if errors is None:
        errors = RigErrors.synchronised() if run.trial.quick else RigErrors()
    # One stream of random numbers for each use: more frames do not change the calibration.
    rig, *eyes, encoders = [
        np.random.default_rng(s)
        for s in np.random.SeedSequence(settings.seed).spawn(2 + len(world.cameras))
    ]
    # Where nothing can be rendered, before anything is written.
    world.render(0)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    believed = errors.believed(world.cameras, rig)
    writers = [PngWriter(folder / "cameras" / c.name, c) for c in believed]
    _write_object(folder / "object.toml", run, settings)
    path, truth = _PathWriter(folder, world, errors, encoders), []

    def keep(c: int, moment: float, clean: tuple[np.ndarray, np.ndarray]) -> None:
        pictures = observe(*clean, world.cameras[c], eyes[c], noisy=settings.noisy)
        writers[c].write(errors.stamp(c, moment), pictures)

    began = world.time
    frames, samples = _moments(run.end - began, settings.frame_rate)
    try:
        # OpenGL wants one thread; noise and files take one for each camera.
        with ThreadPoolExecutor(len(writers)) as pool:
            for moment in np.union1d(frames, samples):
                run.step_to(began + moment)
                if moment in samples:
                    path.add(moment)
                if moment not in frames:
                    continue
                clean = [world.render(c) for c in range(len(writers))]
                list(pool.map(keep, range(len(writers)), [moment] * len(writers), clean))
                truth.append((moment, world.vertices()))
                on_frame(moment)
    finally:
        path.close()
        _write_truth(folder / "truth", world, settings, errors, truth)


def _moments(seconds: float, frame_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of the pictures and of the robot's path [s].

    The path lasts a little longer than the pictures, because some clocks are ahead.
    """
    frames = np.arange(int(seconds * frame_rate + 1e-9) + 1) / frame_rate
    samples = np.arange(int((seconds + MAX_CLOCK_OFFSET) * PATH_RATE + 1e-9) + 1) / PATH_RATE
    return frames, samples


class _PathWriter:
    """Writer of the robot's measured path; each row is written to disk immediately."""

    def __init__(
        self, folder: Path, world: Reality, errors: RigErrors, encoders: np.random.Generator
    ):
        self._world, self._errors, self._encoders = world, errors, encoders
        self._files: dict[str, IO[str]] = {}
        self._write(folder / "gripper.csv", "time,x,y,z,ax,ay,az,closed")
        if (robot := world.robot) is not None:
            names = [f"q{k}" for k in range(robot.arm.joints)]
            self._write(folder / "joints.csv", ",".join(["time", *names]))

    def add(self, moment: float) -> None:
        world, hand = self._world, self._world.hand
        moment = self._errors.stamp_of_robot(moment)
        if (robot := world.robot) is not None:
            q = robot.measured(world.data)
            wrong = q + self._errors.encoders * self._encoders.standard_normal(len(q))
            hand = hand + tcp_pose(robot.arm, wrong)[:3, 3] - tcp_pose(robot.arm, q)[:3, 3]
            self._row("joints.csv", [moment, *wrong])
        self._row("gripper.csv", [moment, *hand, *world.hand_axis, len(world.held) > 0])

    def close(self) -> None:
        for file in self._files.values():
            file.close()

    def _write(self, path: Path, header: str) -> None:
        file = open(path, "w", buffering=1, encoding="utf-8")  # noqa: SIM115
        self._files[path.name] = file
        file.write(f"{header}\n")

    def _row(self, name: str, numbers: Sequence[float]) -> None:
        self._files[name].write(",".join(f"{float(x):.6f}" for x in numbers) + "\n")


def _write_object(path: Path, run: TrialRun, settings: RecordSettings) -> None:
    trial = run.trial
    lines = [
        "table_height = 0.0",
        'gripper_source = "measured"',
        *([f'robot = "{robot.arm.name}"'] if (robot := run.world.robot) else []),
        f"quasi_static = {str(trial.quasi_static).lower()}",
        'source = "a MuJoCo test scene (the second reality), seen by simulated depth cameras"',
        f"notes = {json.dumps(settings.notes)}",
        "",
        "[object]",
        f'grasp = "{trial.grasp}"',
        f"grasp_radius = {trial.reach!r}",
        f"grasp_inset = {trial.inset!r}",
    ]
    for key, value in trial.item.description().items():
        lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}")
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_truth(folder, world, settings, errors, truth) -> None:
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
            "noisy": settings.noisy,
            "errors": asdict(errors),
            "seed": settings.seed,
        },
    )


def record_and_perceive(
    item: RealObject,
    folder: str | os.PathLike,
    *,
    frame_rate: float = 15.0,
    seed: int = 0,
    end: str = "hold",
    motion: LiftMotion | None = None,
) -> tuple[Recording, list[tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64]]]]:
    """Lift an object under two noisy cameras and perceive it by its colour.

    Args:
        item: The object.
        folder: For the pictures; an older recording there is replaced. The recording itself is
            written to recording.npz inside.
        frame_rate: [1/s].
        seed: Of all noise.
        end: How the predefined lift ends, one of `gendom.robot.LIFT_ENDS`.
        motion: How it is lifted instead.

    Returns:
        The perceived recording, and what each camera saw halfway: colour [height, width, 3] and
        depth [height, width] [m], 0 where there is none.

    Raises:
        DeviceError: MuJoCo is not installed, or nothing can be rendered.
        RobotError: There is no such end, the motion is for another kind, or beyond the arm.
        GendomError: The folder cannot be written.
    """
    folder = Path(folder)
    trial = lifted_by(item, motion or predefined_lift(item.kind, end))
    for part in ("cameras", "truth"):
        shutil.rmtree(folder / part, ignore_errors=True)
    run = TrialRun(trial, cameras=lift_cameras(item))
    run.step_to(run.closes)
    with run.world:
        record(
            run,
            folder,
            RecordSettings(
                frame_rate=frame_rate,
                seed=seed,
                notes=f"The predefined lift of {item.name}, seed {seed}.",
            ),
        )
    recorded = read_cameras(folder)
    perceived = perceive(recorded, PerceptionSettings(colour=item.colour))
    perceived.recording.write(folder / "recording.npz")
    return perceived.recording, _halfway(recorded)


def _halfway(
    recorded: CameraRecording,
) -> list[tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64]]]:
    """Colour and depth [m] of each camera's middle picture."""
    found = []
    for source in recorded.sources:
        frames = list(source)
        pictures = frames[len(frames) // 2].read()
        depth = pictures.depth * source.camera.depth_unit
        colour = pictures.colour
        if colour is None:
            colour = np.zeros((*depth.shape, 3), dtype=np.uint8)
        found.append((colour, depth))
    return found
