"""The numbers of the pages: made from what was measured, and checked by running commands."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from gendom.installation import version

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.skipif(
    not (ROOT / "benchmarks").is_dir(), reason="no benchmarks beside the tests"
)


@pytest.fixture
def figures(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import figures  # pyright: ignore[reportMissingImports]

    yield figures
    for name in ("figures", "stated"):
        del sys.modules[name]


@pytest.fixture
def stored(figures):
    return json.loads(figures.STORED.read_text(encoding="utf-8"))


def test_pages_state_what_was_measured(figures, stored):
    """`python benchmarks/figures.py --pages` makes them so."""
    for page in figures.PAGES:
        text = page.read_text(encoding="utf-8")
        assert figures.made(text, stored) == text, f"{page.name}: numbers were edited by hand"
    # a number that was edited is found
    text = figures.PAGES[1].read_text(encoding="utf-8")
    number = re.search(r"bending length \| (0\.\d+) m", text)
    assert number is not None
    edited = text[: number.start(1)] + "0.999" + text[number.end(1) :]
    assert figures.made(edited, stored) == text != edited
    # every block has a page and every figure a line
    pages = "".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    template = figures.TEMPLATES.read_text(encoding="utf-8")
    blocks = [[m[2] for m in figures.BLOCK.finditer(text)] for text in (pages, template)]
    assert sorted(blocks[0]) == sorted(blocks[1])
    names = {figure.name for figure in figures.FIGURES}
    assert set(re.findall(r"\{([\w-]+)[\[:]", template)) == names >= set(stored)


@pytest.fixture
def counting(figures, monkeypatch, tmp_path):
    """Make a figure the only one; its command prints how often it has been run."""
    script = tmp_path / "count.py"
    script.write_text(
        "import pathlib, sys\n"
        "p = pathlib.Path('runs'); p.write_text((p.read_text() if p.exists() else '') + 'x')\n"
        "print(p.stat().st_size); sys.exit(int(sys.argv[1]))\n"
    )
    monkeypatch.setattr(figures, "STORED", tmp_path / "stored.json")
    monkeypatch.setattr(figures, "PAGES", ())
    figures.STORED.write_text("{}")

    def only(exit=0, read=lambda text: {"runs": float(text)}, **options):
        command = f"python {script} {exit}"
        figure = figures.Figure("n", command, read, json=False, **options)
        monkeypatch.setattr(figures, "FIGURES", (figure,))
        return figure

    return only


def test_what_was_run_is_kept(figures, counting, tmp_path, capsys):
    """Until the command or the version changes, and --again is given."""
    out = ["--out", str(tmp_path / "out")]
    counting()
    assert figures.main([*out, "--write"]) == 0
    stored = json.loads(figures.STORED.read_text())["n"]
    assert stored["numbers"] == {"runs": 1.0} and stored["version"] == version()
    assert figures.main([*out, "--again"]) == 0  # nothing has changed
    assert json.loads((tmp_path / "out" / "n.json").read_text())["output"] == "1\n"
    path = tmp_path / "out" / "n.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": "0.0.9"}))
    capsys.readouterr()
    assert figures.main(out) == 1
    assert "OUTDATED: of 0.0.9" in capsys.readouterr().out
    assert figures.main([*out, "--again"]) == 1  # it was run again, and finds 2 for 1
    assert "| n | runs | 1 | 2 | 5 % | OFF |" in capsys.readouterr().out
    assert "OFF" in (tmp_path / "out" / "found.md").read_text()


def test_what_fails_is_said_and_run_again(figures, counting, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    counting(exit=3)
    assert figures.main([*out, "--write"]) == 1
    assert "FAILED: see n.log" in capsys.readouterr().out
    assert json.loads(figures.STORED.read_text()) == {}
    assert figures.main(out) == 1
    assert (tmp_path / "out" / "n" / "runs").read_text() == "xx"
    counting(needs=("hours",))
    assert figures.main(out) == 0
    assert "not run: needs hours" in capsys.readouterr().out
    counting(read=lambda text: {"runs": json.loads(text)["runs"]})
    assert figures.main([*out, "--again"]) == 1
    assert "cannot be read" in capsys.readouterr().out


def test_tolerances_are_of_the_smaller_number_and_fixed(figures):
    figure = figures.Figure("n", "", dict, relative=1.0)
    assert figure.agrees("x", 2.0, 4.0) and figure.agrees("x", 4.0, 2.0)
    assert not figure.agrees("x", 2.0, 4.1) and not figure.agrees("rows", 2.0, 3.0)
    near = replace(figure, relative=0.05, absolute=0.1)
    assert near.agrees("x", 0.0, -0.1) and not near.agrees("x", 0.0, 0.11)
    # numbers are found in tables and behind text
    numbers = dict(figures.leaves({"table": "| a | 1.5 x (1 to 2) |", "list": [3.0, {"b": 4.0}]}))
    assert numbers == {"table.0": 1.5, "table.1": 1, "table.2": 2, "list.0": 3.0, "list.1.b": 4.0}
    figure = figures.Figure("n", "", lambda found: {"a": found["a"]})
    assert figure.numbers('told [before]\n{"a": 1.23456789}\nand after\n') == {"a": 1.2346}
    with pytest.raises(ValueError, match="no JSON"):
        figure.numbers("nothing")
