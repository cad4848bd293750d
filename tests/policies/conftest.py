"""A stand-in for the trained network, whose answers are known in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from gendom.materials import PARAMETERS, Material, Rope, dimensionless_parameters, size_of
from gendom.policies import Column, Description, GoalRange, Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import RopeReaching
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation


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


# ---- a task solved in closed form: a thrown stone whose reach depends on E and damping -----------

TASK = RopeReaching().of_one_size()
ROPE = Rope(
    length=0.3, diameter=0.016, material=Material(E=8e5, nu=0.3, density=900.0, damping=0.004)
)


def reach_of(x, z, E, damping):
    """In rope lengths: grows with x and z, and the more with E and the less with damping."""
    return 1.1 + 0.5 * x + (0.6 * np.log(E / 0.4) - 6.0 * (damping - 0.02)) * z


@dataclass(frozen=True, kw_only=True)
class Throws(Simulation):
    """`reach_of` in place of a simulation."""

    off: float = 0.0
    """Added to each reach [lengths]."""
    risky_above: float = 9.0
    """Releases higher than this leave their plane [lengths]."""
    fails: bool = False

    def carry_out(self, task, items, actions, **_):
        outcomes = []
        for item, (x, z) in zip(items, np.asarray(actions), strict=True):
            L, alike = size_of(item), dimensionless_parameters(item)
            reached = reach_of(x / L, z / L, alike["bending_ratio"], alike["damping"]) + self.off
            values = {"x": L * reached, "sideways": 0.0 if z < self.risky_above * L else 0.1 * L}
            outcomes.append(
                Outcome(values={}, fault="it burst") if self.fails else Outcome(values=values)
            )
        return outcomes
