"""Names of tasks in files of others are looked up by every reader and never executed."""

import json

import pytest

from gendom import cli
from gendom.datasets.demonstrations import generate
from gendom.tasks import RopeReaching
from policies.test_demonstrations import demonstrator
from policies.test_policy import graph


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


OBJECT = ["--E", "1e6", "--density", "800", "--nu", "0.3", "--length", "0.3", "--diameter", "0.02"]


@pytest.mark.parametrize(
    "words",
    [
        "train rope-reaching --data data --out o.onnx",
        "train rope-reaching --data good --finetune data --out o.onnx",
        "evaluate rope-reaching --policy policy.onnx",
        "act rope-reaching --goal 0.3 --policy policy.onnx OBJECT",
    ],
    ids=lambda words: words.split()[0],
)
def test_no_reader_executes_a_name(words, places, tmp_path, capsys, monkeypatch):
    """`trace` would be there once task.py was executed."""
    monkeypatch.chdir(tmp_path)
    code = cli.main([*words.removesuffix("OBJECT").split(), *OBJECT * words.endswith("OBJECT")])
    assert code == 2, capsys.readouterr().out
    assert not (tmp_path / "trace").exists()
    assert len(capsys.readouterr().err.splitlines()) <= 2
