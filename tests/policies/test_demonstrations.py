"""What is read from a set of demonstrations; names of tasks in files of others are looked up by
every reader and never executed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gendom import cli
from gendom.datasets.demonstrations import generate
from gendom.errors import DatasetError
from gendom.files import write_json
from gendom.materials import Rope, dimensionless_parameters
from gendom.policies.demonstrations import Demonstrations
from gendom.reading import read_json
from gendom.tasks import RopeReaching, Task
from gendom.tasks.demonstrator import Demonstrator
from policies.test_policy import graph

pytestmark = pytest.mark.usefixtures("quick")


def demonstrator(kind: type[Task] = RopeReaching):
    return Demonstrator(task=kind(item=Rope(length=0.5, diameter=0.02)))


@pytest.fixture
def folder(tmp_path):
    generate(demonstrator(), 50, tmp_path / "set", seed=2, shard_size=10)
    return tmp_path / "set"


def test_read_gives_units_of_similarity_and_leaves_failures_out(folder):
    data = Demonstrations.read(folder)
    assert len(data) < 50 and data.action.shape == (len(data), 2)
    assert data.goal[:, 0] == pytest.approx(2.0 * data.action[:, 0])
    assert data.action_names == ("release_x", "release_z") and data.goal_names == ("x",)
    assert data.task["name"] == "rope-reaching"
    assert data.varying == ("bending_ratio", "nu", "damping", "density", "thickness_ratio")
    first = demonstrator().task.draw_items([np.random.default_rng([2, 1])])[0]
    assert data.parameters["bending_ratio"][0] == pytest.approx(
        dimensionless_parameters(first)["bending_ratio"]
    )
    assert data.risk is not None
    assert set(np.round(0.5 * data.risk, 9)) <= {0.01 * k for k in range(10)}
    # what is there of an unfinished set is taken
    (folder / "shard-00004.parquet").unlink()
    part = Demonstrations.read(folder)
    assert len(part) == len(data) - 8
    np.testing.assert_array_equal(part.goal, data.first(len(part)).goal)


def test_too_few_broken_or_other_demonstrations_are_refused(folder):
    data = Demonstrations.read(folder)
    with pytest.raises(DatasetError, match="19 usable demonstrations"):
        data.first(19)
    with pytest.raises(DatasetError, match="goal holds numbers that are not finite"):
        replace(data, goal=np.full(data.goal.shape, np.nan))
    path = folder / "dataset.json"
    write_json(path, read_json(path) | {"goal_names": ["x", "z"], "goal_units": ["m", "m"]})
    with pytest.raises(DatasetError):
        Demonstrations.read(folder)


@pytest.fixture
def places(tmp_path, description):
    """A sound data set, and one and a policy that name a Python file as their task, else whole."""
    place = str(tmp_path / "task.py")
    (tmp_path / "task.py").write_text(f"open({str(tmp_path / 'trace')!r}, 'w')\n")
    generate(demonstrator(), 30, tmp_path / "good", seed=2)
    named = type("Reaching", (RopeReaching,), {"name": place})
    generate(demonstrator(named), 30, tmp_path / "data", seed=2)
    about = json.loads(description.to_json())
    about["task"]["name"] = place
    names = ["goal_x", "bending_ratio", "nu"]
    graph(tmp_path / "policy.onnx", names, {"gendom-policy": json.dumps(about)})


@pytest.mark.parametrize(
    "words",
    [
        "train rope-reaching --data data --out o.onnx",
        "train rope-reaching --data good --finetune data --out o.onnx",
        "evaluate rope-reaching --policy policy.onnx",
        "act rope-reaching --goal 0.3 --policy policy.onnx --E 1e6 --density 800 --nu 0.3"
        " --length 0.3 --diameter 0.02",
    ],
    ids=lambda words: words.split()[0],
)
def test_no_reader_executes_a_name(words, places, tmp_path, capsys, monkeypatch):
    """`trace` would be there once task.py was executed."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(words.split()) == 2, capsys.readouterr().out
    assert not (tmp_path / "trace").exists()
    assert len(capsys.readouterr().err.splitlines()) <= 2
