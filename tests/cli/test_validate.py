"""`gendom validate`: exit codes, table and JSON."""

import json

import pytest

from gendom import cli
from gendom.errors import SimulationError
from gendom.validation import Case, Check, suite


def check(measured):
    return Check.within("length of a rope", "m", 2.0, measured, 0.1, "a ruler")


@pytest.fixture
def case(monkeypatch):
    """Put a case named `test` in place that returns the given checks or raises."""

    def install(run):
        monkeypatch.setitem(suite.CASES, "test", Case(name="test", title="a rope", run=run))

    return install


def test_list(capsys):
    assert cli.main(["validate", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(suite.CASES)


def test_list_as_json(capsys):
    assert cli.main(["validate", "--list", "--json", "--only", "energy"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["cases"]
    assert entry["name"] == "energy"


def test_all_within(capsys, case):
    case(lambda _: [check(2.05)])
    assert cli.main(["validate", "--only", "test"]) == 0
    out, err = capsys.readouterr()
    assert "length of a rope       2 m    2.05 m  0.05 m    0.1 m\n" in out
    assert "source: a ruler" in out and "1 of 1 checks" in out
    assert "test passed in" in err


def test_one_without(capsys, case):
    case(lambda _: [check(2.05), check(2.2)])
    assert cli.main(["validate", "--only", "test"]) == 1
    out, err = capsys.readouterr()
    assert "0.2 m    0.1 m  FAILED\n" in out and "1 of 2 checks" in out
    assert "test FAILED in" in err


def test_a_simulation_that_stops_fails_its_case(capsys, case):
    """The others still run."""

    def run(_):
        raise SimulationError("a particle turned inside out", where="world 3")

    case(run)
    assert cli.main(["validate", "--quick", "--threads", "1", "--only", "test", "free-fall"]) == 1
    out = capsys.readouterr().out
    assert "FAILED: world 3: a particle turned inside out" in out
    assert "2 of 2 checks within what is allowed; 1 case stopped" in out


def test_json_tells_source_and_settings(capsys):
    words = ["validate", "--quick", "--threads", "1", "--json", "--dtype", "float32"]
    assert cli.main([*words, "--only", "free-fall"]) == 0
    out = capsys.readouterr().out
    found = json.loads(out)
    assert found["passed"] is True
    assert found["settings"] == {
        "device": "cpu",
        "dtype": "float32",
        "quick": True,
        "threads": 1,
    }
    (entry,) = found["cases"]
    assert entry["name"] == "free-fall" and entry["failure"] is None
    for row in entry["checks"]:
        assert row["source"] and row["passed"] is True
        assert 0.0 < row["error"] <= row["allowed"]
        assert row["error"] == abs(row["measured"] - row["expected"])


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--only", "bending"], "--only: there is no case 'bending'"),
        (["--device", "cuda:77"], "there is no device 'cuda:77'"),
        (["--threads", "0", "--only", "free-fall"], "threads must be at least 1"),
    ],
)
def test_bad_flags(capsys, words, line):
    assert cli.main(["validate", *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and line in err
    assert len(err.splitlines()) == 1
