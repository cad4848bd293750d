"""The three tasks in the second reality as Gymnasium environments.

    gendom/RopeReaching-v0     release point (x, z) [m]     goal: farthest x of the tip [m]
    gendom/RopeCasting-v0      way of the hand [m]          goal: the tip's highest point [m]
    gendom/ClothSpreading-v0   the paper's acceleration A   goal: extended ratio

Importing `gendom.reality` registers them; `gymnasium.make("gendom.reality:gendom/RopeReaching-v0")`
does both. A step is one action carried out to its end, and ends the episode.

Observation: a dictionary of float32. `metadata["units"]` has the units too, by the same names, and
those of the action.

    goal         [1] farthest x [m]; [2] way along the cast and height [m]; [1] extended ratio [-]
    sizes        [2] a rope's length and diameter, a cloth's side and thickness [m]
    parameters   [2] E / density [m^2/s^2] and nu [-]: only if asked for, see `TaskEnv`

Reward: minus the distance of what was reached from the goal [m]; of spreading, the extended ratio.
What the arm refuses (a place out of its reach, a collision) is not carried out and earns `REFUSED`,
less than anything that is.

info of a step:

    action       what was carried out: rope reaching moves a release point into its limits
    reached      as the goal; NaN if refused
    sideways     largest distance of a rope's tip from the plane of its motion [m]
    slowed_by    how much longer the arm took than the task asks for
    deviation    largest distance of the arm's path from the ideal one at equal times [m]
    refused      why the arm refused (then only this, action and reached are there), or None

A simulation that diverges raises `SimulationError`: it says nothing about the action.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from gendom.errors import DeviceError, ParameterError, RobotError
from gendom.reality.objects import OBJECTS, RealCloth, RealObject, RealRope, find_object
from gendom.reality.scene import default_cameras, looking_at
from gendom.reality.trials import (
    CAST_PLACE,
    START,
    TASK_ORIGIN,
    Performance,
    Trial,
    carry_out_casting,
    carry_out_reaching,
    carry_out_spreading,
    casting,
    reaching,
    reaching_task,
    spreading,
)
from gendom.robot.motions import LARGEST_PAPER_A
from gendom.tasks.rope_reaching import RELEASE_DISTANCE, RELEASE_X, RELEASE_Z

try:
    import gymnasium
except ImportError:
    raise DeviceError(
        "Gymnasium is not installed",
        where="gendom.reality.envs",
        fix="pip install 'gendom[reality]'",
    ) from None

Array = npt.NDArray[np.float64]
Observation = dict[str, npt.NDArray[np.float32]]

REFUSED = -1.0
"""Reward of an action that the arm refuses."""

REACHING_GOALS = (1.2, 1.75)
"""Range in which goals of rope reaching are drawn [rope lengths]."""

CAST_ACTIONS = (0.1, 0.25)
"""Range of casts [m]: a shorter one may throw the tip higher on its way back."""

CAST_GOALS = ((0.22, 0.18), (0.31, 0.21), (0.39, 0.235), (0.45, 0.25))
"""Highest points of the tip [m] that goals of casting are drawn between: about what a polyester
rope does for casts of 0.1, 0.15, 0.2 and 0.25 m."""

SPREAD_GOAL = 0.75
"""Extended ratio that the paper asks for."""

FRAME_RATE = 10
"""Of a video of initial and final pictures [1/s]."""


def _metadata(action: Sequence[str], goal: Sequence[str]) -> dict[str, Any]:
    """A task's, with the units of its action and goal."""
    units = {"goal": tuple(goal), "sizes": ("m", "m"), "parameters": ("m^2/s^2", "1")}
    return {
        "render_modes": ["rgb_array"],
        "render_fps": FRAME_RATE,
        "units": {**units, "action": tuple(action)},
    }


class TaskEnv(gymnasium.Env[Any, Any]):
    """One task of the second reality.

    Args:
        objects: Names of objects, one of which is drawn at each reset; by default all of the
            task's kind.
        parameters: Whether observations hold the object's parameters, or those that `reset` is
            given in their place.
        robot: True: the xArm 7 acts; False: a free hand, about twice as quick.
        render_mode: None or "rgb_array".

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: There is no such object or render mode, or the object is of another kind.
    """

    metadata: ClassVar[dict[str, Any]] = _metadata(action=(), goal=())
    action_space: gymnasium.spaces.Box
    observation_space: gymnasium.spaces.Dict
    kind: ClassVar[type]
    goal_size: ClassVar[int] = 1
    looks_at: ClassVar[tuple[float, float, float]]
    """[m]; in the middle of what `render` shows."""
    seen_from: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 0.3)
    """Where its camera is from there [m]: ropes swing across, in front of the arm."""

    def __init__(
        self,
        *,
        objects: Sequence[str] | None = None,
        parameters: bool = False,
        robot: bool = True,
        render_mode: str | None = None,
    ):
        if objects is None:
            objects = [name for name, item in OBJECTS.items() if isinstance(item, self.kind)]
        self.objects = [self._find(name) for name in objects]
        if not self.objects:
            raise ParameterError("is empty", where="objects", fix="name one at least")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ParameterError(
                f"is {render_mode!r}", where="render_mode", fix="give 'rgb_array' or None"
            )
        self.render_mode = render_mode
        self.robot = robot
        box = gymnasium.spaces.Box
        low, high = np.array([self.action_limits(item) for item in self.objects]).T
        self.action_space = box(low.min(axis=-1), high.max(axis=-1), dtype=np.float64)
        spaces: dict[str, gymnasium.Space[Any]] = {
            "goal": box(-10.0, 10.0, (self.goal_size,)),
            "sizes": box(0.0, 10.0, (2,)),
        }
        if parameters:
            spaces["parameters"] = box(
                np.array([0.0, -1.0], np.float32), np.array([1e9, 0.5], np.float32)
            )
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self._item: Any = None
        self._goal = np.zeros(self.goal_size)
        self._parameters = np.zeros(2)
        self._performance: Performance | None = None

    # ---- what a task is --------------------------------------------------------------------------

    def action_limits(self, item: Any) -> list[tuple[float, float]]:
        """Lowest and highest value of each component of the action for an object."""
        raise NotImplementedError

    def draw_goal(self, item: Any, rng: np.random.Generator) -> Array:
        """A goal within what the object can reach."""
        raise NotImplementedError

    def allowed(self, item: Any, action: Array) -> Array:
        """The action to carry out instead of one that is in the limits."""
        return action

    def trial(self, item: Any, action: Array) -> Trial:
        """The motion."""
        raise NotImplementedError

    def carry_out(self, performance: Performance) -> tuple[Array, float | None]:
        """What is reached, and how far the tip leaves its plane [m]."""
        raise NotImplementedError

    def reward(self, reached: Array) -> float:
        """Of what was reached."""
        return -float(np.linalg.norm(self._goal - reached))

    # ---- Gymnasium -------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Take an object and a goal.

        Args:
            seed: Of the objects and goals to come.
            options: "object": name, "goal": see above, "parameters": (E / density [m^2/s^2],
                nu) to be seen, e.g. an estimate; what is not given is drawn, or true.

        Returns:
            The observation, and {"object": its name}.

        Raises:
            ParameterError: An option is unknown or out of its range.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        rng = self.np_random
        drawn = self.objects[int(rng.integers(len(self.objects)))]
        item = self._find(given.pop("object")) if "object" in given else drawn
        goal = self.draw_goal(item, rng)
        if "goal" in given:
            goal = _numbers(given.pop("goal"), self.goal_size, "goal")
        material = item.material
        shown = np.array([material.specific_modulus, material.nu])
        if "parameters" in given:
            if "parameters" not in self.observation_space.spaces:
                raise ParameterError(
                    "are not observed",
                    where="option parameters",
                    fix="make it with parameters=True",
                )
            shown = _numbers(given.pop("parameters"), 2, "parameters")
        if given:
            raise ParameterError(
                f"there is no option {next(iter(given))!r}",
                where="reset",
                fix="have object, goal and parameters",
            )
        self._forget()
        self._item, self._goal, self._parameters = item, goal, shown
        observation = self._observe()
        for name, space in self.observation_space.spaces.items():
            if observation[name] not in space:
                raise ParameterError(
                    f"is {observation[name].tolist()}",
                    where=f"option {name}",
                    fix=f"keep to {space}",
                )
        return observation, {"object": item.name}

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry an action out to its end, from the start; see the top of this module.

        Args:
            action: Values beyond the action space are clipped to it.

        Returns:
            observation, reward, True, False, info.

        Raises:
            ParameterError: `reset` was not called, or the action is not finite or of another
                shape.
            SimulationError: The world diverged.
        """
        item = self._require_item()
        space = self.action_space
        values = _numbers(action, len(space.low), "action")
        values = self.allowed(item, np.clip(values, space.low, space.high))
        info: dict[str, Any] = {"action": values, "refused": None}
        self._forget()
        try:
            self._performance = self._perform(values)
        except RobotError as error:
            info |= {"reached": np.full(self.goal_size, np.nan), "refused": str(error)}
            return self._observe(), REFUSED, True, False, info
        reached, sideways = self.carry_out(self._performance)
        deviation = self._performance.deviation
        info |= {
            "reached": reached,
            "slowed_by": self._performance.slowed_by,
            "deviation": 0.0 if deviation is None else deviation.at_equal_times,
        }
        if sideways is not None:
            info["sideways"] = sideways
        return self._observe(), self.reward(reached), True, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """[480, 640, 3] the scene as it is now, from one camera; None without a render mode.

        Before the first step the arm stands where an action from the middle of the space begins.

        Raises:
            DeviceError: Nothing can be rendered here; says which packages bring what is missing.
        """
        if self.render_mode is None:
            return None
        self._require_item()
        if self._performance is None:
            space = self.action_space
            middle = self.allowed(self._item, np.mean([space.low, space.high], axis=0))
            self._performance = self._perform(middle)
        return self._performance.world.render(0)[1]

    def close(self) -> None:
        """Give the renderer's memory back."""
        self._forget()

    # ---- inside ----------------------------------------------------------------------------------

    def _find(self, name: str) -> RealObject:
        item = find_object(name)
        if not isinstance(item, self.kind):
            mine = [n for n, other in OBJECTS.items() if isinstance(other, self.kind)]
            raise ParameterError(
                f"{name} is none of this task", where="object", fix=f"choose {', '.join(mine)}"
            )
        return item

    def _perform(self, action: Array) -> Performance:
        cameras = []
        if self.render_mode is not None:
            position = np.add(self.looks_at, self.seen_from)
            cameras = [default_cameras()[0].at(looking_at(position, self.looks_at))]
        return Performance(self.trial(self._item, action), robot=self.robot, cameras=cameras)

    def _observe(self) -> Observation:
        item = self._item
        rope = isinstance(item, RealRope)
        sizes = (item.length, item.diameter) if rope else (item.side, item.thickness)
        known = {"goal": self._goal, "sizes": sizes, "parameters": self._parameters}
        spaces = self.observation_space.spaces
        return {name: np.array(known[name], dtype=np.float32) for name in spaces}

    def _require_item(self) -> Any:
        if self._item is None:
            raise ParameterError("there is no object yet", where="step", fix="call reset first")
        return self._item

    def _forget(self) -> None:
        if self._performance is not None:
            self._performance.world.close()
            self._performance = None


class RopeReachingEnv(TaskEnv):
    """Rope reaching; release points [m] and goals [m] in the task's frame (`reaching_task`).

    The task's release points are no box: one that is too near to the rope's top or too far from
    it is moved straight away from it or towards it, to the nearest that is allowed. All points
    of the box come into the limits so.
    """

    metadata = _metadata(action=("m", "m"), goal=("m",))
    kind = RealRope
    looks_at = (TASK_ORIGIN[0], -0.05, 0.3)

    def action_limits(self, item: RealRope) -> list[tuple[float, float]]:
        return [(low * item.length, high * item.length) for low, high in (RELEASE_X, RELEASE_Z)]

    def allowed(self, item: RealRope, action: Array) -> Array:
        top = reaching_task(item).top[[0, 2]]
        away = action - top
        distance = np.linalg.norm(away)
        near, far = np.array(RELEASE_DISTANCE) * item.length
        if near <= distance <= far:
            return action
        return top + away * (np.clip(distance, near, far) / distance)

    def draw_goal(self, item: RealRope, rng: np.random.Generator) -> Array:
        return rng.uniform(*REACHING_GOALS, size=1) * item.length

    def trial(self, item: RealRope, action: Array) -> Trial:
        return reaching(item, action)

    def carry_out(self, performance: Performance) -> tuple[Array, float | None]:
        outcome = carry_out_reaching(performance)
        return np.array([outcome.reached]), outcome.sideways


class RopeCastingEnv(TaskEnv):
    """Rope casting; the action is how far the hand moves [m], the goal where the tip is highest:
    along the cast from where it hung, and above the table [m]."""

    metadata = _metadata(action=("m",), goal=("m", "m"))
    kind = RealRope
    goal_size = 2
    looks_at = (CAST_PLACE[0], 0.0, 0.3)

    def action_limits(self, item: RealRope) -> list[tuple[float, float]]:
        return [CAST_ACTIONS]

    def draw_goal(self, item: RealRope, rng: np.random.Generator) -> Array:
        knots = np.array(CAST_GOALS)
        at = rng.uniform(0.0, len(knots) - 1.0)
        return np.array([np.interp(at, np.arange(len(knots)), column) for column in knots.T])

    def trial(self, item: RealRope, action: Array) -> Trial:
        return casting(item, float(action[0]))

    def carry_out(self, performance: Performance) -> tuple[Array, float | None]:
        outcome = carry_out_casting(performance)
        return outcome.highest, float(np.abs(outcome.vertices[:, -1, 0] - CAST_PLACE[0]).max())


class ClothSpreadingEnv(TaskEnv):
    """Cloth spreading; the action is the paper's acceleration A [-], at most `LARGEST_PAPER_A`.

    The reward is the extended ratio [-], whatever the goal, which is `SPREAD_GOAL` if not given.
    """

    metadata = _metadata(action=("1",), goal=("1",))
    kind = RealCloth
    looks_at = (START + 0.15, 0.0, 0.1)
    seen_from = (0.4, 0.6, 0.5)

    def action_limits(self, item: RealCloth) -> list[tuple[float, float]]:
        return [(0.0, LARGEST_PAPER_A)]

    def draw_goal(self, item: RealCloth, rng: np.random.Generator) -> Array:
        return np.array([SPREAD_GOAL])

    def trial(self, item: RealCloth, action: Array) -> Trial:
        return spreading(item, float(action[0]))

    def carry_out(self, performance: Performance) -> tuple[Array, float | None]:
        return np.array([carry_out_spreading(performance).ratio]), None

    def reward(self, reached: Array) -> float:
        return float(reached[0])


def _numbers(value: Any, count: int, name: str) -> Array:
    """`count` finite numbers; one may come alone."""
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ParameterError(
            f"is {value}", where=name, fix=f"give {count} finite number{'s' * (count > 1)}"
        )
    return numbers
