"""Small changes to the code, one at a time, and whether a room's fast tests fail on them.

    python benchmarks/mutants.py                         # every room
    python benchmarks/mutants.py --only readers --count 80
    python benchmarks/mutants.py --again                 # what survived, with today's tests

Changes are those of cosmic-ray, made in a copy of the repository. Of each room `--count` places are
drawn by `--seed`, and one change of each. Left out is what changes no result: types, the text of
messages (f-strings), caches and flags of classes, flags of calls (`strict`, `optimize`), and
identity in place of equality, which is up to Python. What was tried is kept in --out as
long as the room's code stays the same, so an interrupted run goes on. The table and the changes
that survived are printed.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import difflib
import hashlib
import importlib
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cosmic_ray.commands.init import init
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkItem, WorkResult

ROOT = Path(__file__).resolve().parents[1]

LONGEST, MOST_MEMORY = 600.0, 1 << 33
"""Of a room's tests [s of CPU], [bytes]."""

PRELOADED = (
    "numpy",
    "scipy",
    "warp",
    "PIL",
    "msgspec",
    "pyarrow",
    "onnxruntime",
    "mujoco",
    "tyro",
    "cv2",
)
"""Packages that are imported once."""

IDENTITY = ("_Eq_Is", "_Is_Eq", "_NotEq_IsNot", "_IsNot_NotEq")
"""Ends of operators' names."""

ROOMS = {
    "intervals": ("estimation", "intervals", "estimation/test_exact_intervals"),
    "readers": ("datasets", "clouds npz folder ../reading",
                "test_reading datasets/test_clouds datasets/test_folder "
                "datasets/test_recording"),
    "policies": ("policies", "policy adaptation graph",
                 "policies/test_policy policies/test_adapt policies/test_demonstrations"),
    "robot": ("robot", "kinematics path motion planning collision",
              "robot/test_exact_robot robot/test_motion robot/test_collision"),
    "verdict": ("estimation", "verdict", "estimation/test_exact_verdict"),
    "likelihood": ("estimation", "likelihood", "estimation/test_exact_likelihood"),
}  # fmt: skip
"""Folder, modules and tests by room."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=list(ROOMS), default=list(ROOMS))
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("mutants"))
    parser.add_argument("--again", action="store_true", help="try what survived again")
    given = parser.parse_args()
    out = given.out.resolve()
    tree = out / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    left = shutil.ignore_patterns(".*", out.name, "_build", "__pycache__")
    shutil.copytree(ROOT, tree, ignore=left, symlinks=True)
    os.environ.setdefault("GENDOM_TEST_DATA", str(ROOT.parent / "shared" / "data"))
    sys.path[:0] = [str(tree / "src"), str(tree / "tests"), str(tree)]
    os.chdir(tree)
    rows, alive = [], []
    for room in given.only:
        tried, killed, left = tested(room, given, out)
        rows.append(f"| {room} | {tried} | {killed} | {100.0 * killed / tried:.0f} % |")
        alive += left
    print("\n".join(["| room | changes | found | share |", "|---" * 4 + "|", *rows, *alive]))
    return 0


def tested(room: str, given: argparse.Namespace, out: Path) -> tuple[int, int, list[str]]:
    """Number of changes tried, of those that a test found, and the diffs of the others."""
    folder, names, tests = ROOMS[room]
    modules = [Path("src/gendom", folder, f"{name}.py") for name in names.split()]
    code = hashlib.sha256(b"".join(path.read_bytes() for path in modules)).hexdigest()[:8]
    session = out / f"{room}-{code}-{given.seed}-{given.count}.sqlite"
    with use_db(str(session)) as db:
        if not db.num_work_items:
            init(modules, db, {})
            chosen = drawn(list(db.work_items), random.Random(given.seed), given.count)
            db.clear()
            db.add_work_items(chosen)
        kept: dict[Any, WorkResult] = dict(db.results)
        todo = [
            item
            for item in db.work_items
            if item.job_id not in kept
            or (given.again and kept[item.job_id].test_outcome == TestOutcome.SURVIVED)
        ]
        files = [f"tests/{name}.py" for name in tests.split()]
        limit = LONGEST
        if todo:
            failed, seconds = run(files, modules, LONGEST)
            if failed:
                sys.exit(f"mutants: the tests of {room} fail without any change")
            limit = 5.0 + 3.0 * seconds
        for k, item in enumerate(todo):
            print(f"{room}: {k} of {len(todo)}", file=sys.stderr, flush=True)
            (change,) = item.mutations
            operator = get_operator(change.operator_name)(**change.operator_args)
            try:
                with use_mutation(change.module_path, operator, change.occurrence) as codes:
                    failed, _ = run(files, modules, limit)
            except AttributeError:  # cosmic-ray cannot change exceptions in tuples
                continue
            old, new = (str(code).splitlines() for code in codes)
            diff = list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:]
            said = "\n".join([f"{change.module_path}:{change.start_pos[0]}", *diff])
            outcome = TestOutcome.KILLED if failed else TestOutcome.SURVIVED
            db.set_result(item.job_id, WorkResult(WorkerOutcome.NORMAL, None, outcome, said))
        results = [found for _, found in db.results]
    left = [f"\n{found.diff}" for found in results if not found.is_killed]
    return len(results), len(results) - len(left), left


def run(tests: list[str], modules: list[Path], limit: float) -> tuple[bool, float]:
    """Whether a test fails or takes more than `limit`, and the time taken [s of CPU]. A fork has
    what other packages bring, so only ours are imported anew."""
    for path in modules:  # what was compiled in the same second would be taken again
        for old in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            old.unlink()
    with tempfile.TemporaryFile("w+") as known:
        if (pid := os.fork()) == 0:
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2))
            resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
            signal.alarm(30 * int(limit))  # of waits
            sys.dont_write_bytecode = limit < LONGEST
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            code = pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *tests])
            print(*sys.modules, file=known, flush=True)
            os._exit(int(code))
        _, status, used = os.wait4(pid, 0)
        known.seek(0)
        others = [n for n in known.read().split() if n.split(".")[0] in PRELOADED]
    for name in others:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    return status != 0, used.ru_utime + used.ru_stime


def drawn(items: list[WorkItem], rng: random.Random, count: int) -> list[WorkItem]:
    """One change at each of some places."""
    at: dict[tuple[Path, tuple[int, int]], list[WorkItem]] = {}
    left = {path: set(left_out(path)) for path in {i.mutations[0].module_path for i in items}}
    for item in items:
        change = item.mutations[0]
        if change.operator_name.endswith(IDENTITY):
            continue
        if not any(a <= change.start_pos < b for a, b in left[change.module_path]):
            at.setdefault((change.module_path, change.start_pos), []).append(item)
    places = sorted(at, key=str)
    order = lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence)  # noqa: E731
    chosen = rng.sample(places, min(count, len(places)))
    return [rng.choice(sorted(at[place], key=order)) for place in chosen]


def left_out(path: Path) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """What changes no result in a module, see above: lines and columns of beginnings and ends."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        found: list[ast.expr | None] = []
        if isinstance(node, (ast.arg, ast.AnnAssign)):
            found = [node.annotation]
        elif isinstance(node, ast.FunctionDef):
            found = [node.returns]
            found += [d for d in node.decorator_list if "cache" in ast.unparse(d).split(".")]
        elif isinstance(node, ast.JoinedStr):
            found = [node]
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name):
            found = [node.test] if node.test.id == "TYPE_CHECKING" else []
        elif isinstance(node, ast.Call):
            found = [k.value for k in node.keywords if k.arg in ("strict", "optimize")]
        elif isinstance(node, ast.ClassDef):
            found = [d for d in node.decorator_list if isinstance(d, ast.Call)]
        for one in filter(None, found):
            end = one.end_lineno or one.lineno, one.end_col_offset or 0
            yield (one.lineno, one.col_offset), end


if __name__ == "__main__":
    sys.exit(main())
