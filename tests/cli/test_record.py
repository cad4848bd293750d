"""`gendom record`: numbers in other units are refused before the lift."""

import pytest

from gendom import cli


@pytest.mark.parametrize(
    ("flags", "line"),
    [
        ("--rise 225", "--rise: is 225 m, and the rope 0.3 m long; give metres: 225 mm are 0.225"),
        ("--rise 22", "--rise: is 22 m, and the rope 0.3 m long; give metres: 22 cm are 0.22"),
        ("--rise nan", "--rise: is nan m"),
        ("--rise 0", "--rise: is 0 m"),
        ("--encoder-noise 5", "--encoder-noise: is 5 radians; give 0 to 0.1: 5 mrad are 0.005"),
        ("--frame-rate 0", "--frame-rate: is 0.0; give 90 or less, above 0"),
        (
            "--reality cloth-cotton --rise 150",
            "--rise: is 150 m, and the cloth 0.3 m wide; give metres: 150 mm are 0.15",
        ),
    ],
)
def test_numbers_in_other_units_are_refused(flags, line, tmp_path, capsys):
    if "--reality" not in flags:
        flags += " --reality rope-cotton"
    words = ["record", "--out", str(tmp_path / "lift")]
    assert cli.main([*words, *flags.split()]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(f"gendom record: {line}") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())
