"""Training, on a toy task whose forward map is known; refining, in a world in closed form."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gendom.errors import PolicyError
from gendom.materials import PARAMETERS, dimensionless_parameters, size_of, with_dimensionless
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import ClothSpreading, RopeReaching
from policies.conftest import TASK as THROWING
from policies.conftest import Throws, demonstrations, reach_of

torch = pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from gendom.policies import training as train_module  # noqa: E402
from gendom.policies.training import Training, train  # noqa: E402

CENTRE, RADIUS = np.array([0.45, 0.45]), 0.16


def reach(action, E, nu):
    """Goals grow with the distance from a centre: a whole circle of actions reaches each."""
    distance = np.linalg.norm(action - CENTRE, axis=1)
    return 1.2 + 1.5 * distance * (E / 0.4) ** 0.9 * (0.7 + nu)


def toy(count: int, seed: int = 0, *, risky: bool = False) -> Demonstrations:
    """Demonstrations of `reach`; where risky, those right of the centre are, and reach anything."""
    rng = np.random.default_rng(seed)
    radius, angle = RADIUS * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    action = CENTRE + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    E = np.exp(rng.uniform(np.log(0.25), np.log(0.7), count))
    nu = rng.uniform(0.2, 0.4, count)
    goal = reach(action, E, nu)
    risk = np.full(count, 1e-4)
    if risky:
        right = action[:, 0] > CENTRE[0]
        risk[right] = 0.3
        goal[right] = rng.uniform(1.0, 2.0, right.sum())
    return demonstrations(RopeReaching(), action, goal, {"bending_ratio": E, "nu": nu}, risk)


def sheets(action, E, *, risk=None) -> Demonstrations:
    """Demonstrations without goals: actions [N] that were enough for cloths of `bending_ratio`."""
    goal = np.empty((len(E), 0))
    return demonstrations(ClothSpreading(), action, goal, {"bending_ratio": E}, risk)


def acted(policy: Policy, cases: Demonstrations) -> np.ndarray:
    return policy.actions(cases.goal, {n: cases.parameters[n] for n in ("bending_ratio", "nu")})


def mean_error(policy: Policy) -> float:
    """Of |goal - reached| in cases that were not trained on [rope lengths]."""
    new = toy(500, seed=1)
    reached = reach(acted(policy, new), new.parameters["bending_ratio"], new.parameters["nu"])
    return np.abs(reached - new.goal[:, 0]).mean()


@pytest.fixture(scope="module")
def distal(tmp_path_factory) -> Policy:
    path = tmp_path_factory.mktemp("policy") / "distal.onnx"
    return train(toy(1200), path, Training(epochs=20, batch_size=128))


def test_distal_reaches_goals_where_the_mean_action_does_not(distal, tmp_path):
    inverse = train(toy(600), tmp_path / "inverse.onnx", Training(epochs=30, method="inverse"))
    assert mean_error(distal) < 0.015
    assert mean_error(inverse) > 0.1
    action = acted(distal, toy(500, seed=1))  # and it stays where demonstrations are
    assert np.linalg.norm(action - CENTRE, axis=1).max() < RADIUS + 0.05
    # and it knows: its own estimate on the held-out demonstrations agrees
    assert distal.description.training["errors"]["goal_rms_by_forward_model"] < 0.015


def test_risky_actions_are_avoided_and_what_they_reach_is_not_learnt(distal, tmp_path):
    careful = train(toy(1000, risky=True), tmp_path / "p.onnx", Training(epochs=20, batch_size=128))
    cases = toy(300, seed=1)
    risky = acted(careful, cases)[:, 0] > CENTRE[0]
    assert risky.mean() < 0.05
    assert (acted(distal, cases)[:, 0] > CENTRE[0]).mean() > 0.5
    assert mean_error(careful) < 0.03


def test_where_torch_has_no_gpu_networks_are_trained_on_the_cpu(tmp_path, caplog):
    if torch.cuda.is_available():
        pytest.skip("torch has a GPU")
    one, other = (
        acted(train(toy(100), tmp_path / d, Training(epochs=2), device=d), toy(20, seed=1))
        for d in ("cpu", "cuda")
    )
    np.testing.assert_array_equal(one, other)
    assert caplog.text.count("torch has no CUDA") == 1


@pytest.mark.gpu
def test_networks_trained_on_a_gpu_are_as_good(tmp_path):
    if not torch.cuda.is_available():
        pytest.skip("torch has no CUDA")
    policy = train(toy(1200), tmp_path / "p.onnx", Training(epochs=60), device="cuda")
    assert mean_error(policy) < 0.015


def test_without_goals_only_what_succeeded_is_learnt(tmp_path):
    """Soft objects need more of the action; a fifth failed, whatever was done."""
    rng, count = np.random.default_rng(0), 400
    E = rng.uniform(0.06, 0.16, count)
    failed = rng.uniform(size=count) < 0.2
    d = sheets(np.where(failed, 0.65, 0.6 - 3.0 * E), E, risk=np.where(failed, 0.9, 0.1))
    policy = train(d, tmp_path / "p.onnx", Training(epochs=60, method="inverse"))
    trained = policy.description.training
    assert (trained["demonstrations"], trained["failed"]) == (count, failed.sum())
    at = np.linspace(0.07, 0.15, 5)
    asked = policy.actions(np.empty((5, 0)), {"bending_ratio": at})[:, 0]
    assert asked == pytest.approx(0.6 - 3.0 * at, abs=0.02)
    assert policy.goal_range().shape == (0, 2)


@pytest.mark.parametrize("count", [500, 501, 502])
def test_bins_of_one_object_ascend(count):
    """Their means are rounded otherwise where they have other numbers of rows."""
    for E in np.linspace(0.3, 0.4, 40):
        d = toy(count)
        d.parameters["bending_ratio"][:] = E
        assert (np.diff(train_module.goal_range(d).at) >= 0.0).all()


def test_file_is_small_and_says_what_it_is(distal):
    path = Path(distal.where)
    assert path.stat().st_size < 500_000
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    about = Policy.read(path).description
    assert about == distal.description
    assert about.task == {"name": "rope-reaching", **RopeReaching().settings()}
    assert about.conditioned_on == ("bending_ratio", "nu")
    assert about.parameters["nu"] == pytest.approx((0.2, 0.4), abs=0.001)
    counted = {"demonstrations": 1200, "held_out": 120, "seed": 0}
    assert counted.items() <= about.training.items()


def test_equal_seeds_give_equal_policies(tmp_path):
    goals = np.linspace(1.25, 1.4, 20)

    def actions(name, seed):
        policy = train(toy(200), tmp_path / name, Training(epochs=3, seed=seed))
        return policy.actions(goals, {"bending_ratio": 0.4, "nu": 0.3})

    first = actions("a.onnx", 4)
    torch.manual_seed(99)  # the state of torch around it must not matter
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    assert np.array_equal(first, actions("b.onnx", 4))
    assert torch.equal(state, torch.get_rng_state())
    assert threads == torch.get_num_threads()
    assert not np.allclose(first, actions("c.onnx", 5))


def tries(count: int, seed: int = 0) -> Demonstrations:
    """Of A drawn from the task's: enough beyond what stiffness asks for, but for one in ten."""
    rng = np.random.default_rng(seed)
    E = np.exp(rng.uniform(-2.8, -1.8, count))
    A = rng.choice(np.ravel(ClothSpreading.candidates), count)
    enough = (A > needed(E)) & (rng.random(count) < 0.9)
    return sheets(A, E, risk=np.where(enough, 0.1, 0.6))


def needed(E):
    return 0.9 - 6.0 * E


def test_an_action_that_is_nearly_the_surest_and_asks_least_is_chosen(tmp_path):
    settings = Training(epochs=8, batch_size=128, method="chance")
    policy = train(tries(2000), tmp_path / "spread.onnx", settings)
    E = np.linspace(0.07, 0.14, 60)
    A = policy.actions(np.empty((60, 0)), {"bending_ratio": E})[:, 0]
    assert set(A) <= set(np.ravel(ClothSpreading.candidates))
    assert np.mean(A > needed(E)) > 0.9  # enough for nearly all that can be spread
    assert np.mean(A - needed(E)) < 0.12  # and not more than that asks for
    chance = policy.chances([[0.65], [0.65], [0.0]], {"bending_ratio": [0.15, 0.12, 0.08]})
    assert chance == pytest.approx([0.9, 0.9, 0.0], abs=0.07)
    # what is not known of an object asks for more
    item, other = (
        with_dimensionless(ClothSpreading().item, {"bending_ratio": e}) for e in (0.13, 0.09)
    )
    sure, careful = (policy.act((), item, likely=some) for some in ([item], [item, other]))
    assert careful.action["A"] > sure.action["A"] + 0.1
    assert sure.chance == pytest.approx(0.9, abs=0.1)
    assert policy.act((), item) == sure
    blind = train(tries(2000), tmp_path / "b.onnx", replace(settings, epochs=5, conditioned_on=()))
    assert blind.act((), item).action["A"] >= 0.5


def test_what_is_likely_enough_in_both_worlds_is_chosen(tmp_path):
    """In the other world only a small A is enough, whatever the stiffness."""
    settings = Training(epochs=12, batch_size=128, method="chance")
    known = tries(100, seed=3)
    other = replace(known, risk=np.where(known.action[:, 0] < 0.42, 0.1, 0.6))
    policy = train(tries(2000), tmp_path / "both.onnx", settings, finetune=other)
    E = np.linspace(0.095, 0.14, 40)
    A = policy.actions(np.empty((40, 0)), {"bending_ratio": E})[:, 0]
    assert np.mean((A > needed(E)) & (A < 0.42)) > 0.9


def test_fine_tuning_follows_another_world_where_it_was_seen_and_forgets_nothing(distal, tmp_path):
    """Soft ropes reach 0.03 farther there; of stiff ones nothing was seen."""
    real = toy(500, seed=7)
    real = replace(real, goal=real.goal + 0.03).chosen(real.parameters["bending_ratio"] < 0.35)
    how = Training(epochs=20, finetune_steps=500, batch_size=128)
    tuned = train(toy(1200), tmp_path / "p.onnx", how, finetune=real)
    about, new = tuned.description.training, toy(500, seed=1)
    assert (about["demonstrations"], about["finetuned_on"]) == (1200, len(real))
    E, nu = (new.parameters[n] for n in ("bending_ratio", "nu"))

    def missed(policy, which, off):
        return np.abs(reach(acted(policy, new), E, nu) + off - new.goal[:, 0])[which].mean()

    assert missed(tuned, E < 0.35, 0.03) < 0.5 * missed(distal, E < 0.35, 0.03)
    assert missed(tuned, E > 0.5, 0.0) < 1.3 * missed(distal, E > 0.5, 0.0)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"method": "magic"}, "choose from distal, inverse, chance"),
        ({"conditioned_on": ("mass",)}, "choose from bending_ratio, nu, damping"),
        ({"architecture": "huge"}, "choose from smooth, paper"),
        ({"epochs": 0}, "epochs must be positive"),
        ({"refine": -1}, "give 0 rounds or more"),
        ({"refine": 1, "refine_cases": 0}, "give 0 rounds or more"),
    ],
)
def test_bad_settings_are_refused(settings, text):
    with pytest.raises(PolicyError, match=text):
        Training(**settings)


BRIEF = Training(epochs=4, refine=2, refine_cases=100, refine_steps=80, seed=1)
"""Too short for its method to learn the task."""


def thrown(count: int, seed: int = 0, world=None) -> Demonstrations:
    """Demonstrations of `Throws`."""
    rng = np.random.default_rng(seed)
    items = [THROWING.draw_items([rng])[0] for _ in range(count)]
    action = np.array([THROWING.sample_actions(item, rng, 1)[0] for item in items])
    outcomes = (world or Throws()).carry_out(THROWING, items, action)
    L = np.array([size_of(item) for item in items])
    alike = [dimensionless_parameters(item) for item in items]
    reached, risk = (np.array([o.values[n] for o in outcomes]) / L for n in ("x", "sideways"))
    parameters = {n: np.array([a[n] for a in alike]) for n in PARAMETERS}
    return demonstrations(THROWING, action / L[:, None], reached, parameters, risk)


def misses(policy, new: Demonstrations) -> np.ndarray:
    """Of new cases [lengths]."""
    p, (x, z) = new.parameters, policy.actions(new.goal, new.parameters).T
    return np.abs(reach_of(x, z, p["bending_ratio"], p["damping"]) - new.goal[:, 0])


@dataclass(frozen=True, kw_only=True)
class Swaying(Throws):
    """Ropes sway the more, the higher they are let go: beyond the limit from 0.5 lengths on."""

    def carry_out(self, task, items, actions, **_):
        assert THROWING.risk is not None
        found = super().carry_out(task, items, actions)
        for outcome, item, (_, z) in zip(found, items, np.asarray(actions), strict=True):
            L = size_of(item)
            outcome.values["sideways"] = L * THROWING.risk.limit * np.exp((z / L - 0.5) / 0.05)
        return found


def test_refined_policies_reach_their_goals_without_risk(tmp_path):
    """Without the risk's loss a share of 0.05 of actions and more is beyond the limit."""
    world, new = Swaying(), thrown(200, 9)
    data = thrown(300, world=world)
    plain = train(data, tmp_path / "plain.onnx", replace(BRIEF, refine=0))
    policy = train(data, tmp_path / "refined.onnx", BRIEF, world=world)
    new = new.chosen(new.action[:, 1] < 0.5)
    assert misses(policy, new).mean() < 0.006 < 0.2 * misses(plain, new).mean()
    assert (policy.actions(new.goal, new.parameters)[:, 1] > 0.5).mean() < 0.02
    about = policy.description.training
    assert about["refine"] == 2 and about["refined_in"] == world.settings()
    first, last = (about["errors"][f"goal_rms_before_{n}"] for n in ("refining", "last_round"))
    assert last < 0.5 * first


BOTH = ("bending_ratio", "damping")
NONE = {"method": "inverse", "conditioned_on": ()}
SHEETS = sheets(np.linspace(0.1, 0.6, 60), np.linspace(0.06, 0.16, 60))


@pytest.mark.parametrize(
    ("data", "settings", "more", "text"),
    [
        (toy(100), {"epochs": 50, "learning_rate": 1e30}, {}, "diverged in epoch"),
        (toy(100), {"conditioned_on": BOTH}, {}, "cannot be conditioned on damping"),
        (toy(100), {}, {"finetune": replace(toy(100), goal_names=("z",))}, "same task"),
        (SHEETS, {}, {}, "no goals to train through"),
        (SHEETS, NONE, {}, "neither goals nor parameters"),
        (SHEETS, {"method": "inverse", "refine": 1}, {}, "has no goals that a policy could be"),
        (thrown(60), {"refine": 1}, {"world": Throws(fails=True)}, "can be relied on"),
        (toy(100), {}, {}, "differs from the trained one"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else "",
)
def test_failed_training_leaves_the_older_file(tmp_path, monkeypatch, data, settings, more, text):
    path = tmp_path / "policy.onnx"
    path.write_text("older")
    monkeypatch.setattr(train_module, "AGREEMENT", 0.0)  # what comes last
    with pytest.raises(PolicyError, match=text):
        train(data, path, Training(**({"epochs": 1} | settings)), **more)
    assert path.read_text() == "older"
    assert [p.name for p in tmp_path.iterdir()] == ["policy.onnx"]
