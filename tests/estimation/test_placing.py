"""Where a cloth lies before it is lifted."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation.scene import LiftScene

ROOM = {"width": 0.28, "height": 0.2}


def seen_lying(cloth_lift, turn, *, seed=0, crumpled=False, inset=0.0):
    """Frames of a rectangle of 0.28 x 0.2 m turned about the held corner [rad]: noisy clouds with
    round corners and a hole, flat in the first five, then drawn together towards a direction that
    is not its diagonal's, as a cloth that is lifted is."""
    rng = np.random.default_rng(seed)
    sides = np.array(list(ROOM.values()))
    uv = rng.random((6000, 2)) * sides
    uv = uv[np.linalg.norm(np.maximum(np.abs(uv - sides / 2) - sides / 2 + 0.02, 0), axis=1) < 0.02]
    uv = uv[np.linalg.norm(uv - [0.02, 0.03], axis=1) > 0.03]  # under the fingers
    uv -= inset * sides / np.hypot(*sides)
    if crumpled:
        uv = uv * [0.6, 0.8]
    c, s = math.cos(turn), math.sin(turn)
    flat = np.pad(uv @ np.array([[c, s], [-s, c]]), ((0, 0), (0, 1)), constant_values=0.002)
    towards = turn + math.atan2(sides[1], sides[0]) + 0.08
    along = flat @ [math.cos(towards), math.sin(towards), 0.0]
    hung = along[:, None] * [math.cos(towards), math.sin(towards), 0.0] + [0.0, 0.0, 0.1]
    hung = 0.7 * hung + 0.3 * flat
    clouds = [x + 0.003 * rng.normal(size=x.shape) for x in [flat] * 5 + [hung] * 7]
    described = replace(cloth_lift.object, **ROOM, grasp_inset=inset or None)
    return cloth_lift.recording(clouds, object=described)


@pytest.mark.parametrize("turn", [-2.0, 0.0, 0.3, 1.4, 3.1])
def test_a_cloth_that_lies_flat_lies_as_its_edges_show(cloth_lift, turn):
    scene = LiftScene.of(seen_lying(cloth_lift, turn, inset=0.012), cloth_lift.settings)
    found = math.atan2(*scene.inwards[0][1::-1]) - math.atan2(ROOM["height"], ROOM["width"])
    assert math.remainder(found - turn, 2 * math.pi) == pytest.approx(0.0, abs=0.012)


def test_one_that_does_not_lies_as_it_hangs(cloth_lift):
    scene = LiftScene.of(seen_lying(cloth_lift, 0.3, crumpled=True), cloth_lift.settings)
    found = math.atan2(*scene.inwards[0][1::-1]) - math.atan2(ROOM["height"], ROOM["width"])
    assert found == pytest.approx(0.38, abs=0.03)
