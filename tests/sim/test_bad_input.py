"""Arguments of another type, shape or range end in one line that names them."""

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.materials.parameters import OF_THIN
from gendom.sim import (
    Capsule,
    Cuboid,
    Gripper,
    Rollout,
    Simulator,
    Solver,
    Sphere,
    Table,
    cloth,
    open_device,
    rope,
)
from validation.bench import flat_simulator, moved

nan, inf = math.nan, math.inf
RAGGED = [[0.0, 1.0], [2.0]]

ROPE = rope(diameter=0.01, length=0.3)
MATERIAL = Material()
HAND = Gripper.still((0.0, 0.0, 0.0), radius=0.02)


def refused(make, **given):
    """The one line with which an argument is refused."""
    with pytest.raises(ParameterError) as found:
        make(**given)
    message = str(found.value)
    assert "\n" not in message and len(message) < 300
    return message


# ---- one argument is wrong -----------------------------------------------------------------------

PATH = {"time": [0.0, 1.0], "position": [[0, 0, 0], [0, 0, 1]], "radius": 0.01}


def made(kind="thin", **given):
    return flat_simulator(**{"body": ROPE, "materials": [MATERIAL], "engine": kind, **given})


def of_made(method, kind="thin"):
    return lambda **given: getattr(made(kind, grippers=[HAND]), method)(**given)


def each(values, names):
    return {name: values for name in names.split()}


SIMULATORS = {
    **each([3, None], "body"),
    "materials": [MATERIAL, [3]],
    "grippers": [HAND, [3], [[3]], [HAND, 3], "two"],
    **each([3], "table device self_contact"),
    "gravity": [RAGGED, (0.0, -9.81), (0.0, 0.0, nan)],
    **each([RAGGED, -1.0], "velocity_damping air_density self_friction stiffness mass"),
    "positions": [RAGGED, np.zeros((5, 3)), np.full((31, 3), nan)],
    "start_time": [[0.0, 1.0], nan],
    **each([[1e-4], 0.0], "substep cfl"),
    "threads": [1.5, 0],
    **each(["float16"], "dtype engine"),
}
VELOCITIES = {"v": [(nan, 0.0, 0.0), np.zeros((7, 3))], "affine": ["spin", nan]}
WRONG = [
    (rope, {"diameter": 0.01, "length": 0.3}, {
        **each([[0.01, 0.02], 0.0], "diameter length cells_across"),
        "cells_across": [0.3, 20.0],
        "points": [25.5, [25, 25], 10**9],
        **each([(0.0, 1.0), (nan, 0.0, 0.0), None], "start direction"),
        "direction": [(0, 0, 0)],
        "centre_line": [RAGGED, [[0, 0, 0], [nan, 0, 0]], [[0, 0, 0]], [[0, 0], [1, 0]],
                        [[0, 0, 0]] * 2 + [[1, 0, 0]]],
    }),
    (rope, {"diameter": 0.01}, {"length": [...]}),
    (cloth, {"width": 0.2, "height": 0.2, "thickness": 0.002, "dx": 0.02}, {
        **each([RAGGED, 0.0, inf], "width height thickness dx"),
        "points": [8, (8, 8, 8), (8.5, 8), (8, 1), (1, 5)],
        "corner": [3.0, (0.0, nan, 0.0)],
        "yaw": [inf, [0.0]],
    }),
    (Material, {}, each([[1.0, 2.0]], " ".join(("E", "nu", "density", "damping", *OF_THIN)))),
    (Gripper, PATH, {
        "time": [RAGGED, [0.0, nan], [0.0, 0.0]],
        "position": [[[0.0, 0.0, nan]] * 2, [[0.0, 0.0]] * 2, [[0, 0, 0]] * 3],
        "quat_xyzw": [[[0.0, 0.0, 0.0, nan]] * 2, [[0.0, 0.0, 0.0, 1.0]], np.zeros((2, 4))],
        "radius": [[0.01, 0.02], inf, 0.0],
        **each([[0.0, 1.0], nan], "hold_from hold_until"),
    }),
    (Table, {"height": 0.0}, {"height": [[0.0, 1.0], nan], "friction": [RAGGED, -0.3]}),
    (made, {}, SIMULATORS),
    (partial(made, "mpm"), {}, SIMULATORS),
    (of_made("run"), {"times": [1e-4]}, {
        "times": [RAGGED, None, np.zeros((1, 1)), [], [0.2, 0.1], [-0.1], [0.1, nan]],
        "particles": [[0.5, 1.5], [-1], 3, [10**6]],
        **each([3], "on_frame keep_going"),
    }),
    (of_made("set_velocities"), {"v": (0.0, 0.0, 0.0)}, VELOCITIES),
    (of_made("set_velocities", "mpm"), {"v": (0.0, 0.0, 0.0)}, VELOCITIES),
    (Rollout, {}, {"simulator": [3]}),
    (open_device, {}, {"name": [3]}),
    (ROPE.surface, {}, {"x": [RAGGED, np.zeros((5, 3)), np.zeros(3)]}),
]  # fmt: skip
"""What is made, of which arguments, and wrong ones in place of each; `...`: it is left out."""


@pytest.mark.parametrize(
    ("make", "given", "name", "value"),
    [
        pytest.param(make, given, name, value, id=f"{name}-{' '.join(repr(value).split())[:30]}")
        for make, given, wrong in WRONG
        for name, values in wrong.items()
        for value in values
    ],
)
def test_a_wrong_argument_is_named(make, given, name, value):
    names = {"name": "device", "time": "times?"}
    given = {n: v for n, v in {**given, name: value}.items() if v is not ...}
    assert re.search(rf"\b{names.get(name, name)}\b", refused(make, **given))


# ---- arguments that do not fit together ----------------------------------------------------------


SHEET: dict[str, Any] = {"width": 0.2, "height": 0.2, "thickness": 0.002, "dx": 0.02}
BLOCK = cloth(width=0.3, height=0.2, thickness=0.25, dx=0.05)
LINE = rope(diameter=0.01, length=0.2, start=(-0.1, 0.0, 0.1), points=21)
MEETS: dict[str, Any] = {"body": LINE, "materials": [MATERIAL]}
BALL = Sphere(radius=0.03, position=[0.0, 0.0, 0.05])
TWO = {"body": ROPE, "materials": [MATERIAL] * 2}
UNFIT = [
    # before arrays are made
    (rope, {"diameter": 1e-6, "length": 1.0},
        r"6\.4e\+07 particles .* at most 1e\+07 .*; a larger diameter"),
    (cloth, {**SHEET, "dx": 1e-5}, "a larger dx$"),
    (cloth, {**SHEET, "points": (10**4, 10**4)}, "fewer points$"),
    (Gripper, {**PATH, "time": [], "position": np.zeros((0, 3))}, r"time \[K > 0\]"),
    (Gripper, {**PATH, "hold_from": 1.0, "hold_until": 0.5},
        r"hold_until must not lie before hold_from, got 0\.5 before 1\.0 s"),
    (Simulator, {**TWO, "materials": []}, "at least one material"),
    (Simulator, {**TWO, "grippers": [[HAND]]}, "grippers given for world 1"),
    (Simulator, {**TWO, "grippers": [[HAND], []]}, r"same number of grippers, got \[0, 1\]"),
    (Simulator, {**TWO, "table": Table(height=-0.005, friction=np.ones(3))}, "friction"),
    (Simulator, {"body": rope(diameter=0.3, length=0.2), "materials": [MATERIAL]},
        r"a diameter of 0\.3 m and a length of 0\.2 m are not those of a rod"),
    (Simulator, {"body": BLOCK, "materials": [MATERIAL]},
        r"a thickness of 0\.25 m and a side of 0\.2 m are not those of a shell"),
    *[(flat_simulator, {"body": body, "materials": [MATERIAL], **wrong}, words)
        for body in (ROPE, cloth(**SHEET))
        for wrong, words in (
            ({"materials": [MATERIAL, Material(E=1e30)]},
                r"world 1 \(E 1e\+30 Pa.*substep would be .*e-1[67] s, the shortest is"),
            ({"substep": 1e-30}, "substep"),
        )],
    # what another body or engine has
    *[(flat_simulator, {"body": body, "engine": kind, "materials": [MATERIAL], **given}, words)
        for body, kind, given, words in (
            (ROPE, "mpm", {"materials": [Material(membrane=1e5)]},
                "materials: only rods and shells have a modulus"),
            (cloth(**SHEET), "mpm", {"materials": [Material(shear=0.5)]},
                "materials: only shells have threads"),
            (ROPE, "thin", {"materials": [Material(warp=0.5)]},
                "materials: only shells have threads"),
            (ROPE, "mpm", {"mass": 2.0}, "mass: only rods and shells have points"),
            (cloth(**SHEET), "thin", {"natural_curvature": 0.0},
                "natural_curvature: only rods may begin"),
            (cloth(**SHEET), "thin", {"stretch": 1.01}, "stretch: only rods may be longer"),
            (ROPE, "thin", {"diameter": [0.01], "table": Table(height=-1.0)},
                "diameter: only rods that meet nothing differ"),
        )],
    (Simulator, {**MEETS, "obstacles": [BALL], "solver": Solver(engine="mpm")},
        "only rods and shells meet obstacles, not a rope of the mpm engine"),
    # obstacles
    (Sphere, {"radius": -0.1, "position": [0, 0, 0]}, "Sphere radius must be positive"),
    (Sphere, {"radius": 0.1, "position": [0, 0, nan]}, "Sphere position"),
    (Sphere, {"radius": 0.1, "position": [0, 0, 0], "friction": -1.0}, "Sphere friction"),
    (Cuboid, {"size": (0.1, 0.1), "position": [0, 0, 0]}, "Cuboid size"),
    (Cuboid, {"size": (1, 1, 1), "rounding": 0.6, "position": [0, 0, 0]}, r"rounded by 0\.6 m"),
    (Capsule.between, {"a": (0, 0, 1), "b": (0, 0, 1), "radius": 0.1},
        "ends are the same place"),
    (Simulator, {**MEETS, "obstacles": BALL}, "obstacles must be a list"),
    (Simulator, {**MEETS, "obstacles": [Table(height=0.0)]}, r"obstacles\[0\]"),
    (Simulator, {**MEETS, "obstacles": [replace(BALL, radius=0.1)]},
        r"55 mm inside the obstacle 0 \(Sphere\)"),
    (Simulator, {**MEETS, "materials": [MATERIAL] * 2,
        "obstacles": [[BALL], [replace(BALL, radius=0.004)]]},
        "fits between the body's points, which are 10 mm apart"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "given", "words"), UNFIT)
def test_what_does_not_fit_together_is_said(make, given, words):
    assert re.search(words, refused(make, **given))


def test_grippers_that_miss_say_by_how_much():
    hands = [[Gripper.still((0.0, 0.0, height), radius=0.02)] for height in (0.0, 0.5)]
    table = Table(height=-0.005)  # heights are counted from it inside
    s = Simulator(ROPE, [MATERIAL] * 2, grippers=hands, table=table)
    at = r"world 1 .*it is at \[0.0, 0.0, 0.5\] m, its radius 0.02 m, the nearest point 0.5 m away"
    with pytest.raises(SimulationError, match=at):
        s.run([1e-3])
    # objects in the table name the world
    x = np.repeat(moved(ROPE, (0.0, 0.0, 0.1)).points[None], 3, axis=0)
    x[1, :, 2] = -0.2
    s = partial(Simulator, ROPE, [MATERIAL] * 3, table=Table(height=0.0))
    message = refused(s, positions=x)
    assert message.startswith("world 1, centres of its cross-sections lie between [0.0, 0.0, -0.2]")
    assert "205 mm inside the table" in message
    assert "world" not in refused(s, positions=x[1])
    s(positions=x[:1])
