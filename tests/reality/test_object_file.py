"""Objects of one's own."""

import math

import pytest

from gendom.errors import ParameterError
from gendom.materials import Material, catalogue
from gendom.reality import find_object
from gendom.reality.objects import RealCloth, RealRope

ROPE = {"kind": "'rope'", "length": 0.28, "diameter": 0.012, "mass": 0.03, "E": 1.2e6, "nu": 0.35}
CLOTH = {"kind": "'cloth'", "side": 0.2, "thickness": 0.0005, "density": 400, "E": 6e5, "nu": 0.3,
         "damping": 0.01, "friction": 0.5, "colour": [40, 70, 150]}  # fmt: skip
NYLON = {"kind": "'rope'", "length": 0.5, "material": "'nylon-rope'"}


@pytest.fixture
def found(tmp_path):
    """Function (entries of a file, changes): its object; what is None is left out."""

    def read(entries, **changes):
        told = {k: v for k, v in (entries | changes).items() if v is not None}
        path = tmp_path / "mine.toml"
        path.write_text("\n".join(f"{name} = {value}" for name, value in told.items()))
        return find_object(str(path))

    return read


def test_objects_of_files(found):
    item = found(ROPE)
    assert isinstance(item, RealRope) and item.name == "mine"
    assert item.mass == pytest.approx(0.03)
    density = 0.03 / (math.pi / 4.0 * 0.012**2 * 0.28)
    expected = Material(E=1.2e6, nu=0.35, density=density, damping=0.004)
    assert item.material == expected and item.friction == 0.3
    item = found(CLOTH)
    assert isinstance(item, RealCloth)
    assert item.material == Material(E=6e5, nu=0.3, density=400.0, damping=0.01)
    assert (item.side, item.friction, item.colour) == (0.2, 0.5, (40, 70, 150))
    assert item.mass == pytest.approx(0.2**2 * 0.0005 * 400.0)
    # a material of the catalogue
    known, item = catalogue.get("nylon-rope"), found(NYLON)
    assert item.material == known.material() and item.diameter == known.across.typical
    assert item.friction == known.friction.typical
    item = found(NYLON, mass=0.03, nu=0.3)
    assert item.mass == pytest.approx(0.03) and item.material.nu == 0.3
    assert item.material.E == known.E.typical


def test_a_thick_rope_s_points_do_not_touch(found):
    item = found(ROPE, diameter=0.03)
    assert item.vertices == 10 and item.spacing > item.diameter


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": '"string"'}, "give rope or cloth"),
        ({"length": None}, "lacks length"),
        ({"mass": None}, "one of mass and density"),
        ({"length": "280"}, r"check sizes \[m\]"),
        ({"diameter": "-0.01"}, "give metres"),
        ({"diameter": "0.1"}, "is no rope"),
        ({"mass": "30"}, "its density would be"),
        ({"nu": "0.5"}, r"mine.toml: Poisson's ratio nu must lie in"),
        ({"damping": "-1"}, r"mine.toml: damping must be"),
        ({"E": '"soft"'}, "E is 'soft'"),
        ({"friction": "-1"}, "friction must be"),
        ({"colour": "[1, 2]"}, "three of 0 to 255"),
        ({"weight": "1"}, "weight means nothing"),
        ({"material": '"nylon-rop"'}, "no material 'nylon-rop'; did you mean 'nylon-rope'"),
        ({"material": '"denim"'}, "mine.toml: denim is a cloth, and kind is 'rope'"),
    ],
)
def test_what_is_missing_or_impossible_is_named(found, change, says):
    with pytest.raises(ParameterError, match=says) as error:
        found(ROPE, **change)
    assert "\n" not in str(error.value)
