"""What spreads cloths: how quickly they are brought down, and from how high.

    python benchmarks/spreading.py --count 150 --device cuda

Drawn cloths (the ranges of `ClothSpreading`) are brought down by A in our simulator, for every step
time [sqrt(L / g)], height [sides] and largest acceleration of the tool [g] that is asked for. The
table: share of cloths that lie spread, of all and by quarters of their bending length, limp first;
and the mean share of a cloth that does.
"""

import argparse
import math
import time

import numpy as np

from gendom.materials import STANDARD_GRAVITY, dimensionless_parameters
from gendom.tasks import ClothSpreading
from gendom.tasks.cloth_spreading import SPREAD
from gendom.tasks.world import Simulation


def way_down(step_time: float, height: float, acceleration: float) -> ClothSpreading:
    """The task with another step time, height and largest acceleration."""
    steps, raised = step_time, height

    class WayDown(ClothSpreading):
        step_time = steps
        height = raised

        def tool_path(self, item, action):
            path = super().tool_path(item, action)
            limited = math.isfinite(acceleration)
            return path.gentle(acceleration * STANDARD_GRAVITY) if limited else path

    return WayDown()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--A", type=float, nargs="+", default=[0.0, 0.2, 0.65])
    parser.add_argument("--step-times", type=float, nargs="+", default=[0.28, 0.14, 0.07])
    parser.add_argument("--heights", type=float, nargs="+", default=[0.8])
    parser.add_argument("--accelerations", type=float, nargs="+", default=[math.inf])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=5)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    items = [ClothSpreading().draw_item(rng) for _ in range(given.count)]
    stiffness = np.array([dimensionless_parameters(item)["bending_ratio"] for item in items])
    quarter = np.searchsorted(np.quantile(stiffness, [0.25, 0.5, 0.75]), stiffness)
    print("step time  height  acceleration     A   spread  by quarters              share  time")
    for step_time in given.step_times:
        for height in given.heights:
            for acceleration in given.accelerations:
                task = way_down(step_time, height, acceleration)
                for A in given.A:
                    began = time.perf_counter()
                    actions = np.full((len(items), 1), A)
                    outcomes = Simulation(device=given.device).carry_out(task, items, actions)
                    share = np.array([o.values.get("share", math.nan) for o in outcomes])
                    done = share >= SPREAD
                    by = "  ".join(f"{done[quarter == k].mean():.2f}" for k in range(4))
                    print(
                        f"{step_time:9.2f}{height:8.1f}{acceleration:14.2f}{A:6.2f}"
                        f"{done.mean():9.2f}  {by}  {np.nanmean(share):9.2f}"
                        f"{time.perf_counter() - began:6.0f} s",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
