"""Clouds of known geometry: the error has the size of the depth noise, and no bias."""

import numpy as np
import pytest

from gendom.perception import CameraView, PerceptionSettings, perceive_frame
from gendom.perception.colour import ObjectColour, lab
from gendom.reality import sensor

SETTINGS = PerceptionSettings(workspace=(-0.3, -0.3, -0.1, 0.4, 0.3, 0.5))


def expected_rms(world, camera, thing, points):
    """RMS of the distance to a surface that depth noise causes: noise x slope of the distance."""
    T = camera.T_world_camera
    depth = (points - T[:3, 3]) @ T[:3, 2]
    along = (points - T[:3, 3]) / depth[:, None]
    h = 1e-6
    slope = (thing.distance(points + h * along) - thing.distance(points - h * along)) / (2 * h)
    return np.sqrt(np.mean((world.depth_rms(camera, depth) * slope) ** 2))


def thing_of(world, name):
    s = np.linspace(0.0, 1.0, 40)
    helix = np.stack([0.1 * np.cos(5 * s), 0.1 * np.sin(5 * s), 0.05 + 0.3 * s], axis=1)
    return {
        "plane": world.Plane(0.0, colour=world.RED),
        "sphere": world.Sphere((0.02, -0.01, 0.15), 0.08),
        "rope": world.Rope(helix, radius=0.008),
        "thin rope": world.Rope(helix, radius=0.005),
    }[name]


def on_table(world, thing, cameras, *, sensor=None, height=0.0):
    """Views that know their table, and pictures of a thing on it."""
    scene, views = world.Scene([world.Plane(), thing]), []
    pictures = [
        scene.pictures(camera, sensor=sensor or world.NOISE, seed=k)
        for k, camera in enumerate(cameras)
    ]
    for camera, seen in zip(cameras, pictures, strict=True):
        views.append(CameraView(camera, SETTINGS))
        views[-1].find_table(seen.depth, height)
    return views, pictures


@pytest.mark.parametrize(("name", "within"), [("plane", 0.03), ("sphere", 0.1), ("rope", 0.2)])
def test_error_of_pixels_is_that_of_the_noise(world, name, within):
    """Without noise that of the depth unit of 0.1 mm. What a curved surface adds to the noise's
    grows with it over the radius."""
    thing, camera = thing_of(world, name), world.make_camera()
    view, scene = CameraView(camera, SETTINGS), world.Scene([thing])
    points, counts = view.segment(scene.pictures(camera, sensor=world.EXACT))
    assert len(points) == counts[-1] > 500
    assert np.abs(thing.distance(points)).max() < 6e-5
    points, _ = view.segment(scene.pictures(camera))
    error = thing.distance(points.astype(float))
    expected = expected_rms(world, camera, thing, points)
    assert 5e-4 < expected < 5e-3
    assert np.sqrt(np.mean(error**2)) == pytest.approx(expected, rel=within)
    assert abs(error.mean()) < 1e-3


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("name", ["sphere", "thin rope"])
def test_fused_cloud_has_no_bias(world, name, whole):
    """Two cameras, table removed, colour chosen, voxels and outliers: below the pixels' noise. The
    whole sensor has shared noise, shadows, edges that are lost or hang between, and dropout."""
    thing, cameras = thing_of(world, name), world.pair(scale=1.0)
    views, pictures = on_table(world, thing, cameras, sensor=sensor if whole else None)
    cloud = perceive_frame(views, pictures, colour=ObjectColour.near(lab(world.RED)))
    error = thing.distance(cloud.points.astype(float))
    noise = max(world.depth_rms(camera, 0.8) for camera in cameras)
    assert len(cloud.points) > 400
    assert abs(error.mean()) < 1e-3
    assert 0.3 * noise < np.sqrt(np.mean(error**2)) < (2.5e-3 if whole else noise)
    # Both sides of the object are there.
    assert whole or all(0.2 < np.mean(cloud.seen_by == bit) for bit in (1, 2))


def test_table_fit_measures_plane_and_noise(world):
    camera = world.make_camera()
    view = CameraView(camera, SETTINGS)
    scene = world.Scene([world.Plane(0.013), world.lifted_rope()])
    view.find_table(scene.pictures(camera).depth, None)
    assert view.table is not None
    assert view.table.height(0.0, 0.0) == pytest.approx(0.013, abs=5e-4)
    assert np.degrees(np.arccos(view.table.normal[2])) < 0.1
    assert view.table.noise == pytest.approx(world.depth_rms(camera, 1.0), rel=0.05)
