"""What README and docs say can be done: commands, links and pages; and their numbers, made from
what was measured.

Shell blocks (fenced without a language, or as `sh`) hold commands only. Every command parses.
Blocks are run from top to bottom of a page, but for those under a comment
`<!-- not run: reason -->`. Commands in backticks name what there is.
"""

import ast
import contextlib
import importlib.util
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from experiments import __main__ as experiments
from gendom import cli, tasks
from gendom.cli.parsing import arguments_of, parse
from gendom.errors import GendomError
from gendom.hardware.cell import Cell
from gendom.installation import version
from gendom.perception.camera import Camera
from gendom.perception.camera_file import write_camera

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)])
TUTORIAL = DOCS / "tutorial.md"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="no docs beside the tests")

NOT_STARTED = ("make", "pip", "git", "cd", "source", "ray", "pytest")
"""Programs that blocks may call and this test never does."""


class Block(NamedTuple):
    """A shell block: why it is not run, and what the page says that comes out, which is the block
    of text that follows."""

    page: Path
    line: int
    commands: tuple[str, ...]
    skipped: str | None
    shown: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


FENCE = re.compile(r"(?ms)^(?:<!-- not run: (?P<why>[^>]*) -->\n+)?"
                   r"```(?P<language>[^\n]*)\n(?P<body>.*?)^```$")  # fmt: skip


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    every = list(FENCE.finditer(text))
    for found, after in zip(every, [*every[1:], None], strict=False):
        if found["language"] not in ("", "sh"):
            continue
        body = found["body"].replace("\\\n", " ")
        lines = [re.sub(r"\s+# .*$", "", line).strip() for line in body.splitlines()]
        commands = (c.strip() for line in lines for c in line.split(" && "))
        commands = tuple(c for c in commands if c and not c.startswith("#"))
        shown = after["body"] if after and after["language"] == "text" else ""
        number = text[: found.start()].count("\n") + 1
        yield Block(page, number, commands, found["why"], shown)


def inline(page: Path) -> Iterator[str]:
    """Commands in backticks outside of blocks."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for code in re.findall(r"`([^`\n]+(?:\n[^`\n]+)?)`", text):
        words, programs = " ".join(code.split()), r"python (examples/|benchmarks/|-m experiments )"
        if re.match(rf"(gendom [a-z]|{programs}|make( |$))", words):
            yield words


ALL = [block for page in PAGES for block in blocks(page)] if DOCS.is_dir() else []
# the changelog names what went, too
INLINE = sorted({code for p in PAGES if p.name != "CHANGELOG.md" for code in inline(p)})


def fault_of_gendom(command: str, *, whole: bool) -> str | None:
    """What is wrong with a `gendom` command, without redirections and flags that all commands take;
    `whole`: all that it needs must be there."""
    words = shlex.split(command.partition(" > ")[0])[1:]
    words = [w for w in words if w not in ("--debug", "--quiet")]
    if words in ([], ["--version"], ["--help"], ["help"], ["help", "COMMAND"]):
        return None
    name, *rest = words[1:2] if words[0] == "help" else words
    if name not in cli.COMMANDS:
        return f"there is no command {name!r}"
    kind, known = import_module(cli.COMMANDS[name][0]).Command, dict(tasks._registered)
    flags = {"--help", *arguments_of(kind)}
    if unknown := [w for w in rest if re.match(r"--[a-zA-Z]", w) and w not in flags]:
        return f"gendom {name} has no {unknown[0]}"
    try:
        if whole and words[0] != "help":
            parse(kind, name, rest)
    except SystemExit as stop:
        return "does not parse" if stop.code else None
    except GendomError as fault:
        return str(fault)
    finally:  # a task in a file is registered when its name is parsed
        tasks._registered.clear()
        tasks._registered.update(known)
    return None


def fault_of_python(words: list[str]) -> str | None:
    """What is wrong with a script of the repository or a table of experiments, and its flags."""
    if words[:2] == ["-m", "experiments"]:
        try:
            experiments.parser().parse_args(["sim2sim"] if words[2:] == ["TABLE"] else words[2:])
        except SystemExit:
            return "does not parse"
    if words[0] == "-m":
        return None
    script = ROOT / words[0]
    text = script.read_text(encoding="utf-8") if script.is_file() else ""
    for word in (w for w in words[1:] if w.startswith("--")):
        field = word[2:].replace("-", "_")  # of a class or function, which tyro makes a flag
        if f'"{word}"' not in text and not re.search(rf"\b{field}: ", text):
            return f"{script.name} has no {word}"
    return None if text else f"there is no {words[0]}"


def fault_of(command: str, *, whole: bool = True) -> str | None:
    """What is wrong with a command of a page."""
    program, *rest = shlex.split(command)
    program = program.removeprefix(".venv/bin/")
    if program == "gendom":
        return fault_of_gendom(command, whole=whole)
    if program == "python":
        return fault_of_python(rest)
    if program == "make":
        folder = ROOT / (rest[rest.index("-C") + 1] if "-C" in rest else ".")
        targets = re.findall(r"(?m)^([a-z-]+):", (folder / "Makefile").read_text(encoding="utf-8"))
        wanted = [w for w in rest if "=" not in w and w not in ("-C", folder.name)]
        return next((f"there is no target {w}" for w in wanted if w not in targets), None)
    return None if program in NOT_STARTED else f"is no command that this test knows: {program}"


@pytest.mark.parametrize("block", ALL, ids=str)
def test_commands_of_blocks_parse(block, monkeypatch):
    monkeypatch.chdir(ROOT)  # where tasks in files are
    faults = [f"{c}: {fault}" for c in block.commands if (fault := fault_of(c))]
    assert faults == []


@pytest.mark.parametrize("command", INLINE)
def test_commands_in_backticks_are_known(command):
    assert fault_of(command, whole=False) is None


@pytest.mark.parametrize(
    "command",
    [
        "gendom estmate lift.npz", "gendom estimate a.npz --start 3", "gendom estimate --starts 3",
        "gendom act rope-throwing", "python examples/10_nothing.py", "make everything",
        "python examples/03_estimate.py --into here", "frobnicate",
        "python -m experiments ablations",
    ],
)  # fmt: skip
def test_wrong_commands_are_found(command, monkeypatch):
    """The tests above are no good if they find nothing."""
    monkeypatch.chdir(ROOT)
    assert fault_of(command) is not None


def run_command(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run one command in a folder."""
    words = shlex.split(command.partition(" > ")[0])
    program = words[0].removeprefix(".venv/bin/")
    if program in NOT_STARTED:
        return
    monkeypatch.chdir(folder)
    if program == "gendom":
        assert cli.main(words[1:]) == 0, command
        return
    assert program == "python", command
    words = [sys.executable, str(ROOT / words[1]), *words[2:]]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))  # the tested code
    run = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, f"{command}\n{run.stderr}"
    print(run.stdout)


@pytest.fixture(scope="session")
def after_tutorial(tmp_path_factory) -> Path:
    """A folder in which the tutorial was followed, with what other pages take for granted."""
    if missing := [n for n in ("torch", "onnx") if importlib.util.find_spec(n) is None]:
        pytest.skip(f"needs {', '.join(missing)}")
    folder = tmp_path_factory.mktemp("tutorial")
    with pytest.MonkeyPatch.context() as patch:
        for block in (b for b in ALL if b.page == TUTORIAL and b.skipped is None):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                for command in block.commands:
                    run_command(command, folder, patch)
            (folder / f"{block.line}.txt").write_text(printed.getvalue())
    written = {path.name for path in (folder / "mine").iterdir()}
    assert {"lift.npz", "estimate.json", "report.html", "replay.gif", "action.json"} <= written
    (folder / "lift").mkdir()
    for name in ("lift.npz", "recording.npz", "estimate.json", "lift/estimate.json"):
        made = "lift.npz" if name.endswith(".npz") else "estimate.json"
        shutil.copy(folder / "mine" / made, folder / name)
    return folder


NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?")


def differences(shown: str, printed: str) -> Iterator[str]:
    """Lines of a page that did not come out: other words, or numbers that are more than a tenth
    off, and 0.4 of those in mm."""
    came = {}
    for line in printed.splitlines():
        came.setdefault(" ".join(NUMBER.sub("#", line).split()), []).append(line)
    for line in filter(None, map(str.strip, shown.splitlines())):
        if line == "..." or line.startswith(("search ", "report: ")):  # times and places
            continue
        numbers = np.array([float(x) for x in NUMBER.findall(line)])
        room = 0.1 * np.abs(numbers) + 0.4 * (" mm" in line) + 1e-9
        others = came.get(" ".join(NUMBER.sub("#", line).split()), ())
        found = [np.array([float(x) for x in NUMBER.findall(other)]) for other in others]
        if not any((np.abs(other - numbers) <= room).all() for other in found):
            yield f"{line} | {', '.join(others) or 'did not come out'}"


@pytest.mark.slow
@pytest.mark.parametrize("block", [b for b in ALL if b.page == TUTORIAL and b.shown], ids=str)
def test_the_tutorial_shows_what_comes_out(block, after_tutorial, monkeypatch, capsys):
    printed = after_tutorial / f"{block.line}.txt"
    if "make demo" in block.commands:
        pytest.importorskip("mujoco", reason="needs the extra reality")
        run_command("gendom demo", after_tutorial, monkeypatch)
        printed.write_text(capsys.readouterr().out)
    assert list(differences(block.shown, printed.read_text())) == []


RUN = [b for b in ALL if b.skipped is None and b.page != TUTORIAL]
RUN = [b for b in RUN if any(shlex.split(c)[0] not in NOT_STARTED for c in b.commands)]


@pytest.mark.slow
@pytest.mark.parametrize("block", RUN, ids=str)
def test_blocks_run(block, after_tutorial, monkeypatch):
    for command in block.commands:
        run_command(command, after_tutorial, monkeypatch)


FOUND = [(page, f) for page in PAGES for f in FENCE.finditer(page.read_text(encoding="utf-8"))]
PYTHON = [(page, found["body"]) for page, found in FOUND if found["language"] == "python"]


@pytest.mark.parametrize(("page", "code"), PYTHON, ids=lambda value: getattr(value, "stem", ""))
def test_imports_of_python_blocks_are_there(page, code):
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("gendom"):
            module = import_module(node.module or "")
            missing = [n.name for n in node.names if not hasattr(module, n.name)]
            assert missing == [], node.module


def test_the_cell_of_the_page_on_hardware_is_one(tmp_path):
    page = DOCS / "hardware.md"
    (cell,) = (f["body"] for at, f in FOUND if at == page and f["language"] == "toml")
    (tmp_path / "cell.toml").write_text(cell, encoding="utf-8")
    (tmp_path / "left").mkdir()
    K = np.array([[610.0, 0.0, 320.0], [0.0, 610.0, 240.0], [0.0, 0.0, 1.0]])
    down = np.array([[0, -1, 0, 0.5], [-1, 0, 0, 0], [0, 0, -1, 1.1], [0, 0, 0, 1.0]])
    camera = Camera(name="left", width=640, height=480, K=K, T_world_camera=down)
    write_camera(tmp_path / "left" / "camera.toml", camera)
    assert Cell.read(tmp_path / "cell.toml").faults() == []


@pytest.mark.slow
def test_the_python_of_the_readme_runs(after_tutorial, monkeypatch):
    monkeypatch.chdir(after_tutorial)
    (code,) = [code for page, code in PYTHON if page.name == "README.md"]
    exec(compile(code, "README.md", "exec"), {})


def test_the_readme_keeps_to_one_screen():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(text.splitlines()) <= 60
    assert len(table.splitlines()) - 2 <= 8  # figures, without the head
    assert "make demo" in text and "make test" in text


# ---- links -----------------------------------------------------------------------------------


def prose(page: Path) -> str:
    """A page without its blocks."""
    return re.sub(r"(?ms)^```.*?^```$", "", page.read_text(encoding="utf-8"))


@cache
def anchors(page: Path) -> set[str]:
    """Those that GitHub and MyST give to headings."""
    found = set()
    for heading in re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE):
        plain = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower())
        found.add(plain.strip().replace(" ", "-"))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_anchors_and_named_files_are_there(page):
    for target in re.findall(r"\]\((?![a-z]+:)([^)\s]+)\)", prose(page)):
        path, _, anchor = target.partition("#")
        place = page.parent / path if path else page
        assert place.exists() and (not anchor or anchor in anchors(place)), target
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:src|tests|benchmarks|experiments)/[\w./-]+\.\w+)`", text)
    assert page.name == "CHANGELOG.md" or [f for f in named if not (ROOT / f).exists()] == []


# ---- the reference ---------------------------------------------------------------------------


def test_public_packages_and_names_are_in_the_reference():
    import gendom

    pages = {path.stem for path in (DOCS / "api").glob("gendom.*.md")}
    rooms = (ROOT / "src" / "gendom").glob("*/__init__.py")
    public = [path.parent.name for path in rooms if "__all__" in path.read_text(encoding="utf-8")]
    assert {f"gendom.{name}" for name in public} <= pages
    text = (DOCS / "api" / "index.md").read_text(encoding="utf-8")
    public = set(gendom.__all__) - {"__version__"}
    assert {name for name in public if f"`gendom.{name}`" not in text} <= {"GendomError"}


# ---- numbers -----------------------------------------------------------------------------------


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
        return code, capsys.readouterr().out, json.loads(figures.STORED.read_text())

    return check


def test_what_was_run_is_kept(checked, tmp_path):
    """Until the command or the version changes, and --again is given; what fails is run again."""
    code, told, stored = checked("--write", exit=3)
    assert (code, stored) == (1, {}) and "FAILED: see n.log" in told
    path = tmp_path / "out" / "n.json"
    (tmp_path / "out" / "n" / "runs").unlink()
    path.unlink()
    code, _, stored = checked("--write")
    assert code == 0 and stored["n"]["numbers"] == {"runs": 1.0}
    assert stored["n"]["version"] == version() and checked("--again")[0] == 0  # nothing has changed
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": "0.0.9"}))
    assert "OUTDATED: of 0.0.9" in checked()[1]
    code, told, _ = checked("--again")  # it was run again, and finds 2 for 1
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
