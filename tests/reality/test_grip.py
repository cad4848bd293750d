"""The grip's force: what is pulled harder slides as under dry friction."""

import math
from typing import cast

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import STANDARD_GRAVITY
from gendom.reality import OBJECTS, Layout, RealCloth, Reality, RealObject, RealRope, lift
from gendom.reality.trials import TrialRun
from gendom.robot import LiftMotion

ROPE = cast(RealRope, OBJECTS["rope-cotton"])
CLOTH = cast(RealCloth, OBJECTS["cloth-rubber-200mm"])


def hanging(item: RealObject, share: float) -> Reality:
    """An object that hangs from a hand that holds this share of its weight."""
    layout = Layout(origin=(0.4, 0.0, 0.8), along=(0.0, 0.0, -1.0))
    if isinstance(item, RealCloth):
        half = math.sqrt(0.5)
        layout = Layout(
            origin=(0.4, 0.0, 0.8), along=(half, 0.0, -half), across=(-half, 0.0, -half)
        )
    weight = item.mass * STANDARD_GRAVITY
    world = Reality(item, layout, timestep=0.00025, air_density=0.0, grip_force=share * weight)
    world.data.mocap_pos[0] = (0.4, 0.0, 0.795)
    world.step_to(0.0)
    world.attach(0.0125)
    return world


def fallen(world: Reality, seconds: float) -> float:
    """How far the object's middle falls in that time [m]."""
    before = world.vertices()[:, 2].mean()
    world.step_to(world.time + seconds)
    return before - world.vertices()[:, 2].mean()


@pytest.mark.parametrize(
    ("item", "share"), [(ROPE, 1.1), pytest.param(CLOTH, 3.0, marks=pytest.mark.slow)]
)
def test_what_a_grip_can_hold_stays(item, share):
    """A cloth that is let go flat by its corner pulls more than its weight at first."""
    world = hanging(item, share)
    held = len(world.held)
    x = world.vertices()[world.held]
    world.step_to(0.05)
    assert len(world.held) == held
    assert np.abs(world.vertices()[world.held] - x).max() < 2e-4


@pytest.mark.parametrize("share", [0.95, 0.5])
def test_what_is_too_heavy_slides_as_under_dry_friction(share):
    """1/2 (1 - F / W) g t^2."""
    seconds = 0.06
    expected = 0.5 * (1.0 - share) * STANDARD_GRAVITY * seconds**2
    assert fallen(hanging(ROPE, share), seconds) == pytest.approx(expected, rel=0.03)


@pytest.mark.slow
def test_a_cloth_slides_out_of_the_fingers():
    world = hanging(CLOTH, 0.5)
    assert 0.0 < fallen(world, 0.05) < 0.5 * STANDARD_GRAVITY * 0.05**2
    world.step_to(0.2)
    assert len(world.held) == 0
    # free fall from then on, until it meets the table at 0.37 s
    speed = -world.data.qvel[world._dofs][:, 2].mean()
    world.step_to(world.time + 0.02)
    faster = -world.data.qvel[world._dofs][:, 2].mean()
    assert faster - speed == pytest.approx(0.02 * STANDARD_GRAVITY, rel=0.01)


def test_a_lift_with_a_weak_grip_loses_its_rope():
    """The whole way: through `TrialRun`, under the arm."""
    trial = lift(ROPE, LiftMotion(kind="rope", rise=0.2, speed=0.3))
    weak = TrialRun(trial, grip_force=0.3 * ROPE.mass * STANDARD_GRAVITY)
    weak.step_to(weak.end)
    assert len(weak.world.held) == 0
    assert weak.world.vertices()[:, 2].max() < 0.05


@pytest.mark.parametrize("force", [0.0, -1.0, math.nan])
def test_forces_that_are_none(force):
    with pytest.raises(ParameterError, match="grip_force"):
        hanging(ROPE, force)
