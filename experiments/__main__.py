"""`python -m experiments TABLE`: make a table, print it, and write it with its figures."""

from __future__ import annotations

import argparse
import logging
import shlex
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from experiments.runs import Runs
from gendom.errors import GendomError
from gendom.files import check_folder
from gendom.installation import how_to_install

TABLES = {
    "sim2sim": "errors of estimators on simulated lifts with exact clouds",
    "real2sim": "three ropes and two cloths of the MuJoCo test scene, each lifted once and "
    "estimated by every method; Chamfer distances beside the paper's",
    "ablation": "policies that see both parameters, one or none, on goals of random ropes",
    "generalization": "the default policy and R2S2R on the paper's three ropes and on softer ones",
    "rope-real": "three ropes of the MuJoCo test scene, each lifted once; policies, baselines, "
    "polished and adapted actions, carried out by the arm",
    "planning": "the same lifts: actions of the policy, polished, and by CMA-ES in the simulator "
    "at equal simulator time, in our simulator and carried out by the arm; and by `adapt` and "
    "iterative learning from execution to execution",
    "wiggle": "networks from a lift's clouds to parameters, then CMA-ES, or straight to actions",
    "cloth-real": "six cloths of that scene, or drawn ones, each lifted once, then spread or "
    "dragged by the policy, with parameters from the lift, with true ones and without",
    "coverage": "random objects of that scene are lifted, recorded and estimated: errors, share of "
    "shipped intervals that hold the truth, refused lifts; a lift takes about a minute on a core",
    "sbc": "simulation-based calibration: ranks of truths that are drawn from the priors, in the "
    "posteriors of lifts of our own simulator, with tests of that; four seconds a rope",
    "npe": "a neural posterior of the library sbi, trained on such lifts of one rope, beside the "
    "estimator's on others: errors, coverage, seconds and simulations",
    "two-hands": "random ropes between two hands of that scene, as markers and as clouds: errors, "
    "intervals and the error of another motion; two minutes a rope",
    "verdict": "the same lifts, each recording corrupted in 48 ways, and what estimates say: "
    "refused, right or wrong; a lift of a rope takes about five minutes on a core",
    "calibration": "random pictures of a board with one fault each: refused, or true and stated "
    "errors of the camera's pose; a third of a second a set",
}

UNLIKE = ("soft-5", "soft-10", "soft-20", "tip-5", "tip-15", "thick", "thin", "2-hz")
"""Of lifts, see `experiments.lifts`."""

FIRST_REPORTED = 1000
"""Seed of the first lift whose interval is reported: those below are for calibrations."""


def parser() -> argparse.ArgumentParser:
    """The flags of all tables."""
    every = argparse.ArgumentParser(
        prog="python -m experiments",
        description="Make one of the paper's tables, or measure estimates. Results in --out are "
        "kept, so an interrupted table continues. Tables of policies need the extra train, charts "
        "the extra docs.",
        epilog="\n".join(f"{name}: {about}." for name, about in TABLES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = every.add_argument
    add("table", choices=TABLES)
    add(
        "--scale",
        choices=("small", "full"),
        default="small",
        help="small: minutes on two cores; full: the paper's counts and more, for a GPU",
    )
    add(
        "--task",
        choices=("rope-reaching", "rope-casting", "cloth-spreading", "cloth-dragging"),
        help="of ablation, generalization, planning, rope-real and wiggle (default: "
        "rope-reaching), and of cloth-real (cloth-spreading)",
    )
    add(
        "--method",
        nargs="*",
        default=(),
        choices=("gauss-newton", "adam", "differential-evolution", "pointnet"),
        help="of sim2sim and real2sim: only these rows; by default all, but of sim2sim not "
        "differential-evolution",
    )
    add(
        "--rows",
        nargs="*",
        default=(),
        choices=("inverse", "distal", "refined"),
        help="of ablation: only policies that are trained so, on all demonstrations",
    )
    add(
        "--objects",
        nargs="*",
        default=(),
        help="of real2sim and cloth-real: only these, by the names of gendom record --reality",
    )
    add(
        "--engine",
        choices=("thin", "mpm"),
        default="thin",
        help="of sim2sim, ablation and generalization; mpm: the paper's, slower",
    )
    add(
        "--kind",
        choices=("rope", "thin", "cloth"),
        default="rope",
        help="of coverage, verdict and sbc: what is lifted; thin: ropes of 3 to 8 mm",
    )
    add(
        "--wide",
        action="store_true",
        help="of coverage and verdict: objects of nearly all sizes and materials",
    )
    add(
        "--measured",
        action="store_true",
        help="of coverage: also with sizes, mass and clamp that are wrong as people measure "
        "(1 mm, thickness 3 %%, mass 1 %%)",
    )
    add(
        "--unlike",
        choices=UNLIKE,
        help="of coverage: ropes that turn in soft fingers by 5 to 20 degrees, have 5 or 15 %% of "
        "their mass at the tip, a diameter that is stated 5 %% off, or two frames a second",
    )
    add(
        "--given",
        type=Path,
        metavar="FOLDER",
        help="of coverage: recordings NAME.npz of others, with the truth in NAME.json (E, "
        "bending_length, damping, friction, nu, in SI units, as far as they are known)",
    )
    add(
        "--calibrate",
        action="store_true",
        help="of coverage: without calibration, and write the factors of one; of sbc: without",
    )
    add(
        "--end",
        choices=("hold", "swing", "drop"),
        default="hold",
        help="of coverage, verdict and sbc: how lifts end",
    )
    add(
        "--lifts",
        type=int,
        default=40,
        help="of coverage, verdict, calibration, sbc, two-hands and npe: how many",
    )
    add(
        "--drawn",
        type=int,
        default=0,
        help="of cloth-real: so many cloths of the task's ranges in place of named ones",
    )
    add(
        "--acted",
        type=int,
        help="of planning: goals that the arm acts for (default: small 3, full all of 201)",
    )
    add("--jobs", type=int, default=2, help="processes of the MuJoCo test scene and of training")
    add(
        "--out",
        type=Path,
        help="folder that keeps all that a table is made from (default: its name)",
    )
    add(
        "--seed",
        type=int,
        help=f"of all random draws (default: 0; {FIRST_REPORTED} for coverage without --calibrate)",
    )
    add("--device", default="cpu", help="cpu, cuda or cuda:0 and so on")
    add("--json", action="store_true", help="print JSON")
    return every  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Make a table; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    flags = parser().parse_args(words)
    if flags.seed is None:
        reported = flags.table == "coverage" and not flags.calibrate
        flags.seed = FIRST_REPORTED if reported else 0
    kind = "cloth" if flags.table == "cloth-real" else "rope"
    flags.task = flags.task or {"cloth": "cloth-spreading", "rope": "rope-reaching"}[kind]
    if not flags.task.startswith(kind):
        parser().error(f"{flags.table} takes tasks of a {kind}, not {flags.task}")
    counts = [n for n in (flags.lifts, flags.jobs, flags.acted) if n is not None]
    if min(counts) < 1 or min(flags.seed, flags.drawn) < 0:
        parser().error(
            "--lifts, --jobs and --acted must be at least 1, --seed and --drawn at least 0"
        )
    logging.basicConfig(format="%(message)s")
    logging.getLogger("experiments").setLevel(logging.INFO)
    folder = flags.out or Path(flags.table)
    runs = Runs(folder=folder, device=flags.device, jobs=flags.jobs, seed=flags.seed)
    began = time.monotonic()
    try:
        check_folder(folder)
        module = import_module(f"experiments.{flags.table.replace('-', '_')}")
        result = module.run(runs, flags)
        about = {"table": flags.table, "scale": flags.scale, "seed": flags.seed}
        seconds = {"seconds": time.monotonic() - began}
        command = f"python -m experiments {shlex.join(words)}"
        runs.publish(result, about, seconds, command=command, json=flags.json)
    except GendomError as error:
        print(f"experiments {flags.table}: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        extra = {"mujoco": "reality", "matplotlib": "docs"}.get(error.name or "", "train")
        how = "pip install sbi" if error.name == "sbi" else how_to_install(extra)
        said = f"needs {error.name}; install it with: {how}"
        print(f"experiments {flags.table}: {said}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
