"""Base class of the thin engines of ``Simulator``: W worlds, their grippers and their runs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.errors import SimulationError
from gendom.sim.device import load_kernels
from gendom.sim.paths import HostPaths, LedPaths, Pose, paths_on
from gendom.sim.setting import Frames, Setting, spread
from gendom.sim.thin.contact import PAIRS, contact_arrays
from gendom.sim.thin.grips import (
    LOCAL_STRETCH,
    STRETCH,
    Grip,
    Overstretch,
    overstretch_times,
    released,
)
from gendom.sim.thin.run import Event, Held, Round, Run, put, put_worlds
from gendom.sim.thin.schedule import Schedule, make_schedule
from gendom.sim.thin.step import make_kernels
from gendom.sim.thin.types import SPIN, ParameterDerivatives, V, X, make_types

CFL = 0.8
"""Default share of the longest stable step of small vibrations, of damped bodies and rods."""

SHORTEST_SUBSTEP = 1e-9
"""Below, the steps of two seconds outnumber their counter of 32 bits [s]."""

GROUP = 16
"""Maximum number of worlds that a CPU thread simulates at a time."""

AT_ONCE = 4096
"""Worlds whose grippers' paths are looked at together, for the memory that takes."""


class ThinEngine(ABC):
    """W thin bodies of one shape.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    kind: ClassVar[str]
    """Name of the kind of body in the kernels."""
    directed: ClassVar[bool]
    """Whether edges have directions of their own."""
    state_rows: ClassVar[int]
    state_bars: ClassVar[int]
    scratch_rows: ClassVar[int]
    scratch_bars: ClassVar[int]
    """Numbers of components of states, of derivatives by states, and of their scratch arrays."""
    threads_on_cuda: ClassVar[int]
    """Of a world."""
    undamped_cfl: ClassVar[float] = CFL
    """As ``CFL``, of worlds without damping."""
    stiffened: ClassVar[tuple[slice, ...]]
    """Components of the stiffness that change at a gripper's border, see ``Grip.stiffer``."""

    spacing: float
    """Largest distance between neighbouring points [m]."""
    per_mass: NDArray[np.float64]
    """[W, n] inverse masses of points [1/kg]."""
    per_turn: NDArray[np.float64]
    """[W, n] inverse moments of inertia of edges [1/(kg m^2)]; 0 where they have no directions."""
    drag_by_air: NDArray[np.float64]
    """[n] drag of points over the density of the air."""

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        self.check_suits(setting)
        W, n, G = len(setting.materials), len(setting.body.points), len(setting.grippers[0])
        self.num_worlds, self.num_points = W, n
        self.share = spread(setting.stiffness, (W, n), "stiffness")
        self.air_density = spread(setting.air_density, (W,), "air_density")
        longest = self.prepare(setting)
        damped = np.array([m.damping > 0.0 for m in setting.materials])
        limits = substep or (cfl or np.where(damped, CFL, self.undamped_cfl)) * longest
        self.setting = s = replace(setting, substep=np.broadcast_to(limits, W))
        s.check_substep(
            SHORTEST_SUBSTEP, fix="a softer or denser material, fewer points, or a longer substep"
        )
        self.real = wp.float32 if s.dtype == "float32" else wp.float64
        self.types = make_types(self.real)
        self.kernels = make_kernels(self.real, self.kind)
        self.threads = self.threads_on_cuda if s.device.is_cuda else 1
        self.slots, self.row_length = self.layout()
        self.origin = np.array([0.0, 0.0, s.table.height if s.table is not None else 0.0])
        self.stacked = dict(s.grippers.arrays)
        self.stacked["position"] = self.stacked["position"] - self.origin
        self.paths = HostPaths(self.stacked)
        self.device_paths = paths_on(s.device, self.stacked, self.real)
        self.closed = np.zeros((W, G), dtype=int)
        """[W, G] 0: not yet closed, 1: closed, 2: opened."""
        self.overstretched: dict[int, Overstretch] = {}
        """How grippers will pull worlds apart."""
        self.holds = np.zeros((W, G, n), dtype=np.int32)
        self.stiffer = np.ones((W, G, len(self.stiffened), n))
        self.device_model = self._device_model()
        self.state = self.zeros((W, self.state_rows, self.row_length))
        self.kept_state = self.zeros(self.state.shape)
        self.kept_time = np.full(W, s.start_time)
        self.now = np.full(W, s.start_time)
        """[W] time of the state [s]."""
        self.failures: dict[int, SimulationError] = {}
        self.used = False
        self.led: LedPaths | None = None
        """Paths of grippers after ``lead``."""
        self.last_dt = np.zeros(W)
        """[W] length of the last step [s]; 0 where velocities are those at the current time."""
        x = spread(np.asarray(s.positions, dtype=float) - self.origin, (W, n, 3), "positions")
        self.state.assign(self.first_state(x))
        if s.self_contact:
            # identical initial positions are checked once
            for one in x[: 1 if x.strides[0] == 0 else W]:
                self.check_apart(one)
        self.load("begin", "advance")
        self.launch(self.kernels.begin, slice(0, W), [self.device_model, self.state])

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
    def fill(self, model: Any) -> None:
        """Set shape, stiffness and inertia of the kernels' model."""

    @abstractmethod
    def first_state(self, x: NDArray[np.floating]) -> NDArray[np.float64]:
        """State [W, ., P] at rest, with points [W, n, 3]."""

    @abstractmethod
    def between(self, g: NDArray[np.int64], h: NDArray[np.int64]) -> tuple[int, int, float]:
        """The points i of g [k] and j of h [l] that have least of the body at rest between them,
        and how much [m]; infinite where that is not known."""

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
    def stiffen(self, model: Any, worlds: NDArray[np.int64]) -> None:
        """Copy the stiffness at the borders of grippers to the kernels' model."""

    @abstractmethod
    def parameters(self) -> tuple[str, ...]:
        """Parameters of this body's model beside E, nu and density."""

    @abstractmethod
    def derivatives(self, name: str) -> ParameterDerivatives:
        """Derivatives of the model by ``E``, ``nu``, ``density`` or one of ``parameters``."""

    @abstractmethod
    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Transpose of ``Grip.stiffer`` of a gripper that closed: derivatives by points [k, n, 3],
        by centres [k, 3] and by radii [k]."""

    @abstractmethod
    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Convert derivatives ``found`` by the stiffness with borders to those by the stiffness
        without borders, in place; return the derivatives by ``stiffer`` [k, M, n]."""

    @abstractmethod
    def by_shares(self, model_bar: NDArray[np.floating]) -> NDArray[np.float64]:
        """Derivatives by the share of E at each point, [W, n]."""

    @abstractmethod
    def by_start(
        self, x: NDArray[np.floating], v: NDArray[np.floating], bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Derivatives by initial positions and velocities [W, n, 3], given those by the first state
        [W, n, .]."""

    def spins_of(self, v: NDArray[np.floating]) -> NDArray[np.floating] | None:
        """Spins [W, n - 1, 3] of edges whose points have velocities v, if edges have any."""
        return None

    @abstractmethod
    def tape(self, memory: float) -> Any:
        """Make the tape that records a run for its reverse pass; it takes what memory it needs."""

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
        """Velocities of points, [W, n, 3] [m/s]; held ones have their gripper's."""
        return self._velocities(self.state, self.now).astype(self.setting.dtype)

    def _velocities(self, rows: wp.array, now: NDArray[np.float64]) -> NDArray[np.float64]:
        x, v = self.component(X, rows), self.component(V, rows)
        for g in range(self.closed.shape[1]):
            w = np.flatnonzero(self.closed[:, g] == 1)
            with_hand, _ = released(x[w], self.paths.pose(g, w, now[w]), self.holds[w, g])
            v[w] = np.where((self.holds[w, g] & 1)[..., None] > 0, with_hand, v[w])
        return v

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set points' velocities [W, n, 3] [m/s]; edges of rods rotate with them, not twisting."""
        require(
            not np.any(np.asarray(affine)),
            f"{self.kind}s have no affine velocities",
            fix="engine='mpm'",
        )
        v = spread(v, (self.num_worlds, self.num_points, 3), "velocities")
        rows = self.state.numpy()
        rows[:, V, self.slots] = np.swapaxes(v, 1, 2)
        spins = self.spins_of(v)
        if spins is not None:
            rows[:, SPIN, self.slots[:-1]] = np.swapaxes(spins, 1, 2)
        self.state.assign(rows)
        self.last_dt[:] = 0.0

    def kept(self, *, last_good: bool) -> dict[str, NDArray[Any]]:
        """Return x [m], v [m/s] and all components of the state.

        With ``last_good`` they are those of the last valid state, and its time is added.
        """
        state, time = (self.kept_state, self.kept_time) if last_good else (self.state, self.now)
        kept: dict[str, Any] = {
            "x": self.component(X, state) + self.origin,
            "v": self._velocities(state, time),
            "state": self.component(slice(0, self.state_rows), state),
        }
        return kept | ({"time": self.kept_time} if last_good else {})

    # ---- running ---------------------------------------------------------------------------------

    def run(
        self,
        frames: Frames,
        *,
        after: Callable[[slice, Round], None] | None = None,
        most_steps: int | None = None,
        kept: Any = None,
    ) -> Schedule:
        """Simulate all worlds to all times.

        Args:
            frames: Frames to record.
            after: Called from the threads for each group of worlds and each round between events.
            most_steps: Maximum number of steps in a piece.
            kept: [S, W, ...] array that receives the states at the start of pieces; by default
                only the last one is kept.

        Raises:
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        run = self._prepared(frames, self.schedule(frames, most_steps), kept)
        self._simulate(run, after)
        frames.x[...] = run.x.numpy().reshape(frames.x.shape) + self.origin.astype(frames.x.dtype)
        if frames.on_frame is not None:
            frames.on_frame(len(frames.times))
        self._raise(keep_going=frames.keep_going)
        return run.plan

    def step(self, until: float, *, keep_going: bool) -> None:
        """Simulate all worlds to one time [s] within which no gripper closes or opens.

        Raises:
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        run, s = self._stepping, self.setting
        span, plan = until - self.now, run.plan
        steps = np.maximum(1, np.ceil(span / s.substep - 1e-9))
        plan.begins[:, 0], plan.steps[:, 0], plan.before[:, 0] = self.now, steps, self.last_dt
        plan.dt[:, 0] = span / steps
        if s.device.is_cuda:
            for name in ("begins", "steps", "before", "dt"):
                getattr(run.on_device, name).assign(getattr(plan, name))
        run.frames = replace(run.frames, times=np.array([until]))
        run.stopped.fill_(-1)
        self._simulate(run, most=self.num_worlds)  # a step is short: few launches
        self._raise(keep_going=keep_going)

    @cached_property
    def _stepping(self) -> Run:
        """A run of one piece that records no frame; its arrays serve all steps."""
        frames = Frames(0.0, np.ones(1), np.zeros(0, dtype=int), np.empty(0), None, False)
        return self._prepared(frames, self.schedule(frames, None), None)

    def _simulate(
        self, run: Run, after: Callable[[slice, Round], None] | None = None, most: int = GROUP
    ) -> None:
        self.used = True

        def simulate(group: slice) -> None:
            for round in self._rounds(group, run.plan):
                self._advance(run, group, round)
                if after is not None:
                    after(group, round)

        self.each_group(simulate, most)
        alive = np.setdiff1d(np.arange(self.num_worlds), list(self.failures))
        self.kept_time[alive] = run.plan.time(alive, run.plan.count[alive] - 1)
        self.last_dt = run.plan.last_dt()
        self.now[:] = run.frames.times[-1]

    def _raise(self, *, keep_going: bool) -> None:
        if self.failures and not keep_going:
            raise self.failures[min(self.failures)]

    def lead(
        self,
        position: NDArray[np.float64],
        quat_xyzw: NDArray[np.float64] | None,
        closed: NDArray[np.bool_] | None,
        until: float,
    ) -> None:
        """From now on grippers move straight to poses [W, G, .], where they are at a time [s].

        Those of ``closed`` [W, G] hold from now on what they hold or close on, others open; None:
        all stay as they are.
        """
        every, now = np.arange(self.num_worlds), self.now[0]
        held = (self.stacked["hold_from"] <= now) & (now < self.stacked["hold_until"])
        held = held if closed is None else closed
        self.closed[held & (self.closed == 2)] = 0
        if self.led is None:
            self.led = LedPaths(self.paths, now)
            self.stacked, self.paths = self.led.arrays, HostPaths(self.led.arrays)
            self.device_paths = paths_on(self.setting.device, self.stacked, self.real)
        self.led.lead(now, until, position - self.origin, quat_xyzw, held)
        if self.setting.device.is_cuda:  # else the kernels read the same memory
            for name in self.led.changing:
                getattr(self.device_paths, name).assign(self.stacked[name])
        if (np.count_nonzero(self.closed == 1, axis=1) > 1).any():
            self.overstretched.clear()
            for g in range(1, self.closed.shape[1]):
                holding = np.flatnonzero(self.closed[:, g] == 1)
                self._find_overstretch(g, holding, self.now[holding])
            self.hold(every)

    def each_group(self, job: Callable[[slice], None], most: int = GROUP) -> None:
        """Call ``job`` for each group of worlds, at most so many, that are launched together, in
        threads."""
        W = self.num_worlds
        size = W if self.threads > 1 else max(1, min(most, -(-W // self.setting.threads)))
        groups = [slice(first, min(first + size, W)) for first in range(0, W, size)]
        if len(groups) == 1:
            job(groups[0])
            return
        for done in [self._pool.submit(job, group) for group in groups]:
            done.result()

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(max_workers=self.setting.threads)

    def schedule(self, frames: Frames, most_steps: int | None) -> Schedule:
        """Schedule of all worlds up to the last frame."""
        switches = [self.stacked["hold_from"], self.stacked["hold_until"]]
        switches = np.concatenate(switches, axis=1)
        return make_schedule(frames, switches, self.setting.substep, most_steps, self.last_dt)

    def _prepared(self, frames: Frames, plan: Schedule, kept: Any) -> Run:
        W, device = self.num_worlds, self.setting.device
        vec3, nan = self.types.vec3, np.nan
        shape = (len(frames.times), W, len(frames.particles))
        return Run(
            plan=plan,
            frames=frames,
            on_device=self.plan_on_device(plan),
            pieces=self.zeros((W, 2), wp.int32),
            stopped=wp.full(W, -1, dtype=wp.int32, device=device),
            stopped_at=self.zeros(W, wp.float64),
            points=self.array(frames.particles, wp.int32),
            x=wp.full(shape, vec3(nan, nan, nan), dtype=vec3, device=device),
            kept=self.kept_state if kept is None else kept,
            every=0 if kept is None else W,
        )

    def _rounds(self, group: slice, plan: Schedule) -> Iterator[Round]:
        worlds = np.arange(group.start, group.stop)
        at = np.zeros(len(worlds), dtype=int)
        count = plan.count[worlds].copy()
        while (at < count).any():
            going = at < count
            now = plan.time(worlds, np.minimum(at, np.maximum(count - 1, 0)))
            events = self.switch(worlds[going], now[going])
            until = np.where(going, plan.until(group, at), at)
            yield Round(events, np.stack([at, until], axis=1).astype(np.int32))
            failed = [w - group.start for w in list(self.failures) if w in worlds]
            count[failed] = 0
            at = until

    def _advance(self, run: Run, group: slice, round: Round) -> None:
        """Take the steps of a group's round."""
        pieces = round.pieces.copy()
        failed = [w - group.start for w in list(self.failures) if group.start <= w < group.stop]
        pieces[failed, 1] = pieces[failed, 0]
        put(run.pieces, group, pieces)
        if group.start not in run.launches:
            run.launches[group.start] = self.launch(
                self.kernels.advance,
                group,
                [
                    self.device_model, self.device_paths, run.on_device, run.pieces, 0, 0,
                    self.state, run.kept, run.every, LOCAL_STRETCH**2, STRETCH, run.stopped,
                    run.stopped_at, run.x, run.points,
                ],
                record_cmd=True,
            )  # fmt: skip
        run.launches[group.start].launch()
        stopped, stopped_at = run.stopped.numpy()[group], run.stopped_at.numpy()[group]
        for k in np.flatnonzero(stopped >= 0).tolist():
            w, s = group.start + k, int(stopped[k])
            if w not in self.failures:
                self.kept_time[w] = run.plan.time(w, s)
                self.failures[w] = self._failure(w, s, float(stopped_at[k]), run.plan)

    def _failure(self, w: int, s: int, time: float, plan: Schedule) -> SimulationError:
        """Why world w stopped in piece s at a time [s]."""
        error, model = self.setting.error, self.device_model
        if self.setting.self_contact and model.near_count.numpy()[w].sum() > model.near.shape[1]:
            return error(
                w, float(plan.time(w, s)), f"more than {PAIRS} pairs a point are about to meet",
                where="contact of the body with itself", fix="fewer points, or a thinner body",
            )  # fmt: skip
        if w in self.overstretched and time > self.overstretched[w].time:
            return self.overstretched[w].error(self.setting, w)
        return error(
            w, time,
            f"the body is stretched or compressed by more than {100 * STRETCH:.0f} % in the "
            f"mean, or somewhere by more than {100 * LOCAL_STRETCH:.0f} %",
            where=f"substep {plan.dt[w, s]:.3g} s",
            fix="slower grippers or velocities, or a smaller substep",
        )  # fmt: skip

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
        pose = self.paths.pose(g, worlds, now)
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
        rows = worlds * self.closed.shape[1] + g
        put_worlds(self.device_model.place, rows, self.rows(grip.place))
        self._find_overstretch(g, worlds, now)
        self.hold(worlds)
        return Event(g, True, worlds, now, pose, grip, self.pick(X, state))

    def _open(self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> Event:
        rows = self.state.numpy()[worlds]
        x = self.pick(X, rows)
        pose = self.paths.pose(g, worlds, now)
        grip = Grip(self.holds[worlds, g].copy(), np.empty(0), self.stiffer[worlds, g].copy(), ())
        v, spin = released(x, pose, grip.holds)
        rows[:, V] += self.rows(np.swapaxes(v, 1, 2))
        if self.directed:
            rows[:, SPIN] += self.rows(np.swapaxes(spin, 1, 2))
        put_worlds(self.state, worlds, rows)
        self.closed[worlds, g] = 2
        self.holds[worlds, g] = 0
        self.stiffer[worlds, g] = 1.0
        self.hold(worlds)
        return Event(g, False, worlds, now, pose, grip, x)

    def _find_overstretch(
        self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]
    ) -> None:
        """Find when gripper g, which closes, and others will have pulled worlds [k] apart."""
        for h in range(self.closed.shape[1]):
            both = (self.closed[worlds, h] == 1) & (h != g)
            if not both.any():
                continue
            w, since = worlds[both], now[both]
            held = self.holds[w][:, [h, g]] & 1
            alike, which = np.unique(held, axis=0, return_inverse=True)
            which = which.reshape(-1)  # of the few ways of holding
            for k, (theirs, mine) in enumerate(alike):
                if not (theirs.any() and mine.any()):
                    continue
                i, j, rest = self.between(np.flatnonzero(mine), np.flatnonzero(theirs))
                if np.isfinite(rest):
                    of = np.flatnonzero(which == k)
                    for some in np.array_split(of, -(-len(of) // AT_ONCE)):
                        self._keep_overstretch((h, g), (j, i), w[some], since[some], rest)

    def _keep_overstretch(
        self, grippers: tuple[int, int], points: tuple[int, int], worlds: NDArray[np.int64],
        now: NDArray[np.float64], rest: float,
    ) -> None:  # fmt: skip
        """Keep when two grippers will have pulled points apart that are ``rest`` [m] apart in the
        body at rest, where that is sooner than what is known."""
        rows, (first, second) = worlds * self.closed.shape[1], grippers
        places = self.device_model.place.numpy()[:, :3][..., self.slots[list(points)]]
        ends = places[rows + first, :, 0], places[rows + second, :, 1]
        most = (1.0 + STRETCH) * rest
        times, far = overstretch_times(self.paths, worlds, grippers, ends, now, most)
        for k in np.flatnonzero(np.isfinite(times)).tolist():
            w, found = int(worlds[k]), Overstretch(float(times[k]), grippers, float(far[k]))
            if w not in self.overstretched or found.time < self.overstretched[w].time:
                self.overstretched[w] = found

    def held(self, group: slice) -> Held:
        """Copy what grippers hold in a group of worlds."""
        G = self.closed.shape[1]
        place = self.device_model.place.numpy()[group.start * G : group.stop * G]
        return Held(self.holds[group].copy(), self.stiffer[group].copy(), place.copy())

    def hold_again(self, group: slice, held: Held) -> None:
        """Let grippers hold what they held."""
        G = self.closed.shape[1]
        self.holds[group], self.stiffer[group] = held.holds, held.stiffer
        put(self.device_model.place, slice(group.start * G, group.stop * G), held.place)
        self.hold(np.arange(group.start, group.stop))

    def hold(self, worlds: NDArray[np.int64]) -> None:
        """Copy the held points of worlds [k] to the kernels' model."""
        model, known = self.device_model, self.overstretched
        put_worlds(model.holds, worlds, self.holds[worlds])
        since = [known[w].time if w in known else np.inf for w in worlds.tolist()]
        put_worlds(model.overstretched_from, worlds, np.array(since))
        self.stiffen(model, worlds)
        if self.setting.self_contact:
            put_worlds(model.loose, worlds, self._loose(worlds))

    def _loose(self, worlds: NDArray[np.int64]) -> NDArray[np.float64]:
        """Inverse masses of points of worlds [k], 0 for held ones, [k, 1, P] [1/kg]."""
        free = 1.0 - np.any(self.holds[worlds] & 1, axis=1)
        per_mass = np.broadcast_to(self.per_mass, (self.num_worlds, self.num_points))[worlds]
        return self.rows(per_mass * free)[:, None]

    def gripper_forces(self) -> NDArray[np.float64]:
        """Forces of the body on grippers, [W, G, 3] [N]: momentum that held points would gain in a
        short step if they were let go, over its length."""
        self.load("let_go")
        W, dt = self.num_worlds, float(self.setting.substep.min())
        rows = self.zeros((2 * W, *self.state.shape[1:]))
        wp.copy(rows, self.state, count=self.state.size)
        self.each_group(
            lambda g: self.launch(self.kernels.let_go, g, [self.device_model, dt, rows])
        )
        found = self.pick(V, rows.numpy())
        mass = 1.0 / np.broadcast_to(self.per_mass, (W, self.num_points))
        force = (mass / dt)[..., None] * (found[W:] - found[:W])
        held = np.where(self.closed == 1, 1, 0)[..., None] * (self.holds & 1)
        return np.einsum("wgn,wnk->wgk", held, force)

    # ---- arrays ----------------------------------------------------------------------------------

    def array(self, values: Any, dtype: Any = None) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values), dtype=dtype or self.real, device=self.setting.device
        )

    def zeros(self, shape: Any, dtype: Any = None) -> wp.array:
        return wp.zeros(shape, dtype=dtype or self.real, device=self.setting.device)

    def load(self, *names: str) -> None:
        """Compile kernels, or load them from Warp's cache, before threads call them."""
        for name in names:
            load_kernels(getattr(self.kernels, name).module, self.setting.device, self._block)

    @property
    def _block(self) -> int:
        """Number of threads in a CUDA block."""
        return self.threads if self.threads > 1 else 256

    def launch(
        self, kernel: Any, group: slice, inputs: list[Any], *, record_cmd: bool = False
    ) -> Any:
        """Launch a kernel with one block of threads for each world of the group, or return its
        launch."""
        return wp.launch(
            kernel,
            dim=(group.stop - group.start) * self.threads,
            inputs=[group.start, self.threads, *inputs],
            device=self.setting.device,
            block_dim=self._block,
            record_cmd=record_cmd,
        )

    def plan_on_device(self, plan: Schedule, *, record: bool = True) -> Any:
        """Convert a schedule to the kernels' struct, without frames if they are not recorded; on
        the CPU it shares the schedule's memory."""
        made, device = self.types.FramePlan(), self.setting.device
        plan = plan if record else replace(plan, frame=0 * plan.frame - 1)
        for name in ("begins", "done", "steps", "dt", "before", "frame"):
            kind = wp.int32 if name in ("done", "steps", "frame") else wp.float64
            values = np.ascontiguousarray(getattr(plan, name))
            setattr(made, name, wp.array(values, dtype=kind, device=device, copy=device.is_cuda))
        return made

    def _device_model(self) -> Any:
        s, W, n = self.setting, self.num_worlds, self.num_points
        friction = s.table.friction if s.table is not None else 0.0
        model = self.types.ThinModel()
        model.points = n
        model.slot = self.array(self.slots, wp.int32)
        model.scratch = self.zeros((W, self.scratch_rows, self.row_length))
        model.damping = self.array([material.damping for material in s.materials])
        model.velocity_damping = self.array(spread(s.velocity_damping, (W,), "velocity_damping"))
        model.friction = self.array(spread(friction, (W,), "friction"))
        model.gravity = self.array(spread(s.gravity, (W, 3), "gravity"), self.types.vec3)
        model.table = int(s.table is not None)
        model.radius = s.body.thickness / 2.0
        model.holds = self.array(self.holds, wp.int32)
        model.place = self.zeros((W * self.closed.shape[1], 7, self.row_length))
        model.overstretched_from = self.array(np.full(W, np.inf), wp.float64)
        self.fill(model)
        for name, value in contact_arrays(s, n, self.spacing, self.rows).items():
            if isinstance(value, np.ndarray):
                value = self.array(value, wp.int32 if value.dtype == np.int32 else None)
            setattr(model, name, value)
        model.loose = self.array(self._loose(np.arange(W * int(s.self_contact))))
        return model
