"""A stand-in for the trained network, whose answers are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from gendom.policies import Column, Description, GoalRange, Policy


class FakeSession:
    """Releases on a line; keeps what it was fed."""

    def __init__(self):
        self.fed: dict[str, np.ndarray] = {}
        self.offset = 0.0

    def run(self, names, feed):
        self.fed = {name: value.copy() for name, value in feed.items()}
        goal = feed["goal"]
        stiffness = np.log(feed.get("specific_modulus", np.full_like(goal, 1000.0)) / 1000.0)
        x = 0.6 - 0.3 * (goal - 1.4) + 0.02 * stiffness + self.offset
        return [np.concatenate([x, np.full_like(goal, 0.5)], axis=1).astype(np.float32)]


def describe(conditioned_on=("specific_modulus", "poissons_ratio"), **changes) -> Description:
    """A description of a policy for the standard rope."""
    goal = Column(name="goal", unit="rope length", mean=1.4, scale=0.1)
    fields = {
        "task": {"name": "rope-reaching", "length": 0.25, "diameter": 0.014, "gravity": 9.81},
        "method": "distal",
        "conditioned_on": tuple(conditioned_on),
        "inputs": (goal, *(Column(name=n, unit="", mean=0, scale=1) for n in conditioned_on)),
        "outputs": tuple(
            Column(name=n, unit="rope length", mean=0.5, scale=0.2)
            for n in ("release_x", "release_z")
        ),
        "goals": GoalRange(at=(400.0, 1600.0), low=(1.2, 1.1), high=(1.8, 1.6)),
        "parameters": {"specific_modulus": (200.0, 4000.0), "poissons_ratio": (0.2, 0.4)},
        "training": {"seed": 3},
    }
    return Description(**(fields | changes))


@pytest.fixture
def make_policy():
    """Build a policy around a `FakeSession`; returns both."""

    def make(**changes) -> tuple[Policy, FakeSession]:
        session = FakeSession()
        return Policy(session, describe(**changes), where="fake.onnx"), session

    return make


@pytest.fixture
def description() -> Description:
    return describe()
