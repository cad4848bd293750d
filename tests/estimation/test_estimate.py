"""Known parameters come back from lifts that were simulated with them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.datasets import ObjectDescription, Recording
from gendom.errors import ParameterError, RecordingError
from gendom.estimation import (
    EstimateSettings,
    Lift,
    ReplaySettings,
    Theta,
    estimate,
    replay_chamfer,
)
from gendom.estimation.estimate import STEPS, _Comparison, _theta
from gendom.estimation.priors import BENDING_RANGE, FRICTION_PRIOR
from gendom.files import to_json
from gendom.materials.parameters import bending_length, specific_modulus_of
from gendom.observation import chamfer
from gendom.sim import Rollout, Simulator

LENGTH, DIAMETER, DENSITY = 0.2, 0.012, 1000.0
MODULUS = specific_modulus_of(0.35 * LENGTH, DIAMETER / 4.0, 9.81)
"""E / density of a rope that bends over 7 cm [m^2/s^2]."""

CHEAP = ReplaySettings(cells_across=1.0, clock=5.0, threads=1)
"""A coarse and quick replay; the recording made with it is as quick."""

EXACT = replace(CHEAP, dtype="float64")

SUBSTEP = 1.0e-4
"""Where substeps are not to follow the stiffness [s]."""

KEYS = {
    "begins_with", "bending_length", "bounds", "chamfer_last", "chamfer_last_surface",
    "chamfer_mean", "chamfer_mean_surface", "density", "density_assumed", "device", "format",
    "frames", "friction", "grip_offset", "history", "hold", "identifiable", "interrupted",
    "intervals", "iterations", "loss", "method", "notes", "object", "poissons_ratio", "seconds",
    "seed", "simulation", "specific_modulus", "starts", "youngs_modulus",
}  # fmt: skip


def recording(clouds, **changes):
    """A slow lift by 10 cm in 1.6 s, then 0.4 s of rest, seen as these clouds."""
    time = np.linspace(0.0, 2.0, len(clouds))
    height = DIAMETER / 2.0 + 0.1 * np.minimum(time / 1.6, 1.0)
    mass = DENSITY * math.pi / 4.0 * DIAMETER**2 * LENGTH
    values = {
        "object": ObjectDescription(kind="rope", length=LENGTH, diameter=DIAMETER, mass=mass),
        "table_height": 0.0,
        "gripper_source": "measured",
        "quasi_static": True,
        "source": "made by a test",
    }
    return Recording.from_frames(
        clouds,
        time=time,
        gripper_position=np.stack([0.0 * time, 0.0 * time, height], axis=1),
        **{**values, **changes},
    )


def at_rest():
    """[300, 3] the upper side of the straight rope on its table."""
    x = np.linspace(0.0, LENGTH, 300)
    return np.stack([x, 0.0 * x, np.full(300, DIAMETER)], axis=1)


def synthetic(replay=CHEAP, *, frames=10, modulus=MODULUS, friction=0.3, seed=0):
    """A recording of a rope with known parameters: 120 points a frame with 1 mm noise."""
    rng = np.random.default_rng(seed)
    lift = Lift(recording([at_rest()] * frames), replay)
    clouds = []
    theta = Theta(specific_modulus=modulus, nu=0.3, friction=friction)
    for x in lift.simulate([theta])[:, 0]:
        skin = lift.body.surface(x)
        shown = skin[lift.visible(skin)]
        shown = shown[rng.choice(len(shown), size=min(120, len(shown)), replace=False)]
        clouds.append(shown + 0.001 * rng.normal(size=shown.shape))
    return recording(clouds)


@pytest.fixture(scope="module")
def lifted():
    return synthetic()


@pytest.fixture(scope="module")
def result(lifted):
    """The estimate from one start, and what was reported on the way."""
    reports = []
    settings = EstimateSettings(starts=1, replay=CHEAP)
    return estimate(lifted, settings, on_progress=reports.append), reports


# ---- recovery --------------------------------------------------------------------------------


def test_known_modulus_comes_back(result):
    """E within 10 %, inside its interval; nu not identifiable, its interval spans the prior's."""
    record = result[0].record
    assert record["specific_modulus"] == pytest.approx(MODULUS, rel=0.1)
    low, high = record["intervals"]["specific_modulus"]
    assert low < MODULUS < high
    assert 1.02 < high / low < 2.0
    assert record["identifiable"]["youngs_modulus"] and not record["identifiable"]["poissons_ratio"]
    low, high = record["intervals"]["poissons_ratio"]
    assert high - low > 0.1
    start = record["starts"][0]["initial"]["specific_modulus"]
    assert not 0.9 * MODULUS < start < 1.1 * MODULUS  # it had some way to go
    assert abs(record["grip_offset"]) < 1e-3


def test_another_seed_finds_the_same(lifted, result):
    """A start drawn elsewhere ends at the same modulus within 5 %."""
    other = estimate(lifted, EstimateSettings(starts=1, seed=1, replay=CHEAP)).record
    first = result[0].record
    assert other["seed"] == 1
    starts = [r["starts"][0]["initial"]["specific_modulus"] for r in (first, other)]
    assert abs(math.log(starts[0] / starts[1])) > 0.1
    assert other["specific_modulus"] == pytest.approx(MODULUS, rel=0.1)
    assert other["specific_modulus"] == pytest.approx(first["specific_modulus"], rel=0.05)


def test_friction_follows_the_free_end():
    """A short lift tells little of it: its interval holds the truth, E does not suffer."""
    found = []
    for friction in (0.1, 0.7):
        seen = synthetic(friction=friction)
        record = estimate(seen, EstimateSettings(starts=1, replay=CHEAP)).record
        low, high = record["intervals"]["friction"]
        assert low < friction < high
        assert record["specific_modulus"] == pytest.approx(MODULUS, rel=0.1)
        found.append(record["friction"])
    assert found[0] < FRICTION_PRIOR[0] < found[1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_known_modulus_comes_back_from_a_finer_world(seed):
    """A rope simulated at two cells, replayed at 1.5: the interval holds the truth.

    Two grids do not agree better than ``GRID_ERROR``, so the interval has to allow for it.
    """
    seen = synthetic(ReplaySettings(cells_across=2.0), frames=12, seed=seed)
    settings = EstimateSettings(starts=2, seed=seed, replay=ReplaySettings(cells_across=1.5))
    record = estimate(seen, settings).record
    low, high = record["intervals"]["specific_modulus"]
    assert low < MODULUS < high < 2.0 * low
    assert not record["identifiable"]["poissons_ratio"]


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_softer_and_stiffer_ropes_come_back(share):
    """Bending over a quarter and over half of its length: E within 10 %."""
    modulus = specific_modulus_of(share * LENGTH, DIAMETER / 4.0, 9.81)
    record = estimate(synthetic(modulus=modulus), EstimateSettings(starts=2, replay=CHEAP)).record
    assert record["specific_modulus"] == pytest.approx(modulus, rel=0.1)


# ---- the result ------------------------------------------------------------------------------


def test_record_is_gendom_estimate_1(result):
    """All keys are there, it has a JSON form, and its numbers agree with each other."""
    estimated = result[0]
    record = estimated.record
    assert record["format"] == "gendom-estimate/1"
    assert set(record) == KEYS
    assert to_json(record)
    assert record["density"] == pytest.approx(DENSITY) and not record["density_assumed"]
    assert record["youngs_modulus"] == pytest.approx(record["specific_modulus"] * DENSITY)
    assert record["specific_modulus"] == estimated.theta.specific_modulus
    k = DIAMETER / 4.0
    assert record["bending_length"] == pytest.approx(
        bending_length(record["specific_modulus"], k, 9.81)
    )
    intervals = record["intervals"]
    assert intervals["level"] == 0.9
    for name in ("youngs_modulus", "specific_modulus", "bending_length", "poissons_ratio"):
        assert intervals[name][0] < record[name] < intervals[name][1]
        low, high = record["bounds"][name]
        assert low < record[name] < high
    low, high = record["bounds"]["specific_modulus"]
    np.testing.assert_allclose(record["bounds"]["youngs_modulus"], [low * DENSITY, high * DENSITY])
    # The range is one of bending lengths, in lengths of the simulated rope.
    shares = np.array(record["bounds"]["bending_length"]) / estimated.lift.size
    np.testing.assert_allclose(shares, BENDING_RANGE["rope"])
    assert record["simulation"]["cells_across"] == 1.0
    assert record["simulation"]["clock"] == 5.0
    assert not record["interrupted"]
    assert record["iterations"] >= 2
    iterations = {"coarse": [], "fine": []}
    for step in record["history"]:
        iterations[step["stage"]].append(step["iteration"])
    assert 1 <= min(iterations["coarse"]) <= max(iterations["coarse"]) < min(iterations["fine"])


def test_chamfer_is_that_of_the_best_fit(lifted, result):
    """The reported distances are those of the positions handed out, frame by frame."""
    estimated = result[0]
    assert estimated.chamfer[3] == chamfer(lifted.frame(3), estimated.positions[3])
    record = estimated.record
    whole, surface = replay_chamfer(estimated.lift, estimated.positions)
    assert np.array_equal(whole, estimated.chamfer)
    assert len(whole) == lifted.num_frames
    assert record["chamfer_last"] == whole[-1]
    assert record["chamfer_mean"] == pytest.approx(whole.mean())
    assert record["chamfer_last_surface"] == surface[-1]
    assert surface.mean() < whole.mean() < 0.01  # noise and the unseen lower side
    again = replay_chamfer(estimated.lift, estimated.positions[[2, 5]], frames=[2, 5])[0]
    assert np.array_equal(again, whole[[2, 5]])


def test_progress_is_reported(result):
    """Coarse before fine, the share of work never falls, losses are finite."""
    reports = result[1]
    stages = [p.stage for p in reports]
    assert stages == sorted(stages) and set(stages) == {"coarse", "fine"}
    done = [p.done for p in reports]
    assert done == sorted(done) and 0.0 < done[0] and done[-1] <= 1.0
    assert done[stages.index("fine")] > done[stages.index("fine") - 1]
    assert all(np.isfinite(p.loss) and p.best.specific_modulus > 0.0 for p in reports)


def test_ctrl_c_keeps_the_best_so_far(lifted):
    """An interrupt after the first iteration gives a whole result that says so."""

    def interrupt(progress):
        raise KeyboardInterrupt

    settings = EstimateSettings(starts=1, replay=CHEAP)
    record = estimate(lifted, settings, on_progress=interrupt).record
    assert record["interrupted"]
    assert set(record) == KEYS
    assert record["iterations"] == 1
    assert [h["stage"] for h in record["history"]] == ["interrupted"]
    initial = record["starts"][0]["initial"]["specific_modulus"]
    assert record["specific_modulus"] == pytest.approx(initial)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"starts": 0}, "starts"),
        ({"frames": "first"}, "'all' or 'last'"),
        ({"max_iterations": 1}, "max_iterations"),
        ({"level": 1.0}, "level"),
        ({"level": 0.0}, "level"),
    ],
)
def test_bad_settings_are_refused(settings, words):
    """The error names the setting."""
    with pytest.raises(ParameterError, match=words):
        EstimateSettings(**settings)


# ---- the replay ------------------------------------------------------------------------------


def test_quasi_static_replay_does_not_depend_on_the_clock():
    """At half the default speed particles are elsewhere by less than 3 mm, in every frame."""
    seen = recording([at_rest()] * 6)
    theta = [Theta(specific_modulus=MODULUS)]
    default = Lift(seen, ReplaySettings(cells_across=1.5, threads=1))
    slow = Lift(seen, ReplaySettings(cells_across=1.5, threads=1, clock=default.clock / 2.0))
    x, y = (lift.simulate(theta)[:, 0] for lift in (default, slow))
    assert np.linalg.norm(x - y, axis=-1).max() < 0.003
    assert np.ptp(x[-1, :, 2]) > 0.09  # it was lifted
    assert default.clock == pytest.approx(2.0 * 0.12 / 0.1)


def test_grip_offset_raises_the_object():
    """What hangs 5 mm higher than stated is held 5 mm higher, once off the table."""
    lift = Lift(recording([at_rest()] * 5), CHEAP)
    offsets = (0.0, 0.005)
    x = lift.simulate([Theta(specific_modulus=MODULUS, grip_offset=o) for o in offsets])
    held = np.linalg.norm(lift.body.x - lift.grip[0], axis=1) < DIAMETER / 2.0
    assert held.any()
    rise = (x[:, 1] - x[:, 0])[:, held, 2].mean(axis=1)
    assert rise[1:] == pytest.approx(0.005, abs=5e-4)


def test_a_dynamic_recording_keeps_its_clock():
    """Only quasi-static recordings are replayed faster or slower than they were made."""
    assert Lift(recording([at_rest()] * 3, quasi_static=False)).clock == 1.0


def test_rope_is_placed_where_it_is_seen():
    """The body lies along the cloud on the table, from half a diameter behind the gripper on."""
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cloud = at_rest()
    cloud[:, :2] = cloud[:, :2] @ turn.T
    lift = Lift(recording([cloud] * 3), ReplaySettings(cells_across=2.0))
    x = lift.body.x
    along = x[:, :2] @ turn[:, 0]
    across = x[:, :2] @ turn[:, 1]
    assert along.min() == pytest.approx(-DIAMETER / 2.0, abs=0.002)
    assert np.ptp(along) == pytest.approx(LENGTH, abs=0.004)
    assert np.abs(across).max() < DIAMETER / 2.0 + 1e-3
    assert x[:, 2].mean() == pytest.approx(DIAMETER / 2.0)
    assert x[:, 2].min() > 0.0
    assert lift.grip[0] == pytest.approx([0.0, 0.0, DIAMETER / 2.0], abs=lift.body.dx / 2.0)


def test_unknown_mass_assumes_a_density():
    """Without a mass the density is assumed and said to be; motion depends on it by the air
    alone."""
    description = ObjectDescription(kind="rope", length=LENGTH, diameter=DIAMETER)
    seen = recording([at_rest()] * 3, object=description)
    lift = Lift(seen, EXACT)
    assert lift.density_assumed and lift.density == 1000.0
    heavy = ObjectDescription(kind="rope", length=LENGTH, diameter=DIAMETER, mass=0.1)
    other = Lift(recording([at_rest()] * 3, object=heavy), EXACT)
    assert other.density == pytest.approx(0.1 / (math.pi / 4 * DIAMETER**2 * LENGTH))
    theta = [Theta(specific_modulus=MODULUS)]
    assert np.abs(other.simulate(theta) - lift.simulate(theta)).max() < 1e-5


def test_a_recording_without_points_cannot_be_lifted():
    """The error is the recording's, not one of array shapes."""
    with pytest.raises(RecordingError, match="no frame holds a point"):
        Lift(recording([np.zeros((0, 3))] * 3))


@pytest.mark.parametrize("setting", [{"clock": 0.0}, {"clock": np.nan}, {"cells_across": -1.0}])
def test_bad_replay_settings_are_refused(setting):
    """Numbers that make no replay raise before anything is simulated."""
    with pytest.raises(ParameterError, match=next(iter(setting))):
        ReplaySettings(**setting)


def test_negative_friction_is_refused():
    """Before anything is simulated."""
    with pytest.raises(ParameterError, match="friction"):
        Theta(specific_modulus=MODULUS, friction=-0.1)


# ---- gradients -------------------------------------------------------------------------------


def density_loss(comparison, x):
    """[1] what ``_Comparison`` makes of positions x [T, N, 3], a tensor, in PyTorch."""
    import torch

    lift = comparison.lift
    body = lift.body
    loss = torch.zeros(1, dtype=x.dtype)
    sections = len(np.unique(body.material_coordinates[:, 0]))
    yz = np.linalg.norm(body.material_coordinates[: len(body.x) // sections, 1:], axis=1)
    outer = torch.tensor(yz > 0.6 * yz.max())
    for t in range(len(x)):
        section = x[t].reshape(sections, -1, 3)
        middle = section.mean(dim=1, keepdim=True)
        out = (section - middle)[:, outer]
        out = out * (body.thickness / 2.0 / out.norm(dim=-1, keepdim=True))
        skin = (middle + out).reshape(-1, 3)
        at = skin.detach().numpy()
        skin = skin[torch.tensor(lift.visible(at) & lift.inside(at))]
        for grid, seen, scale in zip(
            comparison.grids, comparison.seen, comparison.scales, strict=True
        ):
            q = (skin - torch.tensor(grid.origin)) / grid.cell
            base = torch.floor(q.detach() - 0.5)
            f = q - base
            w = torch.stack([(1.5 - f) ** 2 / 2, 0.75 - (f - 1) ** 2, (f - 0.5) ** 2 / 2], dim=-1)
            density = torch.zeros(grid.shape, dtype=x.dtype)
            for n in np.ndindex(3, 3, 3):
                node = tuple((base[:, a] + n[a]).long() for a in range(3))
                weight = w[:, 0, n[0]] * w[:, 1, n[1]] * w[:, 2, n[2]] / len(skin)
                density = density.index_put(node, weight, accumulate=True)
            loss = loss + scale * ((density.ravel() - torch.tensor(seen[t])) ** 2).sum()
    return loss


@pytest.mark.parametrize(("steps", "rel"), [([1e-7, 1e-6], 2e-4), (STEPS["rope"][:2], 0.08)])
def test_differences_of_the_density_loss_are_its_gradient(lifted, monkeypatch, steps, rel):
    """By log E and nu, in float64: reverse mode against the differences of one batch of worlds,
    with tiny steps and with the estimator's own, one-sided and of 3 %."""
    torch = pytest.importorskip("torch")
    rollouts = []

    class Recorded(Simulator):
        """Keeps what it ran; substeps do not follow the stiffness, for that is not derived."""

        def __init__(self, *args, cfl, **options):
            super().__init__(*args, substep=SUBSTEP, **options)

        def run(self, times, **options):
            rollouts.append(Rollout(self))
            return rollouts[-1].forward(times)

    monkeypatch.setattr("gendom.estimation.lift.Simulator", Recorded)
    monkeypatch.setitem(STEPS, "rope", np.array([*steps, 5e-4, 0.02]))
    lift = Lift(lifted, EXACT)
    comparison = _Comparison(lift, lift.frames, [16, 32, 64], free=[0, 1])
    theta = np.array([math.log(1.3 * MODULUS), 0.35, 0.0, 0.3])
    (model,) = comparison.models([theta])
    assert model is not None

    x = torch.tensor(lift.simulate([_theta(theta)])[:, 0], requires_grad=True)
    loss = density_loss(comparison, x)
    loss.backward()
    assert loss.item() == pytest.approx(model.sse, rel=1e-12)
    assert x.grad is not None
    gradients = rollouts[-1].backward(x.grad.numpy()[:, None])
    E = lift.material(_theta(theta)).E
    # the estimator's gradient is J^T r: half of that of the sum of squares
    found = np.array([gradients.E[0] * E, gradients.nu[0]]) / 2.0
    # that by nu is a two-thousandth of that by E: long steps show its size, no more
    np.testing.assert_allclose(
        model.gradient[:2], found, rtol=rel, atol=1e-3 * rel * abs(found[0]) / 0.08
    )
