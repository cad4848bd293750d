"""Tasks in the MuJoCo test scene (the second reality) as Gymnasium environments: one for each, such
as ``gendom/RopeReaching-v0``, those of other packages included (docs/reality.md has the table).

A step is one action carried out to its end, and ends the episode. Actions, goals and limits are
those of `gendom.tasks`, in the task's frame.

Observation: a dictionary of float32.

    goal         [G] as the task's goals; absent where it has none
    sizes        [2] a rope's length and diameter, a cloth's side and thickness [m]
    parameters   [5] E / density [m^2/s^2], nu [-], damping [s], friction [-], density [kg/m^3]:
                 only if asked for, see `TaskEnv`

Reward: minus the task's error, the distance of what was reached from the goal; of a task without
goals, the first of its outcomes (spreading: the share that lies spread). What the arm refuses (a
place out of its reach, a collision) is not carried out and earns `REFUSED`, less than anything
that is; a learner that minds its size is given clipped rewards.

info of a step, beside the task's outcome by name:

    action       what was carried out: one that the task does not allow is moved into its limits
    reached      [G] as the goal; NaN if refused
    refused      why the arm refused (then only this, action and reached are there), or None
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from gendom.arguments import check_numbers, require
from gendom.arrays import Array
from gendom.errors import DeviceError, ParameterError, RobotError, SimulationError
from gendom.installation import how_to_install
from gendom.materials import LARGEST, QUANTITIES, to_columns
from gendom.reality.object_file import find_object
from gendom.reality.objects import OBJECTS, RealObject
from gendom.reality.trials import RealWorld, observe
from gendom.tasks import Task, find_task
from gendom.tasks.cases import draw_cases

try:
    import gymnasium
except ImportError:
    where, fix = "gendom.reality.envs", how_to_install("reality")
    raise DeviceError("Gymnasium is not installed", where=where, fix=fix) from None

Observation = dict[str, npt.NDArray[np.float32]]

REFUSED = -100.0
"""Reward of an action that the arm refuses: worse than that of any miss. Observed goals and sizes
are within 10 m, so no rope's end comes to lie so far from its goal."""


class TaskEnv(gymnasium.Env[Any, Any]):
    """One task in the MuJoCo test scene.

    Args:
        task: Its name, or the task itself.
        objects: Names of objects (or the objects themselves), one of which is drawn at each reset;
            by default all of the task's kind.
        parameters: Whether observations hold the object's parameters, or those that `reset` is
            given in their place.
        robot: True: the xArm 7 acts; False: a free hand, about twice as quick.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: There is no such task or object, or the object is of another kind.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}
    action_space: gymnasium.spaces.Box
    observation_space: gymnasium.spaces.Dict

    def __init__(
        self,
        task: str | Task,
        *,
        objects: Sequence[str | RealObject] | None = None,
        parameters: bool = False,
        robot: bool = True,
    ):
        self.task = find_task(task)() if isinstance(task, str) else task
        own = [item for item in OBJECTS.values() if item.kind == self.task.kind]
        self.objects = [self._find(item) for item in (own if objects is None else objects)]
        require(self.objects, "is empty", where="objects", fix="name one at least")
        self.world = RealWorld(robot=robot)
        box = gymnasium.spaces.Box
        limits = np.array([self.task.limits(item) for item in self.objects])
        low, high = limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)
        self.action_space = box(low, high, dtype=np.float64)
        spaces: dict[str, gymnasium.Space[Any]] = {"sizes": box(0.0, LARGEST, (2,))}
        if self.task.goals:
            spaces["goal"] = box(-10.0, 10.0, (len(self.task.goals),))
        if parameters:
            ends = np.array([[0.0, -1.0, 0.0, 0.0, 0.0], [1e9, 0.5, 1e3, 1e2, 1e6]], np.float32)
            spaces["parameters"] = box(*ends)
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self._item: RealObject | None = None
        self._seen: dict[str, Array] = {}

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Choose an object and a goal.

        Args:
            seed: Of the objects and goals to come.
            options: "object": name or object, "goal": [G], "parameters": [5] to be seen, e.g. an
                estimate; what is not given is drawn, or true. A goal is drawn by simulating an
                action that is drawn, with this object: it can be reached. Where the task names a
                risk the action keeps to its limit.

        Returns:
            The observation, and {"object": its name}.

        Raises:
            ParameterError: An option is unknown or out of its range, or no goal can be drawn.
        """
        super().reset(seed=seed)
        given, rng, spaces = dict(options or {}), self.np_random, self.observation_space.spaces
        drawn = self.objects[int(rng.integers(len(self.objects)))]
        drawn_seed = int(rng.integers(2**63))  # object and options do not change later draws
        item = self._find(given.pop("object", drawn))
        for name in given:
            there, fix = name in {*spaces} - {"sizes"}, "have object, goal and, if seen, parameters"
            require(there, f"there is no option {name!r} here", where="reset", fix=fix)
        if self.task.goals and "goal" not in given:
            try:
                given["goal"] = draw_cases(self.task, 1, seed=drawn_seed, items=[item]).goal[0]
            except SimulationError as error:
                fix = "give option goal"
                raise ParameterError(error.what, where="reset", fix=fix) from None
        columns = to_columns(item)
        seen = {
            "sizes": [getattr(item, name) for name in item.sizes],
            "parameters": [columns[name] for name in QUANTITIES],
            **given,
        }
        found = {
            name: check_numbers(f"option {name}", np.atleast_1d(seen[name]), space.shape or ())
            for name, space in spaces.items()
        }
        for name, value in found.items():
            within = value.astype(np.float32) in spaces[name]
            fix = f"keep to {spaces[name]}"
            require(within, f"is {value.tolist()}", where=f"option {name}", fix=fix)
        self._item, self._seen = item, found
        return self._observe(), {"object": item.name}

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry an action out to its end, from the start; see the top of this module.

        Args:
            action: [A]; one that the task does not allow for this object is moved to the nearest.

        Returns:
            observation, reward, True, False, info.

        Raises:
            ParameterError: `reset` was not called, or the action is not finite or of another
                shape.
            SimulationError: The world diverged.
        """
        task, item = self.task, self._item
        if item is None:
            raise ParameterError("there is no object yet", where="step", fix="call reset first")
        asked = check_numbers("action", np.atleast_1d(action), (len(task.actions),))
        info: dict[str, Any] = {"action": task.nearest(item, asked), "refused": None}
        try:
            run = self.world.begin(task, item, info["action"])
        except RobotError as error:
            info |= {"reached": np.full(len(task.goals), np.nan), "refused": str(error)}
            return self._observe(), REFUSED, True, False, info
        values = task.outcome(item, observe(task, run))
        reward = next(iter(values.values()))
        info = values | info | {"reached": np.array([values[q.name] for q in task.goals])}
        if task.goals:
            reward = -task.error(item, self._seen["goal"], values)
        return self._observe(), float(reward), True, False, info

    def _observe(self) -> Observation:
        return {name: value.astype(np.float32) for name, value in self._seen.items()}

    def _find(self, item: str | RealObject) -> RealObject:
        found = find_object(item) if isinstance(item, str) else item
        mine = [name for name, other in OBJECTS.items() if other.kind == self.task.kind]
        what, fix = f"{found.name} is none of this task", f"choose {', '.join(mine)}"
        require(found.kind == self.task.kind, what, where="object", fix=fix)
        return found
