"""Materials, objects, the numbers by which they are alike, and the file of an estimate: it is used
as it was written, or refused."""

import copy
import json
import math
import re
import tomllib
from contextlib import nullcontext
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from gendom import cli
from gendom.errors import GendomError, ParameterError
from gendom.materials import (
    KINDS,
    QUANTITIES,
    STANDARD_GRAVITY,
    Cloth,
    Items,
    Material,
    Rope,
    catalogue,
    dimensionless_parameters,
    from_columns,
    items_from_columns,
    to_columns,
    unit_of,
    with_dimensionless,
)
from gendom.materials.estimate import Estimate
from gendom.materials.parameters import E_over_rho_of, bending_length

ROPE = Rope(
    length=0.3,
    diameter=0.016,
    material=Material(E=7.7e5, nu=0.35, density=800.0, damping=0.005),
    friction=0.4,
)
CLOTH = Cloth(side=0.2, thickness=0.001, material=Material(E=2e6, nu=0.45, density=1100.0))


def test_moduli_speeds_and_lengths_are_known():
    """E = mu (3 lam + 2 mu) / (lam + mu) and nu = lam / (2 (lam + mu))."""
    for nu in (-0.5, 0.0, 0.1, 0.25, 0.45):
        material = Material(E=9.0e4, nu=nu, density=900.0)
        mu, lam = material.lame
        assert mu * (3.0 * lam + 2.0 * mu) / (lam + mu) == pytest.approx(9.0e4)
        assert lam / (2.0 * (lam + mu)) == pytest.approx(nu)
        assert material.E_over_rho == pytest.approx(100.0)
        share = (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
        assert material.wave_speed == pytest.approx(10.0 * math.sqrt(share))
    assert Material(E=12.0, nu=0.25).lame_of(1.0) == pytest.approx((4.8, 3.2))
    assert bending_length(1.0e4, 1.0e-3, 10.0) == pytest.approx(0.1)
    for modulus in (1.0, 450.0, 3.0e6):
        length = bending_length(modulus, 0.003, 9.81)
        assert E_over_rho_of(length, 0.003, 9.81) == pytest.approx(modulus)


@pytest.mark.parametrize("value", [0.5, -1.0, 0.7, 0.0, math.nan, math.inf])
@pytest.mark.parametrize("field", ["E", "nu", "density"])
def test_out_of_range_is_refused_by_name(field, value):
    allowed = value == 0.0 if field == "nu" else 0.0 < value < 1.0
    with nullcontext() if allowed else pytest.raises(ParameterError, match=field):
        Material(**{field: value})


def test_likeness_of_a_rope_is_that_of_theory():
    """(E I / (mass per length g))^(1/3) / L, with I and the mass worked out anew."""
    I, A = math.pi * 0.016**4 / 64.0, math.pi * 0.016**2 / 4.0
    alike = dimensionless_parameters(ROPE)
    assert alike["bending_ratio"] == pytest.approx(
        (7.7e5 * I / (800.0 * A * 9.81)) ** (1 / 3) / 0.3
    )
    assert alike["nu"] == 0.35 and alike["friction"] == 0.4
    assert alike["damping"] == pytest.approx(0.005 / math.sqrt(0.3 / 9.81))
    weight_per_area = 800.0 * A * 0.3 / (0.3 * 0.016)
    assert alike["density"] == pytest.approx(1.2 * 0.3 / weight_per_area)
    # likeness of a cloth is that of a plate
    rigidity = 2e6 * 0.001**3 / (12.0 * (1.0 - 0.45**2))
    bending = (rigidity / (1100.0 * 0.001 * 9.81)) ** (1 / 3)
    assert dimensionless_parameters(CLOTH)["bending_ratio"] == pytest.approx(bending / 0.2)
    assert dimensionless_parameters(CLOTH)["density"] == pytest.approx(1.2 * 0.2 / 1.1)


@pytest.mark.parametrize("item", [ROPE, CLOTH])
def test_likeness_is_given(item):
    wanted = {"bending_ratio": 0.3, "nu": 0.25, "damping": 0.03, "friction": 0.6, "density": 0.05}
    own = dimensionless_parameters(item)
    wanted["thickness_ratio"] = 0.09
    for names in ((), ("nu",), ("density",), ("bending_ratio", "damping"), tuple(wanted)):
        given = {name: wanted[name] for name in names}
        made = with_dimensionless(item, given)
        assert dimensionless_parameters(made) == pytest.approx({**own, **given})
        same = made.sizes[: 1 if "thickness_ratio" in names else 2]
        assert [getattr(made, n) for n in same] == [getattr(item, n) for n in same]


@pytest.mark.parametrize("item", [ROPE, CLOTH])
def test_columns_give_the_object_back(item):
    columns = to_columns(item)
    assert from_columns(item.kind, columns) == item
    assert set(QUANTITIES) <= set(columns)
    many = {name: x * np.linspace(1.0, 1.05, 5) for name, x in columns.items()}
    each = [from_columns(item.kind, {n: x[k] for n, x in many.items()}) for k in range(5)]
    made = items_from_columns(item.kind, many)
    assert list(made) == each and list(Items.of(each)[1:4]) == each[1:4]
    assert list(made.some(np.array([3, 0]))) == [each[3], each[0]]
    assert list(made.materials) == [one.material for one in each]
    # one that is too thick, though each number of it is that of others that are not
    many[item.sizes[1]][0], many[item.sizes[0]][3] = 1e-5, 1e-3
    with pytest.raises(ParameterError, match=f"{item.sizes[0]} 0.001 m is no {item.kind}"):
        items_from_columns(item.kind, many)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"length": 0.0}, "length must be positive"),
        ({"diameter": math.nan}, "diameter must be positive"),
        ({"diameter": 0.07}, "is no rope"),
        ({"length": 250.0, "diameter": 14.0}, "length is 250 m; give metres: 250 mm are 0.25 m"),
        ({"length": 30.0, "diameter": 1.4}, "length is 30 m; give metres: 30 cm are 0.3 m"),
        ({"diameter": 14.0}, "diameter is 14 m; give metres: 14 mm are 0.014 m"),
        ({"diameter": 1.4}, "metres: 1.4 cm are 0.014 m, 1.4 mm are 0.0014 m"),
        ({"friction": -0.1}, "friction must be finite"),
        ({"E": 0.8}, "E is 0.8 Pa; give Pa: 0.8 MPa are 800000 Pa"),
        ({"density": 1.1}, "give kg/m.3: 1.1 g/cm.3 are 1100 kg/m.3"),
        ({"density": 1.1e6}, "give kg/m.3: 1.1e.06 g/m.3 are 1100 kg/m.3"),
        ({"damping": 4.0}, "damping is 4 s; give s: 4 ms are 0.004 s"),
    ],
)
def test_impossible_objects_and_other_units_are_refused(change, says):
    of_material = not change.keys() <= {"length", "diameter", "friction"}
    with pytest.raises(ParameterError, match=says):
        if of_material:
            change = {"material": replace(ROPE.material, **change)}
        replace(ROPE, **change)
    with pytest.raises(ParameterError, match="unknown unit 'kg'"):
        unit_of("kg", ROPE)


@pytest.fixture(scope="module")
def found():
    rope = Rope(length=0.4, diameter=0.01, material=Material(E=8e5, nu=0.3, density=800.0))
    return Estimate.of(rope).with_uncertain("E_over_rho", 0.03).with_uncertain("nu", 0.01)


def places(value, at=()):
    """Of everything in a document, the first of each list alone."""
    yield at
    first = enumerate(value[:1]) if isinstance(value, list) else ()
    for name, inner in value.items() if isinstance(value, dict) else first:
        yield from places(inner, (*at, name))


def test_whatever_is_changed_by_hand_is_refused_in_one_line(found, tmp_path):
    """Everything in the file, left out, of odd types, or 1 % off."""
    path, whole = tmp_path / "estimate.json", json.loads(json.dumps(found.record))
    for at in list(places(whole))[1:]:
        outer, last = at[: len(at) - 1], list(at).pop()
        for odd in (None, "x", -1e308, [[1]], "left out", "off"):
            inner = document = copy.deepcopy(whole)
            for name in outer:
                inner = inner[name]
            now = inner[last]
            inner[last] = 1.01 * now if odd == "off" and isinstance(now, float) else odd
            if odd == "left out":
                del inner[last]
            if document == whole:
                continue
            path.write_text(json.dumps(document))
            with pytest.raises(GendomError) as refused:
                Estimate.load(path)
            assert "\n" not in str(refused.value), (outer, last, odd)
    path.write_text(json.dumps({n: v for n, v in whole.items() if n != "sha256"}))
    with pytest.raises(GendomError, match=r"of a version before 0\.2; run gendom"):
        Estimate.load(path)


def test_intervals_end_where_the_search_did(found, tmp_path):
    """Of what follows from E over density, too."""
    wide = found.with_gaussian(found.mean, np.diag([100.0, 1e-4])).record
    for name in ("E_over_rho", "E", "bending_length"):
        assert wide["intervals"][name] == pytest.approx(wide["bounds"][name])
    # another layout of the text is no change
    path = tmp_path / "estimate.json"
    path.write_text(json.dumps(found.record, sort_keys=True).replace(".0,", ","))
    assert Estimate.load(path).E == pytest.approx(found.E)


# ---- the catalogue ---------------------------------------------------------------------------


@pytest.fixture
def table():
    """The catalogue's TOML, to be changed."""
    text = files("gendom.materials").joinpath("catalogue.toml").read_text(encoding="utf-8")
    return copy.deepcopy(tomllib.loads(text))


def test_a_material_for_a_simulation(table):
    known = catalogue.get("cotton-rope")
    rope = Rope(length=0.3, diameter=known.across.typical, material=known.material())
    assert rope.material.E == known.E.typical and rope.material.density == known.density.typical
    assert known.size == "diameter" and catalogue.get("denim").size == "thickness"
    # every source and shared range is used
    entries = [x for material in table["materials"].values() for x in material.values()]
    ranges = [x for x in (*entries, *table["shared"].values()) if isinstance(x, dict)]
    assert {x["source"] for x in ranges if "source" in x} == set(table["sources"])
    assert set(table["shared"]) <= {x for x in entries if isinstance(x, str)}
    # an unknown name has a near one
    with pytest.raises(ParameterError, match=r"'coton-rop'; did you mean 'cotton-rope'\?"):
        catalogue.get("coton-rop")
    with pytest.raises(ParameterError, match="no material 'q'; gendom materials lists them"):
        catalogue.get("q")


@pytest.mark.parametrize("material", catalogue.materials().values(), ids=lambda m: m.name)
def test_numbers_are_those_of_things_that_hang(material):
    """Bending lengths between those of the limpest cloth and the stiffest cable, and every number
    is one that objects take."""
    kind = KINDS[material.kind]
    sizes = dict(zip(kind.sizes, (1.0, material.across.typical), strict=True))
    item = kind(**sizes, material=material.material())
    E, density = material.E, material.density
    for modulus in (E.low / density.high, E.high / density.low):
        c = bending_length(modulus, item.radius_of_gyration, STANDARD_GRAVITY)
        assert 0.006 < c < 0.6
    for name, (_, found) in material.ranges().items():
        said = found.basis == "estimate" or catalogue.sources()[found.source].says
        assert found.how and (said is True or re.search(r"\d", said)), name


@pytest.mark.parametrize(
    ("where", "key", "value", "said"),
    [
        ("cotton-rope", "kind", "string", "cotton-rope: has kind 'string'; give rope, cloth"),
        ("cotton-rope", "E", None, "cotton-rope: lacks E"),
        ("cotton-rope", "colour", "red", "cotton-rope: has unknown colour"),
        ("cotton-rope.E", "low", 1e7, "cotton-rope.E: has .*not above 0 and in order"),
        ("cotton-rope.E", "high", math.inf, "cotton-rope.E: has .*not all finite"),
        ("cotton-rope.E", "basis", "heard", "cotton-rope.E: has the basis 'heard'; give measured"),
        ("cotton-rope.E", "source", "", "cotton-rope.E: is computed, and has no source; name it"),
        ("cotton-rope.E", "source", "nobody-1900", "'nobody-1900', which is not listed"),
        ("cotton-rope.E", "source", "peirce-1930", "'peirce-1930', and what that says is not"),
        ("cotton-rope.E", "unit", "Pa", "cotton-rope.E: is no range"),
    ],
)
def test_what_is_wrong_with_a_catalogue_is_told(table, where, key, value, said):
    entry = table["materials"]
    for name in where.split("."):
        entry = entry[name]
    entry[key] = value
    if value is None:
        del entry[key]
    with pytest.raises(ParameterError, match=said):
        catalogue.parse(table)


def test_the_command(capsys, refused):
    assert cli.main(["materials"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n{name} " in out for name in catalogue.materials())
    assert cli.main(["materials", "cotton-rope", "hookup-wire"]) == 0
    out = capsys.readouterr().out
    assert "  E          1e+06 Pa (2e+05 to 4e+06) " in out and "computed [kuroki-2023]: " in out
    assert "[kuroki-2023] S. Kuroki" in out and "hookup-wire: one stranded copper" in out
    assert "says: estimates of [E, nu]" in out and "not checked: " in out
    assert cli.main(["materials", "denim", "--json"]) == 0
    (denim,) = json.loads(capsys.readouterr().out)["materials"]
    assert denim["E"]["unit"] == "Pa" and denim["thickness"]["typical"] == 0.001
    assert "did you mean 'denim'?" in refused("materials", "demin")


def test_what_is_known_exactly_is_drawn_alike():
    assert Estimate.of(ROPE).draws(3, seed=0) == [ROPE] * 3
