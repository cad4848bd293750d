"""The sensor's faults have the size that their formulas give, each alone."""

import numpy as np
import pytest

from gendom.reality import sensor
from gendom.reality.model import DEPTH_UNIT, default_cameras
from gendom.reality.sensor import RigErrors

F, B = 385.0, 0.05
CAMERA = default_cameras()[0].at(np.eye(4))
WIDTH, HEIGHT = CAMERA.width, CAMERA.height

GREY = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)


def tilted(angle, z=0.8):
    """A plane whose normal makes this angle [rad] with the central ray."""
    rays, normal = CAMERA.rays(), np.array([np.sin(angle), 0.0, np.cos(angle)])
    along = rays @ normal
    depth = np.where(along > 1e-3, z * normal[2] / along, 0.0)
    return depth.reshape(HEIGHT, WIDTH)


def step(near=0.6, far=1.0, column=320):
    return np.where(np.arange(WIDTH) < column, far, near) * np.ones((HEIGHT, 1))


OFF = {"SUBPIXEL": 0.0, "QUANTISATION": 1e-9, "EDGE_LOST": 0.0, "EDGE_MIXED": 0.0,
       "GRAZING_FROM": np.pi / 2, "GRAZING_TO": np.pi, "DROPOUT": 0.0, "MIN_RANGE": 0.0,
       "MAX_RANGE": np.inf, "COLOUR_NOISE": 0.0}  # fmt: skip


@pytest.fixture
def only(monkeypatch):
    """Leaves the named errors, and perhaps shadows, alone."""

    def leave(*, shadow=False, **errors):
        for name, value in (OFF | errors).items():
            monkeypatch.setattr(sensor, name, value)
        if not shadow:
            monkeypatch.setattr(sensor, "_in_shadow", lambda disparity: disparity < 0.0)

    return leave


def seen(depth, colour=GREY, seed=0, **how):
    return sensor.observe(depth, colour, CAMERA, np.random.default_rng(seed), **how)


def measured(depth):
    """Depth [m], NaN where none is."""
    counts = seen(depth).depth
    assert counts.dtype == np.uint16
    return np.where(counts > 0, counts * CAMERA.depth_unit, np.nan)


def test_without_noise_depth_is_exact_to_the_depth_unit():
    depth = tilted(0.5)
    depth[:5], depth[5:10] = 0.0, np.inf
    depth[10:12] = 7.0  # more than 65535 counts
    colour = np.arange(HEIGHT * WIDTH * 3).reshape(HEIGHT, WIDTH, 3).astype(np.uint8)
    pictures = seen(depth, colour, noisy=False)
    nothing = np.zeros((12, WIDTH))
    np.testing.assert_array_equal(pictures.depth[:12], nothing)
    np.testing.assert_array_equal(pictures.depth[12:], np.round(depth[12:] / DEPTH_UNIT))
    np.testing.assert_array_equal(pictures.colour, colour)


@pytest.mark.parametrize(("z", "correlation"), [(0.4, 2.0), (1.5, 0.0)])
def test_noise_is_that_of_stereo(z, correlation, only):
    """RMS = z^2 s / (f B). The second order of 1 / disparity adds less than 2 % here."""
    only(SUBPIXEL=0.08, CORRELATION=correlation)
    error = measured(np.full((HEIGHT, WIDTH), z)) - z
    expected = z**2 * 0.08 / (F * B)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(expected, rel=0.05)
    assert abs(error.mean()) < 0.05 * expected


def test_edges_lose_and_mix_depth(only):
    """Of the two columns at a step so many as asked, and no other pixel."""
    depth = step()
    only(EDGE_LOST=0.4, EDGE_MIXED=0.3)
    found = measured(depth)
    at = found[:, 319:321]
    assert np.isnan(at).mean() == pytest.approx(0.4, abs=0.05)
    assert ((at > 0.61) & (at < 0.99)).mean() == pytest.approx(0.3, abs=0.06)
    assert np.nanmin(found) > 0.599 and np.nanmax(found) < 1.001
    apart = np.delete(np.arange(WIDTH), [319, 320])
    np.testing.assert_allclose(found[:, apart], depth[:, apart], atol=DEPTH_UNIT)
    # planes have no edges
    depth = tilted(0.7)
    only(EDGE_LOST=1.0)
    np.testing.assert_allclose(measured(depth), depth, atol=DEPTH_UNIT)


def test_near_things_throw_a_shadow_to_their_left(only):
    """As wide as the disparities differ, and a band at the left as wide as the disparity."""
    only(shadow=True)
    found = measured(step(0.6, 1.0, 320))
    lost = np.flatnonzero(np.isnan(found[0]))
    near, far = F * B / 0.6, F * B / 1.0
    at_left, at_step = lost[lost < 100], lost[lost >= 100]
    assert len(at_left) == int(np.ceil(far)) and at_left[0] == 0
    assert at_step[-1] == 319 and len(at_step) == pytest.approx(near - far, abs=1.0)
    # To the right of a near thing nothing is hidden.
    assert not np.isnan(measured(step(1.0, 0.6, 320))[:, 40:]).any()


def test_range(only):
    depth = np.linspace(0.05, 4.0, WIDTH)[None].repeat(HEIGHT, axis=0)
    only(MIN_RANGE=0.17, MAX_RANGE=3.0)
    np.testing.assert_array_equal(np.isnan(measured(depth)), (depth < 0.17) | (depth > 3.0))
    # edges are no grazing surfaces and the rest is lost at random
    only(GRAZING_FROM=1.0, GRAZING_TO=1.2, DROPOUT=0.03)
    assert np.isnan(measured(step())).mean() == pytest.approx(0.03, rel=0.05)


def test_errors_of_a_rig_have_the_size_asked_for():
    rng = np.random.default_rng(0)
    T = np.eye(4)
    T[:3, :4] = [[0, -1, 0, 0.4], [1, 0, 0, -0.2], [0, 0, 1, 0.9]]
    found = [c.calibrated() for c in RigErrors().believed([CAMERA.at(T)] * 1500, rng)]
    moved = np.array([t[:3, 3] - T[:3, 3] for t in found])
    turned = np.array([t[:3, :3] @ T[:3, :3].T for t in found])
    angle = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt((moved**2).sum(axis=1).mean()) == pytest.approx(2e-3, rel=0.07)
    assert np.degrees(np.sqrt((angle**2).mean())) == pytest.approx(0.3, rel=0.07)
    np.testing.assert_allclose(turned @ np.swapaxes(turned, 1, 2), [np.eye(3)] * 1500, atol=1e-12)
    rig, none = RigErrors(), RigErrors(translation=0.0, rotation=0.0, clock_offset=0.0)
    assert (rig.stamp(0, 1.0), none.stamp(1, 1.0)) == (1.0, 1.0)
    assert rig.stamp(1, 1.0) == pytest.approx(1.02)
    (camera,) = none.believed([CAMERA], rng)
    np.testing.assert_array_equal(camera.calibrated(), np.eye(4))
