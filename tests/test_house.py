"""The house: imports run one way and in no circle, functions and files are short."""

import ast
import graphlib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import gendom

SOURCES = Path(gendom.__file__).parent

FLOORS = (
    ("arrays", "errors", "shown", "lazy", "environments", "plugins", "installation", "progress",
     "arguments", "files", "reading", "streams"),
    ("materials", "observation", "robot"),
    ("sim", "datasets"),
    ("tasks", "perception"),
    ("estimation", "policies", "viz", "reality"),
    ("hardware", "twins"),
    ("cli",),
)  # fmt: skip
"""Rooms from the ground up: each may import from those below it, and from itself."""

BESIDE = {"estimation", "policies"}
"""Rooms of one floor that must not import each other."""

LONG, LONGER, MOST_LONG, LONGEST_FILE = 60, 120, 30, 600
"""Lines of a function that count as long, of none but kernels, how many may be long, and lines of
a file."""


@cache
def modules() -> dict[str, ast.Module]:
    """Syntax trees of all modules by dotted name."""
    found = {}
    for path in sorted(SOURCES.rglob("*.py")):
        parts = ["gendom", *path.relative_to(SOURCES).with_suffix("").parts]
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements below a node; expressions hold neither imports nor functions."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.stmt | ast.excepthandler | ast.match_case):
            yield inner
            yield from statements(inner)


@cache
def imports() -> dict[str, set[str]]:
    """Modules of the package that each module names in its import statements, wherever these
    stand."""
    known = modules()
    found: dict[str, set[str]] = {}
    for name, tree in known.items():
        targets = set()
        for node in statements(tree):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= {n if n in known else node.module for n in inner}
        found[name] = {t for t in targets if t in known and t != name}
    return found


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def test_no_modules_import_each_other():
    graph = {**imports(), "gendom": set()}  # the face hands on names of all rooms
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(f"import circle: {' -> '.join(error.args[1])}")


def test_imports_run_downwards():
    floor = {name: k for k, names in enumerate(FLOORS) for name in names}
    unknown = {room(m) for m in modules()} - set(floor) - {"", "__main__"}
    assert not unknown, "rooms without a floor"
    upwards = [
        f"{module} -> {target}"
        for module, targets in imports().items()
        for target in sorted(targets)
        if room(module) in floor and room(target) in floor and room(module) != room(target)
        if floor[room(target)] > floor[room(module)] or {room(module), room(target)} == BESIDE
    ]
    assert not upwards


def test_no_two_classes_share_a_name():
    """But for those of the command line, a class `Command` each."""
    found = Counter(
        node.name
        for tree in modules().values()
        for node in statements(tree)
        if isinstance(node, ast.ClassDef) and node.name != "Command"
    )
    assert [name for name, count in found.items() if count > 1] == []


def builds_kernels(function: ast.FunctionDef) -> bool:
    """Whether Warp's kernels or structs are defined in it."""
    inner = [n for n in ast.walk(function) if isinstance(n, ast.FunctionDef | ast.ClassDef)]
    return any("wp." in ast.unparse(d) for n in inner for d in n.decorator_list)


def test_functions_are_short():
    long = [
        (lines, f"{name}.{node.name}")
        for name, tree in modules().items()
        for node in statements(tree)
        if isinstance(node, ast.FunctionDef)
        if (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > LONG
        if not builds_kernels(node)
    ]
    assert len(long) <= MOST_LONG and all(lines <= LONGER for lines, _ in long), sorted(long)


def test_files_are_short():
    files = [path for path in SOURCES.rglob("*") if path.suffix in (".py", ".h", ".cu", ".js")]
    lines = {path.name: path.read_text(encoding="utf-8").count("\n") for path in files}
    assert {name: n for name, n in lines.items() if n > LONGEST_FILE} == {}
