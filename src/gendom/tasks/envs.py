"""Tasks step by step in our simulator, as Gymnasium environments, many worlds side by side.

    envs = gymnasium.make_vec("gendom.environments:gendom/RopeReachingSteps-v0", num_envs=64)

``RopeReachingSteps``, ``RopeCastingSteps``, ``ClothSpreadingSteps``, ``ClothDraggingSteps``: each
has the task's scene, time and outcome, in its frame. An episode takes `STEPS` steps; all worlds end
at once and begin again with the next step (`AutoresetMode.NEXT_STEP`).

Action, each from -1 to 1: speed of the tool along the task's x and z, in `FASTEST`; and of tasks
that let go, whether the tool holds on (above 0). Once open it stays so. A tool that holds what a
stand holds, too, goes no farther from that than it was.

Observation [D], in units of similarity (lengths over the object's size L, speeds over sqrt(g L)):
`MARKERS` points of the object, evenly spaced, and their velocities, the tool's place, whether it
holds, the share of time that is left, the goal; and with ``parameters=True`` the object's
parameters as networks see them (`gendom.materials.QUANTITIES`, logarithms where ratios count).
All objects are as thick as the task's own.

Reward: 0 until the last step, then minus the distance of what was reached from the goal, over L;
of a task without goals the first of its outcomes. A world that diverges earns `DIVERGED`.

With ``cloud=N`` N points of the object's surface stand in place of the markers and velocities,
drawn anew in every step, in no order: what cameras would give that see it from everywhere.

info: ``parameters`` [W, 5] always; in the last step ``reached`` [W, G], NaN where a world diverged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from gendom.arguments import check_integers, require
from gendom.arrays import Array
from gendom.materials import QUANTITIES, Item, dimensionless_parameters, size_of, unit_of
from gendom.robot.path import TcpPaths
from gendom.sim import Simulator, Targets
from gendom.tasks import Task, find_task
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.task import numbers_of
from gendom.tasks.world import Simulation, judged, opening

STEPS = 40
"""Of an episode."""

LOOKS = 2
"""Times in a step at which the object is looked at."""

FASTEST = 2.0
"""Speed of the tool [sqrt(g L)]."""

MARKERS = 9
"""Points that are observed."""

BANK = 256
"""Objects and goals that episodes draw from, at least; a goal is what an action reaches."""

DIVERGED = -10.0


class StepsVectorEnv(VectorEnv[Any, Any, Any]):
    """W worlds of one task.

    Args:
        task: Its name, or the task itself.
        num_envs: W.
        parameters: Whether observations hold the object's parameters.
        cloud: Number of points of a cloud that is observed in place of markers; 0: markers.
        device: ``cpu``, ``cuda`` or ``cuda:0`` and so on.
        threads: Of the CPU (default: one a core).

    Raises:
        ParameterError: There is no such task, or W is below 1.
        DeviceError: The device is not there.
    """

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        task: str | Task,
        num_envs: int = 1,
        *,
        parameters: bool = False,
        cloud: int = 0,
        device: str = "cpu",
        threads: int | None = None,
    ):
        check_integers("num_envs", num_envs, (), least=1)
        check_integers("cloud", cloud, (), least=0)
        self.cloud = cloud
        task = find_task(task)() if isinstance(task, str) else task
        self.task = task.of_one_size()
        self.num_envs, self.sees_parameters = num_envs, parameters
        self.world = Simulation(device=device, threads=threads)
        path = self._path(self.task.item)
        self.lets_go = math.isfinite(opening(path.events))
        size = (3 * cloud or 6 * MARKERS) + 5 + len(self.task.goals) + 5 * parameters
        box = gymnasium.spaces.Box
        self.single_observation_space = box(-np.inf, np.inf, (size,), np.float32)
        self.single_action_space = box(-1.0, 1.0, (2 + self.lets_go,), np.float32)
        batched = gymnasium.vector.utils.batch_space
        self.observation_space = batched(self.single_observation_space, num_envs)
        self.action_space = batched(self.single_action_space, num_envs)
        self._bank: Cases | None = None
        self._step = STEPS
        self._simulator: Simulator | None = None

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin episodes with drawn objects and goals; ``seed`` is that of all further draws."""
        if seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(seed)
            self._bank = None
        require(not options, "there are no options", where="reset", fix="leave them out")
        return self._begin(), {"parameters": self.parameters.copy()}

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Lead all worlds for one step; where episodes have ended they begin again.

        Raises:
            ParameterError: ``reset`` was not called, or actions [W, A] are of another shape or not
                finite.
        """
        require(self._simulator is not None, "no episode has begun", where="step",
                fix="call reset first")  # fmt: skip
        W, never = self.num_envs, np.zeros(self.num_envs, dtype=bool)
        wanted = np.asarray(actions, dtype=float)
        shape = (W, 2 + self.lets_go)
        fits = wanted.shape == shape and bool(np.isfinite(wanted).all())
        require(fits, f"must be finite numbers {list(shape)}", where="actions")
        if self._step == STEPS:
            seen = self._begin()
            return seen, np.zeros(W), never, never, {"parameters": self.parameters.copy()}
        self._act(np.clip(wanted, -1.0, 1.0))
        info: dict[str, Any] = {"parameters": self.parameters.copy()}
        done, reward = never, np.zeros(W)
        if self._step == STEPS:
            done = ~never
            reward, info["reached"] = self._judged()
        return self._observed(), reward, done, never, info

    # ---- inside ----------------------------------------------------------------------------------

    def _path(self, item: Item) -> Any:
        """The tool's path for an action in the middle of the limits: only where it begins, and
        whether it lets go, count."""
        task = self.task
        return task.tool_path(item, task.nearest(item, task.limits(item).mean(axis=1)))

    def _drawn(self) -> tuple[list[Item], Array]:
        """Objects and goals for W worlds."""
        rng, count = self.np_random, max(BANK, self.num_envs)
        if self._bank is None:
            seed = int(rng.integers(2**63))
            self._bank = draw_cases(self.task, count, seed=seed, simulation=self.world)
        rows = rng.integers(count, size=self.num_envs)
        return [self._bank.items[k] for k in rows], self._bank.goal[rows]

    def _begin(self) -> NDArray[np.float32]:
        self.items, self.goals = self._drawn()
        task, item = self.task, self.items[0]
        scene, path = task.scene(item), self._path(item)
        paths = TcpPaths([path] * self.num_envs)
        begin, ends = float(paths.moves.min()), float(task.times(item)[-1])
        self._dt = (ends - begin) / STEPS
        simulator, self.body = self.world.simulator(task, self.items, paths, begin)
        self._simulator = simulator
        self._still = [np.asarray(scene.origin, dtype=float)] if scene.stand > 0.0 else []
        self._tool = np.tile(path.position_at([begin])[0], (self.num_envs, 1))
        self._reach = max(
            [float(np.linalg.norm(self._tool[0] - x)) for x in self._still], default=0.0
        )
        self._holds = np.ones(self.num_envs, dtype=bool)
        self._opened = np.full(self.num_envs, np.inf)
        self._step = 0
        self._seen = [(begin, simulator.positions().astype(float), self._tool.copy())]
        own = [dimensionless_parameters(i) for i in self.items]
        seen = [[math.log(o[p.name]) if p.log else o[p.name] for p in QUANTITIES.values()]
                for o in own]  # fmt: skip
        self.parameters = np.array(seen)
        return self._observed()

    def _act(self, actions: Array) -> None:
        simulator, item = self._simulator, self.items[0]
        assert simulator is not None
        if self.lets_go:
            opens = self._holds & (actions[:, 2] <= 0.0)
            self._opened[opens] = simulator.time
            self._holds &= ~opens
        speed = FASTEST * unit_of("m/s", item) * actions[:, :2]
        for _ in range(LOOKS):
            self._tool[:, [0, 2]] += speed * self._dt / LOOKS
            stands = [np.tile(x, (self.num_envs, 1)) for x in self._still]
            for stand in stands:  # no farther than what both hold is long
                away = self._tool - stand
                far = np.linalg.norm(away, axis=1, keepdims=True)
                self._tool = stand + np.minimum(1.0, self._reach / np.maximum(far, 1e-9)) * away
            closed = np.stack([np.ones_like(self._holds)] * len(stands) + [self._holds], axis=1)
            position = np.stack([*stands, self._tool], axis=1)
            targets = Targets(position=position, closed=closed)
            simulator.step(self._dt / LOOKS, targets, keep_going=True)
            now = simulator.positions().astype(float)
            self._seen.append((simulator.time, now, self._tool.copy()))
        self._step += 1

    def _observed(self) -> NDArray[np.float32]:
        simulator, item = self._simulator, self.items[0]
        assert simulator is not None
        L, speed = size_of(item), unit_of("m/s", item)
        W = np.arange(self.num_envs)[:, None]
        if self.cloud:
            skin = self.body.surface(simulator.positions())
            drawn = self.np_random.integers(skin.shape[1], size=(self.num_envs, self.cloud))
            shape = [skin[W, drawn] / L]
        else:
            shown = np.linspace(0, simulator.num_points - 1, MARKERS).round().astype(int)
            shape = [simulator.positions()[:, shown] / L, simulator.velocities()[:, shown] / speed]
        left = np.full(self.num_envs, 1.0 - self._step / STEPS)
        units = self.task.goal_units(item) if self.task.goals else 1.0
        parts = [
            *(of.reshape(self.num_envs, -1) for of in shape),
            self._tool / L, self._holds[:, None], left[:, None], self.goals / units,
        ]  # fmt: skip
        if self.sees_parameters:
            parts.append(self.parameters)
        return np.nan_to_num(np.concatenate(parts, axis=1)).astype(np.float32)

    def _judged(self) -> tuple[Array, Array]:
        """Rewards [W], and what was reached [W, G]."""
        task, simulator = self.task, self._simulator
        times, x, hand = (np.array(values) for values in zip(*self._seen, strict=True))
        assert simulator is not None
        opens = np.minimum(self._opened, times[-1])
        hands = np.moveaxis(hand, 1, 0)
        found = judged(task, self.items, simulator, self.body, times, x, hands, opens)
        reward = np.nan_to_num(
            numbers_of(found, [*task.goals, *task.outcomes][:1])[:, 0], nan=DIVERGED
        )
        for w, (item, goal) in enumerate(zip(self.items, self.goals, strict=True)):
            if task.goals and found[w].fault is None:
                reward[w] = -task.error(item, goal, found[w].values) / size_of(item)
        return reward, numbers_of(found, task.goals)


class StepsEnv(gymnasium.Env[Any, Any]):
    """One world of a `StepsVectorEnv`, whose arguments it takes."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, task: str | Task, **settings: Any):
        self.many = StepsVectorEnv(task, 1, **settings)
        self.observation_space = self.many.single_observation_space
        self.action_space = self.many.single_action_space
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """As `StepsVectorEnv.reset`."""
        super().reset(seed=seed)
        seen, info = self.many.reset(seed=seed, options=options)
        self._over = False
        return seen[0], {name: value[0] for name, value in info.items()}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """As `StepsVectorEnv.step`.

        Raises:
            ParameterError: The episode is over, or as there.
        """
        require(not self._over, "the episode is over", where="step", fix="call reset first")
        seen, reward, done, _, info = self.many.step(np.asarray(action)[None])
        self._over = bool(done[0])
        info = {name: value[0] for name, value in info.items()}
        return seen[0], float(reward[0]), self._over, False, info
