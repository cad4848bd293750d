"""What a data set costs beside its simulation: seconds of Python and NumPy on one core.

    python benchmarks/host.py --task rope-reaching --size 40000

The kernel that advances rods and shells is replaced by a made-up motion: what is left draws objects
and actions, makes paths and worlds, evaluates outcomes, and writes the shards, as on a GPU.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from gendom.datasets import demonstrations
from gendom.datasets.demonstrations import SHARD_SIZE, generate
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.run import Run
from gendom.tasks import find_task
from gendom.tasks.demonstrator import Demonstrator


def made_up(run, group):
    """A tip that swings forth and rises; a cloth with waves of different heights."""
    x = run.x.numpy()  # [T, W, P, 3]
    T, W, P, _ = x.shape
    time, world = np.linspace(0.0, 1.0, T)[:, None, None], np.linspace(0.0, 1.0, W)[:, None]
    if P == 1:
        x[..., 0] = 0.05 + 0.35 * np.sin(2.0 * time) + 0.08 * world
        x[..., 1] = 0.001 * time
        x[..., 2] = 0.1 * time * (1.3 - time) + 0.02 * world
        return
    side = np.linspace(0.0, 0.2, int(np.sqrt(P)))
    along, across = (axis.ravel() for axis in np.meshgrid(side, side, indexing="ij"))
    x[..., 0], x[..., 1] = along, across
    x[..., 2] = 0.001 + 0.03 * world * np.abs(np.sin(40.0 * along))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="rope-reaching")
    parser.add_argument("--size", type=int, default=40000)
    given = parser.parse_args()
    setattr(Run, "launch", made_up)  # noqa: B010
    # in batches as large as on a GPU
    most = demonstrations._MOST_TOGETHER
    demonstrations._count_together = lambda kind, shard_size, left, places: most
    ThinEngine.groups = lambda self, most=0, least=1: [slice(0, self.num_worlds)]
    source = Demonstrator(task=find_task(given.task)())
    with tempfile.TemporaryDirectory() as folder:
        for size in (64, given.size):  # the first one compiles
            began = time.process_time()
            generate(source, size, Path(folder) / str(size), seed=0, shard_size=SHARD_SIZE["cuda"])
    print(f"{given.task}, {given.size}: {time.process_time() - began:.1f} s")


if __name__ == "__main__":
    main()
