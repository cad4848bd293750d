"""The simulator against mechanics: momentum, beams, friction, grippers, and its own promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from gendom.errors import DeviceError, ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import (
    Gripper,
    Simulator,
    Solver,
    Table,
    cloth,
    list_devices,
    rope,
    stable_substep,
)
from validation.bench import flat_simulator

SOFT = Material(E=2.0e4, nu=0.3, density=1000.0)
G = 9.81
DX = 0.01


def block(size=(0.04, 0.04, 0.04), corner=(0.003, 0.001, 0.022)):
    """A solid block on cells of 1 cm; ``corner`` is the middle of its edge along z."""
    return cloth(width=size[0], height=size[1], thickness=size[2], dx=DX, corner=corner)


def simulator(body, materials=(SOFT,), **options):
    """A simulator in float64 on one thread and without air, unless told otherwise."""
    defaults = {"dtype": "float64", "threads": 1, "air_density": 0.0, "engine": "mpm"}
    return flat_simulator(body, materials, **{**defaults, **options})


def lifted_rope(materials=(SOFT,), *, cells=1.5, **options):
    """A rope that starts on a table and whose one end is lifted by 10 cm in 0.3 s."""
    body = rope(diameter=0.02, length=0.12, start=(0.0, 0.0, 0.01), cells_across=cells)
    grip = Gripper(time=[0.0, 0.3], position=[(0, 0, 0.01), (0, 0, 0.11)], radius=0.02)
    table = options.pop("table", Table(height=0.0))
    return simulator(body, materials, grippers=[grip], table=table, velocity_damping=2.0, **options)


# ---- free motion -----------------------------------------------------------------------------


def test_free_fall_is_that_of_symplectic_euler():
    """After n substeps h: x = x0 + v0 t + g h^2 n (n + 1) / 2, to round-off, for every particle."""
    body = block()
    s = simulator(body)
    v = np.array([0.3, -0.2, 1.0])
    s.set_velocities(v)
    expected = body.x.copy()
    g = np.array([0.0, 0.0, -G])
    for x, interval in zip(s.run([0.1, 0.35])[:, 0], (0.1, 0.25), strict=True):
        n = math.ceil(interval / s.substep[0])
        h = interval / n
        expected += v * interval + g * h**2 * n * (n + 1) / 2
        v = v + g * interval
        assert np.abs(x - expected).max() < 1e-13
    assert np.abs(s.velocities()[0] - v).max() < 1e-12
    # the exact parabola lies g h t / 2 above: a first-order error, here of 0.4 mm
    assert expected[0, 2] - body.x[0, 2] < 1.0 * 0.35 - G * 0.35**2 / 2 - 1e-5


def test_momenta_of_a_free_block_are_conserved():
    """A turning, wobbling block keeps linear and angular momentum to round-off."""
    body = block(size=(0.06, 0.04, 0.03))
    body = body.moved(-body.x.mean(axis=0))
    s = simulator(body, [SOFT], gravity=(0.0, 0.0, 0.0))
    spin = np.cross([3.0, 2.0, 10.0], body.x)
    stretch = 5.0 * body.x * [1.0, -0.5, 0.2]
    s.set_velocities(spin + stretch + [1.0, 0.5, 0.2])

    def momenta():
        """Sums of v and of x cross v plus the affine velocities' own moment (D = dx^2 / 4)."""
        x, v = s.positions()[0], s.velocities()[0]
        C = s.worlds.state.C.numpy()[0].sum(axis=0) * DX**2 / 4.0
        own = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
        return v.sum(axis=0), np.cross(x, v).sum(axis=0) + own

    p0, L0 = momenta()
    s.run([0.05, 0.2])
    p, L = momenta()
    assert np.linalg.norm(p - p0) < 1e-13 * np.linalg.norm(p0)
    assert np.linalg.norm(L - L0) < 2e-13 * np.linalg.norm(L0)
    F = s.deformation_gradients()[0]
    assert np.abs(F - np.eye(3)).max() > 0.1  # it did turn and deform


def test_damping_is_exponential():
    """Without gravity every velocity falls as exp(-damping t), whatever the substep."""
    s = simulator(block(), gravity=(0, 0, 0), velocity_damping=3.0)
    s.set_velocities((1.0, 2.0, -3.0))
    s.run([0.4])
    assert s.velocities()[0] == pytest.approx(
        np.tile([1.0, 2.0, -3.0], (s.body.num_particles, 1)) * math.exp(-1.2), rel=1e-12
    )


def test_a_rigid_turn_is_free_of_stress():
    """A block that turns by 1 rad keeps its shape within 1 % and its F is that rotation.

    Velocities set by hand give particles no affine velocity of their own, so their angular
    momentum is shared with it: the rate drops by sum r^2 / (sum r^2 + N dx^2 / 2).
    """
    body = block()
    centre = body.x.mean(axis=0)
    s = simulator(body, gravity=(0, 0, 0))
    inertia = ((body.x - centre)[:, :2] ** 2).sum() / body.num_particles
    rate = 2.0 * (inertia + DX**2 / 2.0) / inertia
    s.set_velocities(np.cross([0.0, 0.0, rate], body.x - centre))
    x = s.run([0.5])[0, 0]
    U, _, Vt = np.linalg.svd((body.x - centre).T @ (x - centre))
    Q = (U @ Vt).T
    assert Rotation.from_matrix(Q).as_rotvec() == pytest.approx([0.0, 0.0, 1.0], abs=0.02)
    assert np.abs(x - centre - (body.x - centre) @ Q.T).max() < 0.01 * 0.04
    assert np.abs(s.deformation_gradients()[0] - Q).max() < 0.02


# ---- equal problems have equal answers -------------------------------------------------------


def turned_z(v):
    """Vectors [..., 3] turned by 90 degrees about z."""
    v = np.asarray(v, dtype=float)
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], axis=-1)


def test_answer_turns_with_the_problem():
    """Body, gripper path and spin, gravity and velocity turned by 90 degrees turn the answer."""
    body = rope(diameter=0.02, length=0.12, start=(0.013, 0.004, 0.01), cells_across=1.5)
    path = np.array([(0.02, 0.0, 0.01), (0.05, 0.03, 0.06)])
    axis = np.array([0.3, 0.5, 0.8])
    pull = np.array([1.0, 0.5, -9.0])

    def answer(turn):
        quat = Rotation.from_rotvec([0.0 * axis, turn(axis)]).as_quat()
        grip = Gripper(time=[0, 0.2], position=turn(path), quat_xyzw=quat, radius=0.02)
        s = simulator(
            replace(body, x=turn(body.x)),
            grippers=[grip],
            table=Table(height=0.0),
            gravity=turn(pull),
        )
        s.set_velocities(turn(np.array([0.1, 0.2, 0.0])))
        return s.run([0.1, 0.2])[:, 0]

    one, other = answer(np.asarray), answer(turned_z)
    assert np.abs(turned_z(one) - other).max() < 1e-10
    assert np.abs(one[1] - one[0]).max() > 0.01


DIFFERENT = tuple(
    Material(E=E, nu=nu) for E, nu in ((1e4, 0.3), (3e4, 0.2), (1e5, 0.4), (2e4, 0.1), (5e3, 0.0))
)
"""Worlds whose substeps differ, so that they take turns at being the slowest."""


def test_a_batch_equals_its_worlds_bit_for_bit():
    """On the CPU a world does not know its neighbours, nor how many threads there are."""
    times = [0.1, 0.3]
    batch = lifted_rope(DIFFERENT, threads=2).run(times)
    assert np.array_equal(batch, lifted_rope(DIFFERENT, threads=1).run(times))
    for w, material in enumerate(DIFFERENT):
        assert np.array_equal(batch[:, w], lifted_rope([material]).run(times)[:, 0])
    assert np.abs(np.diff(batch, axis=1)).max(axis=(0, 2, 3)).min() > 1e-4


def test_worlds_take_their_own_values():
    """Friction, gravity, damping, grippers and positions of world w are row w of what is given."""
    body = block(size=(0.04, 0.02, 0.02), corner=(0.0, 0.0, 0.0125))
    still = Gripper.still((9.0, 0.0, 0.0), radius=0.001, may_miss=True)
    holds = Gripper.still(body.x[0], radius=0.03)
    own = [
        {"friction": 0.1, "gravity": (3.0, 0.0, -9.0), "damping": 0.0, "grip": still, "at": 0.0},
        {"friction": 0.6, "gravity": (9.0, 1.0, -9.0), "damping": 1.0, "grip": still, "at": 0.1},
        {"friction": 0.1, "gravity": (5.0, 0.0, -9.0), "damping": 2.0, "grip": holds, "at": 0.0},
    ]

    def of(worlds):
        return simulator(
            body,
            [SOFT] * len(worlds),
            table=Table(height=0.0, friction=[w["friction"] for w in worlds]),
            gravity=[w["gravity"] for w in worlds],
            velocity_damping=[w["damping"] for w in worlds],
            grippers=[[w["grip"]] for w in worlds],
            positions=np.stack([body.x + np.array([w["at"], 0.0, 0.0]) for w in worlds]),
        ).run([0.1])[0]

    together = of(own)
    for w, world in enumerate(own):
        assert np.array_equal(together[w], of([world])[0])
    moved = together.mean(axis=1)[:, 0] - [body.x[:, 0].mean() + w["at"] for w in own]
    assert moved[0] > 0.005 and moved[1] > moved[2] + 0.005


def test_float32_is_close_to_float64():
    """A lift of 10 cm differs by hardly more than the last rounding between the two.

    Over a table it differs by more: a section that sticks in one slides in the other for a while.
    """
    times = [0.1, 0.3]
    for table, bound in ((None, 3e-7), (Table(height=0.0), 3e-5)):
        double = lifted_rope(DIFFERENT, table=table).run(times)
        single = lifted_rope(DIFFERENT, table=table, dtype="float32").run(times)
        assert single.dtype == np.float32
        assert 0.0 < np.abs(single - double).max() < bound


def test_a_table_far_from_the_origin_is_as_calm_in_float32():
    """What presses on a table is far below the last bit of its height."""
    body = rope(diameter=0.02, length=0.12, start=(0.0, 0.0, 300.01), cells_across=1.5)
    s = simulator(body, table=Table(height=300.0), dtype="float32")
    s.run([0.2])
    assert np.abs(s.velocities()).max() < 1e-5
    height = s.positions()[0, :, 2].mean(dtype=float) - 300.0
    assert height == pytest.approx(0.01, abs=1e-4)


@pytest.mark.gpu
def test_cuda_agrees_with_cpu():
    """A short lift of five worlds on cuda equals the CPU's: 10 um in float32, 1e-9 m in float64."""
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device on this machine")
    for dtype, bound in (("float32", 1e-5), ("float64", 1e-9)):
        cpu = lifted_rope(DIFFERENT, dtype=dtype).run([0.1, 0.3])
        cuda = lifted_rope(DIFFERENT, dtype=dtype, device="cuda").run([0.1, 0.3])
        assert np.abs(cuda - cpu).max() < bound


def test_two_runs_equal_one():
    """run() to two times equals two run() to one each, bit for bit, time kept."""
    one, two = lifted_rope(), lifted_rope()
    frames = one.run([0.1, 0.17])
    assert np.array_equal(frames[:1], two.run([0.1]))
    assert two.time == 0.1
    assert np.array_equal(frames[1:], two.run([0.17]))
    assert np.array_equal(one.velocities(), two.velocities())
    assert np.array_equal(two.run([0.17]), frames[1:])  # no time passes


def test_chosen_particles_are_those_of_all():
    """``particles`` records a part, ``on_frame`` counts the frames, the last one included."""
    counts = []
    part = lifted_rope().run([0.05, 0.1], particles=[7, 3], on_frame=counts.append)
    assert np.array_equal(part, lifted_rope().run([0.05, 0.1])[:, :, [7, 3]])
    assert counts[-1] == 2 and counts == sorted(counts)


# ---- bending ---------------------------------------------------------------------------------


def cantilever_ratio(cells, *, slenderness):
    """Sag of a clamped rope's tip over that of a slender beam, w L^4 / (8 E I)."""
    d = 0.02
    k = d / 4.0
    L = slenderness * d
    back = 2.0 * d
    sag = 0.03 * L
    specific = G * L**4 / (8.0 * k**2 * sag)
    body = rope(diameter=d, length=L + back, start=(-back, 0, 0), cells_across=cells)
    clamp = Gripper.still((-1.5 * d, 0.0, 0.0), radius=1.5 * d)
    frequency = 3.5 * math.sqrt(specific) * k / L**2
    s = simulator(
        body,
        [Material(E=1000.0 * specific, nu=0.3, density=1000.0)],
        grippers=[clamp],
        velocity_damping=1.6 * frequency,
        dtype="float32",
    )
    x = s.run(np.array([0.8, 1.0]) * 10.0 / frequency)[:, 0]
    along = body.material_coordinates[:, 0]
    last, before = (x[:, along == u, 2].mean(axis=1) for u in np.unique(along)[[-1, -2]])
    tip = last + (last - before) / 2.0
    assert tip[1] == pytest.approx(tip[0], rel=0.01)  # it hangs still
    return -tip[1] / sag


@pytest.mark.parametrize(("cells", "slenderness"), [(1.0, 15.0), (1.5, 15.0), (3.0, 10.0)])
def test_cantilever_sags_as_a_beam(cells, slenderness):
    """Tip sag within 2 % of w L^4 / (8 E I), whatever the grid (4 % where there is one cell)."""
    bound = 0.04 if cells == 1.0 else 0.02
    assert cantilever_ratio(cells, slenderness=slenderness) == pytest.approx(1.0, abs=bound)


def creep(lift):
    """How much further a clamped rope sags after a slow lift, relative to its sag before."""
    d, L, back, far = 0.02, 0.2, 0.04, 1.0
    k = d / 4.0
    sag = 0.06 * L
    specific = G * L**4 / (8.0 * k**2 * sag)
    body = rope(diameter=d, length=L + back, start=(-back, 0, 0), cells_across=1.5)
    path = [(-far, 0, 0), (-far, 0, 0), (-far, 0, lift)]
    grip = Gripper(time=[0.0, 0.4, 1.0], position=path, radius=far)
    s = simulator(
        body,
        [Material(E=1000.0 * specific, nu=0.3, density=1000.0)],
        grippers=[grip],
        velocity_damping=3.5 * math.sqrt(specific) * k / L**2,
    )
    x = s.run([0.4, 1.5])[:, 0, :, 2]
    tip = body.material_coordinates[:, 0] > L + back - 0.01
    sags = -x[:, tip].mean(axis=1) + [0.0, lift]
    return sags[1] / sags[0] - 1.0


def test_a_beam_keeps_its_shape_across_cells():
    """Carried slowly through 15 cells a beam creeps by under 1 %."""
    assert abs(creep(0.2)) < 0.01


# ---- elastic forces --------------------------------------------------------------------------


def elastic_energy(body, x, mu, lam):
    """Sum over particles of their volume times psi(F), F from the rest lattice."""
    before, behind = body.lattice[:, :, 0], body.lattice[:, :, 1]
    F = np.swapaxes(x[behind] - x[before], 1, 2) @ body.rest_frames
    J = np.linalg.det(F)
    stretches = np.linalg.svd(F, compute_uv=False)
    psi = mu / 2 * ((stretches**2).sum(axis=1) - 3.0 - 2.0 * np.log(J)) + lam / 2 * np.log(J) ** 2
    return body.volume * psi.sum()


@pytest.mark.parametrize("bent", [False, True])
def test_forces_are_the_derivatives_of_the_elastic_energy(bent):
    """What a substep gives to each particle, over its length, against central differences."""
    line = [(0.0, 0.0, 0.0), (0.03, 0.0, 0.0), (0.05, 0.02, 0.0), (0.06, 0.05, 0.02)]
    straight = [(0.0, 0.0, 0.0), (0.08, 0.0, 0.0)]
    body = rope(diameter=0.02, cells_across=1.5, centre_line=line if bent else straight)
    assert body.num_particles % 8  # some are done together with others that are done already
    rng = np.random.default_rng(4)
    x = body.x + 0.1 * body.dx * rng.uniform(-1.0, 1.0, body.x.shape)
    s = simulator(body, gravity=(0.0, 0.0, 0.0), positions=x, substep=1e-6)
    s.run([1e-6])
    impulses = s.worlds.state.impulses.numpy()[0, :, :, :3]
    given = np.zeros_like(x)
    for axis in range(3):
        np.add.at(given, body.lattice[:, axis, 0], impulses[:, axis])
        np.add.at(given, body.lattice[:, axis, 1], -impulses[:, axis])
    momentum = SOFT.density * body.volume * s.velocities()[0].sum(axis=0)
    assert np.abs(given.sum(axis=0)).max() < 1e-12 * np.abs(given).max()
    assert np.abs(momentum).max() < 1e-12 * np.abs(given).sum()
    mu, lam = SOFT.lame
    step = 1e-7
    for p in rng.choice(body.num_particles, 6, replace=False):
        for n in range(3):
            moved = np.zeros_like(x)
            moved[p, n] = step
            energies = [elastic_energy(body, x + sign * moved, mu, lam) for sign in (1, -1)]
            force = -(energies[0] - energies[1]) / (2.0 * step)
            assert given[p, n] / 1e-6 == pytest.approx(
                force, rel=1e-5, abs=1e-6 * np.abs(given).max() / 1e-6
            )


# ---- table -------------------------------------------------------------------------------------


def on_table(**options):
    """A block that rests on a table at height 0.5 m."""
    body = block(size=(0.06, 0.04, 0.04), corner=(0.003, 0.001, 0.52))
    friction = options.pop("friction", 0.3)
    return simulator(body, table=Table(height=0.5, friction=friction), **options)


def test_block_rests_at_table_height():
    """Weight pressed it down by no more than 2 rho g h^2 / E / 2; the lowest layer lies on it."""
    s = on_table(velocity_damping=20.0)
    first = s.body.x
    x = s.run([0.4])[0, 0]
    assert np.abs(s.velocities()).max() < 2e-3
    assert x[:, 2].min() == pytest.approx(0.5 + DX / 4, abs=0.1 * DX)
    sunk = first[:, 2].mean() - x[:, 2].mean()
    assert 0.0 < sunk < 1000.0 * G * 0.04**2 / 2.0e4
    assert np.abs(x.mean(axis=0) - first.mean(axis=0))[:2].max() < 1e-3 * DX


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_block_slides_to_a_stop(mu):
    """Stopping distance v^2 / (2 mu g), time v / (mu g), within 3 %."""
    s = on_table(friction=mu)
    s.run([0.3])
    start = s.positions()[0].mean(axis=0)[0]
    v = 0.8
    s.set_velocities((v, 0.0, 0.0))
    stop = v / (mu * G)
    x = s.run(0.3 + np.array([0.5, 1.5]) * stop)[:, 0].mean(axis=1)[:, 0] - start
    distance = v**2 / (2.0 * mu * G)
    assert x[0] == pytest.approx(0.75 * distance, rel=0.03)
    assert x[1] == pytest.approx(distance, rel=0.03)
    assert abs(s.velocities()[0].mean(axis=0)[0]) < 0.03 * v


@pytest.mark.parametrize("side", [-1, 1])
def test_tilted_gravity_slides_beyond_the_angle_of_friction(side):
    """Below atan(mu) the block stays; above it gains g (sin a - mu cos a) t."""
    mu = 0.3
    angle = math.atan(mu) * (1.0 + 0.25 * side)
    s = on_table(friction=mu, gravity=(G * math.sin(angle), 0.0, -G * math.cos(angle)))
    s.run([0.8])
    x0, v0 = s.positions()[0].mean(axis=0)[0], s.velocities()[0].mean(axis=0)[0]
    s.run([1.3])
    x1, v1 = s.positions()[0].mean(axis=0)[0], s.velocities()[0].mean(axis=0)[0]
    gain = 0.5 * G * (math.sin(angle) - mu * math.cos(angle))
    if side < 0:
        assert abs(x1 - x0) < 1e-4
    else:
        assert v1 - v0 == pytest.approx(gain, rel=0.05)


# ---- grippers --------------------------------------------------------------------------------


def held(body, centre, radius):
    """[N] particles whose whole stencil a gripper holds: 1.5 cells an axis within radius + dx."""
    return np.linalg.norm(body.x - centre, axis=1) < radius + DX - 1.5 * math.sqrt(3.0) * DX


def test_gripper_carries_exactly():
    """Held particles follow a crooked path to 1e-9 m and stay where it ends."""
    body = block(size=(0.08, 0.04, 0.04))
    t = np.linspace(0.0, 0.5, 6)
    centre = body.x.mean(axis=0) - [0.03, 0.0, 0.0]
    path = centre + np.stack([0.1 * np.sin(6 * t), 0.05 * t, 0.3 * t**2], axis=1)
    grip = Gripper(time=t, position=path, radius=0.035)
    times = np.linspace(0.05, 0.7, 14)
    x = simulator(body, grippers=[grip]).run(times)[:, 0]
    inner = held(body, path[0], 0.035)
    assert 20 < inner.sum() < body.num_particles / 2
    expected = body.x[inner] + (grip.position_at(times) - path[0])[:, None]
    assert np.abs(x[:, inner] - expected).max() < 1e-9
    assert np.abs(x[-1, ~inner] - body.x[~inner] - (path[-1] - path[0])).max() > 1e-4


@pytest.mark.parametrize(
    ("knots", "angles", "times", "expected"),
    [
        ([0.0, 0.2, 0.4], [0.0, 0.4, 1.2], [0.1, 0.2, 0.3], [0.2, 0.4, 0.8]),
        ([0.1, 0.2], [0.0, 0.4], [0.05, 0.2, 0.3], [0.0, 0.4, 0.4]),
    ],
    ids=["along its path", "outside of it"],
)
def test_gripper_turns_what_it_holds(knots, angles, times, expected):
    """Held particles turn about the centre by the pose's angle; before and after the path they
    stay."""
    body = block(size=(0.06, 0.06, 0.06))
    centre = body.x.mean(axis=0)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    quat = Rotation.from_rotvec(np.asarray(angles)[:, None] * axis).as_quat()
    grip = Gripper(
        time=knots, position=np.tile(centre, (len(knots), 1)), quat_xyzw=quat, radius=0.04
    )
    x = simulator(body, grippers=[grip], gravity=(0, 0, 0)).run(times)[:, 0]
    inner = held(body, centre, 0.04)
    X = body.x[inner] - centre
    turned = []
    for frame in x[:, inner] - centre:
        U, _, Vt = np.linalg.svd(X.T @ frame)
        vector = Rotation.from_matrix((U @ Vt).T).as_rotvec()
        assert np.linalg.norm(np.cross(vector, axis)) < 1e-3
        # explicit Euler along the tangent lets radii grow by (rate h)^2 / 2 a substep
        assert np.linalg.norm(frame, axis=1) == pytest.approx(np.linalg.norm(X, axis=1), rel=0.01)
        turned.append(vector @ axis)
    assert turned == pytest.approx(expected, abs=2e-3)


# ---- grid ------------------------------------------------------------------------------------


def test_grid_follows_a_flying_block():
    """Two metres of flight through 200 cells take no more memory, and the centre flies straight."""
    body = block()
    s = simulator(body, gravity=(0, 0, 0))
    room = s.worlds.room
    v = np.array([1.2, -1.2, 1.06])
    s.set_velocities(v + np.cross([2.0, 3.0, 5.0], body.x - body.x.mean(axis=0)))
    x = s.run([1.0])[0, 0]
    assert s.worlds.room == room
    assert room[0] < 16 and room[1] < 16 and room[2] < 16 * body.num_particles
    assert x.mean(axis=0) == pytest.approx(body.x.mean(axis=0) + v, abs=1e-12)


@pytest.mark.parametrize("cells", [200, -1000])
def test_far_from_the_origin_nothing_changes(cells):
    """Started whole cells away, on a table as far up, the answer only moves along."""
    body = block(corner=(0.003, 0.001, 0.045))
    swing = np.cross([2.0, 3.0, 5.0], body.x - body.x.mean(axis=0))

    def run(shift):
        s = simulator(body.moved(shift), table=Table(height=float(shift[2])))
        s.set_velocities(swing)
        return s.run([0.1, 0.3]) - shift

    here = run(np.zeros(3))
    away = run(DX * np.array([cells, -cells, cells]))
    assert np.abs(away - here).max() < 1e-11
    assert np.abs(here[1] - here[0]).max() > 1e-3


def test_grid_grows_while_running():
    """An upright rope that tips over needs wider windows and more nodes; the answer is the same."""
    body = rope(diameter=0.02, length=0.4, start=(0, 0, -0.2), direction=(0, 0, 1))
    answers = []
    for room in ((8, 8, 400), (80, 80, 40000)):
        s = simulator(body, gravity=(0, 0, 0))
        s.worlds.room = room
        s.set_velocities(np.cross([3.0, 4.0, 0.0], body.x))
        answers.append(s.run([0.15, 0.3])[:, 0])
        grown = s.worlds.room
        if room[0] == 8:
            assert grown[0] > 20 and grown[1] > 20 and grown[2] > 400
        else:
            assert grown == room
    assert np.array_equal(*answers)
    assert np.ptp(answers[0][1, :, :2], axis=0).min() > 0.2


# ---- time steps and failures -----------------------------------------------------------------


def test_substep_is_a_share_of_the_courant_limit():
    """cfl * dx / sqrt((lam + 2 mu) / density), for every world; a given substep overrides it."""
    stiff = Material(E=9.0e4, nu=0.0, density=900.0)  # 10 m/s
    assert stable_substep(stiff, 0.02, cfl=0.3) == pytest.approx(0.3 * 0.02 / 10.0)
    s = Simulator(block(), [stiff, SOFT], solver=Solver(engine="mpm", cfl=0.2))
    assert s.substep[0] == pytest.approx(0.2 * DX / 10.0)
    assert s.substep[1] == pytest.approx(0.2 * DX / SOFT.wave_speed)
    assert Simulator(
        block(), [stiff], solver=Solver(engine="mpm", substep=1e-5)
    ).substep == pytest.approx([1e-5])


def failing(E=1.0e6, substep=1e-3):
    """Two worlds of which the second takes substeps far beyond its limit."""
    body = rope(diameter=0.02, length=0.12, start=(0, 0, 0.05), cells_across=1.5)
    grip = Gripper(time=[0, 0.3], position=[(0, 0, 0.05), (0, 0, 0.15)], radius=0.02)
    materials = [SOFT, Material(E=E, nu=0.4, density=1000.0)]
    return simulator(body, materials, grippers=[grip], substep=substep)


@pytest.mark.parametrize(
    ("E", "substep", "what"),
    [(1.0e6, 1e-3, "velocities grew"), (1.0e5, 1.5e-3, "turned inside out")],
)
def test_divergence_names_its_world(E, substep, what):
    """The error says which world failed, how, when and with what, and which particle if one."""
    s = failing(E, substep)
    with pytest.raises(SimulationError, match=rf"world 1 at 0\.\d+ s .*nu 0\.4.*{what}") as e:
        s.run(np.linspace(0.01, 0.2, 20))
    assert e.value.world == 1
    assert e.value.parameters == {"E": E, "nu": 0.4, "density": 1000.0}
    assert e.value.time is not None and 0.0 < e.value.time < 0.2
    if "particle" not in str(e.value):
        assert e.value.particle is None
    else:
        assert e.value.particle in range(s.body.num_particles)


def test_last_good_state_is_that_of_its_time(tmp_path):
    """Runs to the saved time, one for all or one a world, end at the saved positions."""
    s = failing()
    with pytest.raises(SimulationError):
        s.run(np.arange(1, 201) * 0.001)
    s.save_state(tmp_path / "state.npz", last_good=True)
    with np.load(tmp_path / "state.npz") as saved:
        for name in ("x", "v", "C", "F", "E", "nu", "density", "substep"):
            assert len(saved[name]) == 2 and np.isfinite(saved[name]).all()
        times, x = np.broadcast_to(saved["time"], 2), saved["x"]
    assert np.abs(s.positions()[1] - x[1]).max() > 1e-6
    for w, time in enumerate(times):
        frames = np.arange(1, round(time / 0.001) + 1) * 0.001
        alone = simulator(
            s.body, [s.materials[w]], grippers=s.worlds.setting.grippers[w], substep=1e-3
        )
        assert np.abs(alone.run(frames)[-1, 0] - x[w]).max() < 1e-9


def test_state_now(tmp_path):
    """save_state() keeps what the simulator holds, and overwrites nothing by halves."""
    s = lifted_rope()
    s.run([0.05])
    s.save_state(tmp_path / "now.npz")
    with np.load(tmp_path / "now.npz") as saved:
        assert np.array_equal(saved["x"], s.positions())
        assert np.array_equal(saved["v"], s.velocities())
        assert np.array_equal(saved["F"], s.deformation_gradients())
        assert saved["time"] == 0.05
    assert [p.name for p in tmp_path.iterdir()] == ["now.npz"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"materials": []}, "at least one material"),
        ({"table": Table(height=0.0, friction=[0.1, 0.2])}, "friction"),
        ({"positions": np.full((512, 3), np.nan)}, "positions must be finite"),
        ({"materials": [SOFT] * 2, "grippers": [[Gripper.still((0, 0, 0), radius=1)], []]}, "same"),
        ({"materials": [SOFT] * 2, "grippers": [[Gripper.still((0, 0, 0), radius=1)]]}, "world 1"),
    ],
)
def test_arguments_that_do_not_fit(options, words):
    """The error names the argument."""
    body = block()
    assert body.num_particles == 512
    with pytest.raises(ParameterError, match=words):
        simulator(body, options.pop("materials", [SOFT]), **options)


def test_a_device_that_is_not_there():
    """The error says what to use instead."""
    with pytest.raises(DeviceError, match=r"'cuda:77'.*--device cpu"):
        simulator(block(), device="cuda:77")


def test_a_list_of_devices():
    """Names with commas between them, or all GPUs."""
    assert list_devices("cpu, cpu") == ["cpu", "cpu"]
    with pytest.raises(DeviceError, match="'cuda:77'"):
        list_devices("cpu,cuda:77")
    if wp.is_cuda_available():
        assert list_devices("all")[0] == "cuda:0"
    else:
        with pytest.raises(DeviceError, match="--device cpu"):
            list_devices("all")


def test_substeps_that_are_too_short_are_refused():
    body = rope(diameter=0.02, length=0.1)
    with pytest.raises(ParameterError, match=r"world 1 .*substeps of .* s would be needed"):
        Simulator(body, [Material(), Material(E=1e14)], solver=Solver(engine="mpm"))
    with pytest.raises(ParameterError, match="substeps of 1e-09 s"):
        Simulator(body, [Material()], solver=Solver(engine="mpm", substep=1e-9))


def test_a_world_that_diverges_leaves_the_others_alone():
    stiff = Material(E=2.0e7, nu=0.3, density=1000.0)
    options = {"substep": 5e-4}
    times = [0.02, 0.04, 0.06]
    body = block()
    kick = np.random.default_rng(0).standard_normal((body.num_particles, 3))
    batch = simulator(body, [SOFT, stiff, SOFT], **options)
    batch.set_velocities(0.1 * kick)
    x = batch.run(times, keep_going=True)
    alone = simulator(body, [SOFT], **options)
    alone.set_velocities(0.1 * kick)
    expected = alone.run(times)
    assert list(batch.failures) == [1]
    assert batch.failures[1].world == 1
    assert np.isnan(x[-1, 1]).all()
    assert np.array_equal(x[:, 0], expected[:, 0]) and np.array_equal(x[:, 2], expected[:, 0])
    batch.run([0.08], keep_going=True)  # and it stays where it is
    with pytest.raises(SimulationError, match="world 1"):
        batch.run([0.1])


def test_a_spin_that_is_set_with_its_affine_velocities_stays():
    body = block()
    omega = np.array([0.0, 0.0, 20.0])
    out = body.x - body.x.mean(axis=0)
    spin = np.array([[0.0, -20.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    kept = {}
    for name, affine in (("with", spin), ("without", 0.0)):
        s = simulator(body, gravity=(0.0, 0.0, 0.0))
        s.set_velocities(np.cross(omega, out), affine)
        s.run([10.0 * s.substep[0]])
        assert s.affine_velocities().shape == (1, body.num_particles, 3, 3)
        v = s.velocities()[0]
        kept[name] = np.cross(out, v)[:, 2].sum() / np.cross(out, np.cross(omega, out))[:, 2].sum()
    assert kept["with"] == pytest.approx(1.0, abs=0.03)
    assert kept["without"] < 0.9
