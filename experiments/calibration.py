"""What `gendom calibrate` says of sets with one fault each: its stated error or its refusal beside
the true error. Corners are projected with noise, poses go through a file as users write them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.runs import Result, Runs, Table
from gendom.arrays import rigid
from gendom.errors import GendomError
from gendom.perception import Board, BoardView, Camera, calibrate
from gendom.perception.calibration import COLUMNS, read_poses

Array = NDArray[np.float64]

BOARDS = (
    Board(squares_x=7, squares_y=5, square=0.05, marker=0.037, dictionary="DICT_4X4_50"),
    Board(squares_x=7, squares_y=6, square=0.035, marker=0.026),
    Board(squares_x=9, squares_y=7, square=0.025, marker=0.018),
)

FAULTS = {
    "none": (),
    "board to another scale, 0.5 to 5 %": ("squares",),
    "focal length, 0.5 to 5 %": ("focal length",),
    "K of another stream, 30 to 50 %": ("focal length",),
    "principal point, 2 to 20 pixels": ("centre",),
    "one pose, 2 to 30 mm": (),
    "one pose, 0.5 to 10 degrees": (),
    "2 to 4 poses, both": (),
    "quaternions w, x, y, z": ("w, x, y, z",),
    "inverse poses": ("inverse",),
    "millimetres": ("millimetres",),
    "angles in degrees": ("degrees",),
    "eye in hand": ("eye in hand",),
    "poses shifted by a row": ("shifted by a row",),
}
"""Faults, and the words that name them in a refusal."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """So many random sets with each fault."""
    work = list(product(FAULTS, range(flags.seed, flags.seed + flags.lifts)))
    rows = list(runs.each(_calibrated, work, "calibrating"))
    by_fault = {name: _summary([r for r in rows if r["fault"] == name]) for name in FAULTS}
    head = ("refused", "named", "true, median", "90 %", "most", "stated, median", "90 %", "held")
    title = f"{flags.lifts} sets a fault; errors of position [mm] of sets that are not refused"
    return Result(
        name="calibration",
        figures={"sets": flags.lifts, "faults": by_fault, "rows": rows},
        shown=[Table(title=title, head=head, rows={n: _cells(s) for n, s in by_fault.items()})],
        notes=["held: both errors are below the stated ones, or the set is refused"],
    )


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    kept = [row for row in rows if "refused" not in row]
    true, stated = (
        np.array([row[key] for row in kept]).reshape(-1, 2) for key in ("true", "stated")
    )
    return {
        "refused": len(rows) - len(kept),
        "named": sum(row.get("named", False) for row in rows),
        "true": [*np.quantile(true[:, 0], [0.5, 0.9, 1.0])] if kept else None,
        "stated": [*np.quantile(stated[:, 0], [0.5, 0.9])] if kept else None,
        "held": (len(rows) - len(kept) + int((true <= stated).all(axis=1).sum())) / len(rows),
    }


def _cells(s: dict[str, Any]) -> tuple[str, ...]:
    errors = [f"{1e3 * e:.2f}" for e in [*s["true"], *s["stated"]]] if s["true"] else ["-"] * 5
    return str(s["refused"]), str(s["named"]), *errors, f"{100 * s['held']:.0f} %"


def _calibrated(work: tuple[str, int]) -> dict[str, Any]:
    """True and stated errors ([m], degrees) of a random set with a fault, or why it is refused."""
    fault, seed = work
    row: dict[str, Any] = {"fault": fault, "seed": seed}
    rng = np.random.default_rng([list(FAULTS).index(fault), seed])
    camera, sighted, poses = draw(rng, in_hand=fault == "eye in hand")
    try:
        camera, views = spoiled(fault, camera, sighted, poses, rng)
        found = calibrate(camera, views)
    except GendomError as error:
        words = FAULTS[fault]
        return {**row, "refused": str(error), "named": any(w in str(error) for w in words)}
    difference = np.linalg.inv(camera.calibrated()) @ found.T_world_camera
    angle = np.degrees(Rotation.from_matrix(difference[:3, :3]).magnitude())
    true = [float(np.linalg.norm(difference[:3, 3])), float(angle)]
    return {**row, "true": true, "stated": [found.error_position, found.error_angle]}


def draw(rng: np.random.Generator, *, in_hand: bool) -> tuple[Camera, list[Any], Array]:
    """A camera, corners in its pictures, [n, 3] on the board and [n, 2] pixels each, and the poses
    [views, 4, 4] that the robot reports: 0.1 mm and 0.01 degrees off."""
    board, f = BOARDS[rng.integers(len(BOARDS))], rng.uniform(380.0, 650.0)
    count, noise, tilt = rng.integers(8, 21), rng.uniform(0.05, 0.3), rng.uniform(20.0, 35.0)
    K = np.array([[f, 0, rng.normal(319.5, 8.0)], [0, f, rng.normal(239.5, 8.0)], [0, 0, 1.0]])
    down = Rotation.from_euler("x", 180, degrees=True) * _turn(rng.normal(0, 20.0, 3))
    T_world_camera = rigid(down.as_matrix(), rng.normal([0.4, 0.0, 0.9], 0.1))
    hold = rigid(_turn(rng.normal(0, 15.0, 3)).as_matrix(), rng.normal([0, 0, 0.1], 0.05))
    camera = Camera(name="drawn", width=640, height=480, K=K, T_world_camera=T_world_camera)
    size = np.array([board.squares_x, board.squares_y, 0.0]) * board.square
    corners = np.asarray(board.opencv().getChessboardCorners(), float)
    away = rng.uniform(1.2, 3.6) * f * size[0] / 640.0  # fills 28 to 80 % of the width
    sighted, poses = [], []
    for places in _path(rng, int(count)):
        T = rigid(_turn(tilt * places[:3]).as_matrix(), np.zeros(3))
        middle = away * (1.0 + 0.2 * places[3]) * np.array([*(0.15 * places[4:6]), 1.0])
        T[:3, 3] = middle - T[:3, :3] @ size / 2.0
        at = (corners @ T[:3, :3].T + T[:3, 3]) @ K.T
        pixels = at[:, :2] / at[:, 2:] + rng.normal(0.0, noise, (len(corners), 2))
        inside = ((pixels > 0) & (pixels < [640, 480])).all(axis=1)
        if inside.sum() < 6:
            continue
        sighted.append((corners[inside], pixels[inside]))
        if in_hand:  # the board lies on the table, the camera is where it held the board
            pose = rigid(np.eye(3), [0.5, 0.0, 0.0]) @ np.linalg.inv(hold @ T)
        else:
            pose = T_world_camera @ T @ np.linalg.inv(hold)
        poses.append(_off(pose, rng, 1e-4, 0.01))
    return camera, sighted, np.array(poses)


def _path(rng: np.random.Generator, count: int) -> Array:
    """[count, 6] places in -1 to 1: independent, or every second time along a smooth path."""
    if rng.random() < 0.5:
        return rng.uniform(-1.0, 1.0, (count, 6))
    turns, phases = rng.uniform(0.5, 2.0, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return np.sin(2.0 * np.pi * turns * np.linspace(0.0, 1.0, count)[:, None] + phases)


def _turn(rotvec: Array) -> Rotation:
    """Of a rotation vector in degrees."""
    return Rotation.from_rotvec(rotvec, degrees=True)


def _off(T: Array, rng: np.random.Generator, distance: float, degrees: float) -> Array:
    """A pose that is off by normal errors of these sizes on each axis [m], [degrees]."""
    return T @ rigid(_turn(rng.normal(0.0, degrees, 3)).as_matrix(), rng.normal(0, distance, 3))


def spoiled(
    fault: str, camera: Camera, sighted: list[Any], poses: Array, rng: np.random.Generator
) -> tuple[Camera, list[BoardView]]:
    """The camera and the views as they are read where something is wrong.

    Raises:
        GendomError: The file of poses is refused.
    """
    K, scale, order = camera.K.copy(), 1.0, [0, 1, 2, 3, 4, 5, 6]
    sign = rng.choice([-1.0, 1.0])
    if fault.startswith("board"):
        scale = 1.0 + sign * rng.uniform(0.005, 0.05)
    elif fault.startswith("focal"):
        K[:2, :2] *= 1.0 + sign * rng.uniform(0.005, 0.05)
    elif fault.startswith("K of"):
        K[:2, :2] *= 1.0 + rng.uniform(0.3, 0.5)
    elif fault.startswith("principal"):
        direction = rng.uniform(0.0, 2.0 * np.pi)
        K[:2, 2] += rng.uniform(2.0, 20.0) * np.array([np.cos(direction), np.sin(direction)])
    elif "pose, " in fault or "poses, " in fault:
        some = 1 if fault.startswith("one") else int(rng.integers(2, 5))
        for k in rng.choice(len(poses), some, replace=False):
            axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
            turned = 0.0 if "mm" in fault else rng.uniform(0.5, 10.0)
            moved = 0.0 if "degrees" in fault else rng.uniform(0.002, 0.03)
            poses[k] @= rigid(_turn(turned * axis).as_matrix(), moved * way)
    elif fault == "inverse poses":
        poses = np.asarray(np.linalg.inv(poses), float)
    elif fault == "poses shifted by a row":
        poses = np.roll(poses, int(sign), axis=0)
    elif fault == "quaternions w, x, y, z":
        order = [0, 1, 2, 6, 3, 4, 5]
    values = np.concatenate(
        [poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()], axis=1
    )[:, order]
    if fault == "millimetres":
        values[:, :3] *= 1e3
    elif fault == "angles in degrees":
        values[:, 3:6] = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz", degrees=True)
        values[:, 6] = 0.0
    with TemporaryDirectory() as folder:
        path = Path(folder) / "poses.csv"
        lines = [f"{k}.png,{','.join(map(repr, map(float, v)))}" for k, v in enumerate(values)]
        path.write_text("\n".join([",".join(COLUMNS), *lines]) + "\n", encoding="utf-8")
        read = [T for _, T in read_poses(path)]
    views = [
        BoardView(f"{k}.png", scale * points, pixels, T)
        for k, ((points, pixels), T) in enumerate(zip(sighted, read, strict=True))
    ]
    return replace(camera, K=K), views
