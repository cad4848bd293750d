"""The way from depth to cloud: colours, stages, and clouds of known geometry, whose error has the
size of the depth noise, and no bias."""

from pathlib import Path

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.perception import CameraView, PerceptionSettings, Pictures, cloud, perceive_frame
from gendom.perception.cloud import fuse
from gendom.perception.colour import ObjectColour, lab
from gendom.reality import sensor

SETTINGS = PerceptionSettings(workspace=(-0.4, -0.4, -0.1, 0.4, 0.4, 0.5))


def test_a_rope_no_broader_than_pixels_keeps_what_has_depth(world):
    """Of whose pixels most are lost, all being at edges, where its diameter is known."""
    camera = world.make_camera()
    rope = world.lifted_rope(radius=0.001)
    pictures, rng = world.Scene([rope]).pictures(camera), np.random.default_rng(0)
    red, kept = ObjectColour.near(lab(world.RED)), []
    seen = np.where(rng.random(pictures.depth.shape) < 0.6, 0, pictures.depth).astype(np.uint16)
    for breadth in (np.inf, 0.002):
        points, counts = CameraView(camera, SETTINGS, breadth).segment(
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
    found = perceive_frame([CameraView(camera, SETTINGS)], [blind])
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
        ({"colour": (1, 2, 300)}, "0 to 255"),
        ({"colour": (1, 2, 3), "masks": Path("m")}, "are both given"),
        ({"sync_tolerance": -1.0}, "sync_tolerance is -1"),
        ({"sync_tolerance": 20.0}, "is 20 s; give seconds"),
    ],
)
def test_bad_settings(wrong, said):
    with pytest.raises(ParameterError, match=said):
        PerceptionSettings(**wrong)


# ---- clouds of known geometry


HELIX = np.stack([f(5.0 * np.linspace(0.0, 1.0, 40)) for f in (np.cos, np.sin, np.copy)], axis=1)
HELIX = [0.0, 0.0, 0.05] + HELIX * [0.1, 0.1, 0.06]


def test_pixels_lie_on_the_surface(world):
    """But for the depth unit of 0.1 mm."""
    camera = world.make_camera()
    for thing in (world.Plane(0.0, colour=world.RED), world.Rope(HELIX, radius=0.008)):
        seen = world.Scene([thing]).pictures(camera, sensor=world.EXACT)
        points, counts = CameraView(camera, SETTINGS).segment(seen)
        assert len(points) == counts[-1] > 500
        assert np.abs(thing.distance(points)).max() < 6e-5


@pytest.mark.parametrize("whole", [False, True])
def test_fused_cloud_has_no_bias(world, whole):
    """Two cameras, table removed, colour chosen, voxels and outliers: below the pixels' noise. The
    whole sensor has shared noise, shadows, edges that are lost or hang between, and dropout."""
    thing, views, pictures = world.Rope(HELIX), [], []
    scene, cameras = world.Scene([world.Plane(), thing]), world.pair(scale=1.0)
    for k, camera in enumerate(cameras):
        seen = scene.pictures(camera, sensor=sensor if whole else world.NOISE, seed=k)
        pictures.append(seen)
        views.append(CameraView(camera, SETTINGS))
        views[-1].find_table(seen.depth, 0.0)
    cloud = perceive_frame(views, pictures, colour=ObjectColour.near(lab(world.RED)))
    error = thing.distance(cloud.points.astype(float))
    noise = max(world.depth_rms(camera, 0.8) for camera in cameras)
    assert len(cloud.points) > 400
    assert abs(error.mean()) < 1e-3
    assert 0.3 * noise < np.sqrt(np.mean(error**2)) < (2.5e-3 if whole else noise)
    # Both sides of the object are there.
    assert whole or all(0.2 < np.mean(cloud.seen_by == bit) for bit in (1, 2))


# ---- colours


def test_lab_of_known_colours():
    """Reference values of CIE L*a*b* under D65; between the ends sRGB is not linear."""
    rgb = [(255, 255, 255), (0, 0, 255), (128, 0, 0), (8, 8, 8)]
    expected = [(100, 0, 0), (32.30, 79.19, -107.86), (25.54, 48.05, 38.06), (2.19, 0, 0)]
    np.testing.assert_allclose(lab(rgb), expected, atol=0.05)


@pytest.mark.parametrize("rgb", [(180, 30, 35), (40, 70, 190), (60, 160, 70), (190, 150, 60)])
def test_what_lies_in_shadow_is_the_object_s(rgb):
    """With down to an eighth of the light; grey, black and other hues in shadow are not."""
    linear = np.where(np.array(rgb) <= 10, 0.0, ((np.array(rgb) / 255 + 0.055) / 1.055) ** 2.4)
    shades = np.array([1.0, 0.5, 0.25, 0.125])[:, None] * linear
    shades = np.rint(255 * (1.055 * shades ** (1 / 2.4) - 0.055)).clip(0).astype(np.uint8)
    assert ObjectColour.near(lab(rgb)).match(shades).all()
    level = shades.mean(axis=1, keepdims=True).astype(np.uint8).repeat(3, axis=1)
    others = np.concatenate([level, shades[:, [1, 2, 0]], shades[:, [2, 0, 1]], 0 * shades])
    assert not ObjectColour.near(lab(rgb)).match(others).any()
