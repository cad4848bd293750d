"""Shapes at rest: against slow motion, mechanics on paper, and each other."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Box, Gripper, Simulator, Table, Weave, cloth, rope
from gendom.sim.thin.engine import ThinEngine

ROPE = rope(diameter=0.01, length=0.3, start=(0, 0, 0.005))
CLOTH = cloth(width=0.3, height=0.3, thickness=0.001, dx=0.02, corner=(0, 0, 5e-4), points=(14, 14))
SOFT = {"rope": Material(E=1e6, damping=0.02), "cloth": Material(E=6e5, density=400, damping=0.02)}
FRAMES = np.linspace(0.0, 1.0, 26)[1:]


def lift(body, seconds=1.0, material=None, **options):
    """By an end or a corner, straight up by 0.3 m."""
    first = body.points[0]
    hand = Gripper(
        time=[0, seconds],
        position=[first, first + np.array([0, 0, 0.3])],
        radius=0.0075 if body.kind == "rope" else 0.015,
    )
    materials = [material or SOFT[body.kind]]
    options = {"table": Table(height=0.0), "grippers": [hand], "threads": 1} | options
    return Simulator(body, materials, **options)


def distances(a, b):
    """[T] mean and [T] largest of points [mm]."""
    d = 1e3 * np.linalg.norm(a - b, axis=-1)[:, 0]
    return d.mean(axis=1), d.max(axis=1)


# ---- slow motion ---------------------------------------------------------------------------------


def test_a_slow_lift_of_a_rope_goes_from_rest_to_rest():
    """In 40 s, until the free end slips and swings."""
    frames = FRAMES[:20]
    found = lift(ROPE).equilibria(frames)
    assert found.converged.all() and found.residual.max() <= 1e-6
    mean, largest = distances(found.positions, lift(ROPE, 40.0).run(40.0 * frames))
    assert mean.max() < 0.05 and largest.max() < 0.1


def test_a_slow_lift_of_a_cloth_goes_from_rest_to_rest():
    """In 40 s, until it begins to fold."""
    frames = FRAMES[:10]
    found = lift(CLOTH).equilibria(frames)
    mean, largest = distances(found.positions, lift(CLOTH, 40.0).run(40.0 * frames))
    assert mean.max() < 0.15 and largest.max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])
def test_very_slow_lifts_go_from_rest_to_rest(body):
    """In 160 s, all the way; folds that snap swing for a while in motion."""
    found = lift(body).equilibria(FRAMES, increments=4)
    mean, largest = distances(found.positions, lift(body, 160.0).run(160.0 * FRAMES))
    assert mean.mean() < 0.15 and np.median(largest) < 0.1 and largest.max() < 10.0


# ---- shapes do not depend on how they were found -------------------------------------------------


def test_weak_gravity_is_balanced_as_well_as_strong():
    """A rope of a hundredth of the stiffness hangs in a hundredth of gravity as this one does."""
    hang = [
        lift(
            ROPE,
            material=replace(SOFT["rope"], E=1e6 * weak),
            table=None,
            gravity=(0, 0, -9.81 * weak),
        ).equilibria(FRAMES)
        for weak in (1.0, 1e-4)
    ]
    np.testing.assert_allclose(hang[1].positions, hang[0].positions, atol=1e-7)
    assert hang[1].residual.max() <= 1e-6


def test_frames_between_do_not_change_a_lift():
    few = lift(ROPE).equilibria(FRAMES[4::5]).positions
    many = lift(ROPE).equilibria(FRAMES).positions[4::5]
    more = lift(ROPE).equilibria(FRAMES[4::5], increments=20).positions
    np.testing.assert_allclose(many, more, atol=1e-7)
    np.testing.assert_allclose(few, more, atol=1e-4)  # friction counts from another shape


def test_without_contact_a_shape_does_not_depend_on_the_way():
    first, last = ROPE.points[0], ROPE.points[-1]

    def hung(detour):
        hands = [
            Gripper.still(first, radius=0.008),
            Gripper(time=[0, 1, 2], position=[last, detour, (0.2, 0.0, 0.1)], radius=0.008),
        ]
        s = Simulator(ROPE, [SOFT["rope"]], grippers=hands)
        return s.equilibria([1.0, 2.0], tolerance=1e-9).positions[1]

    one, other = hung((0.25, 0.05, 0.0)), hung((0.15, -0.1, 0.15))
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_worlds_of_a_batch_do_not_see_each_other():
    """Bit for bit; of different stiffness, friction and grippers' times."""
    first, last = ROPE.points[0], ROPE.points[-1]
    carries = Gripper(time=[0, 1], position=[first, first + np.array([0, 0, 0.1])], radius=0.01)
    hands = [
        [carries, Gripper.still(last, radius=0.02, hold_from=t, hold_until=0.7)]
        for t in (0.0, 0.2, 0.5)
    ]

    def rest(worlds):
        table = Table(height=0.0, friction=[(0.1, 0.3, 0.6)[w] for w in worlds])
        materials = [Material(E=(3e5, 1e6, 3e6)[w]) for w in worlds]
        s = Simulator(ROPE, materials, table=table, grippers=[hands[w] for w in worlds], threads=2)
        return s.equilibria([0.4, 0.8], derivatives=["E", "friction"])

    together = rest([0, 1, 2])
    for w in range(3):
        alone = rest([w])
        np.testing.assert_array_equal(together.positions[:, w], alone.positions[:, 0])
        for name, values in alone.derivatives.items():
            np.testing.assert_array_equal(together.derivatives[name][:, w], values[:, 0])


def test_float32_rests_where_float64_does():
    """Also on the way: a lift in float32 that is searched, and goes on in motion and at rest."""
    found = []
    for dtype in ("float64", "float32"):
        s = lift(ROPE, dtype=dtype)
        x = [s.equilibria([0.2, 0.4]).positions[-1], s.run([0.5])[0]]
        found.append([*x, s.equilibria([0.8]).positions[-1]])
        assert all(part.dtype == dtype for part in found[-1]) and s.dtype == dtype
    for double, single in zip(*found, strict=True):
        assert np.abs(double - single).max() < 1e-4


def test_motion_goes_on_from_rest():
    s = lift(ROPE)
    x = s.equilibria([1.0]).positions[-1]
    assert not s.velocities().any()
    np.testing.assert_allclose(s.run([1.5])[0], x, atol=1e-6)


# ---- mechanics -----------------------------------------------------------------------------------


def test_a_pulled_rope_stretches_against_friction():
    """By mu w L^2 / (2 E A); pushed back a little, its far end sticks."""
    mu, pull, radius = 0.5, 0.01, 0.0105
    first = ROPE.points[0]
    path = [first, first - [pull, 0, 0], first - [pull - 1e-5, 0, 0]]
    hand = Gripper(time=[0, 1, 2], position=path, radius=radius)

    def along(times, **options):
        s = Simulator(
            ROPE, [Material(E=1e6)], grippers=[hand], table=Table(height=0.0, friction=mu)
        )
        return s.equilibria(times, **options).positions[:, 0, :, 0] - ROPE.points[:, 0]

    pulled, pushed = along([1.0, 2.0])
    free = 0.3 - 0.01  # the edge whose middle it holds
    expected = mu * 1000.0 * 9.80665 * free**2 / (2.0 * 1e6)
    assert pulled[-1] + pull == pytest.approx(expected, rel=0.02)
    assert pushed[-1] == pytest.approx(pulled[-1], abs=1e-9) and pushed[2] > pulled[2] + 5e-6
    np.testing.assert_allclose(along([2.0], increments=2)[0], pushed, atol=1e-9)
    assert abs(along([2.0])[0, -1] - pushed[-1]) > 5e-6  # friction counts from the first shape


@pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])
def test_slopes_hold_below_the_angle_of_friction(body):
    """Above it nothing is at rest, which the error says."""

    def slope(tangent, **options):
        gravity = 9.8 * np.array([tangent, 0.0, -1.0])
        s = Simulator(
            body, [SOFT[body.kind]], table=Table(height=0.0, friction=0.3), gravity=gravity
        )
        found = s.equilibria([0.5, 1.0], most_steps=500, **options)
        assert not s.velocities().any()
        return found

    found = slope(0.29)
    assert found.converged.all()
    assert np.abs(found.positions[:, 0] - body.points).max() < 1e-4
    with pytest.raises(SimulationError, match="is not balanced in frame 0, allowed is 1e-06") as e:
        slope(0.31)
    assert e.value.world == 0 and e.value.time == 0.5 and "keep_going" in str(e.value)
    slides = slope(0.31, keep_going=True)
    assert not slides.converged.any() and np.isfinite(slides.positions).all()
    assert slides.residual.min() > 1e-3


def test_a_hanging_rope_leans_on_a_wall():
    """And moves away from it as it becomes thicker."""
    line = rope(diameter=0.01, length=0.2, start=(0, 0, 0.3), direction=(0, 0, -1), points=21)

    def rests(thickness, **options):
        body = replace(line, thickness=thickness)
        s = Simulator(
            body, [Material(E=1e5)], grippers=[Gripper.still((0, 0, 0.3), radius=0.012)],
            gravity=(6.0, 0.0, -9.0), box=Box(lower=(-1, -1, 0), upper=(0.02, 1, 1)),
        )  # fmt: skip
        return s.equilibria([0.1], tolerance=1e-10, **options)

    found = rests(0.01, derivatives=["thickness"])
    x = found.positions[0, 0]
    assert x[:, 0].max() == pytest.approx(0.015, abs=1e-9) and (x[:, 0] > 0.0149).sum() > 2
    h = 1e-8
    differences = (rests(0.01 + h).positions - rests(0.01 - h).positions) / (2.0 * h)
    assert differences[0, 0, -1, 0] == pytest.approx(-0.5)
    np.testing.assert_allclose(found.derivatives["thickness"], differences, atol=1e-6)


def test_grippers_close_and_open_on_shapes_at_rest():
    """One lets go on the way: the rope lies on the table again, where another one takes it."""
    last, first = ROPE.points[-1], ROPE.points[0]
    hands = [
        Gripper(
            time=[0, 1],
            position=[first, first + np.array([0, 0, 0.1])],
            radius=0.01,
            hold_until=0.55,
        ),
        Gripper.still(last, radius=0.02, hold_from=0.75, may_miss=True),
        Gripper.still((0, 0, 1), radius=0.01, hold_from=0.75, may_miss=True),
    ]
    s = Simulator(ROPE, [SOFT["rope"]], grippers=hands, table=Table(height=0.0))
    x = s.equilibria([0.5, 0.7, 1.0]).positions[:, 0]
    assert x[0, 0, 2] == pytest.approx(0.055)
    assert np.abs(x[1:, :, 2] - 0.005).max() < 1e-9
    assert isinstance(s.engine, ThinEngine)
    assert s.engine.holds[0].any(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_contact_of_a_body_with_itself(kind):
    """A rope let down on itself and a folded cloth keep their thickness; without contact, not."""
    if kind == "rope":
        body = rope(diameter=0.01, length=0.3, start=(0, 0, 0.31), direction=(0, 0, -1), points=31)
        way, radius, row = [(0, 0, 0.31), (0.02, 0.006, 0.03)], 0.012, np.arange(31)
    else:
        body = cloth(
            width=0.1, height=0.2, thickness=0.004, dx=0.02, corner=(0, 0, 0.002), points=(7, 13)
        )
        way = [(0.05, 0.2, 0.002), (0.05, 0.14, 0.07), (0.05, 0.08, 0.05), (0.05, 0.05, 0.015)]
        radius, row = 0.03, np.arange(91) // 7
    hand = Gripper(time=np.linspace(0, 1, len(way)), position=way, radius=radius)
    far = np.abs(np.subtract.outer(row, row)) > 3

    def nearest(contact):
        s = Simulator(
            body, [replace(SOFT[kind], E=2e4)], grippers=[hand], table=Table(height=0.0),
            self_contact=contact,
        )  # fmt: skip
        found = s.equilibria(np.linspace(0.1, 1.0, 10))
        assert found.residual.max() <= (0.02 if contact else 1e-6)
        x = found.positions[-1, 0]
        assert x[:, 2].min() > 0.98 * body.thickness / 2.0
        return np.linalg.norm(x[:, None] - x[None], axis=2)[far].min() / body.thickness

    assert nearest(True) > 0.98
    assert nearest(False) < 0.5


# ---- derivatives ---------------------------------------------------------------------------------

TIMES = [0.5, 1.0, 1.6, 2.0]


CURLED = np.array([[0.3 * t, 0.02 * np.sin(3 * t), 0.0025] for t in np.linspace(0, 1, 100)])
RESTING = {
    "rope": rope(diameter=0.01, length=0.3, start=(0, 0, 0.005), points=16),
    "curled ribbon": rope(diameter=0.005, centre_line=CURLED, width=0.008, points=16),
    "cloth": cloth(
        width=0.2, height=0.16, thickness=0.002, dx=0.02, corner=(0, 0, 0.001), points=(9, 8),
        natural_curvature=[[1.5, 0.2], [0.2, -1.0]],
    ),
}  # fmt: skip


def given(kind):
    """A lift by a hand that turns; another one closes later, on a shape at rest."""
    thin, body = kind == "cloth", RESTING[kind]
    own = {"membrane": 1.5e5, "weave": np.array([1.1, 0.9, 0.8, 1.3])} if thin else {}
    if kind == "curled ribbon":
        own = {"width": 0.008}
    return own | {
        "E": 2e5 if thin else 1e6,
        "nu": 0.3,
        "density": 900.0,
        "thickness": body.thickness,
        "stiffness": np.ones(len(body.points)),
        "positions": body.points,
        "friction": 0.3,
        "gravity": np.array([0.5, 0.3, -9.8]),
        "gripper_radius": np.array([0.0351, 0.033] if thin else [0.0175, 0.0171]),
        "gripper_offset": np.zeros((2, 3)),
        "gripper_positions": np.zeros((2, 9, 3)),
        "gripper_rotations": np.zeros((2, 9, 3)),
        "rest_strains": np.zeros((len(body.points), 3 if thin else 6)),
    }


def rests(kind, p, **options):
    own = {"thickness": p["thickness"]}
    if "weave" in p:
        own["weave"] = Weave(
            **dict(zip(("warp", "weft", "shear", "bending"), p["weave"].tolist(), strict=True))
        )
    if "width" in p:
        own["width"] = p["width"]
    body = replace(RESTING[kind], **own)
    t = np.linspace(0.0, 2.0, 9)[:, None]
    late = np.maximum(t - 1.25, 0.0)
    first = body.points[0] + p["gripper_offset"][0] + t * [0.02, 0.01, 0.06]
    last = body.points[-1] + p["gripper_offset"][1] + late * [-0.02, 0.04, 0.04]
    first, last = (
        path + by for path, by in zip((first, last), p["gripper_positions"], strict=True)
    )
    turned = [
        (Rotation.from_rotvec(by) * Rotation.from_rotvec(t * way)).as_quat()
        for by, way in zip(p["gripper_rotations"], ([0.1, 0.3, 0.2], [0.0, 0.1, -0.1]), strict=True)
    ]
    radius = p["gripper_radius"]
    hands = [
        Gripper(time=t[:, 0], position=first, quat_xyzw=turned[0], radius=radius[0]),
        Gripper(time=t[:, 0], position=last, quat_xyzw=turned[1], radius=radius[1], hold_from=1.1),
    ]
    material = Material(E=p["E"], nu=p["nu"], density=p["density"], membrane=p.get("membrane"))
    s = Simulator(
        body, [material], grippers=hands, table=Table(height=0.0, friction=p["friction"]),
        gravity=p["gravity"], stiffness=p["stiffness"], positions=p["positions"],
    )  # fmt: skip
    engine: Any = s.engine
    rest = engine.body.rest.numpy()
    # an edge or joint that is not there has no stiffness: its number changes nothing
    rest[0, engine.natural, engine.slots] += p["rest_strains"]
    engine.body.rest.assign(rest)
    return s.equilibria(TIMES, tolerance=1e-10, **options)


@pytest.mark.parametrize("kind", list(RESTING))
def test_every_derivative_is_that_of_central_differences(kind):
    p, rng = given(kind), np.random.default_rng(0)
    found = rests(kind, p, derivatives=list(p))
    on_table = found.positions[..., 2] < p["thickness"] / 2.0 + 1e-9
    assert (on_table.sum(axis=-1)[:2] > 2).all() and not on_table.all(axis=-1).any()
    for name, value in p.items():
        direction = np.asarray(rng.normal(size=np.shape(value)))
        length = name in ("thickness", "width", "positions") or name.startswith("gripper")
        h = 2e-8 if length else 3e-4 if name == "nu" else 1e-6 * float(np.abs(value).max())
        if name == "rest_strains":
            h = 1e-8

        def at(k, name=name, step=h * direction):
            return rests(kind, p | {name: p[name] + k * step}).positions

        differences = (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * h)
        by = found.derivatives[name]
        by = np.sum(by.reshape(*by.shape[:4], -1) * direction.reshape(-1), axis=-1)
        scale = np.abs(differences).max(axis=(1, 2, 3), keepdims=True)
        assert (np.abs(by - differences) <= 1e-6 * scale).all(), name


def test_derivatives_that_are_not_determined_are_refused():
    """A rope that nobody holds may roll about itself."""
    s = Simulator(ROPE, [Material()], table=Table(height=0.0))
    with pytest.raises(SimulationError, match="nothing resists some motion"):
        s.equilibria([1.0], derivatives=["E"])
    s = Simulator(ROPE, [Material()], table=Table(height=0.0))
    assert s.equilibria([1.0]).converged.all()


# ---- what cannot be ------------------------------------------------------------------------------


@pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])
def test_what_nothing_holds_is_refused(body):
    worlds = [Material()] * 2
    first = body.points[0]
    hold, drop = (
        Gripper.still(first, radius=0.02),
        Gripper.still(first, radius=0.02, hold_until=0.5),
    )

    def make():
        return Simulator(body, worlds, grippers=[[hold], [drop]])

    with pytest.raises(SimulationError, match="no equilibrium: nothing holds the body") as e:
        make().equilibria([0.4, 1.0])
    assert e.value.world == 1 and e.value.time == 0.5
    s = make()
    found = s.equilibria([0.4, 1.0], keep_going=True)
    assert set(s.failures) == {1}
    assert found.converged.tolist() == [[True, True], [True, False]]
    assert np.isnan(found.positions[1, 1]).all() and np.isfinite(found.positions[:, 0]).all()


def test_a_rope_pulled_apart_ends_with_an_error_and_its_last_shape(tmp_path):
    first, last = ROPE.points[0], ROPE.points[-1]
    hands = [
        Gripper.still(first, radius=0.01),
        Gripper(time=[0, 1], position=[last, last + np.array([0.2, 0, 0])], radius=0.01),
    ]
    s = Simulator(ROPE, [Material()], grippers=hands)
    with pytest.raises(SimulationError, match="grippers 0 and 1 pull the body apart"):
        s.equilibria(np.linspace(0.1, 1.0, 10))
    kept = s.engine.kept(last_good=True)
    assert kept["x"][0, -1, 0] == pytest.approx(0.3 + 0.2 * kept["time"][0], abs=1e-3)


def test_bad_input_is_named():
    s = lift(ROPE)
    with pytest.raises(ParameterError, match="must not decrease"):
        s.equilibria([1.0, 0.5])
    with pytest.raises(ParameterError, match="not differentiated by damping, weight; choose of E"):
        s.equilibria([1.0], derivatives=["weight", "E", "damping"])
    with pytest.raises(ParameterError, match="tolerance must be positive"):
        s.equilibria([1.0], tolerance=0.0)
    with pytest.raises(ParameterError, match="at least 1"):
        s.equilibria([1.0], increments=0)
    with pytest.raises(ParameterError, match="itself is not differentiated"):
        lift(ROPE, self_contact=True).equilibria([1.0], derivatives=["E"])
    with pytest.raises(ParameterError, match="only rods and shells"):
        lift(ROPE, engine="mpm").equilibria([1.0])


@pytest.mark.gpu
@pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])
def test_cuda_rests_where_the_cpu_does(body):
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device on this machine")
    frames = FRAMES[:10:3]
    one, other = (
        lift(body, device=device).equilibria(frames, tolerance=1e-8, derivatives=["E", "friction"])
        for device in ("cpu", "cuda")
    )
    np.testing.assert_allclose(other.positions, one.positions, rtol=0.0, atol=1e-8)
    for name, values in one.derivatives.items():
        scale = np.abs(values).max()
        np.testing.assert_allclose(other.derivatives[name], values, rtol=0.0, atol=1e-5 * scale)


@pytest.mark.parametrize("held", [0.7, 0.85, 1.0, 1.15, 1.3, 1.45])
def test_a_coarse_rope_sags_alike_wherever_the_gripper_ends(held):
    """Ten edges; the sphere ends so many edges from the rope's end."""
    length, diameter = 0.3, 0.006
    radius = held * length / 10.0
    free = length - radius
    m = Material(E=1e6, nu=0.3, density=800.0)
    # a sag of 1 %, w L^4 / (8 E I)
    gravity = 0.01 * 8.0 * m.E * (diameter**2 / 16.0) / (m.density * free**3)
    s = Simulator(
        rope(diameter=diameter, length=length, start=(0, 0, 0), points=11), [m], engine="thin",
        grippers=[Gripper.still((0, 0, 0), radius=radius)], gravity=(0.0, 0.0, -gravity),
        air_density=0.0,
    )  # fmt: skip
    sag = -s.equilibria([1.0]).positions[0, 0, -1, 2] / (0.01 * free)
    assert sag == pytest.approx(0.995, abs=0.002)
