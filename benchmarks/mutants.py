"""Small changes to the code, one at a time, and whether a room's fast tests fail on them.

    python benchmarks/mutants.py                         # every room
    python benchmarks/mutants.py --only readers --count 80
    python benchmarks/mutants.py --again                 # what survived, with today's tests

Changes are those of cosmic-ray (`pip install cosmic-ray`), made in a copy of the repository. Of each
room `--count` places are drawn by `--seed`, and one change of each; annotations are left out. What
was tried is kept in --out as long as the room's code stays the same, so an interrupted run goes on.
The table and the changes that survived are printed.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import TestOutcome, WorkItem

ROOT = Path(__file__).resolve().parents[1]
IN, TESTS = "src/gendom/", "tests/"

ROOMS = {
    "likelihood": (
        ["estimation/likelihood.py"],
        ["estimation/test_gauss_newton.py", "estimation/test_camera_pose.py"],
    ),
    "discrepancy": (["estimation/discrepancy.py"], ["estimation/test_discrepancy.py"]),
    "verdict": (["estimation/verdict.py"], ["estimation/test_verdict.py"]),
    "readers": (
        ["reading.py", *(f"datasets/{n}.py" for n in ("cloud_fields", "ply", "pcd", "npz", "folder"))],
        ["datasets/test_ply.py", "datasets/test_pcd.py", "datasets/test_npz.py",
         "datasets/test_folder.py", "test_reading.py", "test_files.py"],
    ),
    "policies": (
        ["policies/policy.py", "policies/adaptation.py", "policies/graph.py"],
        ["policies/test_policy.py", "policies/test_adapt.py"],
    ),
    "robot": (
        [f"robot/{n}.py" for n in ("kinematics", "path", "motion", "timing", "states", "collision")],
        ["robot"],
    ),
}  # fmt: skip
"""Modules and tests by room."""


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
    os.environ["PYTHONPATH"] = os.pathsep.join(["src", "tests", "."])
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
    modules = [Path(IN + name) for name in ROOMS[room][0]]
    command = f"{sys.executable} -m pytest -q -x -p no:cacheprovider -m 'not slow' " + " ".join(
        TESTS + name for name in ROOMS[room][1]
    )
    code = hashlib.sha256(b"".join(path.read_bytes() for path in modules)).hexdigest()[:8]
    session = out / f"{room}-{code}-{given.seed}-{given.count}.sqlite"
    with use_db(str(session)) as db:
        if not db.num_work_items:
            init(modules, db, {})
            chosen = drawn(list(db.work_items), random.Random(given.seed), given.count)
            db.clear()
            db.add_work_items(chosen)
        kept = dict(db.results)
        todo = [
            item
            for item in db.work_items
            if item.job_id not in kept
            or (given.again and kept[item.job_id].test_outcome == TestOutcome.SURVIVED)
        ]
        if todo:
            began = time.monotonic()
            subprocess.run(command, shell=True, check=True, stdout=sys.stderr)
            limit = 3.0 * (time.monotonic() - began) + 10.0
        for k, item in enumerate(todo):
            print(f"{room}: {k} of {len(todo)}", end="\r", file=sys.stderr, flush=True)
            db.set_result(item.job_id, mutate_and_test(item.mutations, command, limit))
        results = [found for _, found in db.results]
    left = [f"\n{found.diff}" for found in results if not found.is_killed]
    return len(results), len(results) - len(left), left


def drawn(items: list[WorkItem], rng: random.Random, count: int) -> list[WorkItem]:
    """One change at each of some places."""
    at: dict[tuple[Path, tuple[int, int]], list[WorkItem]] = {}
    notes = {path: set(annotations(path)) for path in {i.mutations[0].module_path for i in items}}
    for item in items:
        change = item.mutations[0]
        if not any(a <= change.start_pos < b for a, b in notes[change.module_path]):
            at.setdefault((change.module_path, change.start_pos), []).append(item)
    places = sorted(at, key=str)
    order = lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence)  # noqa: E731
    chosen = rng.sample(places, min(count, len(places)))
    return [rng.choice(sorted(at[place], key=order)) for place in chosen]


def annotations(path: Path) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Where a module tells types: lines and columns of beginnings and ends."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        notes = [node.annotation] if isinstance(node, (ast.arg, ast.AnnAssign)) else []
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            notes = [node.returns]
        for note in filter(None, notes):
            end = note.end_lineno or note.lineno, note.end_col_offset or 0
            yield (note.lineno, note.col_offset), end


if __name__ == "__main__":
    sys.exit(main())
