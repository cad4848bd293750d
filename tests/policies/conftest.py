"""A stand-in for the trained network, whose answers are known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gendom.materials import PARAMETERS
from gendom.policies import Column, Description, GoalRange, Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import RopeReaching


class FakeSession:
    """Releases on a line; keeps what it was fed."""

    def __init__(self):
        self.fed: dict[str, np.ndarray] = {}
        self.offset = 0.0
        self.answer: Any = None
        """In place of the release; an exception is raised."""

    def run(self, names, feed):
        self.fed = {name: value.copy() for name, value in feed.items()}
        if isinstance(self.answer, Exception):
            raise self.answer
        if self.answer is not None:
            return [np.array(self.answer, np.float32)]
        goal = feed["goal_x"]
        stiffness = np.log(feed.get("bending_ratio", np.full_like(goal, 0.4)) / 0.4)
        x = 0.6 - 0.3 * (goal - 1.4) + 0.02 * stiffness + self.offset
        return [np.concatenate([x, np.full_like(goal, 0.4)], axis=1).astype(np.float32)]


def describe(conditioned_on=("bending_ratio", "nu"), **changes) -> Description:
    """A description of a policy for rope reaching."""
    goal = Column(name="goal_x", mean=1.4, scale=0.1)
    fields = {
        "task": {"name": "rope-reaching", **RopeReaching().settings()},
        "method": "distal",
        "conditioned_on": tuple(conditioned_on),
        "inputs": (goal, *(Column(name=n, mean=0, scale=1) for n in conditioned_on)),
        "outputs": tuple(Column(name=n, mean=0.5, scale=0.2) for n in ("release_x", "release_z")),
        "goals": GoalRange(at=(0.3, 0.5), low=((1.2,), (1.1,)), high=((1.8,), (1.6,))),
        "parameters": {
            **dict.fromkeys(PARAMETERS, (0.001, 10.0)),
            "bending_ratio": (0.25, 0.7),
            "nu": (0.2, 0.4),
        },
        "training": {"seed": 3},
    }
    return Description(**(fields | changes))


def demonstrations(task, action, goal, parameters, risk=None) -> Demonstrations:
    """Of a task: actions [N, A], goals [N, G], and parameters [N] by name, 1 where not given."""
    return Demonstrations(
        task={"name": task.name, **task.settings()},
        action_names=tuple(q.name for q in task.actions),
        goal_names=tuple(q.name for q in task.goals),
        goal=np.reshape(goal, (len(action), -1)),
        action=np.reshape(action, (len(action), -1)),
        parameters=dict.fromkeys(PARAMETERS, np.ones(len(action))) | parameters,
        risk=risk,
    )


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
