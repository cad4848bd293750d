"""Predict each motion of a cable from each other one: mean errors of a coordinate.

    python benchmarks/cables.py cable_dlo3_*.npz [--jobs 6] [--json]

E, damping and the rest come from one recording; the other's grippers then move the simulated rod,
and its markers are compared with the recorded ones in every frame, as DEFORM does. Recordings of
several cables, told apart by the number before the name's second `_`, are each predicted from their
own cable's.
"""

import argparse
import json
from functools import partial
from itertools import permutations
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, estimate, replay
from gendom.estimation.observed import Observation
from gendom.materials.unknowns import Theta


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with get_context("spawn").Pool(given.jobs) as pool:
        found = dict(zip(given.files, pool.map(estimated, given.files, 1), strict=True))
        pairs = [(a, b) for a, b in permutations(given.files, 2) if cable(a) == cable(b)]
        errors = pool.starmap(error, [(found[a][0], b) for a, b in pairs], 1)
    rows = [
        {"from": a.stem, "to": b.stem, "error": e, "usable": found[a][1]}
        for (a, b), e in zip(pairs, errors, strict=True)
    ]
    if given.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        refused = "" if row["usable"] else ", estimate not usable"
        print(f"{row['from']} -> {row['to']}: {1e3 * row['error']:.1f} mm{refused}")


def cable(path: Path) -> str:
    """Its cable's name."""
    return "_".join(path.stem.split("_")[:2])


read = partial(Recording.read, on_warning=lambda _: None)


def estimated(path: Path) -> tuple[Theta, bool]:
    """The most likely parameters, and whether they are usable."""
    found = estimate(read(path), EstimateSettings(starts=1, scene=SceneSettings(threads=1)))
    return found.theta, found.usable


def error(theta: Theta, other: Path) -> float:
    """Mean absolute error of a coordinate over all frames [m]."""
    scene = LiftScene.of(read(other), SceneSettings(fast_frames=500, slow_frames=500, threads=1))
    markers = Observation(scene).markers
    assert markers is not None, "the recording has no ordered markers"
    index, weight = markers
    x = np.einsum("mk,tmka->tma", weight, replay(scene, [theta])[:, 0][:, index])
    return float(np.abs(x - scene.recording.points.reshape(x.shape)).mean())


if __name__ == "__main__":
    main()
