"""Tasks: a scene, an action with its limits, and the goal that a rollout reaches."""

from gendom.tasks.base import Outcomes, Task
from gendom.tasks.rope_reaching import ReachingOutcome, RopeReaching

TASKS: dict[str, type[RopeReaching]] = {RopeReaching.name: RopeReaching}
"""Task classes by name; `TASKS[name](**settings)` rebuilds the task of a set of demonstrations."""

__all__ = ["TASKS", "Outcomes", "ReachingOutcome", "RopeReaching", "Task"]
