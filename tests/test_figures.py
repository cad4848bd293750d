"""The numbers of the pages: made from what was measured, and checked by running commands."""

import json
import re
import sys
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
def checked(figures, monkeypatch, tmp_path, capsys):
    """Check a figure, the only one, whose command prints how often it has been run; gives the exit
    code and the table."""
    script = tmp_path / "count.py"
    script.write_text(
        "import pathlib, sys\n"
        "p = pathlib.Path('runs'); p.write_text((p.read_text() if p.exists() else '') + 'x')\n"
        "print(p.stat().st_size); sys.exit(int(sys.argv[1]))\n"
    )
    monkeypatch.setattr(figures, "STORED", tmp_path / "stored.json")
    monkeypatch.setattr(figures, "PAGES", ())
    figures.STORED.write_text("{}")

    def check(*flags, exit=0, read=lambda text: {"runs": float(text)}, **options):
        figure = figures.Figure("n", f"python {script} {exit}", read, json=False, **options)
        monkeypatch.setattr(figures, "FIGURES", (figure,))
        code = figures.main(["--out", str(tmp_path / "out"), *flags])
        return code, capsys.readouterr().out

    return check


def test_what_was_run_is_kept(figures, checked, tmp_path):
    """Until the command or the version changes, and --again is given; what fails is run again."""
    code, told = checked("--write", exit=3)
    assert code == 1 and "FAILED: see n.log" in told
    assert json.loads(figures.STORED.read_text()) == {}
    path = tmp_path / "out" / "n.json"
    (tmp_path / "out" / "n" / "runs").unlink()
    path.unlink()
    assert checked("--write")[0] == 0
    stored = json.loads(figures.STORED.read_text())["n"]
    assert stored["numbers"] == {"runs": 1.0} and stored["version"] == version()
    assert checked("--again")[0] == 0  # nothing has changed
    assert json.loads(path.read_text())["output"] == "1\n"
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": "0.0.9"}))
    code, told = checked()
    assert code == 1 and "OUTDATED: of 0.0.9" in told
    code, told = checked("--again")  # it was run again, and finds 2 for 1
    assert code == 1 and "| n | runs | 1 | 2 | 5 % | OFF |" in told
    assert "OFF" in (tmp_path / "out" / "found.md").read_text()
    assert "not run: needs hours" in checked(needs=("hours",))[1]
    assert "cannot be read" in checked(read=lambda text: {"runs": json.loads(text)["runs"]})[1]


def test_tolerances_are_of_the_smaller_number_and_fixed(figures):
    figure = figures.Figure("n", "", lambda found: {"a": found["a"]}, relative=1.0, absolute=0.1)
    assert figure.agrees("x", 2.0, 4.0) and figure.agrees("x", 4.0, 2.0)
    assert not figure.agrees("x", 2.0, 4.2) and not figure.agrees("rows", 2.0, 3.0)
    assert figure.agrees("x", 0.0, -0.1) and not figure.agrees("x", 0.0, 0.21)
    # numbers are found in tables and behind text
    numbers = dict(figures.leaves({"table": "| a | 1.5 x (1 to 2) |", "list": [3.0, {"b": 4.0}]}))
    assert numbers == {"table.0": 1.5, "table.1": 1, "table.2": 2, "list.0": 3.0, "list.1.b": 4.0}
    assert figure.numbers('told [before]\n{"a": 1.23456789}\nand after\n') == {"a": 1.2346}
    with pytest.raises(ValueError, match="no JSON"):
        figure.numbers("nothing")
