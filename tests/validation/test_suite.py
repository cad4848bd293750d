"""The suite passes where the simulator is right, and fails where it is not; `python -m validation`:
exit codes, table and JSON."""

import functools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import CFL, GRAVITY, Gripper, cloth
from validation import CASES, Bench, Case, choose, run_case
from validation.__main__ import main
from validation.bench import absolute, relative
from validation.elastica import lateral_load, sag
from validation.readings import swing
from validation.stability import diverged

QUICK = Bench(quick=True, threads=1)


@functools.cache
def failing(name, bench):
    """Quantities of a case that are not within what is allowed."""
    result = run_case(CASES[name], bench)
    assert result.failure is None
    assert result.rows
    return {row.quantity for row in result.rows if not row.passed}


@pytest.mark.parametrize("name", CASES)
def test_quick_suite(name):
    assert failing(name, QUICK) == set()


@pytest.mark.parametrize("name", ["objectivity", "tension"])
def test_quick_suite_in_single_precision(name):
    """The bounds for float32 hold too."""
    assert failing(name, replace(QUICK, dtype="float32")) == set()


# ---- a wrong simulator -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Misled(Bench):
    """A bench whose simulators are given other values than the case believes."""

    change: Callable

    def simulate(self, body, materials, **options):
        materials, options = self.change(self, list(materials), options)
        return super().simulate(body, materials, **options)


def made(change):
    """Materials of which some fields are others."""
    return lambda _, materials, options: ([replace(m, **change(m)) for m in materials], options)


def given(change):
    """Options of which some are others."""
    return lambda _, materials, options: (materials, options | change(options))


stiffer = made(lambda m: {"E": 1.25 * m.E})
softer_in_torsion = made(lambda m: {"nu": (1.0 + m.nu) / 0.9 - 1.0})  # G by a tenth, E the same
always_down = given(lambda _: {"gravity": GRAVITY})
heavier = given(lambda o: {"gravity": 1.1 * np.asarray(o.get("gravity", GRAVITY))})
rubbing_more, rubbing_less = (
    given(lambda o, f=f: {"self_friction": f * np.asarray(o["self_friction"])}) for f in (1.2, 0.8)
)
on_a_high_table = given(lambda o: {"table": replace(o["table"], height=0.002 + o["table"].height)})
halved_by_a_root = given(lambda o: {"cfl": 0.2 * (o["cfl"] / 0.2) ** 0.5 if "cfl" in o else CFL})


def stiffer_in_single(bench, materials, options):
    return (stiffer if bench.dtype == "float32" else made(lambda _: {}))(bench, materials, options)


@pytest.mark.parametrize(
    ("name", "change", "quantities"),
    [
        (name, change, quantities)
        for name, change, *quantities in (
            ("free-flight", heavier, "centre's distance from its path", "drift of momentum"),
            ("objectivity", always_down,
                "largest difference after 90 degrees about x, over the"),
            ("torsion", stiffer, "torsional stiffness, 1 cell", "torsional stiffness, 2"),
            ("ring-down", made(lambda m: {"damping": 0.0}), "decay rate, damping 10 ms"),
            ("terminal-speed", given(lambda _: {"air_density": 0.0}), "a sheet's terminal speed"),
            ("resting", on_a_high_table,
                "height of a rope's axis", "height of the middle of a cloth"),
            ("tension", made(lambda m: {"nu": m.nu + 0.05}), "nu read back, 2 cells across"),
            ("order", halved_by_a_root, "exponent of dt in what halved substeps change"),
            ("precision", stiffer_in_single, "largest difference of float32 from float64"),
            ("shell-cantilever", heavier, "sag of strips over theory"),
            ("rod-ring", softer_in_torsion, "critical twist of a ring"),
            ("rod-order", stiffer,
                "order of a rope's sag, from 1", "order of a rope's sag, from 3"),
            ("rod-layers", rubbing_more, "deceleration of", "stopping distance of"),
            ("shell-layers", rubbing_less,
                "acceleration of a cloth's layer on another at 0.95",
                "acceleration of a cloth's layer on another at 1.25"),
        )
    ],
)  # fmt: skip
def test_a_wrong_simulator_fails(name, change, quantities):
    """One of each kind of fault is noticed by rows that are there for it."""
    short = failing(name, Misled(quick=True, threads=1, change=change))
    assert [q for q in quantities if not any(one.startswith(q) for one in short)] == []


def test_worlds_that_diverge_are_counted():
    """At eight times the substep none of three lasts, and none stops the count."""
    body = cloth(width=0.04, height=0.04, thickness=0.04, dx=0.01, corner=(0.0, 0.0, 0.02))
    materials = [Material(E=E, nu=0.3, density=1000.0) for E in (1e4, 2e4, 3e4)]
    held = [Gripper.still((0.0, 0.0, 0.02), radius=0.02)] * 3
    assert diverged(QUICK, body, materials, held, 0.3, 8.0) == 3
    assert diverged(QUICK, body, materials, held, 0.05, 1.0) == 0


# ---- the command, readings and rows ------------------------------------------------------------


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
