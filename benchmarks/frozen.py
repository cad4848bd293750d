"""Figures that a change of the code must not change: written to one JSON, compared with another.

    python benchmarks/frozen.py --out before.json                     # in the repository's root
    python benchmarks/frozen.py --out after.json --only estimates gradients
    python benchmarks/frozen.py --compare before.json after.json

Figures are of the code that Python finds, through the command line where it gives them. What the
file already holds is not computed again unless ``--only`` names it; several runs may fill one file
at once. ``SECTIONS`` says what there is; the whole takes an hour of two shared cores. Recordings of
others come from the folder ``--shared``; without them their figures are left out.

``--compare`` prints what differs by more than ``TOLERANCES`` and exits with 1 if anything does.
Seconds differ with the machine and its load, so compare them on one idle machine alone.
"""

import argparse
import json
import logging
import math
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

ROOT = Path.cwd()
SHARED = Path("../shared")
SEED = 20

Figures = dict[str, Any]

TOLERANCES = {
    "estimates": (1e-3, 1e-5),
    "policies": (1e-6, 0.0),
    "datasets": (1e-6, 0.0),
    "gradients": (1e-6, 0.0),
    "validation": (1e-4, 1e-7),
    "sim2sim": (1e-2, 1e-4),
    "timings": (0.1, 0.0),
}
"""Of each section: by how much a number or list may differ, relative to its largest, and in all."""

PASSING = ("seconds", "path", "out", "settings")
"""What files say of a run and not of its result."""


# ---- commands ------------------------------------------------------------------------------------


def output(*command: str | Path, codes: tuple[int, ...] = (0,)) -> str:
    """What a module's command prints."""
    done = subprocess.run(
        [sys.executable, "-m", *map(str, command)], cwd=ROOT, capture_output=True, text=True
    )
    if done.returncode not in codes:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.stderr.strip()[-2000:]}")
    return done.stdout


def gendom(*command: str | Path, codes: tuple[int, ...] = (0,)) -> Figures:
    return lasting(json.loads(output("gendom", *command, "--json", "--quiet", codes=codes)))


def lasting(value: Any) -> Any:
    """The same without what differs from run to run."""
    if isinstance(value, dict):
        return {k: lasting(v) for k, v in value.items() if k not in PASSING}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return [lasting(v) for v in value] if isinstance(value, list) else value


# ---- estimates -----------------------------------------------------------------------------------

OF_OBJECT = (
    "E", "E_over_rho", "nu", "damping", "friction", "density", "bending_length",
    "bending_stiffness",
)  # fmt: skip
OF_FIT = ("rms", "rms_registered", "chamfer_last", "chamfer_mean", "iterations")


def estimate(recording: Path) -> Figures:
    """Values and intervals, with how it is held and how well it fits. Not usable: exit code 3."""
    found = gendom("estimate", recording, "--starts", "1", "--seed", "0", codes=(0, 3))
    return {
        "usable": found["verdict"]["usable"],
        "values": {name: found.get(name) for name in OF_OBJECT},
        "held": {name: v for name, v in found["theta"].items() if name not in OF_OBJECT},
        "intervals": found.get("intervals"),
        "fit": {name: found.get(name) for name in OF_FIT},
        "noise": found["noise"],
    }


def shared_estimate(name: str) -> Figures | None:
    path = SHARED / name
    return estimate(path) if path.is_file() else None


def demo_estimate() -> Figures:
    import gendom as package

    return estimate(Path(package.__file__).parent / "assets" / "demo-rope-lift.npz")


def cloth_estimate() -> Figures:
    """A cloth that is recorded in the MuJoCo test scene, pictures and all."""
    with tempfile.TemporaryDirectory() as folder:
        lift, recording = Path(folder) / "lift", Path(folder) / "lift.npz"
        output("gendom", "record", "--reality", "cloth-rubber", "--out", lift, "--seed", "1")
        output("gendom", "perceive", lift, "--out", recording)
        return estimate(recording)


# ---- policies and datasets -----------------------------------------------------------------------


def policy(task_name: str, parameters: bool, count: int) -> Figures:
    """Actions of a shipped policy for drawn objects and goals that they can reach, and what these
    actions reach in the simulator."""
    from gendom.policies import Policy
    from gendom.tasks.world import Simulation

    logging.getLogger("gendom").setLevel(logging.ERROR)  # goals out of range are told one by one
    acting = Policy.pretrained(task_name, parameters=parameters)
    task, simulation = acting.task(), Simulation()
    items, drawn = [], []
    for k in range(count):
        rng = np.random.default_rng([SEED, k])
        items.append(task.draw_items([rng])[0])
        drawn.append(task.sample_actions(items[-1], rng, 1)[0])
    names = [goal.name for goal in task.goals]
    goals = np.empty((count, 0))
    if names:
        outcomes = simulation.carry_out(task, items, np.array(drawn))
        goals = np.array([[o.values[name] for name in names] for o in outcomes])
    actions = [
        list(acting.act(goal, item, force=True).values)
        for goal, item in zip(goals, items, strict=True)
    ]
    outcomes = simulation.carry_out(task, items, np.array(actions))
    return {
        "goals": by_column(names, goals),
        "actions": by_column([a.name for a in task.actions], np.array(actions)),
        "reached": {name: [o.values[name] for o in outcomes] for name in outcomes[0].values},
    }


def by_column(names: list[str], rows: np.ndarray) -> Figures:
    return {name: rows[:, k].tolist() for k, name in enumerate(names)}


def dataset(task: str, engine: str, size: int) -> Figures:
    """Rows of demonstrations: objects, actions and what they reached."""
    import pyarrow.parquet as pq

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "set"
        gendom(
            "dataset", task, "--size", str(size), "--seed", str(SEED), "--engine", engine,
            "--out", out,
        )  # fmt: skip
        tables = [pq.read_table(path) for path in sorted(out.glob("*.parquet"))]
    columns: Figures = {}
    for table in tables:
        for name, values in table.to_pydict().items():
            columns.setdefault(name, []).extend(values)
    columns["fault"] = [fault is not None for fault in columns["fault"]]
    return lasting(columns)


# ---- the simulator: all calls whose form may change ----------------------------------------------


def scene(kind: str) -> tuple[Any, Figures]:
    """A body on a table with a gripper at its end, and everything else that it is simulated by."""
    from gendom.sim import cloth, rope

    rng = np.random.default_rng(SEED)
    if kind == "cloth":
        body = cloth(
            width=0.12, height=0.1, thickness=0.004, dx=0.02, corner=(0, 0, 0.1), points=(7, 6)
        )
    elif kind == "coil":  # two turns that press on each other
        a = np.linspace(0.0, 4.0 * math.pi, 200)
        line = np.stack([0.04 * np.cos(a), 0.04 * np.sin(a), 0.1 + 0.0113 * a / math.tau], axis=1)
        body = rope(diameter=0.012, centre_line=line, points=30)
    else:
        body = rope(diameter=0.012, length=0.2, start=(0, 0, 0.1), direction=(1, 0.1, 0), points=12)
    rest = body.x if kind == "particles" else body.points
    first, up = body.points[0], np.array([0.003, 0.01, 0.015])
    given = {
        "E": 1e6, "nu": 0.3, "density": 900.0, "damping": 0.003, "friction": 0.3,
        "self_friction": 0.3, "gravity": np.array([0.3, 0.2, -30.0]), "velocity_damping": 2.0,
        "air_density": 40.0, "stiffness": 1.0 + 0.2 * rng.normal(size=len(rest)) ** 2,
        "positions": rest + (0.0 if kind == "particles" else 3e-4) * rng.normal(size=rest.shape),
        "velocities": 0.2 * rng.normal(size=rest.shape),
        "gripper_positions": np.array([[first, first + up, first + 2 * up]]),
        "gripper_rotations": np.array([[[0, 0, 0], [0.3, 0.5, 0.1], [0.5, 0.6, -0.3]]]),
        "gripper_radius": np.array([0.021]),
    }  # fmt: skip
    if kind != "particles":
        given["thickness"] = body.thickness
    if kind == "cloth":
        given["membrane"] = 1.5e5
    return body, given


def grouped(*, self_contact: bool = False, **solver: Any) -> Figures:
    """A simulator's settings as it takes them."""
    from gendom.sim import Physics, Solver

    return {"physics": Physics(self_contact=self_contact), "solver": Solver(**solver)}


def gradients(kind: str, **settings: Any) -> Figures:
    """A sum of weighted positions, and its derivatives by all that the scene depends on."""
    import torch

    from gendom.sim import Gripper, Table
    from gendom.sim.autograd import simulate

    body, values = scene(kind)
    given: Figures = {
        name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
        for name, value in values.items()
    }
    path = values["gripper_positions"][0]
    hand = Gripper(
        time=[0, 0.02, 0.05], position=path, quat_xyzw=[[0.0, 0.0, 0.0, 1.0]] * 3, radius=0.021,
        hold_until=0.045,
    )  # fmt: skip
    below = values["positions"][:, 2].min() - 0.0065
    table = Table(height=float(below), friction=0.3)
    times = [0.01, 0.02, 0.03] if kind == "particles" else [0.01, 0.03, 0.05, 0.06]
    own: Any
    try:
        own = grouped(**{"dtype": "float64", **settings})  # type: ignore[arg-type]
    except ImportError:  # 0.1.0
        own = {"options": settings}
    x = simulate(body, times, grippers=[hand], table=table, **own, **given)
    weights = torch.tensor(np.random.default_rng(SEED + 1).normal(size=tuple(x.shape)))
    loss = (x * weights).sum()
    loss.backward()
    figures: Figures = {"loss": loss.item(), "last": x[-1].detach().numpy().ravel().tolist()}
    for name, tensor in given.items():
        assert tensor.grad is not None
        figures[f"by {name}"] = tensor.grad.numpy().ravel().tolist()
    return figures


def rollouts(kind: str, engine: str, count: int) -> None:
    """Lifts of a second, one after the other: a rope by its end, a cloth by its corner."""
    from gendom.materials import Material
    from gendom.sim import Gripper, Simulator, Table, cloth, rope

    if kind == "cloth":
        body = cloth(width=0.3, height=0.3, thickness=0.001, dx=0.02, corner=(0.0, 0.0, 0.0005))
        material = Material(E=6.0e5, nu=0.3, density=400.0, damping=0.005)
    else:
        body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005))
        material = Material(E=1.0e6, nu=0.3, density=1000.0, damping=0.004)
    first = body.points[0]
    path = first + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]])
    hand = Gripper(time=[0.0, 1.0], position=path, radius=0.0075)
    own: Figures = {"engine": engine, "threads": 1}
    with suppress(ImportError):  # 0.1.0
        own = grouped(**own)
    for _ in range(count):
        simulator = Simulator(body, [material], grippers=[hand], table=Table(height=0.0), **own)
        simulator.run(np.linspace(0.1, 1.0, 10))


# ---- mechanics, tables of the paper, seconds -----------------------------------------------------


def validation(engine: str) -> Figures:
    """All rows of a suite. Exit code 1: at least one is off by more than is allowed."""
    options = ("--engine", engine, "--json")
    if (ROOT / "validation").is_dir():
        found = json.loads(output("validation", *options, codes=(0, 1)))
    else:
        found = json.loads(output("gendom", "validate", *options, codes=(0, 1)))
    rows: Figures = {}
    for case in found["cases"]:
        for check in case["checks"]:
            name = f"{case['name']}: {check['quantity']}"
            rows[name] = {k: check[k] for k in ("measured", "expected", "passed")}
    return rows


def sim2sim() -> Figures:
    with tempfile.TemporaryDirectory() as folder:
        options = ("sim2sim", "--scale", "small", "--out", Path(folder) / "table", "--json")
        if (ROOT / "experiments").is_dir():
            found = json.loads(output("experiments", *options))
        else:
            found = json.loads(output("gendom", "reproduce", *options))
    return lasting(found)


def cpu_seconds() -> float:
    """Of this process and of commands that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def timed(job: Callable[[], object], runs: int) -> Figures:
    """Medians after a run that compiles: seconds of the clock, and of all cores."""
    clock, cpu = [], []
    for _ in range(runs + 1):
        began, used = time.perf_counter(), cpu_seconds()
        job()
        clock.append(time.perf_counter() - began)
        cpu.append(cpu_seconds() - used)
    return {"clock": statistics.median(clock[1:]), "cpu": statistics.median(cpu[1:])}


# ---- sections ------------------------------------------------------------------------------------

TASKS = {
    "rope-reaching": {"thin": 200, "mpm": 200},
    "rope-casting": {"thin": 200, "mpm": 200},
    "cloth-spreading": {"thin": 12, "mpm": 4},
}
"""Rows of each with each engine; one of a cloth is a search over a dozen rollouts."""

POLICIES = (
    ("rope-reaching", True), ("rope-reaching", False), ("rope-casting", True),
    ("rope-casting", False), ("cloth-spreading", True),
)  # fmt: skip
"""Shipped ones: the task, and whether they see parameters."""

SECTIONS: dict[str, Callable[[], Figures | None]] = {
    "estimates/demo": demo_estimate,
    "estimates/red-rope": partial(shared_estimate, "data/rope_red_lift.npz"),
    "estimates/wire": partial(shared_estimate, "data/wire_white_loop.npz"),
    "estimates/cable": partial(shared_estimate, "data/cable_dlo3_train_001.npz"),
    "estimates/r02": partial(shared_estimate, "lifts/r02.npz"),
    "estimates/r21": partial(shared_estimate, "lifts/r21.npz"),
    "estimates/c02": partial(shared_estimate, "lifts/c02.npz"),
    "estimates/cloth": cloth_estimate,
    **{
        f"policies/{task}{'' if sees else '-no-parameters'}": partial(policy, task, sees, 50)
        for task, sees in POLICIES
    },
    **{
        f"datasets/{task}/{engine}": partial(dataset, task, engine, size)
        for task, sizes in TASKS.items()
        for engine, size in sizes.items()
    },
    "gradients/rod": partial(gradients, "rope", engine="thin", substep=2e-4),
    "gradients/rod-contact": partial(
        gradients, "coil", engine="thin", substep=1e-4, self_contact=True
    ),
    "gradients/shell": partial(gradients, "cloth", engine="thin", substep=1e-4),
    "gradients/mpm": partial(gradients, "particles", engine="mpm", dtype="float64"),
    "validation/thin": partial(validation, "thin"),
    "validation/mpm": partial(validation, "mpm"),
    "sim2sim": sim2sim,
    "timings/estimate-demo": lambda: timed(demo_estimate, 3),
    "timings/rod": lambda: timed(partial(rollouts, "rope", "thin", 50), 5),
    "timings/shell": lambda: timed(partial(rollouts, "cloth", "thin", 3), 5),
    "timings/mpm": lambda: timed(partial(rollouts, "rope", "mpm", 1), 3),
}


def read(path: Path) -> dict[str, Figures]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def fill(path: Path, only: list[str]) -> int:
    """Compute the figures that the file lacks, or those that are named; how many failed."""
    failed = 0
    for name, job in SECTIONS.items():
        if name not in only and name.split("/")[0] not in only and (only or name in read(path)):
            continue
        began = time.monotonic()
        try:
            figures = job()
        except Exception as error:
            print(f"{name:<40} failed: {error}", flush=True)
            failed += 1
            continue
        if figures is None:
            print(f"{name:<40} left out: no recording in {SHARED}", flush=True)
            continue
        with FileLock(f"{path}.lock"):
            part = path.with_suffix(".part")
            part.write_text(json.dumps({**read(path), name: figures}), encoding="utf-8")
            part.replace(path)
        print(f"{name:<40} {time.monotonic() - began:8.1f} s", flush=True)
    return failed


# ---- comparison ----------------------------------------------------------------------------------


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers, words and lists of them, each with its place."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and any(isinstance(v, dict | list) for v in value):
        for k, inner in enumerate(value):
            yield from leaves(inner, f"{name}[{k}]")
    else:
        yield name, value


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def difference(a: Any, b: Any) -> tuple[float, float]:
    """The largest difference of two leaves, infinite if they are unlike, and their largest
    number."""
    left, right = (v if isinstance(v, list) else [v] for v in (a, b))
    if len(left) != len(right):
        return math.inf, 0.0
    off, size = 0.0, 0.0
    for x, y in zip(left, right, strict=True):
        if is_number(x) and is_number(y):
            off, size = max(off, abs(x - y)), max(size, abs(x), abs(y))
        elif x != y:
            return math.inf, 0.0
    return off, size


def compare(before: Path, after: Path) -> int:
    """Print what differs; the number of such leaves."""
    count, old, new = 0, read(before), read(after)
    for name in {**old, **new}:
        if name not in old or name not in new:
            print(f"{name:<40} only in {before if name in old else after}")
            continue
        relative, absolute = TOLERANCES[name.split("/")[0]]
        a, b = dict(leaves(old[name])), dict(leaves(new[name]))
        gone = {key.split(": ")[0]: None for key in old[name] if key not in new[name]}
        worst, lines = 0.0, [f"    {key}: gone" for key in gone]
        for leaf in [x for x in a if x in b or not x.startswith(tuple(gone))]:
            off, size = difference(a.get(leaf), b.get(leaf))
            if off > (bound := relative * size + absolute) and leaf != "clock":
                lines.append(f"    {leaf}: {shown(a[leaf], b.get(leaf), bound)}, off by {off:.3g}")
            if size > 0.0:
                worst = max(worst, off / size)
        count += len(lines)
        said = f"{len(lines)} of {len(a)} differ" if lines else f"the same ({len(a)})"
        print(f"{name:<40} {said}, numbers by {worst:.2g} at most", *lines, sep="\n")
    return count


def shown(a: Any, b: Any, bound: float) -> str:
    """Two leaves; of lists of one length the first of those that differ, and how many do."""
    many = ""
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        apart = [k for k, pair in enumerate(zip(a, b, strict=True)) if difference(*pair)[0] > bound]
        many = f" ([{apart[0]}], {len(apart)} of {len(a)} differ)"
        a, b = a[apart[0]], b[apart[0]]
    return " -> ".join(f"{v:.8g}" if is_number(v) else f"{v!r:.50}" for v in (a, b)) + many


def main() -> int:
    global SHARED
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="JSON file to write or to complete")
    parser.add_argument("--only", nargs="+", default=[], help="sections, or single ones of them")
    parser.add_argument("--shared", type=Path, default=SHARED, help="folder of recordings")
    parser.add_argument("--compare", nargs=2, type=Path, metavar=("BEFORE", "AFTER"))
    given = parser.parse_args()
    if given.compare:
        return 1 if compare(*given.compare) else 0
    if given.out is None:
        parser.error("give --out or --compare")
    known = {name.split("/")[0] for name in SECTIONS} | set(SECTIONS)
    if unknown := [name for name in given.only if name not in known]:
        parser.error(f"no section {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    SHARED = given.shared
    return 1 if fill(given.out, given.only) else 0


if __name__ == "__main__":
    sys.exit(main())
