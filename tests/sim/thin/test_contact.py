"""Rods and shells that meet themselves: they keep their thickness and never cross."""

from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Gripper, Table, cloth, rope
from gendom.sim.thin.contact import check_cloth
from sim.thin.shared import model_of
from validation.bench import flat_simulator


def nearest(x, apart):
    """Least distance [m] between edges of a rope [n, 3] that are so many points apart."""
    share = np.linspace(0.0, 1.0, 9)[:, None, None]
    along = x[:-1] + share * (x[1:] - x[:-1])
    d = np.linalg.norm(along[:, None, :, None] - along[None, :, None], axis=-1).min(axis=(0, 1))
    i = np.arange(len(x) - 1)
    return d[np.abs(i[:, None] - i) >= apart].min()


def coiling_rope(**options):
    body = rope(
        diameter=0.01, length=0.4, start=(0, 0, 0.42), direction=(0.02, 0.01, -1), points=41
    )
    s = flat_simulator(
        body, [Material(E=2e5, damping=0.01)], engine="thin", table=Table(height=0.0), **options
    )
    return s.run(np.linspace(0.1, 1.0, 37))[:, 0]


def test_a_rope_that_falls_on_itself_keeps_its_thickness():
    assert min(nearest(x, 4) for x in coiling_rope(self_contact=True)) > 0.95 * 0.01
    assert min(nearest(x, 4) for x in coiling_rope()) < 0.5 * 0.01


def test_contact_keeps_momentum():
    """The ends of an open ring in space fly into each other."""
    turn = np.linspace(-0.85, 0.85, 200) * np.pi
    ring = 0.05 * np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    body = rope(diameter=0.01, centre_line=ring, points=31)
    space = {"gravity": (0, 0, 0), "air_density": 0.0, "self_contact": True}
    s = flat_simulator(body, [Material(E=1e5)], **space)
    u = np.linspace(-1.0, 1.0, 31)
    s.set_velocities(np.stack([-1.5 * u**5, 0.1 * u, 0.2 * u**2], axis=1))
    engine: Any = s.engine
    mass = engine.model.mass[0]
    before = mass @ s.velocities()[0]
    x = s.run(np.linspace(0.005, 0.1, 20))[:, 0]
    assert 0.0098 < min(nearest(f, 20) for f in x) < 0.0104  # they do meet
    np.testing.assert_allclose(mass @ s.velocities()[0], before, rtol=0, atol=1e-12)


def simulated(body, hands, **options):
    return flat_simulator(
        body, [Material(E=1e5, density=400.0, damping=0.01)], engine="thin", grippers=hands,
        table=Table(height=0.0, friction=0.4), self_contact=True, **options,
    )  # fmt: skip


def dropped(n, **options):
    """A cloth that hangs by its middle, is let down to the table, and dropped: the body, and its
    points [T, n n, 3]."""
    size = 0.011 * (n - 1)
    body = cloth(
        width=size, height=size, thickness=0.001, dx=0.02, points=(n, n),
        corner=(-size / 2, -size / 2, 0.8 * size),
    )  # fmt: skip
    top = np.array([0.001, 0.002, 0.8 * size])
    let_down = Gripper(
        time=[0, 0.4, 0.9], position=[top, top, top * [1, 1, 0.1]], radius=0.012, hold_until=0.95
    )
    s = simulated(body, [let_down], **options)
    return body, s.run(np.linspace(0.02, 1.5, 75))[:, 0]


CUDA = pytest.param(16, "cuda", marks=pytest.mark.gpu)


@pytest.mark.parametrize(
    ("n", "device"), [(11, "cpu"), pytest.param(16, "cpu", marks=pytest.mark.slow), CUDA]
)
def test_a_crumpled_cloth_never_crosses_and_can_be_pulled_apart(n, device):
    """By two corners. Layers above push none below the table."""
    body, heap = dropped(n, device=device)
    assert min(f[:, 2].min() for f in heap) > 0.499 * body.thickness
    size, corners, model = 0.011 * (n - 1), heap[-1][[0, -1]], model_of(body)
    up, apart = np.array([0, 0, 1.2 * size]), np.array([[-0.48, -0.48, 0], [0.48, 0.48, 0]]) * size
    hands = [
        Gripper(time=[0, 1.0, 2.0], position=[at, at + up, to + up], radius=0.0004)
        for at, to in zip(corners, apart, strict=True)
    ]
    s = simulated(body, hands, positions=heap[-1], device=device)
    x = s.run(np.linspace(0.02, 2.2, 110))[:, 0]
    for f in (*heap, *x):
        check_cloth(f, model)
    # 0.65 to 0.90, as it is rounded; a smaller one unfolds
    assert n == 11 or np.ptp(heap[74], axis=0)[:2].prod() < 0.95 * size**2
    assert np.linalg.norm(x[-1, -1] - x[-1, 0]) > 0.94 * size * np.sqrt(2.0)


def test_a_body_that_begins_in_itself_is_an_error():
    thick = cloth(width=0.1, height=0.1, thickness=0.008, dx=0.02, points=(10, 10))
    line = rope(diameter=0.01, length=0.3, points=31)
    turn = np.linspace(0.0, 2.2 * np.pi, 31)
    ring = 0.3 / (2.2 * np.pi) * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    sheet = cloth(width=0.1, height=0.1, thickness=0.001, dx=0.02, points=(11, 11))
    folded = sheet.points.copy()
    over = folded[:, 0] > 0.05
    folded[over, 0] = 0.1 - folded[over, 0] + 0.001
    folded[over, 2] = 0.004
    nearer, crossing = folded.copy(), folded.copy()
    nearer[over, 2] = 0.0003
    crossing[over, 2] -= 0.08 * (folded[over, 1] - 0.024)
    flat_simulator(line, [Material()], positions=ring)
    flat_simulator(sheet, [Material()], positions=folded, self_contact=True)
    for body, x, said in (
        (thick, thick.points, "cannot be folded"),
        (line, ring, "the rope begins in itself"),
        (sheet, nearer, "the cloth begins in itself: two layers"),
        (sheet, crossing, "the cloth begins crossing itself"),
    ):
        with pytest.raises(ParameterError, match=said):
            flat_simulator(body, [Material()], positions=x, self_contact=True)
