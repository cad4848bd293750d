"""A new material is one entry of a catalogue, in a package with an entry point."""

import json

MATERIAL = """
RANGE = {"basis": "estimate", "how": "by hand"}
MATERIALS = {
    "sources": {"own-2024": {"text": "Our own bench, 2024", "says": "hemp of 8 mm: 1.1 MPa"}},
    "materials": {
        "hemp-rope": {
            "kind": "rope",
            "about": "laid hemp",
            "E": {"low": 5e5, "typical": 1.1e6, "high": 3e6, "basis": "measured",
                  "how": "bent by its weight", "source": "own-2024"},
            "nu": {"low": 0.2, "typical": 0.3, "high": 0.4, **RANGE},
            "density": {"low": 600.0, "typical": 800.0, "high": 1000.0, **RANGE},
            "damping": {"low": 0.002, "typical": 0.005, "high": 0.02, **RANGE},
            "friction": {"low": 0.2, "typical": 0.4, "high": 0.6, **RANGE},
            "diameter": {"low": 0.004, "typical": 0.008, "high": 0.02, **RANGE},
        }
    },
}
"""


def test_a_package_adds_a_material(outside, rope_lift, tmp_path):
    outside.add("hemp", MATERIAL, materials="MATERIALS")
    listed = outside.gendom("materials", "hemp-rope", "--json")
    assert listed.returncode == 0, listed.stderr
    told = json.loads(listed.stdout)
    assert told["materials"][0]["E"]["typical"] == 1.1e6
    assert told["sources"]["own-2024"]["text"] == "Our own bench, 2024"

    path = tmp_path / "lift.npz"
    rope_lift.seen().write(path)
    words = ["--material", "hemp-rope", "--starts", 1, "--points", 15, "--json"]
    estimated = outside.gendom("estimate", path, *words)
    assert estimated.returncode == 0, estimated.stderr
    assert json.loads(estimated.stdout)["simulation"]["material"] == "hemp-rope"


def test_a_material_that_lacks_a_number_is_left_out(outside):
    outside.add("hemp", MATERIAL.replace('"nu"', '"mu"'), materials="MATERIALS")
    listed = outside.gendom("materials")
    assert listed.returncode == 0 and "cotton-rope" in listed.stdout
    assert "'hemp' is left out: hemp-rope: " in listed.stderr
    assert "hemp-rope" not in listed.stdout and "Traceback" not in listed.stderr
