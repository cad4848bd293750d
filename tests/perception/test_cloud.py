"""Stages of the way from depth to cloud."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.perception import (
    CameraView,
    Capsules,
    PerceptionSettings,
    Pictures,
    cloud,
    perceive_frame,
)
from gendom.perception.cloud import Held, fuse
from gendom.perception.colour import ObjectColour, lab
from gendom.perception.robot import read_capsules


def settings(box=(-0.4, -0.4, -0.1, 0.4, 0.4, 0.5), **other):
    return PerceptionSettings(workspace=box, **other)


def test_crop_is_that_of_the_points(world):
    """Depth limits a pixel against a test of every point, at all depths."""
    camera = world.make_camera(scale=0.25)
    wide = CameraView(camera, settings((-9, -9, -9, 9, 9, 9)))
    view = CameraView(camera, settings((-0.2, -0.1, 0.05, 0.15, 0.3, 0.25)))
    size = (camera.height, camera.width)
    depth = np.random.default_rng(0).integers(3000, 14000, size).astype(np.uint16)
    depth[0, :50] = 0
    points = wide.points(depth.ravel(), np.arange(depth.size))
    low, high = np.array([-0.2, -0.1, 0.05]), np.array([0.15, 0.3, 0.25])
    expected = ((points >= low) & (points <= high)).all(axis=1) & (depth.ravel() > 0)
    cropped = view.in_workspace(depth).ravel()
    edge = np.minimum(abs(points - low), abs(points - high)).min(axis=1) < 1e-5
    assert expected.sum() > 300
    np.testing.assert_array_equal(cropped[~edge], expected[~edge])


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


def test_thin_objects_keep_their_pixels(world, monkeypatch):
    """Two pixels across are enough."""
    camera = world.make_camera()
    pictures = world.Scene([world.lifted_rope(radius=0.002)]).pictures(camera)
    kept = CameraView(camera, settings()).segment(pictures)[1][4]
    monkeypatch.setattr(cloud, "MIN_SUPPORT", 0)
    assert kept > 0.85 * CameraView(camera, settings()).segment(pictures)[1][4] > 0


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


def test_scattered_points_are_outliers():
    rng = np.random.default_rng(0)
    rope = np.linspace([-0.2, 0, 0.1], [0.2, 0, 0.1], 500) + rng.normal(0, 1e-3, (500, 3))
    stray = rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 0.8], (40, 3))
    points, _, voxels = fuse([np.concatenate([rope, stray]).astype(np.float32)], settings())
    assert voxels > len(points) and voxels - len(points) == 40
    assert points[:, 2].max() < 0.11


@pytest.mark.parametrize("spread", [0.05, 0.5])
def test_voxels_are_means_and_know_their_cameras(spread):
    """Of dense and sparse clouds, which take different ways: as a plain loop says."""
    p = np.random.default_rng(1).uniform(-spread, spread, (3000, 3)).astype(np.float32)
    clouds = [p[:2000], p[2000:]]
    points, seen_by, voxels = fuse(clouds, settings(min_cluster=1, voxel=0.01))
    cells = {}
    for k, (point, cell) in enumerate(zip(p, np.floor(p * (1 / 0.01)).astype(int), strict=True)):
        cells.setdefault(tuple(cell), []).append((point, 1 if k < 2000 else 2))
    rows = [cells[cell] for cell in sorted(cells)]
    assert voxels == len(rows)
    means = np.array([np.mean([point for point, _ in row], axis=0) for row in rows])
    np.testing.assert_allclose(points, means, atol=1e-6)
    np.testing.assert_array_equal(seen_by, [np.bitwise_or.reduce([b for _, b in r]) for r in rows])


def test_no_voxels_keeps_all_points_and_empty_clouds_stay_empty(world):
    p = np.random.default_rng(0).normal(0, 1e-3, (50, 3)).astype(np.float32)
    points, seen_by, _ = fuse([p[:20], p[20:]], settings(voxel=0.0))
    np.testing.assert_array_equal(points, p)
    assert seen_by.tolist() == [1] * 20 + [2] * 30
    camera = world.make_camera(scale=0.25)
    blind = Pictures(np.zeros((camera.height, camera.width), np.uint16))
    found = perceive_frame([CameraView(camera, settings())], [blind])
    assert found.points.shape == (0, 3) and found.counts.tolist() == [0] * 8


def test_capsules_contain_what_a_distance_says():
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(2, 5, 3))
    ends[1, 4] = ends[0, 4]  # a sphere
    capsules = Capsules(ends[0], ends[1], rng.uniform(0.1, 0.5, 5))
    p = rng.normal(size=(300, 3))
    along = np.linspace(0, 1, 2001)[:, None, None]
    line = ends[0] + along * (ends[1] - ends[0])
    distance = np.array([np.linalg.norm(line - x, axis=2).min(axis=0) for x in p])
    gap = (distance - capsules.radius).min(axis=1)
    sure = np.abs(gap - 0.05) > 1e-3
    np.testing.assert_array_equal(capsules.contain(p, 0.05)[sure], (gap < 0.05)[sure])


def test_noise_of_fingers_is_left_out_where_nothing_chose_the_points():
    """It is 7 mm off a finger, whose margin is 3 mm, and beyond the fingertip."""
    start, end = np.zeros((1, 3)), np.array([[0.0, 0.0, 0.1]])
    finger = Capsules(start, end, np.array([0.01]), np.array([0.003]))
    rope = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, -0.2], 50)
    points = np.concatenate([rope, [[0.017, 0.0, 0.05]]])
    held = Held(np.zeros((1, 3)), reach=0.3, robot=finger)
    assert not finger.contain(points[-1:], 0.01).any()
    assert held.among(points).tolist() == [True] * 50 + [False]
    assert replace(held, chosen=True).among(points).all()


def test_capsules_move_between_their_rows(tmp_path):
    path = tmp_path / "capsules.csv"
    rows = "0,base,0,0,0,0,0,1,0.1\n0,arm,0,0,1,1,0,1,0.05\n2,arm,0,0,1,1,2,1,0.05\n"
    path.write_text("time,capsule,x0,y0,z0,x1,y1,z1,radius\n" + rows)
    capsules = read_capsules(path).at(0.5)
    np.testing.assert_allclose(capsules.end, [[0, 0, 1], [1, 0.5, 1]])
    np.testing.assert_allclose(capsules.radius, [0.1, 0.05])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"workspace": (0.5, -0.4, 0.0, 0.4, 0.4, 0.5)}, "the workspace runs from"),
        ({"workspace": (np.nan, -0.4, 0.0, 0.4, 0.4, 0.5)}, "the workspace runs from"),
        ({"voxel": -1.0}, "voxel is -1.0; give 0 or more"),
        ({"voxel": np.nan}, "voxel is nan"),
        ({"voxel": 5.0}, "voxel is 5 m; give metres: 5 mm are 0.005 m"),
        ({"min_cluster": 0}, "min_cluster is 0"),
        ({"colour": (1, 2, 300)}, "0 to 255"),
        ({"colour": (1, 2, 3), "pick": ("left", 1, 1)}, "are both given"),
        ({"sync_tolerance": -1.0}, "sync_tolerance is -1"),
        ({"sync_tolerance": 20.0}, "is 20 s; give seconds: 20 ms are 0"),
    ],
)
def test_bad_settings(wrong, said):
    with pytest.raises(ParameterError, match=said):
        PerceptionSettings(**wrong)
