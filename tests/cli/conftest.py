"""A simulator that takes no time."""

import numpy as np
import pytest

from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation


@pytest.fixture
def quick(monkeypatch):
    """A world that reaches twice as far as the release; every fifth demonstration fails."""

    def carry_out(self, task, items, actions, **_):
        if self.device == "ctrl-c":
            raise KeyboardInterrupt
        return [
            Outcome(values={"x": 2.0 * a[0], "sideways": 0.0}, fault=None if k % 5 else "diverged")
            for k, a in enumerate(np.asarray(actions))
        ]

    monkeypatch.setattr(Simulation, "carry_out", carry_out)
