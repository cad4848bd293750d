"""How a corner is held comes back from the clouds of a lift that was simulated with it."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from gendom.cli.replay import replay_setup
from gendom.datasets import ObjectDescription, Recording
from gendom.errors import ParameterError
from gendom.estimation import Hold, Lift, ReplaySettings, Theta, replay_chamfer
from gendom.estimation.gauss_newton import Bounds
from gendom.estimation.hold import NAMES, Held, as_held, fit_hold
from gendom.materials.parameters import bending_length

SIDE = 0.2
MODULUS = 600.0
"""E / density of the cloth [m^2/s^2]."""

CHEAP = ReplaySettings(dtype="float32", threads=1)


def recording(clouds, **changes):
    """A corner lifted by 16 cm and moved by 10 cm in 1 s, then half a second of rest."""
    time = np.linspace(0.0, 1.5, len(clouds))
    share = np.clip(time, 0.0, 1.0)
    path = np.stack([0.1 * share, 0.0 * share, 0.02 + 0.16 * share], axis=1)
    values = {
        "object": ObjectDescription(kind="cloth", width=SIDE, height=SIDE, grasp="corner"),
        "table_height": 0.0,
        "gripper_source": "commanded",
        "source": "made by a test",
    }
    return Recording.from_frames(clouds, time=time, gripper_position=path, **{**values, **changes})


def flat():
    """[900, 3] a square on its table, a corner in the origin and the diagonal along x."""
    u = (np.arange(30) + 0.5) / 30 * SIDE
    a, b = (g.ravel() for g in np.meshgrid(u, u))
    return np.stack([(a + b) / math.sqrt(2), (b - a) / math.sqrt(2), 0.0 * a], axis=1)


def lifted(hold, *, frames=12, floor=-1.0, stray=0, seed=0, friction=0.3):
    """A recording of a cloth held like this, what lies below ``floor`` cropped away."""
    rng = np.random.default_rng(seed)
    lift = Lift(recording([flat()] * frames), CHEAP, hold=hold)
    clouds = []
    theta = Theta(specific_modulus=MODULUS, friction=friction)
    for x in lift.simulate([theta])[:, 0].astype(float):
        seen = x[x[:, 2] > floor] + 0.001 * rng.normal(size=(int((x[:, 2] > floor).sum()), 3))
        far = [0.3, -0.3, 0.1] + 0.01 * rng.normal(size=(stray, 3))
        clouds.append(np.concatenate([seen, far]))
    return recording(clouds)


@pytest.fixture(scope="module")
def known():
    return Hold(lag=0.12, height=-0.015, inset=0.03, aside=0.01, turn=0.1, tilt=1.3)


@pytest.mark.slow
def test_a_known_hold_comes_back(known):
    """Found on a grid two thirds as fine, which bends otherwise: to a centimetre, and the replay
    is nearer than that of a cloth held at its very corner."""
    seen = lifted(known)
    lift = Lift(seen, CHEAP)
    found = lift.hold
    assert found is not None and found.sink == 0.0  # the table is seen
    assert found.lag == pytest.approx(known.lag, abs=0.03)
    assert found.height == pytest.approx(known.height, abs=0.012)
    assert found.inset == pytest.approx(known.inset, abs=0.012)
    assert found.aside == pytest.approx(known.aside, abs=0.006)
    assert found.turn == pytest.approx(known.turn, abs=0.08)
    theta = [Theta(specific_modulus=MODULUS)]
    right = replay_chamfer(lift, lift.simulate(theta)[:, 0])[0].mean()
    unfitted = Lift(seen, CHEAP, hold=Hold())
    wrong = replay_chamfer(unfitted, unfitted.simulate(theta)[:, 0])[0].mean()
    assert right < 0.6 * wrong


@pytest.mark.slow
def test_stray_points_do_not_move_it(known):
    """A lump of points far from the cloth changes nothing that matters."""
    plain, strewn = (Lift(lifted(known, stray=n), CHEAP).hold for n in (0, 20))
    assert plain is not None and strewn is not None
    assert strewn.inset == pytest.approx(plain.inset, abs=0.008)
    assert strewn.lag == pytest.approx(plain.lag, abs=0.03)


def test_a_hold_is_not_searched_where_it_is_given(known):
    """A given hold is taken as it is, and a coarser lift keeps it."""
    lift = Lift(recording([flat()] * 4), CHEAP, hold=known)
    assert lift.hold == known
    assert lift.coarser(0.7, hurry=2.0).hold == known


def test_a_thin_cloth_costs_no_more_substeps(monkeypatch):
    """The hold is found with a sheet that bends as far, whatever the thickness that is stated."""
    moduli = []

    def one_look(simulate, clouds, floor, bounds, starts, **_):
        simulate(starts[:1])
        return starts[0]

    def looked_at(self, thetas, **_):
        moduli.append(thetas[0].specific_modulus)

    monkeypatch.setattr("gendom.estimation.lift.fit_hold", one_look)
    monkeypatch.setattr(Lift, "simulate", looked_at)
    for thickness in (0.0005, 0.0002):
        seen = recording([flat()] * 12)
        Lift(replace(seen, object=replace(seen.object, thickness=thickness)), CHEAP)
    first, second = np.reshape(moduli, (2, -1))
    assert second == pytest.approx(first)


def test_the_cloth_lies_as_it_is_held(known):
    """The held point lies inside the corner, beside the diagonal, turned, on the lower table."""
    hold = replace(known, sink=0.01)
    lift = Lift(recording([flat()] * 4), CHEAP, hold=hold)
    x = lift.body.x - [lift.grip[0][0], lift.grip[0][1], 0.0]
    c, s = math.cos(hold.turn), math.sin(hold.turn)
    x = x @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert x[:, 0].min() == pytest.approx(-hold.inset, abs=lift.body.dx)
    assert x[:, :2].mean(axis=0) == pytest.approx(
        [SIDE / math.sqrt(2) - hold.inset, -hold.aside], abs=1e-3
    )
    assert x[:, 2].mean() == pytest.approx(lift.body.thickness / 2.0 - hold.sink)


def test_a_lag_delays_the_motion():
    """What is seen a frame late is where the gripper was a frame before."""
    step = 1.5 / 9
    thetas = [Theta(specific_modulus=MODULUS)]
    prompt, late = (
        Lift(recording([flat()] * 10), CHEAP, hold=Hold(lag=lag)).simulate(thetas)[:, 0]
        for lag in (0.0, step)
    )
    top = [x[:, :, 2].max(axis=1) for x in (prompt, late)]
    assert top[1][5:] == pytest.approx(top[0][4:-1], abs=0.004)
    assert top[0][5] - top[1][5] > 0.01


def test_a_corner_is_held_as_high_and_as_steep_as_told():
    """Held higher, the corner ends higher; 3 cm of cloth beyond the held point stand up."""
    upright = Hold(inset=0.03, tilt=math.pi / 2.0)
    holds = [upright, replace(upright, height=0.02), replace(upright, tilt=0.0)]
    lift = Lift(recording([flat()] * 4), CHEAP, hold=Hold())
    x = lift.simulate([Theta(specific_modulus=MODULUS)] * 3, holds=holds)
    top, higher, level = x[-1, :, :, 2].max(axis=1)
    assert higher - top == pytest.approx(0.02, abs=0.002)
    assert top - level > 0.015


def test_worlds_of_a_batch_hold_as_they_are_told(known):
    """Each world has its own hold, its lower table too."""
    lift = Lift(recording([flat()] * 5), CHEAP, hold=Hold())
    holds = [known, replace(known, sink=0.01)]
    theta = Theta(specific_modulus=MODULUS)
    both = lift.simulate([theta] * 2, holds=holds)
    for w, hold in enumerate(holds):
        alone = Lift(recording([flat()] * 5), CHEAP, hold=hold).simulate([theta])
        assert np.abs(both[:, w] - alone[:, 0]).max() < 1e-4
    assert both[0, 1, :, 2].min() < -0.005 < both[0, 0, :, 2].min()


def test_fit_hold_on_points_that_move_along():
    """With particles that follow the hold linearly the fit is exact; given values stay."""
    rng = np.random.default_rng(0)
    cloth = rng.uniform(-0.1, 0.1, size=(300, 3))
    truth = Hold(lag=0.05, height=0.01, inset=0.012, aside=-0.006, tilt=0.0)

    def simulate(held):
        moves = [
            [h.hold.inset + 0.2 * h.hold.lag * t, h.hold.aside, h.hold.height]
            for t in (0, 1)
            for h in held
        ]
        wider = np.reshape([h.bending / 0.02 for _ in (0, 1) for h in held], (2, len(held), 1, 1))
        return cloth * wider + np.reshape(moves, (2, len(held), 1, 3))

    clouds = list(simulate([Held(hold=truth, bending=0.022)])[:, 0])
    mean = Held(hold=Hold(tilt=0.0), friction=0.3, bending=0.02).vector
    sd = np.full(len(NAMES), 0.1)
    sd[1:4], sd[-1] = 0.02, 0.3
    low, high = mean - 4.0 * sd, mean + 4.0 * sd
    low[4:-1] = high[4:-1] = mean[4:-1]
    low[0] = 0.0
    bounds = Bounds(
        low=low, high=high, mean=mean, sd=sd, largest_step=sd, tolerance=1e-3 * sd
    )  # fmt: skip
    told = []
    found = fit_hold(
        simulate,
        clouds,
        None,
        bounds,
        [as_held(mean)],
        on_iteration=lambda *best: told.append(best),
    )
    assert told[-1][0].hold == found.hold
    assert [loss for _, loss in told] == sorted((loss for _, loss in told), reverse=True)
    for name in ("lag", "height", "inset", "aside"):
        assert getattr(found.hold, name) == pytest.approx(getattr(truth, name), abs=1.5e-3), name
    assert (found.hold.turn, found.hold.tilt, found.hold.sink) == (0.0, 0.0, 0.0)
    assert found.bending == pytest.approx(0.022, rel=0.01)
    assert found.friction == pytest.approx(0.3)
    assert 0.0 <= found.doubt < 0.05


def test_what_a_hold_hides_is_told():
    """Points far to one side move alike when the cloth is held further in and when it bends
    further: the bending is then in doubt, and not where they lie around the held point."""
    rng = np.random.default_rng(1)
    prior = Held(hold=Hold(), bending=0.02).vector
    sd = np.full(len(NAMES), 0.1)
    free = np.isin(NAMES, ["inset", "log_bending"])
    bounds = Bounds(
        low=np.where(free, prior - 0.4, prior), high=np.where(free, prior + 0.4, prior),
        mean=prior, sd=sd, largest_step=sd, tolerance=1e-3 * sd,
    )  # fmt: skip
    doubts = []
    for centre in (0.0, 0.3):
        cloth = rng.uniform(-0.1, 0.1, size=(300, 3)) + np.array([centre, 0.0, 0.0])

        def simulate(held, cloth=cloth):
            wide = np.array([h.bending for h in held])[:, None, None] / 0.02
            inset = np.array([[h.hold.inset, 0.0, 0.0] for h in held])[:, None]
            return (cloth * [1.0, 0.0, 0.0] * wide + cloth * [0.0, 1.0, 1.0] + inset)[None]

        clouds = list(simulate([Held(hold=Hold(), bending=0.021)])[:, 0])
        doubts.append(fit_hold(simulate, clouds, None, bounds, [as_held(prior)]).doubt)
    assert doubts[1] > 3.0 * doubts[0] > 0.0


def test_a_stated_reach_is_believed(monkeypatch):
    """A recording that says how far the fingers reach narrows the search for it."""
    seen_bounds = []

    def one_look(simulate, clouds, floor, bounds, starts, **_):
        seen_bounds.append(bounds)
        assert starts[0].hold.reach == (stated or Hold().reach)
        return starts[0]

    monkeypatch.setattr("gendom.estimation.lift.fit_hold", one_look)
    for stated in (None, 0.012):
        seen = recording([flat()] * 12)
        Lift(replace(seen, object=replace(seen.object, grasp_radius=stated)), CHEAP)
    reach = NAMES.index("reach")
    unknown, known = seen_bounds[0], seen_bounds[-1]
    assert unknown.mean[reach] == Hold().reach and known.mean[reach] == 0.012
    assert known.sd[reach] < 0.5 * unknown.sd[reach]


def test_a_replay_seeks_the_hold_alone(monkeypatch):
    """Material and friction are the estimate's; the height of its own lift's grip is not carried
    over to another one."""
    seen_bounds = []

    def one_look(simulate, clouds, floor, bounds, starts, **_):
        seen_bounds.append(bounds)
        return starts[0]

    monkeypatch.setattr("gendom.estimation.lift.fit_hold", one_look)
    params = {
        "format": "gendom-estimate/1", "specific_modulus": MODULUS, "poissons_ratio": 0.3,
        "grip_offset": 0.004, "friction": 0.45, "object": {"kind": "cloth"},
    }  # fmt: skip
    lift, theta = replay_setup(recording([flat()] * 12), params, "estimate.json", "cpu")
    assert theta == Theta(specific_modulus=MODULUS, nu=0.3, friction=0.45)
    length = bending_length(MODULUS, lift.radius_of_gyration, 9.81)
    for name, value in (("friction", 0.45), ("log_bending", math.log(length))):
        n = NAMES.index(name)
        assert all(b.low[n] == b.high[n] == pytest.approx(value) for b in seen_bounds)
    tilt = NAMES.index("tilt")
    assert seen_bounds and all(b.low[tilt] < b.high[tilt] for b in seen_bounds)


def test_a_replay_of_the_same_lift_holds_as_the_estimate_did(monkeypatch):
    """Also of a longer recording of it, which is then foretold and not fitted."""

    def no_look(*_, **__):
        raise AssertionError("the hold is known")

    monkeypatch.setattr("gendom.estimation.lift.fit_hold", no_look)
    seen = recording([flat()] * 12)
    hold = Hold(lag=0.03, inset=0.012, tilt=1.1)
    params = {
        "format": "gendom-estimate/1", "specific_modulus": MODULUS, "poissons_ratio": 0.3,
        "grip_offset": 0.004, "friction": 0.45, "object": {"kind": "cloth"},
        "hold": asdict(hold), "begins_with": seen.head(5).begins_with,
    }  # fmt: skip
    lift, theta = replay_setup(seen, params, "estimate.json", "cpu")
    assert lift.hold == hold and theta.grip_offset == 0.004


@pytest.mark.parametrize("bad", [{"lag": -0.1}, {"sink": -0.01}, {"inset": np.nan}, {"reach": 0.0}])
def test_bad_holds_are_refused(bad):
    """The error names the value."""
    with pytest.raises(ParameterError, match=next(iter(bad))):
        Hold(**bad)
