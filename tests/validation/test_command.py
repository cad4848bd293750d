"""`python -m validation`: exit codes, table and JSON; readings and rows. Its references stand in
``test_suite``, which simulators pass."""

import json
import math

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from validation import CASES, Case, choose
from validation.__main__ import main
from validation.bench import absolute, relative
from validation.elastica import lateral_load, sag
from validation.readings import swing


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


def test_elasticas_have_known_limits():
    """Gamma / 8 of a beam; a rod that is mere weight but for its clamp reaches out to
    sqrt(2 / Gamma), as E I theta'^2 / 2 = w L (1 + sin theta) there. A strip on its edge."""
    assert sag([0.01])[0] == pytest.approx(0.01 / 8.0, rel=1e-4)
    assert 1.0 / sag([3000.0])[0] == pytest.approx(math.sqrt(2.0 / 3000.0), rel=0.05)
    assert lateral_load() == pytest.approx(12.85, rel=1e-3)


def test_swing_reads_frequency_and_decay_and_refuses_noise():
    t = np.linspace(0.0, 3.0, 90)
    y = 0.3 + np.exp(-0.4 * t) * (2.0 * np.cos(5.0 * t) - np.sin(5.0 * t))
    assert swing(t, y, 5.5) == pytest.approx((5.0, 0.4), rel=1e-6)
    with pytest.raises(SimulationError, match="no single"):
        swing(t, np.random.default_rng(0).normal(size=90), 5.0)
    # errors of rows
    share = relative("a", "m", -2.0, -2.1, 0.05, "s")
    assert share.error == pytest.approx(0.05) and share.relative
    assert not relative("a", "m", 2.0, 2.2, 0.05, "s").passed
    own = absolute("a", "m", 0.0, -0.3, 0.3, "s")
    assert own.error == 0.3 and own.passed and not own.relative
    with pytest.raises(SimulationError, match="a: measured nan"):
        absolute("a", "m", 0.0, math.nan, 0.3, "s")
