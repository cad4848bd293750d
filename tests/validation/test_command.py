"""`python -m validation`: exit codes, table and JSON."""

import json

import pytest

from gendom.errors import ParameterError, SimulationError
from validation import CASES, Case, choose
from validation.__main__ import main
from validation.bench import absolute


@pytest.fixture
def case(monkeypatch):
    """Put a case named `test` in place whose rows measure these values, before it stops if so."""

    def install(*values, stops=False):
        def measure(_):
            yield from (absolute("length of a rope", "m", 2.0, x, 0.1, "a ruler") for x in values)
            if stops:
                raise SimulationError("a particle turned inside out", where="world 3")

        monkeypatch.setitem(CASES, "test", Case("test", "a rope", "mpm", measure))

    return install


def test_list(capsys):
    assert main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(CASES)
    assert main(["--list", "--json", "--engine", "thin", "--only", "energy", "rod-twist"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["cases"]
    assert entry == {"name": "rod-twist", "title": "a twisted rope", "engine": "thin"}
    # cases are chosen by name in the suites order
    assert [case.name for case in choose(["energy", "free-flight"])] == ["free-flight", "energy"]
    assert [case.name for case in choose([])] == list(CASES)
    with pytest.raises(ParameterError, match="case 'bending'; did you mean"):
        choose(["bending"])


@pytest.mark.parametrize(("measured", "code"), [((2.05,), 0), ((2.05, 2.2), 1)])
def test_rows_within_and_without(capsys, case, measured, code):
    case(*measured)
    assert main(["--only", "test"]) == code
    out = capsys.readouterr().out
    assert "length of a rope       2 m    2.05 m  0.05 m    0.1 m\n" in out
    assert "source: a ruler" in out and f"1 of {len(measured)} checks" in out
    assert ("0.2 m    0.1 m  FAILED\n" in out) == bool(code)


def test_a_simulation_that_stops_fails_its_case_alone_and_json_tells_settings(capsys, case):
    case(stops=True)
    words = ["--quick", "--threads", "1", "--dtype", "float32", "--only", "test", "free-flight"]
    assert main(words) == 1
    out = capsys.readouterr().out
    assert "FAILED: world 3: a particle turned inside out" in out
    assert "3 of 3 checks within what is allowed; 1 case stopped" in out
    assert main([*words, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    settings = {"device": "cpu", "dtype": "float32", "quick": True, "threads": 1}
    assert (found["passed"], found["settings"]) == (False, settings)
    flight, test = found["cases"]
    assert flight["name"] == "free-flight" and flight["failure"] is None and test["failure"]
    for one in flight["checks"]:
        assert one["source"] and one["passed"] is True and one["error"] <= one["allowed"]
        assert one["error"] == abs(one["measured"] - one["expected"]) > 0.0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--only", "bending"], "--only: unknown case 'bending'"),
        (["--device", "cuda:77"], "there is no device 'cuda:77'"),
        (["--threads", "0", "--only", "free-flight"], "threads must be at least 1"),
    ],
)
def test_bad_flags(capsys, words, line):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and line in err
    assert len(err.splitlines()) == 1
