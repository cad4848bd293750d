"""What unknowns do to a simulated lift."""

import math
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from gendom.estimation import LiftScene, replay
from gendom.estimation.observed import SKIN_OF_THIN, NoiseModel, Observation
from gendom.estimation.replay import HEM, WorldInputs, held_reach, simulator_of
from gendom.estimation.scene import STRETCH
from gendom.materials.parameters import E_over_rho_of
from gendom.sim import Simulator, Table
from gendom.sim.lines import arc_length


def simulated(lift, changes, frames):
    """The scene of a lift, and its replays [T, W, N, 3] with changes of its truth."""
    scene = LiftScene.of(lift.at_rest(frames), lift.settings)
    return scene, replay(scene, [lift.truth.with_values(c) for c in changes])


def test_grip_height_raises_the_object_and_a_delay_shows_it_late(rope_lift):
    """What hangs 5 mm higher than stated is held 5 mm higher, once off the table; what is seen a
    frame late is where the gripper was a frame before."""
    step = float(rope_lift.at_rest(21).time[1])
    scene, x = simulated(rope_lift, [{}, {"grip_height": 0.005}, {"delay": step}], 21)
    held = int(np.linalg.norm(scene.body.points - scene.held[0], axis=1).argmin())
    rise = x[5:, 1, held, 2] - x[5:, 0, held, 2]
    assert rise == pytest.approx(0.005, abs=5e-4)
    top = x[..., 2].max(axis=2)
    assert top[5:, 2] == pytest.approx(top[4:-1, 0], abs=1e-3)
    assert (top[8:14, 0] - top[8:14, 2]).min() > 0.005


def test_a_soft_rope_keeps_its_length(rope_lift, monkeypatch):
    """Its fibres do, however little it resists bending: to what its weight may lengthen it by."""
    limp = E_over_rho_of(0.15 * rope_lift.object.length, rope_lift.object.diameter / 4.0, 9.81)
    scene = LiftScene.of(rope_lift.at_rest(6), rope_lift.settings)
    for stretch, most in ((STRETCH, 2.5e-3), (0.1, 0.03)):
        monkeypatch.setattr(import_module("gendom.estimation.replay"), "STRETCH", stretch)
        thetas = [rope_lift.truth.with_values({"E_over_rho": limp})]
        hung = replay(scene, thetas)[-1, 0]
        longer = arc_length(hung)[-1] / rope_lift.object.length - 1.0
        assert 0.1 * most < longer < most


def test_stiffness_along_a_thin_rope_makes_no_step_short(rope_lift):
    """Steps are as long as those of a rope as thick as its edges are long, which is as stiff in
    bending; it moves alike."""
    thin = replace(rope_lift.object, diameter=0.002)
    recording = replace(rope_lift.at_rest(6), object=thin)
    scene = LiftScene.of(recording, rope_lift.settings).simulated_with(25)
    bends = E_over_rho_of(0.5 * thin.length, 0.002 / 4.0, 9.81)
    theta = rope_lift.truth.with_values({"E_over_rho": bends})
    simulator, times = simulator_of(scene, [theta])
    bare = replace(simulator.materials[0], membrane=None)
    beside = Simulator(scene.body, [bare], grippers=[[WorldInputs.of(scene, theta).gripper(0)]],
                       table=Table(height=0.0, friction=theta.friction),
                       start_time=simulator.time)  # fmt: skip
    assert simulator.substep[0] > 2.5 * beside.substep[0]
    assert simulator.run(times)[-1, 0] == pytest.approx(beside.run(times)[-1, 0], abs=5e-4)


@pytest.mark.parametrize("axis", [False, True])
def test_a_held_corner_hangs_as_steep_as_told(cloth_lift, axis):
    """By an unknown of the grip, or as the gripper's axis turns down; or else it stays level."""
    frames, held = 6, replace(cloth_lift.object, grasp_radius=0.06)
    turns, level = [], np.array([0.5**0.5, 0.5**0.5, 0.0])
    for angle in (0.0, 0.5):
        down = np.linspace(0.0, angle if axis else 0.0, frames)[:, None]
        axes = np.cos(down) * level - np.sin(down) * [0.0, 0.0, 1.0]
        told = {"gripper_axis": axes} if axis else {}
        scene = LiftScene.of(cloth_lift.at_rest(frames, object=held, **told), cloth_lift.settings)
        tilt = {"grip_tilt": 0.0 if axis else angle}
        x = replay(scene, [cloth_lift.truth.with_values(tilt)])[-1, 0]
        along = x[scene.body.shape[1] + 1] - x[0]
        turns.append(math.atan2(-along[2], math.hypot(along[0], along[1])))
    assert turns == pytest.approx([0.0, 0.5], abs=0.01)


def test_a_tip_keeps_the_mass():
    inputs = WorldInputs.__new__(WorldInputs)
    inputs.positions = np.zeros((11, 3))
    inputs.weigh_tip(0.2)
    own = np.full(11, 0.1)
    own[[0, -1]] /= 2.0
    assert inputs.mass is not None
    assert float(inputs.mass @ own) == pytest.approx(1.0)
    assert float(inputs.mass[-1] * own[-1]) == pytest.approx(0.2 + 0.8 * 0.05)


@pytest.fixture(scope="module")
def scene(cloth_lift):
    return LiftScene.of(cloth_lift.at_rest(4), cloth_lift.settings)


def inputs(scene, cloth_lift, **values):
    return WorldInputs.of(scene, cloth_lift.truth.with_values(values))


def test_warp_and_weft_share_their_geometric_mean(scene, cloth_lift):
    material = inputs(scene, cloth_lift, warp_over_weft=4.0).material
    assert (material.warp, material.weft) == pytest.approx((2.0, 0.5))
    plain = inputs(scene, cloth_lift).material
    assert plain == replace(material, warp=1.0, weft=1.0)


def test_a_hem_counts_by_its_area(scene, cloth_lift):
    """A border of 10 mm of 0.2 m, whatever the points; the mass stays as stated."""
    side, counts = 0.2, scene.body.shape
    hemmed = inputs(scene, cloth_lift, hem_stiffness=5.0, hem_mass=2.0)
    weight = np.ones(counts)
    weight[[0, -1]] /= 2.0
    weight[:, [0, -1]] /= 2.0
    mean = weight.ravel() / weight.sum()
    area = 1.0 - (1.0 - 2.0 * HEM / side) ** 2
    assert hemmed.stiffness @ mean == pytest.approx(1.0 + 4.0 * area)
    assert hemmed.mass is not None and hemmed.mass @ mean == pytest.approx(1.0)
    middle = hemmed.mass.reshape(counts)[counts[0] // 2, counts[1] // 2]
    assert middle == pytest.approx(1.0 / (1.0 + area))


def test_fingers_hide_what_they_hold(rope_lift):
    """Of a rope twice their reach beyond where it is held, and nothing of its far end. Elsewhere a
    shape where no points are counts, but for what it hides of itself."""
    scene = LiftScene.of(rope_lift.seen(frames=5), rope_lift.settings)
    observation = Observation(scene)
    seen, (own, share) = observation.in_view, observation.shape.samples
    x = np.einsum("mk,mka->ma", share, scene.initial[own])
    away = np.linalg.norm(x - scene.held[0], axis=1)
    assert not seen[away < 2.0 * held_reach(scene)].any() and (away < held_reach(scene)).any()
    assert seen[away > 0.1].all()
    aside = np.repeat(scene.initial[None] + [0.0, 0.5, 0.0], len(scene.frames), axis=0)
    for hidden in (False, True):
        sight = np.full(len(seen), not hidden)
        counts = observation.rows(aside, 0.006, lambda _, s=sight: s).counts[:, -len(seen) :]
        assert ((counts > 0.0) == (seen & sight)).all()


def test_a_point_is_as_far_from_a_sheet_as_it_is(scene):
    """Wherever its foot is; beyond an edge as far as it is beyond half a spacing. No skin makes up
    for noise that is thicker than a cloth."""
    assert NoiseModel().of(scene, True).skin == SKIN_OF_THIN
    observation, rng, r = Observation(scene), np.random.default_rng(0), 0.001
    shape = np.repeat(scene.initial[None], len(scene.frames), axis=0)
    flat = scene.initial.reshape(*scene.body.shape, 3)
    first, second = flat[0, -1] - flat[0, 0], flat[-1, 0] - flat[0, 0]
    s, t = rng.uniform(0.01, 0.99, (2, *observation.counts.shape))
    high, beyond = rng.uniform(-0.003, 0.003, s.shape), np.zeros(s.shape)
    beyond[:, ::3] = rng.uniform(0.0, 0.02, beyond[:, ::3].shape)
    s = np.where(beyond > 0.0, 1.0 + beyond / np.linalg.norm(first), s)
    places = flat[0, 0] + s[..., None] * first + t[..., None] * second
    observation.points = places + high[..., None] * [0.0, 0.0, 1.0]
    hidden = np.zeros(len(observation.in_view), bool)
    aside = np.maximum(beyond - 0.5 * observation.shape.spacing, 0.0)
    rows = observation.rows(shape, r, lambda _: hidden)
    points = rows.rho[:, : high.shape[1]]
    np.testing.assert_allclose(points, np.hypot(high, aside) - r, atol=1e-9)
    # shapes that move along the normals come as much nearer
    way = 1e-8 * (first / np.linalg.norm(first) + [0.0, 0.0, 1.0])
    nearer = points - observation.rows(shape + way, r, lambda _: hidden).rho[:, : high.shape[1]]
    np.testing.assert_allclose(nearer, rows.normal[:, : high.shape[1]] @ way, atol=1e-12)
