"""Shells beside MuJoCo (the second reality): cloths lifted by a corner by a free hand, with the
parameters that they have there.

    python benchmarks/sheet_lifts.py [cloth-rubber-200mm ...] [--drawn 4] [--points 28]

Prints for each cloth the mean distance of MuJoCo's vertices from the shell's places that belong to
them, over the lift's frames, and the largest mean of a frame [mm]. Sheets there are softer in their
plane than their material is (`docs/reality.md`); the shell has that modulus (`Material.membrane`).
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from experiments.lifts import draw_object
from gendom.materials import AIR_DENSITY
from gendom.reality import find_object
from gendom.reality.model import softened
from gendom.reality.objects import RealCloth
from gendom.reality.trials import Trial, TrialRun, lift
from gendom.sim import Gripper, Physics, Simulator, Table, cloth

RATE = 30.0
"""Frames a second."""


def theirs(trial: Trial, times: np.ndarray, step: float | None) -> np.ndarray:
    """[T, V, 3] MuJoCo's vertices."""
    run = TrialRun(replace(trial, timestep=step or trial.timestep), robot=False)
    try:
        seen = []
        for moment in times:
            run.step_to(float(moment))
            seen.append(run.world.vertices())
        return np.array(seen)
    finally:
        run.world.close()


def ours(trial: Trial, times: np.ndarray, points: int, contact: bool) -> np.ndarray:
    """[T, V, 3] the shell's places of MuJoCo's vertices."""
    item, layout = trial.item, trial.layout
    assert isinstance(item, RealCloth)
    along_x, along_y, _ = np.asarray(layout.along, dtype=float)
    body = cloth(
        width=item.side, height=item.side, thickness=item.thickness, dx=item.side / 20.0,
        corner=layout.origin, yaw=float(np.arctan2(along_y, along_x)),
        points=(points, points),
    )  # fmt: skip
    knots = np.arange(0.0, trial.end + 0.01, 0.01)
    way = np.array([trial.path.position_at(t, trial.path.blend or 0.0) for t in knots])
    closes = next(e.time for e in trial.path.events if e.closed)
    hand = Gripper(time=knots, position=way, radius=trial.reach, hold_from=closes)
    m = item.material
    soft = type(m)(
        E=m.E, nu=m.nu, density=m.density, damping=m.damping, membrane=softened(item) * m.E
    )
    simulator = Simulator(
        body,
        [soft],
        grippers=[hand],
        table=Table(height=0.0, friction=item.friction),
        physics=Physics(air_density=AIR_DENSITY, self_contact=contact),
    )
    x = simulator.run(times)[:, 0].reshape(len(times), points, points, 3)
    ticks = np.linspace(0.0, 1.0, points)
    places = item.sheet[0][:, ::-1] / item.side
    return np.array([RegularGridInterpolator((ticks, ticks), frame)(places) for frame in x])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="*", default=["cloth-rubber-200mm"])
    parser.add_argument("--drawn", type=int, default=0, help="random cloths, too")
    parser.add_argument("--points", type=int, default=28, help="a side of the shell")
    parser.add_argument("--step", type=float, help="MuJoCo's [s]")
    parser.add_argument("--contact", action="store_true", help="the shell meets itself")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    items = [find_object(name) for name in given.objects]
    items += [draw_object("cloth", seed) for seed in range(given.drawn)]
    rows = []
    for item in items:
        trial = lift(item)
        times = np.arange(0.0, trial.end, 1.0 / RATE)
        began = time.perf_counter()
        there = theirs(trial, times, given.step)
        between = time.perf_counter()
        here = ours(trial, times, given.points, given.contact)
        seconds = between - began, time.perf_counter() - between
        far = 1e3 * np.linalg.norm(here - there, axis=2)
        worst = far.mean(axis=1)
        found = {"mean": float(far.mean()), "worst": float(worst.max())}
        rows.append({"object": item.name, **found})
        if given.json:
            continue
        print(
            f"{item.name:<20} mean {far.mean():.2f} mm, worst frame {worst.max():.2f} mm at "
            f"{times[worst.argmax()]:.2f} of {trial.end:.2f} s, end {worst[-1]:.2f} mm; "
            f"MuJoCo {seconds[0]:.1f} s, shell {seconds[1]:.1f} s",
            flush=True,
        )
    if given.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
