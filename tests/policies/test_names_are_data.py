"""Names of tasks in files of others are looked up by every reader and never executed."""

import json

import pytest

from gendom import cli
from gendom.datasets.demonstrations import generate
from gendom.tasks import RopeReaching
from policies.test_demonstrations import demonstrator
from policies.test_policy import graph


@pytest.fixture
def trace(tmp_path):
    """A file that exists once ``task.py`` was executed."""
    path = tmp_path / "trace"
    (tmp_path / "task.py").write_text(f"open({str(path)!r}, 'w')\n")
    return path


@pytest.fixture
def data(tmp_path):
    """A data set, whole and consistent, that names a Python file as its task."""

    class Reaching(RopeReaching):
        name = str(tmp_path / "task.py")

    generate(demonstrator(Reaching), 30, tmp_path / "set", seed=2)
    return tmp_path / "set"


@pytest.fixture
def policy(tmp_path, description):
    """A policy that names a Python file as its task."""
    about = json.loads(description.to_json())
    about["task"]["name"] = str(tmp_path / "task.py")
    names = ["goal_x", "bending_ratio", "nu"]
    return graph(tmp_path / "policy.onnx", names, {"gendom-policy": json.dumps(about)})


OBJECT = ["--E", "1e6", "--density", "800", "--nu", "0.3", "--length", "0.3", "--diameter", "0.02"]


@pytest.mark.parametrize(
    "words",
    [
        "train rope-reaching --data {data} --out {out}",
        "train rope-reaching --data {good} --finetune {data} --out {out}",
        "evaluate rope-reaching --policy {policy}",
        "act rope-reaching --goal 0.3 --policy {policy} OBJECT",
    ],
    ids=lambda words: words.split()[0],
)
def test_no_reader_executes_a_name(words, data, policy, trace, tmp_path, capsys):
    generate(demonstrator(), 30, tmp_path / "good", seed=2)
    places = {"data": data, "policy": policy, "good": tmp_path / "good", "out": tmp_path / "o.onnx"}
    given = [word.format(**places) for word in words.split() if word != "OBJECT"]
    code = cli.main(given + OBJECT * words.endswith("OBJECT"))
    assert code == 2, capsys.readouterr().out
    assert not trace.exists()
    assert len(capsys.readouterr().err.splitlines()) <= 2
