"""What README and the pages of benchmarks state: commands, and how their numbers are read."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any

import numpy as np

COUNTS = ("lifts", "rows", "passed")
"""Numbers that have to be equal."""

Reader = Callable[[Any], dict[str, Any]]

MACHINE = 1.0
"""Relative tolerance of times and speeds, which machines change: a factor of two."""


@dataclass(frozen=True)
class Figure:
    """Numbers that one command prints."""

    name: str
    command: str
    """As pages show it."""
    read: Reader
    """Numbers, also in lists and mappings, from the command's JSON or text."""
    _: KW_ONLY
    json: bool = True
    """Whether the command prints JSON with ``--json``; its text is read otherwise."""
    relative: float = 0.05
    """Of the smaller of both numbers."""
    absolute: float = 0.0
    needs: tuple[str, ...] = ()
    """``cuda``, ``recordings`` (docs/recordings.md), ``hours``."""

    def numbers(self, output: str) -> dict[str, Any]:
        """From the command's output, with five digits."""
        return _rounded(self.read(_json_in(output) if self.json else output))

    def agrees(self, number: str, stated: float, found: float) -> bool:
        if number in COUNTS:
            return stated == found
        share = self.relative * min(abs(stated), abs(found))
        return abs(found - stated) <= share + self.absolute

    @property
    def allowed(self) -> str:
        share = "a factor of 2" if self.relative == MACHINE else f"{100.0 * self.relative:g} %"
        return share + (f" + {self.absolute:g}" if self.absolute else "")


def _json_in(output: str) -> Any:
    """The JSON in what a command printed; `gendom demo` tells what it does before."""
    began = re.search(r"^[\[{]", output, re.MULTILINE)
    if began is None:
        raise ValueError("no JSON was printed")
    return json.JSONDecoder().raw_decode(output, began.start())[0]


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _rounded(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_rounded(inner) for inner in value]
    return value if isinstance(value, str) else float(f"{value:.5g}")


# ---- how numbers are read ----------------------------------------------------------------------


def coverage(found: Any) -> dict[str, Any]:
    """Of E, bending length, damping and friction [%], friction in its own unit."""
    read: dict[str, Any] = {"usable": found["usable"], "lifts": found["lifts"]}
    fields = ("median_error", "ninety_error", "bias", "half_width", "covered")
    for which in ("unknowns", "measured"):
        read[which] = {
            name: {field: 100.0 * own[field] for field in fields}
            for name, own in found[which].items()
        }
    return read


def given(found: Any) -> dict[str, Any]:
    """Of lifts of others by kind, as `coverage`."""
    read: dict[str, Any] = {"usable": found["usable"], "lifts": found["lifts"]}
    for kind in ("rope", "cloth"):
        read[kind] = {name: percent(own) for name, own in found[kind].items()}
    return read


def percent(own: Any) -> dict[str, float]:
    names = ("lifts", "median_error", "ninety_error", "covered", "ecdf_p")
    return {n: own[n] * (1.0 if n == "lifts" else 100.0) for n in names if n in own}


def sbc(found: Any) -> dict[str, Any]:
    """Of unknowns, errors of transformed ones and p of uniform ranks [%]."""
    own = {name: percent(c) for name, c in found["unknowns"].items()}
    usable = sum(row.get("verdict", {}).get("usable", False) for row in found["rows"])
    return {"lifts": found["lifts"], "usable": usable, **own}


def npe(found: Any) -> dict[str, Any]:
    """Rows by unknown and by who answers, and what it took."""
    read: dict[str, Any] = {"took": found["took"], "lifts": found["lifts"]}
    learning = found["took"]["learning"]
    read["took"]["learning"] = {f"{n} lifts": seconds for n, seconds in learning.items()}
    for row, own in found["rows"].items():
        name, who = row.split(", ")
        read.setdefault(name, {})[who] = {n.split()[-1]: value for n, value in own.items()}
    return read


def verdicts(found: Any) -> dict[str, Any]:
    cases = list(found["cases"].values())
    said = {name: sum(c[name] for c in cases) for name in ("refused", "right", "wrong")}
    usable = [{c: a["right"] for c, a in row.items() if a["usable"]} for row in found["rows"]]
    own = [list(row.values()).count(False) for row in usable if row.get("as recorded") is False]
    return {"lifts": found["lifts"], "cases": sum(said.values()), **said, "own": sum(own)}


def rope(found: Any) -> dict[str, Any]:
    names = ("chamfer_last", "chamfer_mean", "chamfer_last_registered", "chamfer_mean_registered")
    return {
        "bending": found["bending_length"],
        "interval": found["intervals"]["bending_length"],
        "chamfer": [1e3 * found[name] for name in names],
    }


def wire(found: Any) -> dict[str, Any]:
    values = [found["bending_stiffness"], *found["intervals"]["bending_stiffness"]]
    return {"EI": [1e4 * x for x in values]}


def elastica(found: Any) -> dict[str, Any]:
    return {"EI": 1e4 * found["EI"]}


def cables(rows: Any) -> dict[str, Any]:
    """Least and largest error by cable, and of DEFORM's evaluation."""
    by_name: dict[str, list[float]] = {}
    for row in rows:
        name = row["to"].split("_")[1]
        for own in (name, *([f"{name}, eval"] if "eval" in row["to"] else [])):
            by_name.setdefault(own, []).append(1e3 * row["error"])
    return {name: [min(e), max(e)] for name, e in by_name.items()}


def demo(found: Any) -> dict[str, Any]:
    """Misses of three ropes' goals [mm] by way to act."""
    ways = {
        "with_parameters": "with the estimate",
        "without_parameters": "without parameters",
        "polished": "polished in the simulator",
        "after_one_execution": "after one execution",
    }
    return {
        way: [1e3 * of["runs"][name]["error"] for of in found["outcomes"]]
        for way, name in ways.items()
    }


def sim2sim(found: Any) -> dict[str, Any]:
    return {f"{r['method']}-{r['frames']}": r["E"] for r in found["rows"]}


def goals(found: Any) -> dict[str, Any]:
    """Mean and worst miss [mm] by way to act."""
    ways = {name: 1e3 * np.array(e) for name, e in found["misses"].items()}
    return {
        "goals": found["goals"],
        **{n: [float(e.mean()), float(e.max())] for n, e in ways.items()},
    }


def evaluated(found: Any) -> dict[str, Any]:
    return {
        "with" if p["conditioned_on"] else "without": 1e3 * p["error"]["mean"]
        for p in found["policies"]
    }


def cases(found: Any) -> dict[str, Any]:
    """Of cases of mechanics: how many rows, how many pass, and relative errors [%]."""
    rows = [row for case in found["cases"] for row in case["checks"]]
    off = [100.0 * r["error"] for r in rows if r["relative"]]
    passed = sum(r["passed"] for r in rows)
    return {"rows": len(rows), "passed": passed, "median": float(np.median(off)), "worst": max(off)}


def ratios(found: Any) -> dict[str, Any]:
    return {"ratios": [r["measured"] / r["expected"] for r in found["cases"][0]["checks"]]}


def resting(found: Any) -> dict[str, Any]:
    return {"largest": max(r["error"] for r in found["cases"][0]["checks"])}


def ring_down(found: Any) -> dict[str, Any]:
    """Only what is compared with theory, not the grid's own damping."""
    compared = [r for r in found["cases"][0]["checks"] if "rate" in r["quantity"]]
    return {"worst": 100.0 * max(r["error"] for r in compared)}


def two_realities(rows: Any) -> dict[str, Any]:
    """Count, mean and worst distance [mm], or in thousandths, by task."""
    read: dict[str, list[float]] = {}
    for row in rows:
        if row["steady"] and not any(row["faults"]):
            between = [row["ours"][n] - row["mujoco"][n] for n in row["ours"]]
            read.setdefault(row["task"], []).append(1e3 * float(np.linalg.norm(between)))
    return {task: [len(e), float(np.mean(e)), max(e)] for task, e in read.items()}


def sheets(rows: Any) -> dict[str, Any]:
    return {
        "mean": [min(r["mean"] for r in rows), max(r["mean"] for r in rows)],
        "worst": [min(r["worst"] for r in rows), max(r["worst"] for r in rows)],
    }


def jobs(found: Any) -> dict[str, Any]:
    """Seconds by job; of many ropes and cloths for 40,000 and 9,600."""
    read = {name.replace("-", "_"): job["seconds"] for name, job in found.items()}
    for name, whole in (("releases", 40_000), ("spreading", 9600)):
        if name in read:
            read[name] *= whole / int(found[name]["what"].split()[0])
    return read


def bench(rows: Any) -> dict[str, Any]:
    return {
        "speed": [1e-6 * r["point_steps_per_second"] for r in rows],
        "substep": [r["substep_us"] for r in rows],
        "gradient": [r["gradient_cost"] for r in rows if r["gradient_cost"]],
    }


def gradient(rows: Any) -> dict[str, Any]:
    """Cost, least and most in forward runs, of float32 and float64."""
    return {"cost": [[r["cost"], r["least"], r["most"]] for r in rows]}


def arm(found: Any) -> dict[str, Any]:
    """Of a lift, a cast, spreading and releases: times [s], shares of limits, slowing down."""
    beginnings = {"lift": "lift by 225 mm at 2 m", "cast": "cast", "spreading": "spreading"}
    return {
        name: {key: value for key, value in own.items() if "planning" not in key}
        for name, begins in {**beginnings, "releases": "40"}.items()
        for of, own in found.items()
        if of.startswith(begins)
    }


def seconds(found: Any) -> dict[str, Any]:
    return {"seconds": found["seconds"]}


# ---- commands ----------------------------------------------------------------------------------


def covered(name: str, words: str) -> Figure:
    command = f"python -m experiments coverage {words}"
    return Figure(f"coverage-{name}", command, coverage, absolute=1.0, needs=("hours",))


def experiment(name: str, words: str, read: Reader, *needs: str) -> Figure:
    return Figure(
        name, f"python -m experiments {words}", read, relative=0.3, needs=(*needs, "hours")
    )


def reached(name: str) -> Figure:
    command = f"python benchmarks/goals.py rope-{name} --jobs 16"
    return Figure(name, command, goals, relative=0.3, absolute=0.3, needs=("hours",))


def validation(name: str, read: Reader, words: str = "") -> Figure:
    command = f"python -m validation {words or '--only ' + name}"
    return Figure(name, command, read, relative=0.2, absolute=1e-4)


def dataset(name: str, words: str, *needs: str) -> Figure:
    return TIMED(f"set-{name}", f"gendom dataset {words} --out set", seconds, needs=needs)


TIMED = partial(Figure, relative=MACHINE)
REAL = partial(Figure, needs=("recordings",))
ON_CUDA = partial(TIMED, needs=("cuda",))
WIRE = "benchmarks/recordings/wire_white_loop.npz"

FIGURES = (
    covered("rope", "--lifts 30 --seed 400 --measured"),
    covered("wide", "--wide --lifts 20 --seed 400 --measured"),
    covered("cloth", "--kind cloth --lifts 15 --seed 1060"),
    *(
        covered(unlike, f"--lifts 16 --seed 400 --unlike {unlike}")
        for unlike in ("soft-5", "soft-10", "soft-20", "tip-5", "tip-15", "thick", "thin", "2-hz")
    ),
    Figure(
        "coverage-given", "python -m experiments coverage --given lifts", given,
        absolute=1.0, needs=("hours",),
    ),
    experiment("sbc", "sbc --lifts 200 --seed 111", sbc),
    experiment("sbc-cloth", "sbc --kind cloth --lifts 60 --seed 100", sbc),
    experiment("npe", "npe --scale full --lifts 60 --jobs 12 --device cuda", npe, "cuda"),
    experiment("verdict", "verdict --lifts 3 --seed 2000", verdicts),
    experiment("verdict-wide", "verdict --wide --lifts 2 --seed 2000", verdicts),
    experiment("verdict-thin", "verdict --kind thin --lifts 1 --seed 2000", verdicts),
    experiment("verdict-cloth", "verdict --kind cloth --lifts 1 --seed 2000", verdicts),
    Figure("demo", "gendom demo", demo, relative=0.3, absolute=0.3),
    REAL("rope-red", "gendom estimate rope_red_lift.npz --starts 1 --seed 0", rope),
    REAL(
        "cables",
        "python benchmarks/cables.py cable_dlo1_train_048.npz cable_dlo1_eval_054.npz "
        "cable_dlo3_train_001.npz cable_dlo3_train_002.npz cable_dlo3_train_006.npz "
        "cable_dlo3_train_011.npz cable_dlo3_eval_004.npz cable_dlo3_eval_010.npz "
        "cable_dlo4_train_001.npz cable_dlo4_eval_035.npz",
        cables,
    ),
    Figure("wire", f"gendom estimate {WIRE}", wire),
    Figure("wire-elastica", f"python benchmarks/wire.py {WIRE}", elastica),
    Figure(
        "sim2sim", "python -m experiments sim2sim --scale full --method gauss-newton pointnet",
        sim2sim, relative=MACHINE,
    ),
    reached("reaching"),
    reached("casting"),
    Figure("evaluate-casting", "gendom evaluate rope-casting --cases 50 --seed 3", evaluated),
    Figure("evaluate-reaching", "gendom evaluate rope-reaching --cases 50 --seed 3", evaluated),
    validation("cantilever", ratios),
    validation("torsion", cases),
    validation("ring-down", ring_down),
    validation("resting", resting),
    validation("mechanics", cases, "--engine thin"),
    Figure("two-realities", "python benchmarks/two_realities.py", two_realities, absolute=0.1),
    Figure(
        "sheet-lifts",
        "python benchmarks/sheet_lifts.py cloth-rubber-200mm cloth-cotton-200mm --drawn 3",
        sheets,
    ),
    TIMED("thin", "python benchmarks/thin.py --cpu-time", jobs),
    ON_CUDA(
        "thin-cuda", "python benchmarks/thin.py --device cuda --worlds 40000 --sheets 960", jobs
    ),
    TIMED(
        "bench",
        "gendom bench --engine mpm --worlds 1 --threads 1 --dtype float32 float64",
        bench,
    ),
    ON_CUDA(
        "bench-cuda",
        "gendom bench --engine mpm --device cuda --worlds 1024 --seconds 0.2 --gradient",
        bench,
    ),
    Figure("arm", "python benchmarks/arm.py", arm),
    TIMED("gradient", "python benchmarks/gradient.py", gradient),
    dataset("reaching", "rope-reaching --size 40000 --device cuda", "cuda"),
    dataset("casting", "rope-casting --size 20000 --device cuda", "cuda"),
    dataset("spreading", "cloth-spreading --size 9600 --device cuda", "cuda"),
    dataset("cpu", "rope-reaching --size 4000"),
)  # fmt: skip
