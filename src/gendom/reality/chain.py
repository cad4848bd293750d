"""From an object of the MuJoCo test scene to a recording, as with a real rig."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gendom.datasets import Recording
from gendom.perception import PerceptionSettings, perceive, read_cameras
from gendom.reality.objects import RealObject
from gendom.reality.recording import RecordSettings, record
from gendom.reality.trials import TrialRun, lift_cameras, lifted_by
from gendom.robot import LiftMotion, predefined_lift

Sight = tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64]]
"""Colour [height, width, 3] and depth [height, width] [m], 0 where there is none."""


def record_and_perceive(
    item: RealObject,
    folder: str | os.PathLike,
    *,
    frame_rate: float = 15.0,
    seed: int = 0,
    end: str = "hold",
    motion: LiftMotion | None = None,
) -> tuple[Recording, list[Sight]]:
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
        The perceived recording, and what each camera saw halfway, see `halfway`.

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
    perceived.write(folder / "recording.npz")
    return perceived.recording, halfway(folder)


def halfway(folder: str | os.PathLike) -> list[Sight]:
    """Colour and depth [m] of each camera in the middle of a recorded folder.

    Raises:
        RecordingError: The folder or a picture cannot be read.
    """
    sights = []
    for source in read_cameras(folder).sources:
        frames = list(source)
        pictures = frames[len(frames) // 2].read()
        depth = pictures.depth * source.camera.depth_unit
        colour = pictures.colour
        if colour is None:
            colour = np.zeros((*depth.shape, 3), dtype=np.uint8)
        sights.append((colour, depth))
    return sights
