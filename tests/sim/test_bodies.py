"""Ropes and cloths at rest: volume, second moments, spacing, lattice."""

import math

import numpy as np
import pytest

from gendom.sim import cloth, rope


def arc(radius, angle, n=400):
    """Points [n, 3] of a circular arc that starts at the origin along x."""
    a = np.linspace(0.0, angle, n)
    return np.stack([radius * np.sin(a), radius * (1 - np.cos(a)), np.full(n, 0.1)], axis=1)


def section(body):
    """[n, 2] particles of the first cross-section in the rope's own frame."""
    along = body.material_coordinates[:, 0]
    return body.material_coordinates[along == along[0], 1:]


@pytest.mark.parametrize(("length", "end"), [(0.05, 0.05), (0.31, 0.31), (None, 0.2)])
def test_rope_volume_is_exact(length, end):
    """Particles share pi / 4 d^2 L; a stated length cuts or extends the line."""
    for line in (arc(0.2, 1.0, n=4000), [(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0)]):
        body = rope(diameter=0.02, centre_line=line, length=length, cells_across=2.2)
        volume = body.volume * body.num_particles
        assert volume == pytest.approx(math.pi / 4 * 0.02**2 * end, rel=1e-6)
    assert body.x[:, 0].max() == pytest.approx(end, abs=0.5 * body.dx)


@pytest.mark.parametrize("cells", [1.0, 1.5, 4.5])
def test_rope_bends_like_its_round_section(cells):
    """Mean squared distance of particles from both middle planes is d^2 / 16, uncorrelated.

    Particles carry stress at points, so their own second moment is the one that bends.
    """
    s = section(rope(diameter=0.02, length=0.2, cells_across=cells))
    moments = s.T @ s / len(s)
    assert np.allclose(moments, np.eye(2) * 0.02**2 / 16.0, rtol=1e-9, atol=1e-12)
    assert np.allclose(s.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize(("thickness", "layers"), [(0.001, 2), (0.009, 2), (0.015, 3), (0.04, 8)])
def test_cloth_bends_like_its_section(thickness, layers):
    """Layers have mean z^2 = h^2 / 12 about the middle plane; two when thinner than a cell."""
    body = cloth(width=0.2, height=0.1, thickness=thickness, dx=0.01, corner=(0, 0, 0.3))
    z = body.x[:, 2] - 0.3
    assert len(np.unique(z.round(9))) == layers
    assert np.mean(z**2) == pytest.approx(thickness**2 / 12.0)
    assert abs(z.mean()) < 1e-15


@pytest.mark.parametrize(
    "body",
    [
        rope(diameter=0.02, centre_line=arc(0.1, 1.2), cells_across=2.0),
        cloth(width=0.2, height=0.1, thickness=0.001, dx=0.01, yaw=0.3),
        cloth(width=0.04, height=0.03, thickness=0.05, dx=0.01),
    ],
    ids=["rope", "cloth", "block"],
)
def test_rest_frames_give_back_any_affine_map(body):
    """Differences to the neighbours times the rest frame are A when x = A X + b."""
    A = np.eye(3) + 0.3 * np.random.default_rng(1).normal(size=(3, 3))
    x = body.x @ A.T + [1.0, 2.0, 3.0]
    D = np.swapaxes(x[body.lattice[:, :, 1]] - x[body.lattice[:, :, 0]], 1, 2)
    assert np.abs(D @ body.rest_frames - A).max() < 1e-9


def test_surface_of_a_rope_is_its_skin():
    """Outer particles stand half a diameter from the axis, also of a bent rope, on every side."""
    radius = 0.15
    body = rope(diameter=0.02, centre_line=arc(radius, 1.5, n=2000), cells_across=2.5)
    skin = body.surface(body.x)
    centre = np.array([0.0, radius, 0.1])
    flat = np.linalg.norm((skin - centre)[:, :2], axis=1) - radius
    height = skin[:, 2] - centre[2]
    assert np.hypot(flat, height) == pytest.approx(0.01, abs=1e-5)
    turn = np.arctan2(height, flat)
    assert np.histogram(turn, bins=6, range=(-np.pi, np.pi))[0].min() > 0.1 * len(skin)
