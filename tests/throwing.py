"""A source of demonstrations that takes no time, in place of a simulation."""

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gendom.datasets.demonstrations import Outcomes


@dataclass(frozen=True, kw_only=True)
class Throwing:
    """Throw a ball: it lands at speed^2 / gravity. Throws of more than 9 m/s fail."""

    gravity: float = 9.81
    cost: float = 1.0
    thrown: list = field(default_factory=list, compare=False)
    """Batches simulated, by their speeds."""
    stop_at: int | None = None
    """Interrupted in this batch."""
    fault: type[Exception] | None = None
    """What every batch raises."""
    dies_once: str | None = None
    """The first worker to make this file is killed."""

    def about(self):
        return {"task": {"name": "throwing", "gravity": self.gravity}, "units": ["m/s"]}

    def draw(self, rngs):
        drawn = np.array([[rng.uniform(0.0, 10.0), rng.uniform(1.0, 2.0)] for rng in rngs])
        return {"speed": drawn[:, 0], "mass": drawn[:, 1]}

    def demonstrate(self, draws, *, device, on_frame=None):
        if len(self.thrown) == self.stop_at:
            raise KeyboardInterrupt
        if self.fault is not None:
            raise self.fault("the ball is flat")
        if self.dies_once is not None and not Path(self.dies_once).exists():
            Path(self.dies_once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        speed = draws["speed"]
        self.thrown.append(speed)
        failed = speed > 9.0
        goal = np.where(failed, np.nan, speed**2 / self.gravity)
        faults = tuple("flew away" if bad else None for bad in failed)
        return Outcomes(columns={"goal_x": goal}, faults=faults)

    @property
    def count(self):
        return sum(map(len, self.thrown))
