"""Stages of the way from depth to cloud."""

from pathlib import Path

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.perception import CameraView, PerceptionSettings, Pictures, cloud, perceive_frame
from gendom.perception.cloud import fuse
from gendom.perception.colour import ObjectColour, lab


def settings(box=(-0.4, -0.4, -0.1, 0.4, 0.4, 0.5), **other):
    return PerceptionSettings(workspace=box, **other)


def test_pixels_half_behind_the_object_are_dropped(world, monkeypatch):
    """They have its colour, and a depth between its own and that of what is behind."""
    rope, camera, red = world.lifted_rope(), world.make_camera(), ObjectColour.near(lab(world.RED))
    pictures = world.Scene([world.Plane(), rope]).pictures(camera)
    z = pictures.depth.astype(float)
    own = red.match(pictures.colour.reshape(-1, 3)).reshape(z.shape)
    edge = own & ~np.roll(own, 1, axis=1) & (np.roll(z, 1, axis=1) - z > 500)
    mixed = np.where(edge, 0.5 * (z + np.roll(z, 1, axis=1)), z).astype(np.uint16)
    assert edge.sum() > 50
    view, far = CameraView(camera, settings()), []
    view.find_table(pictures.depth, 0.0)
    for least in (0, cloud.MIN_SUPPORT):
        monkeypatch.setattr(cloud, "MIN_SUPPORT", least)
        points, _ = view.segment(Pictures(mixed, pictures.colour), red)
        far.append((rope.distance(points) > 0.02).sum())
    assert far[0] > 50 and far[1] == 0


def test_a_rope_no_broader_than_pixels_keeps_what_has_depth(world):
    """Of whose pixels most are lost, all being at edges, where its diameter is known."""
    camera = world.make_camera()
    rope = world.lifted_rope(radius=0.001)
    pictures, rng = world.Scene([rope]).pictures(camera), np.random.default_rng(0)
    red, kept = ObjectColour.near(lab(world.RED)), []
    seen = np.where(rng.random(pictures.depth.shape) < 0.6, 0, pictures.depth).astype(np.uint16)
    for breadth in (np.inf, 0.002):
        points, counts = CameraView(camera, settings(), breadth).segment(
            Pictures(seen, pictures.colour), red
        )
        assert (rope.distance(points) < 0.01).all()
        kept.append(counts[4] / counts[3])
    assert kept[0] < 0.5 and kept[1] > 0.8


def test_scattered_points_are_outliers(world):
    rng = np.random.default_rng(0)
    rope = np.linspace([-0.2, 0, 0.1], [0.2, 0, 0.1], 500) + rng.normal(0, 1e-3, (500, 3))
    stray = rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 0.8], (40, 3))
    points, _, voxels = fuse([np.concatenate([rope, stray]).astype(np.float32)])
    assert voxels > len(points) and voxels - len(points) == 40
    assert points[:, 2].max() < 0.11
    # empty clouds stay empty
    camera = world.make_camera(scale=0.25)
    blind = Pictures(np.zeros((camera.height, camera.width), np.uint16))
    found = perceive_frame([CameraView(camera, settings())], [blind])
    assert found.points.shape == (0, 3) and found.counts.tolist() == [0] * 8


@pytest.mark.parametrize("spread", [0.02, 0.25])
def test_voxels_are_means_and_know_their_cameras(spread, monkeypatch):
    """Of dense and sparse clouds, which take different ways: as a plain loop says."""
    monkeypatch.setattr(cloud, "MIN_CLUSTER", 1)
    p = np.random.default_rng(1).uniform(-spread, spread, (3000, 3)).astype(np.float32)
    points, seen_by, voxels = fuse([p[:2000], p[2000:]])
    cells = {}
    for k, (point, cell) in enumerate(zip(p, np.floor(p * (1 / 0.005)).astype(int), strict=True)):
        cells.setdefault(tuple(cell), []).append((point, 1 if k < 2000 else 2))
    rows = [cells[cell] for cell in sorted(cells)]
    assert voxels == len(rows)
    means = np.array([np.mean([point for point, _ in row], axis=0) for row in rows])
    np.testing.assert_allclose(points, means, atol=1e-6)
    np.testing.assert_array_equal(seen_by, [np.bitwise_or.reduce([b for _, b in r]) for r in rows])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"workspace": (0.5, -0.4, 0.0, 0.4, 0.4, 0.5)}, "the workspace runs from"),
        ({"workspace": (np.nan, -0.4, 0.0, 0.4, 0.4, 0.5)}, "the workspace runs from"),
        ({"colour": (1, 2, 300)}, "0 to 255"),
        ({"colour": (1, 2, 3), "masks": Path("m")}, "are both given"),
        ({"sync_tolerance": -1.0}, "sync_tolerance is -1"),
        ({"sync_tolerance": 20.0}, "is 20 s; give seconds"),
    ],
)
def test_bad_settings(wrong, said):
    with pytest.raises(ParameterError, match=said):
        PerceptionSettings(**wrong)
