"""Cloths that do not lie flat: registered to the first clouds, pleated, free of stress as bent."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from gendom.datasets import ObjectDescription, Recording
from gendom.estimation import Hold, Lift, ReplaySettings, Theta
from gendom.estimation.priors import SHAPE_SD
from gendom.estimation.shapes import best_sheet, held_height, shaped
from gendom.sim import cloth

SIDE = 0.2


@pytest.fixture(scope="module")
def body():
    return cloth(width=SIDE, height=SIDE, thickness=0.002, dx=0.02)


def test_without_a_shape_it_lies_flat(body):
    """The defaults of a hold are those of a flat cloth, whose held point is the origin."""
    hold = Hold(inset=0.03, aside=0.01)
    x, curvature = shaped(body.material_coordinates, hold, None, width=SIDE, height=SIDE)
    assert not hold.shaped and held_height(hold) == 0.0
    assert np.all(curvature == 0.0)
    a, b, z = body.material_coordinates.T
    flat = np.stack([(a + b) / math.sqrt(2) - 0.03, (b - a) / math.sqrt(2) - 0.01, z], axis=1)
    assert x == pytest.approx(flat, abs=1e-12)


def test_what_makes_a_shape_has_a_prior():
    """Every value that only a cloth with a shape has is searched, and no other."""
    names = [field.name for field in fields(Hold)]
    assert names[names.index("east") :] == list(SHAPE_SD)


def test_bent_as_told_it_is_free_of_stress(body):
    """A sheet bent to the curvature that it is free of stress with has not been strained."""
    curvature = np.tile(np.diag([5.0, 0.0]), (body.num_particles, 1, 1))
    bent = type(body)(**{**vars(body), "curvature": curvature})
    a, b, z = body.material_coordinates.T
    radius, angle = 0.2, a / 0.2
    x = np.stack([(radius + z) * np.sin(angle), b, (radius + z) * np.cos(angle)], axis=1)
    first, second = body.lattice[:, :, 0], body.lattice[:, :, 1]
    F = np.swapaxes(x[second] - x[first], 1, 2) @ bent.rest_frames
    # at the rim differences are one-sided, and a chord is no tangent
    inner = (np.abs(a - SIDE / 2) < SIDE / 2 - 0.01) & (np.abs(b - SIDE / 2) < SIDE / 2 - 0.01)
    strain = np.swapaxes(F, 1, 2) @ F - np.eye(3)
    assert np.abs(strain[inner]).max() < 2e-3
    flat = np.swapaxes(body.x[second] - body.x[first], 1, 2) @ bent.rest_frames
    assert np.abs(np.swapaxes(flat, 1, 2) @ flat - np.eye(3))[inner].max() > 5e-3


def test_a_pleat_stands_where_it_is_held(body):
    """It rises along the held diagonal near the held point and leaves the far cloth flat."""
    hold = Hold(inset=0.03, pleat=1.0, pleat_width=0.04)
    x, curvature = shaped(body.material_coordinates, hold, None, width=SIDE, height=SIDE)
    far = x[:, 0] > 0.13
    near = np.hypot(x[:, 0], x[:, 1]) < 0.01
    assert np.abs(x[far, 2]).max() < 0.002
    crest = x[near, 2].max()
    assert crest == pytest.approx(2.0 * held_height(hold), abs=0.004) and crest > 0.02
    assert np.abs(curvature).max() > 10.0


def ridged(high):
    """[n, 3] a square, its corner in the origin, with a ridge so high and 8 cm wide across."""
    a, b = (g.ravel() for g in np.meshgrid(*[np.linspace(0.0, SIDE, 60)] * 2))
    u, v = (a + b) / math.sqrt(2), (b - a) / math.sqrt(2)
    up = high * np.clip(1.0 - ((u - 0.16) / 0.04) ** 2, 0.0, None) ** 2
    return np.stack([u, v, up], axis=1)


def lift_of(resting):
    """A recording of a cloth that lies like these points [n, 3] and is then lifted."""
    hanging = ridged(0.0)[:, [2, 1, 0]] + [0.0, 0.0, 0.006]
    time = np.linspace(0.0, 1.5, 16)
    path = np.stack([0.0 * time, 0.0 * time, 0.02 + 0.12 * time], axis=1)
    return Recording.from_frames(
        [resting] * 4 + [hanging] * 12,
        time=time,
        gripper_position=path,
        object=ObjectDescription(kind="cloth", width=SIDE, height=SIDE, grasp="corner"),
        table_height=0.0,
        gripper_source="commanded",
        source="made by a test",
    )


def test_worlds_of_other_shapes_are_as_each_alone():
    """Shapes that are free of stress differ from world to world of one call."""
    holds = [Hold(), Hold(pleat=0.9, pleat_width=0.04), Hold(), Hold(arch_along=6.0)]
    theta = Theta(specific_modulus=3000.0)
    settings = ReplaySettings(cells_across=0.6, threads=2)
    lift = Lift(lift_of(ridged(0.0)), settings, hold=Hold())
    x = lift.simulate([theta] * 4, frames=[4, 8], holds=holds)
    for w, hold in enumerate(holds):
        alone = lift.simulate([theta], frames=[4, 8], holds=[hold])
        np.testing.assert_array_equal(x[:, w], alone[:, 0])
    assert min(np.abs(x[:, w] - x[:, 0]).max() for w in (1, 3)) > 2e-3


@pytest.mark.parametrize(
    ("high", "nearer", "taken"), [(0.03, 0.5, 1), (0.03, 0.95, 0), (0.0, 0, 0)]
)
def test_a_shape_is_sought_where_the_clouds_show_one(monkeypatch, high, nearer, taken):
    """A cloth that lies flat stays flat, and one with a ridge too, unless that brings it nearer."""
    lying = ridged(high)
    lying[0, 2] = 0.006  # what little of a flat cloth stands above the crop
    seen = lift_of(lying[lying[:, 2] > 0.005])

    def as_guessed(simulate, clouds, floor, bounds, starts, **_):
        return replace(starts[0], loss=nearer if starts[0].hold.shaped else 1.0)

    monkeypatch.setattr("gendom.estimation.lift.fit_hold", as_guessed)
    monkeypatch.setattr("gendom.estimation.shapes.TURNS", np.zeros(1))
    lift = Lift(seen, ReplaySettings(threads=1))
    assert lift.hold is not None and lift.hold.shaped == bool(taken)
    assert (lift.body.curvature is not None) == bool(taken)


def test_a_ridge_is_registered(monkeypatch):
    """A sheet with a ridge across comes back from the part of it that stands above a crop."""
    monkeypatch.setattr("gendom.estimation.shapes.TURNS", np.radians([0.0, 10.0]))
    points = ridged(0.02)
    seen = points[points[:, 2] > 0.008]
    sheet = best_sheet(
        seen, np.zeros(2), yaw=0.0, size=SIDE, floor=0.008, table=0.0, inset=0.0, aside=0.0
    )
    nodes = sheet.nodes.reshape(-1, 3)
    c, s = math.cos(sheet.yaw), math.sin(sheet.yaw)
    world = nodes @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    assert KDTree(world).query(seen)[0].mean() < 0.006
    edges = np.linalg.norm(np.diff(sheet.nodes, axis=0), axis=-1)
    assert edges == pytest.approx(np.full(edges.shape, SIDE / 28), rel=0.15)
    low = np.hypot(world[:, 0], world[:, 1]) < 0.05
    assert np.abs(world[low, 2]).max() < 0.006
