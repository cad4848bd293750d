"""One lift of each object of the second reality: what the clouds and the estimates are worth.

Each object is lifted by the arm under two noisy cameras and perceived; E and nu are estimated from
that, and everything is compared with the truth, which neither step sees. Goes on where it was:
delete a file in DIR to have it made again.

    python benchmarks/reality.py DIR [rope-cotton ...] [--frame-rate 10] [--starts 1]
"""

import argparse
import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor
from scipy.spatial import KDTree

from gendom.datasets import Recording
from gendom.estimation import Estimate, EstimateSettings, LiftScene, estimate, replay
from gendom.estimation.replay import middle
from gendom.files import write_json
from gendom.perception import PerceptionSettings, perceive, read_cameras
from gendom.reality import (
    OBJECTS,
    RealObject,
    RealRope,
    TrialRun,
    find_object,
    lift,
    lift_cameras,
)
from gendom.reality import (
    record as record_trial,
)

FINER = 8
"""Points between two vertices, where distances to the true shape are measured."""


DEPTH_COLORS = ("#fde725", "#5ec962", "#21918c", "#3b528b", "#440154")
"""From near to far: five of the colours of matplotlib's viridis."""

DEPTHS = 0.5, 1.3
"""Of their ends [m]; black is no depth."""

WIDTH = 1280
"""Of a picture of what all cameras saw [pixels]."""


def encode_camera_views(
    views: Sequence[tuple[NDArray, NDArray]],
) -> bytes:
    """One JPEG: a row for each camera, colour on the left and depth on the right.

    Args:
        views: Colour [height, width, 3] and depth [height, width] [m], 0 where there is none,
            of each camera; pictures of one size.
    """
    scale = np.transpose([ImageColor.getrgb(color) for color in DEPTH_COLORS])
    rows = []
    for colour, depth in views:
        share = np.clip((depth - DEPTHS[0]) / np.ptp(DEPTHS), 0.0, 1.0)
        channels = [np.interp(share, np.linspace(0.0, 1.0, len(c)), c) for c in scale]
        painted = np.stack(channels, axis=-1).astype(np.uint8)
        painted[depth <= 0.0] = 0
        rows.append(np.concatenate([colour, painted], axis=1))
    whole = Image.fromarray(np.concatenate(rows))
    size = WIDTH, round(whole.height * WIDTH / whole.width)
    buffer = io.BytesIO()
    whole.resize(size, Image.Resampling.LANCZOS).save(buffer, "JPEG", quality=80, optimize=True)
    return buffer.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("objects", nargs="*", default=list(OBJECTS))
    parser.add_argument("--frame-rate", type=float, default=10.0)
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rows = []
    for name in args.objects:
        rows.append(measure(find_object(name), args.folder / name, args))
        print(json.dumps(rows[-1]), flush=True)
    write_json(args.folder / "table.json", {"objects": rows})


def measure(
    item: RealObject, folder: Path, args: argparse.Namespace
) -> dict[str, float | str | None]:
    """One object's row."""
    if not (folder / "recording.npz").exists():
        run = TrialRun(lift(item), cameras=lift_cameras(item))
        run.step_to(run.closes)
        notes = f"The predefined lift of {item.name}, seed {args.seed}."
        with run.world:
            record_trial(run, folder, frame_rate=args.frame_rate, seed=args.seed, notes=notes)
        recorded = read_cameras(folder)
        seen = perceive(recorded, PerceptionSettings(colour=item.colour))
        seen.recording.write(folder / "recording.npz")
        sights = []
        for source in recorded.sources:  # halfway
            frames = list(source)
            pictures = frames[len(frames) // 2].read()
            sights.append((pictures.colour, pictures.depth * source.camera.depth_unit))
        (folder / "views.jpg").write_bytes(encode_camera_views(sights))
    recording = Recording.read(folder / "recording.npz")
    if (folder / "estimate.json").exists():
        found = Estimate.load(folder / "estimate.json")
    else:
        found = estimate(recording, EstimateSettings(starts=args.starts, seed=args.seed))
        found.save(folder / "estimate.json")
    record, scene = found.record, LiftScene.of(recording)
    x = middle(scene, replay(scene, [found.theta])[:, 0])
    truth = np.load(folder / "truth" / "truth.npz")
    times = recording.time[list(scene.frames)]
    shapes = np.stack([shape_at(item, truth, t) for t in times])
    error = np.concatenate(
        [to_surface(item, recording.frame(t), s) for t, s in zip(scene.frames, shapes, strict=True)]
    )
    # of the simulated middle line or sheet from the true one
    off = [float(KDTree(s).query(line)[0].mean()) for line, s in zip(x, shapes, strict=True)]
    low, high = found.interval("E") or (None, None)
    return {
        "object": item.name,
        "E_true": item.material.E,
        "E": record["E"],
        "E_low": low,
        "E_high": high,
        "usable": found.usable,
        "nu_true": item.material.nu,
        "nu": record["nu"],
        "seconds": record["seconds"],
        "cloud_bias_mm": 1e3 * float(error.mean()),
        "cloud_rms_mm": 1e3 * float(np.sqrt((error**2).mean())),
        "chamfer_mean_mm": 1e3 * record["chamfer_mean"],
        "chamfer_last_mm": 1e3 * record["chamfer_last"],
        "truth_mean_mm": 1e3 * float(np.mean(off)),
        "truth_last_mm": 1e3 * off[-1],
    }


def shape_at(item: RealObject, truth, time: float) -> NDArray[np.float64]:
    """[n, 3] points on the true middle line or sheet at a time [s]."""
    t, x = truth["time"], truth["vertices"].astype(float)
    k = int(np.clip(np.searchsorted(t, time), 1, len(t) - 1))
    w = np.clip((time - t[k - 1]) / (t[k] - t[k - 1]), 0.0, 1.0)
    vertices = (1.0 - w) * x[k - 1] + w * x[k]
    if isinstance(item, RealRope):
        return finer(vertices, FINER * 4)
    grid = vertices.reshape(item.vertices, item.vertices, 3)
    return finer(np.swapaxes(finer(grid, FINER), 0, 1), FINER).reshape(-1, 3)


def finer(x: NDArray[np.float64], times: int) -> NDArray[np.float64]:
    """Points [V, ...] with others put linearly between them along the first axis."""
    at = np.linspace(0.0, len(x) - 1.0, (len(x) - 1) * times + 1)
    k = np.minimum(at.astype(int), len(x) - 2)
    w = (at - k).reshape(-1, *[1] * (x.ndim - 1))
    return (1.0 - w) * x[k] + w * x[k + 1]


def to_surface(
    item: RealObject, cloud: NDArray[np.floating], shape: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[n] how far outside of the true surface the points of a cloud are [m]."""
    return KDTree(shape).query(cloud)[0] - item.radius


if __name__ == "__main__":
    main()
