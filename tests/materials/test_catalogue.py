"""The catalogue of materials: what is in it, what it refuses, and the table of the docs."""

import copy
import json
import math
import re
import tomllib
from importlib.resources import files

import pytest

from gendom import cli
from gendom.errors import ParameterError
from gendom.materials import KINDS, STANDARD_GRAVITY, Rope, bending_length, catalogue


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


def test_the_command(capsys):
    assert cli.main(["materials"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n{name} " in out for name in catalogue.materials())
    assert cli.main(["materials", "cotton-rope", "hookup-wire"]) == 0
    out = capsys.readouterr().out
    assert "  E          1e+06 Pa (2e+05 to 4e+06) " in out and "computed [kuroki-2023]: " in out
    assert "[kuroki-2023] S. Kuroki" in out and "hookup-wire: one stranded copper" in out
    assert "says: estimates of [E, nu]" in out and "not checked: " in out
    assert cli.main(["materials", "denim", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    (denim,) = told["materials"]
    assert denim["E"]["unit"] == "Pa" and denim["thickness"]["typical"] == 0.001
    assert cli.main(["materials", "demin"]) == 2
    assert "did you mean 'denim'?" in capsys.readouterr().err
