"""Groups of worlds run in threads of their own: none undoes what another does."""

import threading
from typing import Any

import numpy as np
import pytest

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, Solver, cloth, rope
from gendom.sim.thin import rods
from gendom.sim.thin.engine import ThinEngine
from validation.bench import flat_simulator

BODY = rope(diameter=0.004, length=0.31, start=(-0.01, 0, 0), points=32)


def simulator(worlds=8, **settings):
    hand = Gripper.still((-0.005, 0, 0), radius=0.005)
    return flat_simulator(BODY, [Material(E=2e7)] * worlds, grippers=[hand], threads=2, **settings)


def test_borders_stay_stiff_when_two_groups_close_at_once(monkeypatch):
    """The first group's thread is stopped between reading and writing until the other is done."""
    whole, doubled = ThinEngine.stiffen, rods.slower
    order: list[int] = []
    other_done = threading.Event()

    def stiffen(self, worlds):
        order.append(threading.get_ident())
        whole(self, worlds)
        if threading.get_ident() != order[0]:
            other_done.set()

    def slower(stiffer):
        if threading.get_ident() == order[0]:
            other_done.wait(5.0)
        return doubled(stiffer)

    s = simulator()
    engine: Any = s.engine
    assert len(engine.groups()) == 2
    monkeypatch.setattr(ThinEngine, "stiffen", stiffen)
    monkeypatch.setattr(rods, "slower", slower)
    s.run([1e-5])
    assert other_done.is_set()
    given = engine.device_model.inertia.numpy()[:, 3][:, engine.slots]
    assert given.max() == pytest.approx(8.0 / 3.0)
    np.testing.assert_array_equal(given, np.tile(given[0], (8, 1)))


def test_opening_grippers_of_one_group_leave_the_others_where_they_are():
    """Half of the worlds let go while the other half move on."""
    body = cloth(width=0.3, height=0.1, thickness=0.001, dx=0.02, points=(16, 6))
    path = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.05)]
    early, late = (
        [Gripper(time=[0.0, 0.1], position=path, radius=0.02, hold_until=until)]
        for until in (0.02, 0.09)
    )
    hands = [early] * 8 + [late] * 8
    material = [Material(E=2e6, damping=0.004)] * 16
    together = Simulator(body, material, grippers=hands, solver=Solver(threads=2)).run([0.05, 0.1])
    for half, hand in ((slice(0, 8), early), (slice(8, 16), late)):
        alone = Simulator(body, material[:8], grippers=[hand] * 8, solver=Solver(threads=1)).run(
            [0.05, 0.1]
        )
        np.testing.assert_array_equal(together[:, half], alone)
