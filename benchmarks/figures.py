"""Check every number of README and docs/benchmarks.md: run its command, compare, write the pages.

    python benchmarks/figures.py --list               # names, minutes, commands
    python benchmarks/figures.py                      # all but hours, and what lacks here
    python benchmarks/figures.py --only torsion wire  # these, however long they take
    python benchmarks/figures.py --pages              # the pages from figures.json, nothing is run

A command's whole output is kept in --out, so an interrupted check continues, and commands that keep
their own results run in --out/NAME. What was kept of another version or command is made anew with
--again. The table of stated and found is printed and kept as --out/found.md; with --write what was
found takes the place of what was stated, in figures.json and on the pages. Exit code 1: a number is
off, or a command failed.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from stated import COUNTS, FIGURES, Figure

from gendom.files import write_json
from gendom.installation import version
from gendom.reading import read_json

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "benchmarks" / "figures.json"
PAGES = (
    ROOT / "README.md",
    ROOT / "docs" / "benchmarks.md",
    ROOT / "docs" / "performance.md",
    ROOT / "docs" / "reality.md",
    ROOT / "docs" / "robot.md",
)
RECORDINGS = Path(os.environ.get("GENDOM_TEST_DATA", ROOT.parent / "shared" / "data"))
WHERE = {"recordings": "recordings (docs/recordings.md, Recordings of others)"}

TEMPLATES = ROOT / "benchmarks" / "figures.md"
"""Text of every block of the pages, with numbers as `{figure[number]}`. `{figure:command}` is its
command, `{figure:with}` the version and the machine that it was measured with."""

BLOCK = re.compile(r"(<!-- figures: (\S+) -->\n)(.*?)(<!-- figures end -->)", re.DOTALL)
"""Text between these comments of a page is made from `TEMPLATES` and `STORED`."""


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [figure.name for figure in FIGURES]
    parser.add_argument("--only", nargs="+", choices=names, default=[], metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("figures"))
    parser.add_argument("--list", action="store_true", help="names, what they need, commands")
    parser.add_argument("--hours", action="store_true", help="also commands that take hours")
    parser.add_argument("--again", action="store_true", help="run what was kept of other versions")
    parser.add_argument("--write", action="store_true", help="state what was found")
    parser.add_argument("--pages", action="store_true", help="write the pages, run nothing")
    given = parser.parse_args(argv)
    stored = read_json(STORED)
    if given.list:
        for figure in FIGURES:
            minutes = minutes_of([figure], stored)
            print(f"{figure.name:<18} {minutes:>6} {', '.join(figure.needs):<12} {figure.command}")
        return 0
    given.out.mkdir(parents=True, exist_ok=True)
    chosen = [f for f in FIGURES if f.name in (given.only or names) and not given.pages]
    lacking = {f.name: [n for n in f.needs if not here(n, given)] for f in chosen}
    new = [f for f in chosen if not lacking[f.name] and kept_of(f, given) is None]
    if new:
        known = minutes_of(new, stored) or "unknown time"
        print(f"{len(new)} commands to run ({known} when last stated)", file=sys.stderr, flush=True)
    lines, good = [], True
    for figure in chosen:
        if lacks := lacking[figure.name]:
            needs = ", ".join(WHERE.get(need, need) for need in lacks)
            lines.append(row(figure.name, "", "", "", "", f"not run: needs {needs}"))
            continue
        found = checked(figure, given, stored.get(figure.name))
        good = good and all(cells[-1] == "" for cells in found)
        lines += [row(figure.name, *cells) for cells in found]
    if lines:
        head = [row("figure", "number", "stated", "found", "allowed", ""), "|---" * 6 + "|"]
        print("\n".join([*head, *lines]))
        (given.out / "found.md").write_text("\n".join([*head, *lines, ""]), encoding="utf-8")
    if given.write or given.pages:
        write_pages(stored_with(stored, given))
    return 0 if good else 1


def checked(figure: Figure, given: argparse.Namespace, stated: Any) -> list[tuple[str, ...]]:
    """Cells of the table: number, stated, found, allowed, and what is wrong."""
    kept = kept_of(figure, given) or run(figure, given.out)
    if why := fault_of(figure, kept):
        return [("", "", "", "", why)]
    before = dict(leaves(stated["numbers"])) if stated else {}
    cells = []
    for name, found in leaves(figure.numbers(kept["output"])):
        was = before.get(name)
        fault = "" if was is None or figure.agrees(name, was, found) else "OFF"
        allowed = "0" if name in COUNTS else figure.allowed
        cells.append((name, *map(shown, (was, found)), allowed, fault))
    return cells


def kept_of(figure: Figure, given: argparse.Namespace) -> dict[str, Any] | None:
    """The run of a figure's command that is kept, if it ended well."""
    path = given.out / f"{figure.name}.json"
    kept = read_json(path) if path.exists() else {"exit": None}
    return None if kept["exit"] != 0 or (given.again and outdated(figure, kept)) else kept


def run(figure: Figure, out: Path) -> dict[str, Any]:
    """Run a figure's command and keep what it printed."""
    folder = out / figure.name
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{figure.name}: {figure.command}", file=sys.stderr, flush=True)
    began = time.monotonic()
    with (out / f"{figure.name}.log").open("w", encoding="utf-8") as log:
        done = subprocess.run(
            words_of(figure),
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), *sys.path]))},
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    kept = {
        "command": figure.command,
        "version": version(),
        "machine": machine(figure),
        "seconds": time.monotonic() - began,
        "exit": done.returncode,
        "output": done.stdout,
    }
    write_json(out / f"{figure.name}.json", kept)
    return kept


def fault_of(figure: Figure, kept: Mapping[str, Any]) -> str | None:
    """Why a kept run says nothing of a figure."""
    if kept["exit"] != 0:
        return f"FAILED: see {figure.name}.log"
    if outdated(figure, kept):
        return f"OUTDATED: of {kept['version']}, {kept['command']!r}; --again runs it"
    try:
        figure.numbers(kept["output"])
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        return f"FAILED: the output cannot be read ({type(error).__name__}: {error})"
    return None


def outdated(figure: Figure, kept: Mapping[str, Any]) -> bool:
    of = kept["version"].partition(" ")[0], kept["command"]
    return of != (version().partition(" ")[0], figure.command)


def words_of(figure: Figure) -> list[str]:
    """The command with this interpreter, and files where they are."""
    words = shlex.split(figure.command) + (["--json"] if figure.json else [])
    program = {"python": [sys.executable], "gendom": [sys.executable, "-m", "gendom"]}
    first = program.get(words[0], words[:1])
    return [*first, *(placed(word) for word in words[1:])]


def placed(word: str) -> str:
    places = (ROOT / word, RECORDINGS / word)
    return next((str(p) for p in places if "." in word and p.is_file()), word)


def machine(figure: Figure) -> str:
    if "cuda" not in figure.needs:
        return f"{len(os.sched_getaffinity(0))} cores"
    import warp

    return warp.get_device("cuda:0").name


def here(need: str, given: argparse.Namespace) -> bool:
    """Whether this machine has what a figure needs; hours have to be asked for."""
    if need == "recordings":
        return RECORDINGS.is_dir()
    if need == "cuda":
        import warp

        return warp.is_cuda_available()
    return given.hours or bool(given.only)


def minutes_of(figures: Sequence[Figure], stored: Mapping[str, Any]) -> str:
    """How long their commands took when they were last stated, as far as that is known."""
    seconds = [stored.get(f.name, {}).get("seconds") for f in figures]
    return f"{sum(filter(None, seconds)) / 60.0:.1f} min" if any(seconds) else ""


def stored_with(stored: dict[str, Any], given: argparse.Namespace) -> dict[str, Any]:
    """What is stated, with what was found in its place where that is asked for."""
    for figure in FIGURES if given.write else ():
        path = given.out / f"{figure.name}.json"
        if (given.only and figure.name not in given.only) or not path.exists():
            continue
        kept = read_json(path)
        if fault_of(figure, kept) is None:
            numbers = figure.numbers(kept.pop("output"))
            stored[figure.name] = {**kept, "seconds": round(kept["seconds"], 1), "numbers": numbers}
            del stored[figure.name]["exit"]
    write_json(STORED, {f.name: stored[f.name] for f in FIGURES if f.name in stored})
    return stored


def write_pages(stored: Mapping[str, Any]) -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        page.write_text(made(text, stored), encoding="utf-8")


def made(text: str, stored: Mapping[str, Any]) -> str:
    """A page with its blocks made from what is stored; lines with numbers that were never measured
    are left out."""
    templates = {m[2]: m[3] for m in BLOCK.finditer(TEMPLATES.read_text(encoding="utf-8"))}
    known = {name: Stated(own) for name, own in stored.items()}

    def lines(template: str) -> Iterator[str]:
        for line in template.splitlines(keepends=True):
            with suppress(LookupError):
                yield line.format_map(known)

    return BLOCK.sub(lambda m: f"{m[1]}{''.join(lines(templates[m[2]]))}{m[4]}", text)


class Stated(dict[str, Any]):
    """The numbers of a figure; in templates also its command, and what it was measured with."""

    def __init__(self, stored: Mapping[str, Any]):
        super().__init__(stored["numbers"])
        self.shown = {
            "command": f"`{stored['command']}`",
            "with": f"{stored['version']}, {stored['machine']}",
        }

    def __format__(self, spec: str) -> str:
        return self.shown[spec]


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers by dotted names; of texts the numbers in them."""
    if isinstance(value, Mapping):
        entries = list(value.items())
    elif isinstance(value, list):
        entries = list(enumerate(value))
    elif isinstance(value, str):
        entries = list(enumerate(map(float, re.findall(r"-?\d+(?:\.\d+)?", value))))
    else:
        yield name, value
        return
    for key, inner in entries:
        yield from leaves(inner, f"{name}.{key}" if name else str(key))


def shown(number: Any) -> str:
    return "" if number is None else f"{number:.4g}"


def row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(main())
