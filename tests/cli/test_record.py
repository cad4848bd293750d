"""`gendom record`: what cannot be recorded is refused before the lift."""

import pytest

from simulated_cell import write_cell

pytest.importorskip("mujoco", reason="needs the extra reality")


@pytest.mark.parametrize(
    ("flags", "line"),
    [
        ("", "give either --reality or --cell"),
        ("--reality rope-cotton --cell CELL", "give either --reality or --cell"),
        ("--cell CELL --rise 30", "--rise: is 30 m, and the rope 0.3 m long"),
        ("--cell CELL --end swing --rise 0.2 --object no.toml", "no.toml"),
        ("ROPE --rise 225", "--rise: is 225 m, and the rope 0.3 m long; give metres: 225 mm are"),
        ("ROPE --rise 22", "--rise: is 22 m, and the rope 0.3 m long; give metres: 22 cm are 0.22"),
        ("ROPE --rise nan", "--rise: is nan m"),
        ("ROPE --rise 0", "--rise: is 0 m"),
        (
            "ROPE --encoder-noise 5",
            "--encoder-noise: is 5 radians; give 0 to 0.1: 5 mrad are 0.005",
        ),
        ("ROPE --frame-rate 0", "--frame-rate: is 0.0; give 90 or less, above 0"),
        ("--reality cloth-cotton --rise 150", "--rise: is 150 m, and the cloth 0.3 m wide; give"),
    ],
)
def test_what_cannot_be_recorded(flags, line, tmp_path, refused):
    flags = flags.replace("ROPE", "--reality rope-cotton")
    flags = flags.replace("CELL", str(write_cell(tmp_path)))
    assert line in refused("record", *flags.split(), "--out", tmp_path / "lift")
    assert not (tmp_path / "lift").exists()
