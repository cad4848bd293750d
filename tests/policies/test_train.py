"""Training, on a toy task whose forward map is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gendom.errors import DatasetError, PolicyError
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations

torch = pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from gendom.policies import train as train_module  # noqa: E402
from gendom.policies.train import Training, goal_range, train  # noqa: E402

CENTRE, RADIUS = np.array([0.45, 0.56]), 0.16
TASK = {"name": "rope-reaching", "length": 0.25, "diameter": 0.014, "gravity": 9.81}


def reach(action, modulus, nu):
    """Goals grow with the distance from a centre: a whole circle of actions reaches each."""
    distance = np.linalg.norm(action - CENTRE, axis=1)
    return 1.2 + 1.5 * distance * (modulus / 1000.0) ** 0.3 * (0.7 + nu)


def toy(count: int, seed: int = 0) -> Demonstrations:
    rng = np.random.default_rng(seed)
    radius, angle = RADIUS * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    action = CENTRE + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    modulus = np.exp(rng.uniform(np.log(200.0), np.log(4300.0), count))
    nu = rng.uniform(0.2, 0.4, count)
    return Demonstrations(
        task=TASK,
        action_names=("release_x", "release_z"),
        goal=reach(action, modulus, nu),
        action=action,
        specific_modulus=modulus,
        poissons_ratio=nu,
    )


def mean_error(policy: Policy) -> float:
    """Of |goal - reached| in cases that were not trained on [rope lengths]."""
    new = toy(500, seed=1)
    action = policy.actions(new.goal, new.specific_modulus, new.poissons_ratio)
    return np.abs(reach(action, new.specific_modulus, new.poissons_ratio) - new.goal).mean()


@pytest.fixture(scope="module")
def distal(tmp_path_factory) -> Policy:
    path = tmp_path_factory.mktemp("policy") / "distal.onnx"
    return train(toy(1200), path, Training(epochs=100))


def test_distal_reaches_goals_where_the_mean_action_does_not(distal, tmp_path):
    inverse = train(toy(1200), tmp_path / "inverse.onnx", Training(epochs=100, method="inverse"))
    assert mean_error(distal) < 0.015
    assert mean_error(inverse) > 0.1
    # and it knows: its own estimate on the held-out demonstrations agrees
    assert distal.description.training["errors"]["goal_rms"] < 0.015


def test_distal_stays_where_demonstrations_are(distal):
    new = toy(500, seed=1)
    action = distal.actions(new.goal, new.specific_modulus, new.poissons_ratio)
    assert np.linalg.norm(action - CENTRE, axis=1).max() < RADIUS + 0.05


def test_parameters_that_are_not_seen_are_missed(distal, tmp_path):
    blind = train(toy(1200), tmp_path / "none.onnx", Training(epochs=60, conditioned_on=()))
    half = train(
        toy(1200), tmp_path / "half.onnx", Training(epochs=60, conditioned_on=("poissons_ratio",))
    )
    assert [c.name for c in blind.description.inputs] == ["goal"]
    assert [c.name for c in half.description.inputs] == ["goal", "poissons_ratio"]
    assert mean_error(blind) > 3.0 * mean_error(distal)
    assert blind.actions([1.3], 300.0, 0.2) == pytest.approx(blind.actions([1.3]))


def test_file_is_small_and_says_what_it_is(distal):
    path = Path(distal.where)
    assert path.stat().st_size < 500_000
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    about = Policy.read(path).description
    assert about == distal.description
    assert about.task == TASK
    assert about.conditioned_on == ("specific_modulus", "poissons_ratio")
    assert about.training["demonstrations"] == 1200
    assert about.training["held_out"] == 120
    assert about.training["seed"] == 0
    assert about.parameters["poissons_ratio"] == pytest.approx((0.2, 0.4), abs=0.001)


def test_trained_policy_acts(distal):
    action = distal.act(0.36, 2000.0, 0.3, length=0.25, diameter=0.014)
    reached = 0.25 * reach(np.array([action.values]) / 0.25, 2000.0, 0.3)
    assert reached == pytest.approx(0.36, abs=0.01)


def test_equal_seeds_give_equal_policies(tmp_path):
    goals = np.linspace(1.25, 1.4, 20)

    def actions(name, seed):
        policy = train(toy(200), tmp_path / name, Training(epochs=3, seed=seed))
        return policy.actions(goals, 900.0, 0.3)

    first = actions("a.onnx", 4)
    torch.manual_seed(99)  # the state of torch around it must not matter
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    assert np.array_equal(first, actions("b.onnx", 4))
    assert torch.equal(state, torch.get_rng_state())
    assert threads == torch.get_num_threads()
    assert not np.allclose(first, actions("c.onnx", 5))


def test_failed_training_leaves_the_older_file(tmp_path, monkeypatch):
    path = tmp_path / "policy.onnx"
    path.write_text("older")
    monkeypatch.setattr(train_module, "AGREEMENT", 0.0)
    with pytest.raises(PolicyError, match="differs from the trained one"):
        train(toy(100), path, Training(epochs=1))
    assert path.read_text() == "older"
    assert [p.name for p in tmp_path.iterdir()] == ["policy.onnx"]


def test_divergence_is_told(tmp_path):
    with pytest.raises(PolicyError, match="diverged in epoch"):
        train(toy(100), tmp_path / "p.onnx", Training(epochs=50, learning_rate=1e30))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"method": "magic"}, "choose from distal, inverse"),
        ({"conditioned_on": ("E",)}, "choose from specific_modulus, poissons_ratio"),
        ({"architecture": "huge"}, "choose from smooth, paper"),
        ({"epochs": 0}, "epochs must be positive"),
        ({"validation_share": 1.0}, "validation_share must lie between"),
    ],
)
def test_bad_settings_are_refused(settings, text):
    with pytest.raises(PolicyError, match=text):
        Training(**settings)


def test_goal_range_follows_the_modulus():
    data = toy(4000)
    goals = goal_range(data)
    assert list(goals.at) == sorted(goals.at)
    soft, stiff = goals(250.0), goals(4000.0)
    assert stiff[1] - soft[1] > 0.15
    for low, high in (soft, stiff):
        assert 1.2 <= low < 1.25 < high
    ends = np.array([goals(s) for s in data.specific_modulus])
    inside = (ends[:, 0] <= data.goal) & (data.goal <= ends[:, 1])
    assert 0.9 < inside.mean() < 1.0


def test_too_few_or_broken_demonstrations_are_refused():
    with pytest.raises(DatasetError, match="19 usable demonstrations"):
        toy(50).first(19)
    with pytest.raises(DatasetError, match="goal holds numbers that are not finite"):
        replace(toy(30), goal=np.full(30, np.nan))


def test_missing_torch_names_the_extra(run_python):
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "try:\n    import gendom.policies.train\n"
        "except ModuleNotFoundError as error:\n    print(error.name, '|', error)"
    )
    assert run_python(code) == (
        "torch | training needs torch; install it with: pip install 'gendom[train]'"
    )
