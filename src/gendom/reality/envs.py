"""Tasks in the MuJoCo test scene (the second reality) as Gymnasium environments.

    gendom/RopeReaching-v0          release point (x, z) [m]     goal: farthest x of the tip [m]
    gendom/RopeCasting-v0           way of the hand [m]          goal: the tip's highest point [m]
    gendom/RopeCastingAtSpeed-v0    and its speed [m/s]          the same
    gendom/ClothSpreading-v0        the paper's acceleration A   no goal but to be spread

and one for every task of other packages. Importing `gendom.reality` registers them;
`gymnasium.make("gendom.reality:gendom/RopeReaching-v0")` does both. A step is one action carried
out to its end, and ends the episode. Actions, goals and limits are those of `gendom.tasks`, in the
task's frame.

Observation: a dictionary of float32. `metadata["units"]` has the units too, by the same names, and
those of the action.

    goal         [G] as the task's goals; absent where it has none
    sizes        [2] a rope's length and diameter, a cloth's side and thickness [m]
    parameters   [5] E / density [m^2/s^2], nu [-], damping [s], friction [-], density [kg/m^3]:
                 only if asked for, see `TaskEnv`

Reward: minus the task's error, the distance of what was reached from the goal; of a task without
goals, the first of its outcomes (spreading: the share that lies spread). What the arm refuses (a
place out of its reach, a collision) is not carried out and earns `REFUSED`, less than anything
that is; a learner that minds its size is given clipped rewards.

info of a step:

    action       what was carried out: one that the task does not allow is moved into its limits
    reached      [G] as the goal; NaN if refused
    slowed_by    how much longer the arm took than the task asks for
    deviation    largest distance of the arm's path from the ideal one at equal times [m]
    refused      why the arm refused (then only this, action and reached are there), or None

and everything else that the task's outcome has, by name. A simulation that diverges raises
`SimulationError`: it says nothing about the action.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.errors import DeviceError, ParameterError, RobotError
from gendom.installation import how_to_install
from gendom.materials import LARGEST, PARAMETERS, size_of, to_columns, unit_of
from gendom.reality.model import default_cameras, looking_at
from gendom.reality.object_file import find_object
from gendom.reality.objects import OBJECTS, RealObject
from gendom.reality.trials import TrialRun, observe, task_trial
from gendom.tasks import Task, find_task
from gendom.tasks.world import Simulation

try:
    import gymnasium
except ImportError:
    raise DeviceError(
        "Gymnasium is not installed",
        where="gendom.reality.envs",
        fix=how_to_install("reality"),
    ) from None

Array = npt.NDArray[np.float64]
Observation = dict[str, npt.NDArray[np.float32]]

REFUSED = -100.0
"""Reward of an action that the arm refuses: worse than that of any miss. Observed goals and sizes
are within 10 m, so no rope's end comes to lie so far from its goal."""

ACTIONS_A_BATCH, MAX_BATCHES = 32, 8
"""Actions simulated in one batch, and the largest number of batches, to find a goal of a task with
a risk: a tenth of one rope's releases stay within its limit."""

CAMERA_OFFSETS = {"rope": (1.0, 0.0, 0.3), "cloth": (0.4, 0.6, 0.5)}
"""Where the camera of `render` is from the middle of the scene [m]: ropes swing across, in front of
the arm."""

FRAME_RATE = 10
"""Of a video of initial and final pictures [1/s]."""


class TaskEnv(gymnasium.Env[Any, Any]):
    """One task in the MuJoCo test scene.

    Args:
        task: Its name, or the task itself.
        objects: Names of objects (or the objects themselves), one of which is drawn at each reset;
            by default all of the task's kind.
        parameters: Whether observations hold the object's parameters, or those that `reset` is
            given in their place.
        robot: True: the xArm 7 acts; False: a free hand, about twice as quick.
        render_mode: None or "rgb_array".

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: There is no such task, object or render mode, or the object is of another
            kind.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": FRAME_RATE}
    action_space: gymnasium.spaces.Box
    observation_space: gymnasium.spaces.Dict

    def __init__(
        self,
        task: str | Task,
        *,
        objects: Sequence[str | RealObject] | None = None,
        parameters: bool = False,
        robot: bool = True,
        render_mode: str | None = None,
    ):
        self.task = find_task(task)() if isinstance(task, str) else task
        if objects is None:
            objects = [item for item in OBJECTS.values() if item.kind == self.task.kind]
        self.objects = [self._find(item) for item in objects]
        require(self.objects, "is empty", where="objects", fix="name one at least")
        known, fix = render_mode in (None, "rgb_array"), "give 'rgb_array' or None"
        require(known, f"is {render_mode!r}", where="render_mode", fix=fix)
        self.render_mode = render_mode
        self.robot = robot
        box = gymnasium.spaces.Box
        limits = np.array([self.task.limits(item) for item in self.objects])
        self.action_space = box(
            limits[..., 0].min(axis=0), limits[..., 1].max(axis=0), dtype=np.float64
        )
        spaces: dict[str, gymnasium.Space[Any]] = {"sizes": box(0.0, LARGEST, (2,))}
        units = {
            "sizes": ("m", "m"),
            "action": tuple(q.unit for q in self.task.actions),
            "goal": tuple(q.unit for q in self.task.goals),
            "parameters": tuple(p.unit for p in PARAMETERS.values()),
        }
        if self.task.goals:
            spaces["goal"] = box(-10.0, 10.0, (len(self.task.goals),))
        if parameters:
            low = np.array([0.0, -1.0, 0.0, 0.0, 0.0], np.float32)
            high = np.array([1e9, 0.5, 1e3, 1e2, 1e6], np.float32)
            spaces["parameters"] = box(low, high)
        # Gymnasium reads this from the instance, not from the class
        vars(self)["metadata"] = {**self.metadata, "units": units}
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self._item: Any = None
        self._goal = np.zeros(len(self.task.goals))
        self._parameters = np.zeros(len(PARAMETERS))
        self._run: TrialRun | None = None

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Choose an object and a goal.

        Args:
            seed: Of the objects and goals to come.
            options: "object": name or object, "goal": [G], "parameters": [5] to be seen, e.g. an
                estimate; what is not given is drawn, or true. A goal is drawn by simulating an
                action that is drawn, with this object: it can be reached. Where the task names a
                risk the action keeps to its limit, if any drawn does.

        Returns:
            The observation, and {"object": its name}.

        Raises:
            ParameterError: An option is unknown or out of its range.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        rng = self.np_random
        drawn = self.objects[int(rng.integers(len(self.objects)))]
        # a separate random stream: the object and given options do not change later draws
        actions = np.random.default_rng(int(rng.integers(2**63)))
        item = self._find(given.pop("object")) if "object" in given else drawn
        goal = self._goal_of(given.pop("goal", None), item, actions)
        parameters = self._parameters_of(given.pop("parameters", None), item)
        what = f"there is no option {next(iter(given), None)!r}"
        require(not given, what, where="reset", fix="have object, goal and parameters")
        self._end_run()
        self._item, self._goal, self._parameters = item, goal, parameters
        observation = self._observe()
        for name, space in self.observation_space.spaces.items():
            what = f"is {observation[name].tolist()}"
            within = observation[name] in space
            require(within, what, where=f"option {name}", fix=f"keep to {space}")
        return observation, {"object": item.name}

    def _goal_of(self, wanted: Any, item: RealObject, rng: np.random.Generator) -> Array:
        """The goal [G] that is asked for; None: one that can be reached."""
        count = len(self.task.goals)
        if wanted is None:
            return self._reachable(item, rng) if count else np.zeros(0)
        what = f"{self.task.name} has no goal"
        require(count or not np.size(wanted), what, where="option goal", fix="leave it out")
        return _numbers(wanted, count, "goal")

    def _parameters_of(self, wanted: Any, item: RealObject) -> Array:
        """The parameters [5] to be seen: those that are asked for, or the object's own."""
        if wanted is None:
            columns = to_columns(item)
            return np.array([columns[p.column] for p in PARAMETERS.values()])
        seen = "parameters" in self.observation_space.spaces
        fix = "make it with parameters=True"
        require(seen, "are not observed", where="option parameters", fix=fix)
        return _numbers(wanted, len(PARAMETERS), "parameters")

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
        task, item = self.task, self._require_item()
        wanted = task.nearest(item, _numbers(action, len(task.actions), "action"))
        self._end_run()
        info: dict[str, Any] = {"action": wanted, "refused": None}
        try:
            self._run = self._begin(wanted)
        except RobotError as error:
            info |= {"reached": np.full(len(task.goals), np.nan), "refused": str(error)}
            return self._observe(), REFUSED, True, False, info
        values = task.outcome(item, observe(task, self._run))
        reached = np.array([values[q.name] for q in task.goals])
        deviation = self._run.deviation
        info |= {name: value for name, value in values.items() if name not in info}
        info |= {
            "reached": reached,
            "slowed_by": self._run.slowed_by,
            "deviation": 0.0 if deviation is None else deviation.at_equal_times,
        }
        reward = (
            -task.error(item, self._goal, values) if task.goals else next(iter(values.values()))
        )
        return self._observe(), float(reward), True, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """[480, 640, 3] the scene as it is now, from one camera; None without a render mode.

        Before the first step the arm stands where an action from the middle of the space begins.

        Raises:
            DeviceError: Nothing can be rendered here; says which packages are missing.
        """
        if self.render_mode is None:
            return None
        item = self._require_item()
        if self._run is None:
            middle = np.mean([self.action_space.low, self.action_space.high], axis=0)
            self._run = self._begin(self.task.nearest(item, middle))
        return self._run.world.render(0)[1]

    def close(self) -> None:
        """Free the renderer's memory."""
        self._end_run()

    # ---- inside ----------------------------------------------------------------------------------

    def _find(self, item: str | RealObject) -> RealObject:
        found = find_object(item) if isinstance(item, str) else item
        mine = [name for name, other in OBJECTS.items() if other.kind == self.task.kind]
        what, fix = f"{found.name} is none of this task", f"choose {', '.join(mine)}"
        require(found.kind == self.task.kind, what, where="object", fix=fix)
        return found

    def _reachable(self, item: RealObject, rng: np.random.Generator) -> Array:
        """A goal [G] that one action reaches."""
        task, risk = self.task, self.task.risk
        fault, least, best = None, np.inf, None
        for _ in range(1 if risk is None else MAX_BATCHES):
            actions = task.sample_actions(item, rng, 1 if risk is None else ACTIONS_A_BATCH)
            for outcome in Simulation().carry_out(task, [item] * len(actions), actions):
                if outcome.fault is not None:
                    fault = outcome.fault
                    continue
                over = 0.0
                if risk is not None:
                    limit = risk.limit * unit_of(risk.unit, item)
                    over = max(0.0, outcome.values[risk.name] - limit)
                if over < least:
                    least, best = over, outcome
            if least == 0.0:
                break
        if best is None:
            what = f"no goal can be drawn ({fault})"
            raise ParameterError(what, where="reset", fix="give option goal")
        return np.array([best.values[q.name] for q in task.goals])

    def _begin(self, action: Array) -> TrialRun:
        cameras = []
        trial = task_trial(self.task, self._item, action)
        if self.render_mode is not None:
            middle = np.asarray(trial.layout.origin) + 0.5 * size_of(self._item) * np.asarray(
                trial.layout.along
            )
            position = middle + CAMERA_OFFSETS[self.task.kind]
            cameras = [default_cameras()[0].at(looking_at(position, middle))]
        return TrialRun(trial, robot=self.robot, cameras=cameras)

    def _observe(self) -> Observation:
        item = self._item
        known = {
            "goal": self._goal,
            "sizes": [getattr(item, name) for name in item.sizes],
            "parameters": self._parameters,
        }
        return {n: np.array(known[n], dtype=np.float32) for n in self.observation_space.spaces}

    def _require_item(self) -> Any:
        if self._item is None:
            raise ParameterError("there is no object yet", where="step", fix="call reset first")
        return self._item

    def _end_run(self) -> None:
        if self._run is not None:
            self._run.world.close()
            self._run = None


def _numbers(value: Any, count: int, name: str) -> Array:
    """`count` finite numbers; one may come alone."""
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        numbers = np.empty(0)
    good = numbers.shape == (count,) and np.isfinite(numbers).all()
    fix = f"give {count} finite number{'s' * (count > 1)}"
    require(good, f"is {value}", where=name, fix=fix)
    return numbers
