"""Base class of the thin engines of ``Simulator``: W worlds, their grippers and their runs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.errors import SimulationError
from gendom.sim.device import making
from gendom.sim.paths import make_path_type
from gendom.sim.setting import Frames, Setting, spread
from gendom.sim.thin.contact import fill_contact, loose
from gendom.sim.thin.grips import Grip, released
from gendom.sim.thin.poses import Paths, Pose
from gendom.sim.thin.run import Event, Job, Round, put_worlds
from gendom.sim.thin.schedule import Schedule, make_schedule
from gendom.sim.thin.slopes import Slopes
from gendom.sim.thin.stepping import make_stepping
from gendom.sim.thin.tears import LOCAL_STRETCH, STRETCH, Tear, find_tears
from gendom.sim.thin.types import V, X, make_types

CFL = 0.8
"""Default share of the longest stable step of small vibrations, of damped bodies and rods."""

SHORTEST_SUBSTEP = 1e-9
"""Below, the steps of two seconds outnumber their counter of 32 bits [s]."""

GROUP = 16
"""Maximum number of worlds that a CPU thread simulates at a time."""


class ThinEngine(ABC):
    """W thin bodies of one shape.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    kind: ClassVar[str]
    """Name of the kind of body in the kernels."""
    state_rows: ClassVar[int]
    state_bars: ClassVar[int]
    scratch_rows: ClassVar[int]
    scratch_bars: ClassVar[int]
    """Numbers of components of states, of derivatives by states, and of their scratch arrays."""
    lanes_on_cuda: ClassVar[int]
    undamped_cfl: ClassVar[float] = CFL
    """As ``CFL``, of worlds without damping."""
    stiffened: ClassVar[tuple[slice, ...]]
    """Components of the stiffness that change at a gripper's border, see ``Grip.stiffer``."""

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        self.check_suits(setting)
        s = setting
        self.setting = s
        W, n, G = len(s.materials), len(s.body.points), len(s.grippers[0])
        self.share = spread(s.stiffness, (W, n), "stiffness")
        self.longest = self.prepare(setting)
        self.num_worlds, self.num_points = W, n
        limits = np.broadcast_to(self.substeps(substep, cfl), W)
        self.setting = s = replace(setting, substep=limits)
        s.check_substep(
            SHORTEST_SUBSTEP, fix="a softer or denser material, fewer points, or a longer substep"
        )
        self.real = wp.float32 if s.dtype == "float32" else wp.float64
        self.types = make_types(self.real)
        self.kernels = make_stepping(self.real, self.kind)
        self.lanes = self.lanes_on_cuda if s.device.is_cuda else 1
        self.slots, self.row_length = self.layout()
        self.origin = np.array([0.0, 0.0, s.table.height if s.table is not None else 0.0])
        self.stacked = dict(s.grippers.arrays)
        self.stacked["position"] = self.stacked["position"] - self.origin
        self.paths = self._paths()
        self.closed = np.zeros((W, G), dtype=int)
        """[W, G] 0: not yet closed, 1: closed, 2: opened."""
        self.torn: dict[int, Tear] = {}
        """How grippers will pull worlds apart."""
        self.holds = np.zeros((W, G, n), dtype=np.int32)
        self.stiffer = np.ones((W, G, len(self.stiffened), n))
        self.body = self._body()
        self.state = self.zeros((W, self.state_rows, self.row_length))
        self.kept_state = self.zeros(self.state.shape)
        self.kept_time = np.full(W, s.start_time)
        self.failures: dict[int, SimulationError] = {}
        self.used = False
        self.last_dt = np.zeros(W)
        """[W] length of the last step [s]; 0 where velocities are those at the current time."""
        x = spread(np.asarray(s.positions, dtype=float) - self.origin, (W, n, 3), "positions")
        self.state.assign(self.first_state(x))
        if s.self_contact:
            # identical initial positions are checked once
            for one in x[: 1 if x.strides[0] == 0 else W]:
                self.check_apart(one)
        self.load("begin", "advance")
        self.launch(self.kernels.begin, slice(0, W), [self.body, self.state])

    def substeps(self, substep: float | None, cfl: float | None) -> Any:
        """Longest steps of each world [s], of a simulator's arguments."""
        damped = np.array([m.damping > 0.0 for m in self.setting.materials])
        return substep or (cfl or np.where(damped, CFL, self.undamped_cfl)) * self.longest

    # ---- defined by each kind of body ------------------------------------------------------------

    @staticmethod
    @abstractmethod
    def check_suits(setting: Setting) -> None:
        """Check that this engine can simulate the setting.

        Raises:
            ParameterError: If it cannot.
        """

    @abstractmethod
    def prepare(self, setting: Setting) -> NDArray[np.float64]:
        """Make the model and return the longest stable steps for small vibrations, [W] [s]."""

    @abstractmethod
    def layout(self) -> tuple[NDArray[np.int64], int]:
        """Positions of points in a row [n], and the length of a row."""

    @abstractmethod
    def fill(self, body: Any) -> None:
        """Set shape, stiffness and inertia of the kernels' body."""

    @abstractmethod
    def first_state(self, x: NDArray[np.floating]) -> NDArray[np.float64]:
        """State [W, ., P] at rest, with points [W, n, 3]."""

    @abstractmethod
    def between(self, g: NDArray[np.int64], h: NDArray[np.int64]) -> tuple[int, int, float]:
        """The points i of g [k] and j of h [l] that have least of the body at rest between them,
        and how much [m]; infinite where that is not known."""

    spacing: float
    """Largest distance between neighbouring points [m]."""
    per_mass: NDArray[np.float64]
    """[W, n] inverse masses of points [1/kg]."""

    @abstractmethod
    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None: ...

    @abstractmethod
    def check_apart(self, x: NDArray[np.floating]) -> None:
        """Check that the body does not intersect itself.

        Raises:
            ParameterError: If it does at points [n, 3].
        """

    @abstractmethod
    def close(self, g: int, worlds: NDArray[np.int64], pose: Pose, state: NDArray[Any]) -> Grip:
        """Determine the points held by gripper g, which closes in these worlds [k] now, with
        states [k, ., P]."""

    @abstractmethod
    def stiffen(self, body: Any, worlds: NDArray[np.int64]) -> None:
        """Copy the stiffness at the borders of grippers to the kernels' body."""

    @abstractmethod
    def parameters(self) -> tuple[str, ...]:
        """Parameters of this body's model beside E, nu and density."""

    @abstractmethod
    def slopes(self, name: str) -> Slopes:
        """Derivatives of the model by ``E``, ``nu``, ``density`` or one of ``parameters``."""

    @abstractmethod
    def tape(self, memory: float) -> Any:
        """Make the tape that records a run for its reverse pass."""

    # ---- state -----------------------------------------------------------------------------------

    def rows(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Arrange values [..., n] in rows [..., P]."""
        rows = np.zeros((*values.shape[:-1], self.row_length))
        rows[..., self.slots] = values
        return rows

    def component(self, which: slice, rows: Any = None) -> NDArray[np.float64]:
        """Components [W, n, k] of the state, or of other rows."""
        return self.pick(which, (self.state if rows is None else rows).numpy())

    def pick(self, which: slice, rows: NDArray[Any]) -> NDArray[np.float64]:
        """Components [k, n, .] of rows [k, ., P]."""
        return np.swapaxes(rows[:, which][..., self.slots], 1, 2).astype(float)

    def positions(self) -> NDArray[Any]:
        """Positions of points, [W, n, 3] [m]."""
        return (self.component(X) + self.origin).astype(self.setting.dtype)

    def velocities(self) -> NDArray[Any]:
        """Velocities of points, [W, n, 3] [m/s]; 0 for held points."""
        return self.component(V).astype(self.setting.dtype)

    def kept(self, *, last_good: bool) -> dict[str, NDArray[Any]]:
        """Return x [m], v [m/s] and all components of the state.

        With ``last_good`` they are those of the last valid state, and its time is added.
        """
        state = self.kept_state if last_good else self.state
        kept: dict[str, Any] = {
            "x": self.component(X, state) + self.origin,
            "v": self.component(V, state),
            "state": self.component(slice(0, self.state_rows), state),
        }
        if last_good:
            kept["time"] = self.kept_time
        return kept

    # ---- running ---------------------------------------------------------------------------------

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        self.run_rounds(frames, lambda group, round: None)

    def run_rounds(
        self,
        frames: Frames,
        after: Callable[[slice, Round], None],
        *,
        most_steps: int | None = None,
        kept: Any = None,
    ) -> Schedule:
        """Simulate, and call ``after`` for each group of worlds and each round between events.

        Args:
            frames: Frames to record.
            after: Called from the threads.
            most_steps: Maximum number of steps in a piece.
            kept: [S, W, ...] array that receives the states at the start of pieces; by default
                only the last one is kept.
        """
        self.used = True
        plan = self.schedule(frames, most_steps)
        job = Job(self, plan, frames, kept)
        groups = list(self.groups())

        def one(group: slice) -> None:
            for round in self._rounds(group, plan):
                job.advance(group, round)
                after(group, round)

        with ThreadPoolExecutor(max_workers=self.setting.threads) as pool:
            for done in [pool.submit(one, group) for group in groups]:
                done.result()
        job.finish()
        self.last_dt = self.ended(plan)
        if frames.on_frame is not None:
            frames.on_frame(len(frames.times))
        if self.failures and not frames.keep_going:
            raise self.failures[min(self.failures)]
        return plan

    def advance(self, job: Job, group: slice) -> None:
        """Take the steps of a group's pieces."""
        self.launch(
            self.kernels.advance,
            group,
            [
                self.body, self.paths, job.on_device, job.pieces, 0, 0, self.state, job.kept,
                job.every, LOCAL_STRETCH**2, STRETCH, job.stopped, job.stopped_at, job.x,
                job.points,
            ],
        )  # fmt: skip

    def end_error(self, w: int, time: float, dt: float) -> SimulationError:
        """What to say of a world that steps of dt [s] could not go on with."""
        return self.setting.error(
            w,
            time,
            f"the body is stretched or compressed by more than {100 * STRETCH:.0f} % in the "
            f"mean, or somewhere by more than {100 * LOCAL_STRETCH:.0f} %",
            where=f"substep {dt:.3g} s",
            fix="slower grippers or velocities, or a smaller substep",
        )

    def ended(self, plan: Schedule) -> NDArray[np.float64]:
        """Length of each world's last step [W] [s]; 0 if velocities are those at its end."""
        taken = plan.steps[:, -1] > 0
        return np.where(taken, plan.dt[:, -1], plan.before[:, -1])

    def groups(self) -> Iterator[slice]:
        """Groups of worlds that are launched together."""
        W = self.num_worlds
        size = W if self.lanes > 1 else max(1, min(GROUP, -(-W // self.setting.threads)))
        for first in range(0, W, size):
            yield slice(first, min(first + size, W))

    def schedule(self, frames: Frames, most_steps: int | None) -> Schedule:
        """Schedule of all worlds up to the last frame."""
        switches = [self.stacked["hold_from"], self.stacked["hold_until"]]
        switches = np.concatenate(switches, axis=1)
        return make_schedule(frames, switches, self.setting.substep, most_steps, self.last_dt)

    def _rounds(self, group: slice, plan: Schedule) -> Iterator[Round]:
        worlds = np.arange(group.start, group.stop)
        at = np.zeros(len(worlds), dtype=int)
        count = plan.count[worlds].copy()
        while (at < count).any():
            going = at < count
            now = plan.time(worlds, np.minimum(at, np.maximum(count - 1, 0)))
            events = self.switch(worlds[going], now[going])
            until = np.where(going, plan.until(group, at), at)
            pieces = np.stack([at, until], axis=1).astype(np.int32)
            yield Round(events, pieces)
            failed = [w - group.start for w in list(self.failures) if w in worlds]
            count[failed] = 0
            at = until

    # ---- grippers --------------------------------------------------------------------------------

    def switch(self, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> list[Event]:
        """Open and close the grippers of worlds [k] that do so at times [k]."""
        events, (begin, end) = [], (self.stacked[name] for name in ("hold_from", "hold_until"))
        for g in range(self.closed.shape[1]):
            opens = (self.closed[worlds, g] == 1) & (now >= end[worlds, g])
            if opens.any():
                events.append(self._open(g, worlds[opens], now[opens]))
        for g in range(self.closed.shape[1]):
            closes = (self.closed[worlds, g] == 0) & (now >= begin[worlds, g])
            closes &= now < end[worlds, g]
            if closes.any():
                events.append(self._close(g, worlds[closes], now[closes]))
        return events

    def _close(self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> Event:
        state = self.state.numpy()[worlds]
        pose = Paths(self.stacked).pose(g, worlds, now)
        given = (state, self.holds[worlds], self.stacked["radius"][worlds, g], *vars(pose).values())
        if all((values == values[:1]).all() for values in given):  # as worlds that begin alike
            first = Pose(*(values[:1] for values in vars(pose).values()))
            grip = self.close(g, worlds[:1], first, state[:1]).repeated(len(worlds))
        else:
            grip = self.close(g, worlds, pose, state)
        self.closed[worlds, g] = 1
        missed = grip.misses & (self.stacked["may_miss"][worlds, g] == 0)
        for k in np.flatnonzero(missed).tolist():
            w, centre = int(worlds[k]), pose.centre[k]
            far = np.linalg.norm(self.pick(X, state[k : k + 1])[0] - centre, axis=1).min()
            self.failures[w] = self.setting.error(
                w,
                float(now[k]),
                f"gripper {g} closed on nothing",
                where=f"it is at {(centre + self.origin).round(4).tolist()} m, its radius "
                f"{self.stacked['radius'][w, g]:.4g} m, the nearest point {far:.4g} m away",
                fix="move its path to the object, or give it may_miss=True",
            )
        self.holds[worlds, g] = grip.holds
        self.stiffer[worlds, g] = grip.stiffer
        put_worlds(self.body.place, worlds * self.closed.shape[1] + g, self.rows(grip.place))
        find_tears(self, g, worlds, now)
        self.hold(worlds)
        return Event(g, True, worlds, now, pose, grip, self.pick(X, state))

    def _open(self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> Event:
        rows = self.state.numpy()[worlds]
        x = self.pick(X, rows)
        pose = Paths(self.stacked).pose(g, worlds, now)
        grip = Grip(self.holds[worlds, g].copy(), np.empty(0), self.stiffer[worlds, g].copy(), ())
        for which, values in self.let_go(*released(x, pose, grip)):
            rows[:, which] += self.rows(np.swapaxes(values, 1, 2))
        put_worlds(self.state, worlds, rows)
        self.closed[worlds, g] = 2
        self.holds[worlds, g] = 0
        self.stiffer[worlds, g] = 1.0
        self.hold(worlds)
        return Event(g, False, worlds, now, pose, grip, x)

    def let_go(
        self, v: NDArray[np.floating], spin: NDArray[np.floating]
    ) -> list[tuple[slice, NDArray[np.floating]]]:
        """Components of the state that receive velocities and spins [W, n, 3] on release."""
        return [(V, v)]

    def hold(self, worlds: NDArray[np.int64]) -> None:
        """Copy the held points of worlds [k] to the kernels' body."""
        put_worlds(self.body.holds, worlds, self.holds[worlds])
        torn = [self.torn[w].time if w in self.torn else np.inf for w in worlds.tolist()]
        put_worlds(self.body.torn_from, worlds, np.array(torn))
        self.stiffen(self.body, worlds)
        if self.setting.self_contact:
            put_worlds(self.body.loose, worlds, loose(self, worlds))

    # ---- arrays ----------------------------------------------------------------------------------

    def array(self, values: Any, dtype: Any = None) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values), dtype=dtype or self.real, device=self.setting.device
        )

    def zeros(self, shape: Any, dtype: Any = None) -> wp.array:
        return wp.zeros(shape, dtype=dtype or self.real, device=self.setting.device)

    def load(self, *names: str) -> None:
        """Compile kernels, or load them from Warp's cache, before threads call them."""
        with making:
            for name in names:
                module = getattr(self.kernels, name).module
                wp.load_module(module, device=self.setting.device, block_dim=self.block)

    @property
    def block(self) -> int:
        """Number of threads in a CUDA block."""
        return self.lanes if self.lanes > 1 else 256

    def launch(self, kernel: Any, group: slice, inputs: list[Any]) -> None:
        """Launch a kernel with one block of threads for each world of the group."""
        wp.launch(
            kernel,
            dim=(group.stop - group.start) * self.lanes,
            inputs=[group.start, self.lanes, *inputs],
            device=self.setting.device,
            block_dim=self.block,
        )

    def _paths(self) -> Any:
        stacked = self.stacked
        paths = make_path_type(self.real)()
        kinds = {
            "time": wp.float64, "position": wp.vec3d, "orientation": wp.quatd, "turn": wp.vec3d,
            "turns": wp.int32, "hold_from": wp.float64, "hold_until": wp.float64,
            "radius": self.real, "may_miss": wp.int32,
        }  # fmt: skip
        for name, kind in kinds.items():
            setattr(paths, name, self.array(stacked[name], kind))
        return paths

    def _body(self) -> Any:
        s, W, n = self.setting, self.num_worlds, self.num_points
        friction = s.table.friction if s.table is not None else 0.0
        body = self.types.Body()
        body.points = n
        body.slot = self.array(self.slots, wp.int32)
        body.scratch = self.zeros((W, self.scratch_rows, self.row_length))
        body.damping = self.array([material.damping for material in s.materials])
        body.velocity_damping = self.array(spread(s.velocity_damping, (W,), "velocity_damping"))
        body.friction = self.array(spread(friction, (W,), "friction"))
        body.gravity = self.array(spread(s.gravity, (W, 3), "gravity"), self.types.vec3)
        body.table = int(s.table is not None)
        body.radius = s.body.thickness / 2.0
        body.holds = self.array(self.holds, wp.int32)
        body.place = self.zeros((W * self.closed.shape[1], 7, self.row_length))
        body.torn_from = self.array(np.full(W, np.inf), wp.float64)
        self.air_density = spread(s.air_density, (W,), "air_density")
        self.fill(body)
        fill_contact(self, body)
        return body
