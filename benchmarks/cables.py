"""Predict each motion of a cable from each other one: mean errors of a coordinate.

    python benchmarks/cables.py cable_dlo3_*.npz [--json]

E, damping and the rest come from one recording; the other's grippers then move the simulated rod,
and its markers are compared with the recorded ones in every frame, as DEFORM does.
"""

import argparse
import json
from itertools import permutations
from pathlib import Path

import numpy as np

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, estimate, replay
from gendom.estimation.observed import Observation
from gendom.materials.unknowns import Theta


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    read = {p.stem: Recording.read(p, on_warning=lambda _: None) for p in given.files}
    found = {name: estimate(r, EstimateSettings(starts=1)).theta for name, r in read.items()}
    rows = [
        {"from": a, "to": b, "error": error(found[a], read[b])} for a, b in permutations(read, 2)
    ]
    if given.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        print(f"{row['from']} -> {row['to']}: {1e3 * row['error']:.1f} mm")


def error(theta: Theta, other: Recording) -> float:
    """Mean absolute error of a coordinate over all frames [m]."""
    scene = LiftScene.of(other, SceneSettings(fast_frames=500, slow_frames=500))
    markers = Observation(scene).markers
    assert markers is not None, "the recording has no ordered markers"
    index, weight = markers
    x = np.einsum("mk,tmka->tma", weight, replay(scene, [theta])[:, 0][:, index])
    return float(np.abs(x - other.points.reshape(x.shape)).mean())


if __name__ == "__main__":
    main()
