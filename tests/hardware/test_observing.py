"""Where a rope ends, from its cloud; and what that says an action reached."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gendom.arrays import placed
from gendom.datasets import ObjectDescription, Recording
from gendom.errors import RecordingError
from gendom.hardware.cell import BARE
from gendom.hardware.execution import PlannedAction, Trajectory
from gendom.hardware.observing import reached, rope_tip
from gendom.materials import Material, Rope
from gendom.perception.cloud import fuse
from gendom.robot import XARM7
from gendom.tasks import ClothSpreading, RopeReaching
from gendom.tasks.areas import spread_areas
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.tasks.world import Simulation

ROPE = Rope(length=0.3, diameter=0.016, material=Material(E=8.0e5, density=800.0))


def cloud_of(line, rng, side=(0.0, -1.0, 0.3)):
    """Points of the half of a tube's surface that faces one side, with 1 mm of noise."""
    s = rng.uniform(0.0, 1.0, 600)
    along = np.linspace(0.0, 1.0, len(line))
    x = np.stack([np.interp(s, along, line[:, k]) for k in range(3)], axis=1)
    turned = rng.normal(size=(600, 3)) + 1.5 * np.array(side)
    tangent = np.gradient(line, axis=0)[np.clip((s * len(line)).astype(int), 0, len(line) - 1)]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    turned -= np.sum(turned * tangent, axis=1, keepdims=True) * tangent
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    cloud = x + 0.5 * ROPE.diameter * turned + rng.normal(scale=1e-3, size=(600, 3))
    return cloud[np.unique((cloud / 0.005).astype(int), axis=0, return_index=True)[1]]


@pytest.mark.parametrize("bend", [0.0, 4.5])
def test_the_tip_is_where_the_rope_ends_however_it_bends(bend):
    """4.5 rad: the tip comes near to the middle again, and is not the farthest point."""
    rng = np.random.default_rng(0)
    angle = bend * np.linspace(0.0, 1.0, 61)
    steps = 0.005 * np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=1)[:60]
    line = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    tip = rope_tip(cloud_of(line, rng), line[0], ROPE.diameter, 0.24)
    assert tip is not None and np.linalg.norm(tip - line[-1]) < 0.008
    hidden = cloud_of(line[:40], rng)
    assert rope_tip(hidden, line[0], ROPE.diameter, 0.24) is None


class Dragging(RopeReaching):
    name, watches = "cloth-dragging", "all"


def test_what_was_reached_is_seen_within_millimetres_and_nothing_is_made_up():
    """From clouds of a simulated release."""
    task, action, rng = RopeReaching(), (0.18, 0.09), np.random.default_rng(0)
    outcome = Simulation(everything=True).carry_out(task, [ROPE], [action], keep=True)[0]
    T, swung = task.T_world_task(ROPE), cast(Any, outcome.seen)
    plan = BARE.plan(task.tool_path(ROPE, np.array(action)).moved(T), opening=ROPE.diameter)
    motion = plan.motion
    time = np.arange(max(float(swung.times[0]), motion.start), swung.times[-1], 1.0 / 30.0)
    lines = CubicSpline(swung.times, swung.points)(time)
    clouds = [placed(T, cloud_of(x, rng)).astype(np.float32) for x in lines]
    hand = motion.tcp_at(XARM7, time)[:, :3, 3]
    done = PlannedAction(
        task=task.name, action=dict(zip("xz", action, strict=True)), goal={}, object={},
        trajectory=Trajectory(T_base_task=T), plan=plan,
    )  # fmt: skip

    def recorded(every):
        return Recording.from_frames(
            clouds[::every], time=time[::every] + 5.0, gripper_position=hand[::every],
            object=ObjectDescription(kind="rope", length=0.3, mass=0.05),
        )  # fmt: skip

    start = motion.start + 5.0
    found = reached(task, ROPE, done, recorded(1), start)
    assert found["x"] == pytest.approx(outcome.values["x"], abs=0.006)
    assert found["sideways"] < 0.01
    with pytest.raises(RecordingError, match=r"tip is seen in \d pictures after the release"):
        reached(task, ROPE, done, recorded(5), start)
    with pytest.raises(RecordingError, match="cloth-dragging watches something else; write down"):
        reached(Dragging(), ROPE, done, recorded(5), start)


def lying(how, rng, side=0.2, n=41):
    """[n n, 3] a cloth on its table, seen turned: flat, folded or wrinkled in a part."""
    s = np.linspace(0.0, side, n)
    x, y = np.meshgrid(s, s, indexing="ij")
    z, begins = np.full_like(x, 0.001), rng.uniform(0.25, 0.75) * side
    if how == "folded":
        over = x > begins
        x[over], z[over] = 2.0 * begins - x[over], 0.004
    elif how == "wrinkled":
        wave = rng.uniform(0.15, 0.25) * side
        high = rng.uniform(0.4, 0.7) * wave / 6.0
        z += high * (1.0 + np.sin(2.0 * np.pi * x / wave)) * (x > begins)
        rise = np.gradient(z, s, axis=0)
        x = np.cumsum(np.sqrt(np.maximum(1.0 - rise**2, 0.05)), axis=0) * s[1]
    turn = rng.uniform(0.0, 2.0 * np.pi)
    return np.stack([x, y, z], axis=-1) @ Rotation.from_euler("z", -turn).as_matrix()


@pytest.mark.parametrize("how", ["flat", "folded", "wrinkled"])
def test_areas_of_a_cloth_are_those_of_its_shape(how):
    """Beside the areas that the task itself measures, on a cloud of 5 mm with 0.7 mm of noise."""
    rng = np.random.default_rng(["flat", "folded", "wrinkled"].index(how))
    task = ClothSpreading()
    item = task.item
    shape = lying(how, rng)
    i, j = rng.uniform(0.0, 39.999, (2, 9000))
    k, m, a, b = i.astype(int), j.astype(int), (i % 1.0)[:, None], (j % 1.0)[:, None]
    cloud = (1 - b) * ((1 - a) * shape[k, m] + a * shape[k + 1, m])
    cloud += b * ((1 - a) * shape[k, m + 1] + a * shape[k + 1, m + 1])
    cloud += rng.normal(0.0, 7e-4, cloud.shape)
    cloud = fuse([cloud.astype(np.float32)])[0]
    T = task.T_world_task(item)
    where = ObjectDescription(kind="cloth", width=0.2, height=0.2, mass=0.02)
    seen = Recording.from_frames([placed(T, cloud).astype(np.float32)], time=np.zeros(1),
                                 gripper_position=np.zeros((1, 3)), object=where)  # fmt: skip
    action = SimpleNamespace(trajectory=Trajectory(T_base_task=T))
    found = reached(task, item, cast(Any, action), seen, 0.0)
    share, covered = spread_areas(shape.reshape(-1, 3) / 0.2, lattice_triangles(41, 41))
    assert found["covered"] == pytest.approx(covered, abs=0.02)
    assert found["share"] == pytest.approx(share, abs=0.08)
    assert found["unspread"] == 1 - found["share"]
