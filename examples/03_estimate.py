"""Estimate a rope's parameters from one recorded lift, with a report (about 15 s).

    python examples/03_estimate.py --out result
    python examples/03_estimate.py --recording mine/lift.npz --out result

Without --recording it takes the lift that comes with the package. One start of the search is
enough for a first look; the default of `gendom estimate` is three.
"""

import tempfile
from importlib import resources
from pathlib import Path

import tyro

from gendom import Estimate
from gendom.cli import main as gendom


def main(recording: Path | None = None, out: Path | None = None, starts: int = 1) -> None:
    """Write estimate.json and report.html, and use the estimate from Python.

    Args:
        recording: A gendom-recording/1 file; by default the demo's.
        out: Folder to write to; by default a new temporary one.
        starts: Number of starts of the search.
    """
    out = Path(tempfile.mkdtemp(prefix="gendom-")) if out is None else out
    if recording is None:
        recording = Path(str(resources.files("gendom"))) / "assets" / "demo-rope-lift.npz"
    words = ["estimate", str(recording), "--starts", str(starts), "--seed", "0"]
    code = gendom([*words, "--out", str(out), "--report", str(out / "report.html")])
    if code == 3:
        raise SystemExit("the recording cannot be used; the reasons are above and in the report")
    if code:
        raise SystemExit(code)

    found = Estimate.load(out / "estimate.json")
    print("\nE in Pa, with the ends of its 90 % interval:")
    print(found.E, found.interval("E"))
    determined = [name for name, known in found.record["identifiable"].items() if known]
    print("what this lift determines:", ", ".join(determined))
    print("E / density of four plausible ropes:")
    print([round(rope.material.E_over_rho) for rope in found.draws(4, seed=0)])


if __name__ == "__main__":
    tyro.cli(main)
