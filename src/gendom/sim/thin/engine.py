"""Rods behind ``Simulator``: W worlds, what grippers do in them, and their runs."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.sim.gripper import stack_paths
from gendom.sim.mpm.types import make_types as make_path_types
from gendom.sim.setting import DRAG, Frames, Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.grips import Grip, Paths, Pose, close, released
from gendom.sim.thin.rod import RodModel
from gendom.sim.thin.stepping import make_stepping
from gendom.sim.thin.types import (
    MARGIN,
    SCRATCH,
    SPIN,
    STATE,
    Q,
    V,
    X,
    in_rows,
    make_types,
    row_length,
)

CFL = 0.8
"""Default share of the longest stable step of small vibrations."""

STRETCH = 0.2
"""Most that an edge may be stretched or compressed."""

GROUP = 16
"""Most worlds that a thread of the CPU takes at a time."""

LANES = 32
"""Threads of a world on CUDA."""


@dataclass
class Event:
    """A gripper of some worlds that closes or opens now."""

    g: int
    closes: bool
    worlds: NDArray[np.int64]
    """[k] which."""
    time: NDArray[np.float64]
    """[k] [s]."""
    pose: Pose
    grip: Grip
    x: NDArray[np.float64]
    """[k, n, 3] points at that time."""


@dataclass
class Round:
    """What worlds do between two events."""

    events: list[Event]
    pieces: NDArray[np.int32]
    """[W, 2] the first piece, and the one after the last."""
    held: tuple[NDArray[Any], ...] = ()
    """What grippers hold in it, for the reverse."""


@dataclass
class Schedule:
    """Pieces of equal steps between frames and events."""

    begins: NDArray[np.float64]
    steps: NDArray[np.int32]
    dt: NDArray[np.float64]
    frame: NDArray[np.int32]
    count: NDArray[np.int64]
    """[W] pieces of each world; those arrays are [W, S]."""
    due: NDArray[np.bool_]
    """[W, S + 1] whether a piece begins with an event."""


class ThinEngine:
    """W rods of one shape.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    def __init__(self, setting: Setting):
        _check_suits(setting)
        self.setting = setting
        s = setting
        self.real = wp.float32 if s.dtype == "float32" else wp.float64
        self.types = make_types(self.real)
        self.kernels = make_stepping(self.real)
        self.lanes = LANES if s.device.is_cuda else 1
        W, n = len(s.materials), len(s.body.line)
        self.num_worlds, self.num_points = W, n
        self.model = _model(s)
        self.origin = np.array([0.0, 0.0, s.table.height if s.table is not None else 0.0])
        self.stacked = stack_paths(s.grippers)
        self.stacked["position"] = self.stacked["position"] - self.origin
        self.paths = self._paths()
        self.grips: list[Grip | None] = [None] * len(s.grippers[0])
        self.closed = np.zeros((W, len(self.grips)), dtype=int)
        """[W, G] 0: not yet, 1: closed, 2: opened."""
        self.stiffer = np.ones((W, len(self.grips), n))
        self.rod = self._rod()
        self.state = self.zeros((W, STATE, row_length(n)))
        self.kept_state = self.zeros((W, STATE, row_length(n)))
        self.kept_time = np.full(W, s.start_time)
        self.failures: dict[int, SimulationError] = {}
        self.used = False
        self._begin()

    @staticmethod
    def substeps(setting: Setting, cfl: float | None) -> NDArray[np.float64]:
        """[W] longest substeps [s]."""
        _check_suits(setting)
        damped = np.array([m.damping > 0.0 for m in setting.materials])
        return (cfl or CFL) * _model(setting).substep(damped)

    # ---- state -----------------------------------------------------------------------------------

    def component(self, which: slice, state: Any = None) -> NDArray[np.float64]:
        """[W, n, k] components of the state."""
        rows = (self.state if state is None else state).numpy()
        return np.swapaxes(rows[:, which, MARGIN : MARGIN + self.num_points], 1, 2).astype(float)

    def positions(self) -> NDArray[Any]:
        """[W, n, 3] points [m]."""
        return (self.component(X) + self.origin).astype(self.setting.dtype)

    def velocities(self) -> NDArray[Any]:
        """[W, n, 3] of points; 0 of those held [m/s]."""
        return self.component(V).astype(self.setting.dtype)

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set points' velocities [W, n, 3] [m/s]; edges turn with them, without twist."""
        if np.any(np.asarray(affine)):
            raise ParameterError("rods have no affine velocities", fix="engine='mpm'")
        v = spread(v, (self.num_worlds, self.num_points, 3), "velocities")
        d, dv = np.diff(self.component(X), axis=1), np.diff(v, axis=1)
        spin = np.cross(d, dv) / np.sum(d**2, axis=2, keepdims=True)
        rows = self.state.numpy()
        rows[:, V] = in_rows(np.swapaxes(v, 1, 2), self.num_points)
        rows[:, SPIN] = in_rows(np.swapaxes(spin, 1, 2), self.num_points)
        self.state.assign(rows)

    def kept(self, *, last_good: bool) -> dict[str, NDArray[Any]]:
        """x [m], v [m/s], q and spin [rad/s]; of the last good state with its time."""
        state = self.kept_state if last_good else self.state
        parts = {"x": X, "v": V, "q": Q, "spin": SPIN}
        kept: dict[str, Any] = {name: self.component(c, state) for name, c in parts.items()}
        kept["x"] = kept["x"] + self.origin
        if last_good:
            kept["time"] = self.kept_time
        return kept

    # ---- running ---------------------------------------------------------------------------------

    def run(self, frames: Frames) -> None:
        """Simulate all worlds to all times.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
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
        """Simulate, and call ``after`` with every group of worlds and what it did between events.

        Args:
            frames: What to record.
            after: Called from the threads.
            most_steps: Of a piece.
            kept: [S, W, ...] gets the states that pieces begin with; by default only the last.
        """
        self.used = True
        plan = self.schedule(frames, most_steps)
        job = _Job(self, plan, frames, kept)
        groups = list(self.groups())

        def one(group: slice) -> None:
            for round in self._rounds(group, plan):
                job.advance(group, round)
                after(group, round)

        with ThreadPoolExecutor(max_workers=self.setting.threads) as pool:
            for done in [pool.submit(one, group) for group in groups]:
                done.result()
        job.finish()
        if frames.on_frame is not None:
            frames.on_frame(len(frames.times))
        if self.failures and not frames.keep_going:
            raise self.failures[min(self.failures)]
        return plan

    def groups(self) -> Iterator[slice]:
        """Worlds that are launched together."""
        W = self.num_worlds
        size = W if self.lanes > 1 else max(1, min(GROUP, -(-W // self.setting.threads)))
        for first in range(0, W, size):
            yield slice(first, min(first + size, W))

    def schedule(self, frames: Frames, most_steps: int | None) -> Schedule:
        """What worlds do one after the other until the last frame."""
        s = self.setting
        T = len(frames.times)
        last = frames.times[-1]
        switches = np.concatenate(
            [self.stacked["hold_from"], self.stacked["hold_until"]], axis=1
        )  # [W, 2 G]
        # worlds whose grippers switch alike have the same pieces, but for their length
        alike, which = np.unique(switches, axis=0, return_inverse=True)
        which = which.reshape(-1)
        cuts = []
        for row in alike:
            inside = row[(row > frames.began) & (row < last)]
            times = np.concatenate([[frames.began], frames.times, inside])
            frame = np.concatenate([[-1], np.arange(T), np.full(len(inside), -1)])
            order = np.lexsort((frame, times))
            cuts.append((times[order], frame[order], np.isin(times[order], row)))
        blocks = []
        for k, (times, frame, due) in enumerate(cuts):
            worlds = np.flatnonzero(which == k)
            if most_steps is None:
                blocks.append((worlds, _pieces(times, frame, due, s.substep[worlds], None)))
            else:
                blocks += [
                    (w, _pieces(times, frame, due, s.substep[w], most_steps))
                    for w in worlds[:, None]
                ]
        S = max(of["steps"].shape[1] for _, of in blocks)
        shape = (self.num_worlds, S)
        plan = Schedule(
            begins=np.zeros(shape),
            steps=np.zeros(shape, dtype=np.int32),
            dt=np.ones(shape),
            frame=np.full(shape, -1, dtype=np.int32),
            count=np.zeros(self.num_worlds, dtype=int),
            due=np.zeros((self.num_worlds, S + 1), dtype=bool),
        )
        for worlds, of in blocks:
            count = of["steps"].shape[1]
            plan.count[worlds] = count
            for name in ("begins", "steps", "dt", "frame"):
                getattr(plan, name)[worlds, :count] = of[name]
            plan.due[worlds, 1 : count + 1] = of["due"]
        return plan

    def _rounds(self, group: slice, plan: Schedule) -> Iterator[Round]:
        worlds = np.arange(group.start, group.stop)
        at = np.zeros(len(worlds), dtype=int)
        count, W = plan.count[worlds].copy(), self.num_worlds
        while (at < count).any():
            going = at < count
            now = plan.begins[worlds, np.minimum(at, count - 1)]
            events = self._switch(worlds[going], now[going])
            index = np.arange(plan.due.shape[1])
            later = plan.due[worlds] & (index > at[:, None]) & (index < count[:, None])
            until = np.where(later.any(axis=1), later.argmax(axis=1), np.maximum(count, at))
            pieces = np.stack([at, until], axis=1).astype(np.int32)
            yield Round(events, pieces)
            failed = [w - group.start for w in list(self.failures) if w in range(*group.indices(W))]
            count[failed] = 0
            at = until

    def tape(self, memory: float) -> Any:
        """What remembers a run for its reverse."""
        from gendom.sim.thin.tape import RodTape

        return RodTape(self, memory)

    # ---- grippers --------------------------------------------------------------------------------

    def _switch(self, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> list[Event]:
        """Let grippers of worlds [k] close and open that are to at times [k]."""
        events = []
        for g in range(len(self.grips)):
            begin = self.stacked["hold_from"][worlds, g]
            end = self.stacked["hold_until"][worlds, g]
            opens = (self.closed[worlds, g] == 1) & (now >= end)
            if opens.any():
                events.append(self._open(g, worlds[opens], now[opens]))
        for g in range(len(self.grips)):
            begin = self.stacked["hold_from"][worlds, g]
            end = self.stacked["hold_until"][worlds, g]
            closes = (self.closed[worlds, g] == 0) & (now >= begin) & (now < end)
            if closes.any():
                events.append(self._close(g, worlds[closes], now[closes]))
        return events

    def _close(self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> Event:
        x, q = self.component(X)[worlds], self.component(Q)[worlds][:, :-1]
        pose = Paths(self.stacked).pose(g, worlds, now)
        taken = np.any(self.holds[worlds][:, :, :-1] & 2, axis=1)
        grip = close(x, q, pose, self.stacked["radius"][worlds, g], self.model.length, taken)
        self.closed[worlds, g] = 1
        missed = grip.misses & (self.stacked["may_miss"][worlds, g] == 0)
        for w in worlds[missed]:
            self.failures[int(w)] = self.error(
                int(w),
                float(now[worlds == w][0]),
                f"gripper {g} closed on nothing",
                where=f"radius {self.stacked['radius'][w, g]:.4g} m",
                fix="move its path to the object, or give it may_miss=True",
            )
        rows = worlds * len(self.grips) + g
        self.holds[worlds, g] = grip.holds
        self.stiffer[worlds, g] = grip.stiffer
        place = self.rod.place.numpy()
        place[rows] = in_rows(grip.place, self.num_points)
        self.rod.place.assign(place)
        self._hold(worlds)
        return Event(g, True, worlds, now, pose, grip, x)

    def _open(self, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> Event:
        x = self.component(X)[worlds]
        pose = Paths(self.stacked).pose(g, worlds, now)
        grip = Grip(
            holds=self.holds[worlds, g].copy(),
            place=np.empty(0),
            stiffer=self.stiffer[worlds, g].copy(),
            cut=np.empty(0, dtype=np.int64),
            share=np.empty(0),
            free=np.empty(0),
        )
        v, spin = released(x, pose, grip)
        rows = self.state.numpy()
        rows[worlds, V] += in_rows(np.swapaxes(v, 1, 2), self.num_points)
        rows[worlds, SPIN] += in_rows(np.swapaxes(spin, 1, 2), self.num_points)
        self.state.assign(rows)
        self.closed[worlds, g] = 2
        self.holds[worlds, g] = 0
        self.stiffer[worlds, g] = 1.0
        self._hold(worlds)
        return Event(g, False, worlds, now, pose, grip, x)

    def _hold(self, worlds: NDArray[np.int64]) -> None:
        """Hand what is held in those worlds to the kernels."""
        self.rod.holds.assign(self.holds)
        stiffer = self.stiffer.prod(axis=1)
        inertia = self.rod.inertia.numpy()
        n = self.num_points
        inertia[:, 3, MARGIN : MARGIN + n] = stiffer
        inertia[:, 1, MARGIN : MARGIN + n] = self.per_turn / self.slower(stiffer)
        self.rod.inertia.assign(inertia)

    @staticmethod
    def slower(stiffer: NDArray[np.floating]) -> NDArray[np.floating]:
        """[W, n] by how much more inertia edges turn beside joints that a border makes stiffer:
        the substep stays stable."""
        after = np.concatenate([stiffer[:, 1:], np.ones_like(stiffer[:, :1])], axis=1)
        return np.maximum(1.0, np.maximum(stiffer, after))

    def error(self, w: int, time: float, what: str, *, where: str, fix: str) -> SimulationError:
        """An error that names world, time [s] and parameters."""
        m = self.setting.materials[w]
        return SimulationError(
            what,
            where=f"world {w} at {time:.4f} s (E {m.E:.6g} Pa, nu {m.nu:.4g}, density "
            f"{m.density:.6g} kg/m^3, {where})",
            fix=fix,
            world=w,
            time=time,
            parameters={"E": m.E, "nu": m.nu, "density": m.density},
        )

    # ---- arrays ----------------------------------------------------------------------------------

    def array(self, values: Any, dtype: Any = None) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values), dtype=dtype or self.real, device=self.setting.device
        )

    def zeros(self, shape: Any, dtype: Any = None) -> wp.array:
        return wp.zeros(shape, dtype=dtype or self.real, device=self.setting.device)

    def launch(self, kernel: Any, group: slice, inputs: list[Any]) -> None:
        """A block of threads for each world of the group."""
        wp.launch(
            kernel,
            dim=(group.stop - group.start) * self.lanes,
            inputs=[group.start, self.lanes, *inputs],
            device=self.setting.device,
            block_dim=self.lanes if self.lanes > 1 else 256,
        )

    def _paths(self) -> Any:
        stacked = self.stacked
        paths = make_path_types(self.real).Paths()
        kinds = {
            "time": wp.float64, "position": wp.vec3d, "orientation": wp.quatd, "turn": wp.vec3d,
            "turns": wp.int32, "hold_from": wp.float64, "hold_until": wp.float64,
            "radius": self.real, "may_miss": wp.int32,
        }  # fmt: skip
        for name, kind in kinds.items():
            setattr(paths, name, self.array(stacked[name], kind))
        return paths

    def _rod(self) -> Any:
        s, W, n, m = self.setting, self.num_worlds, self.num_points, self.model
        G = len(self.grips)
        friction = s.table.friction if s.table is not None else 0.0
        self.air_density = spread(s.air_density, (W,), "air_density")
        self.drag_by_air = 0.5 * DRAG["rope"] * m.section.breadth * m.tributary
        self.per_turn = np.zeros((W, n))
        self.per_turn[:, :-1] = 1.0 / m.inertia[:, :-1]
        inertia = np.stack(
            [
                1.0 / m.mass,
                self.per_turn,
                self.air_density[:, None] * self.drag_by_air,
                np.ones((W, n)),
            ],
            axis=1,
        )
        self.holds = np.zeros((W, G, n), dtype=np.int32)
        rod = self.types.Rod()
        rod.points = n
        rod.rest = self.array(in_rows(m.rest, n)[None])
        rod.stiffness = self.array(in_rows(m.stiffness, n))
        rod.inertia = self.array(in_rows(inertia, n))
        rod.scratch = self.zeros((W, SCRATCH, row_length(n)))
        rod.damping = self.array([material.damping for material in s.materials])
        rod.velocity_damping = self.array(spread(s.velocity_damping, (W,), "velocity_damping"))
        rod.friction = self.array(spread(friction, (W,), "friction"))
        rod.gravity = self.array(spread(s.gravity, (W, 3), "gravity"), self.types.vec3)
        rod.table = int(s.table is not None)
        rod.radius = s.body.thickness / 2.0
        rod.walls = int(s.box is not None)
        if s.box is not None:
            rod.box_lower = self.types.vec3(*(s.box.lower - self.origin))
            rod.box_upper = self.types.vec3(*(s.box.upper - self.origin))
        rod.holds = self.array(self.holds, wp.int32)
        rod.place = self.zeros((W * G, 7, row_length(n)))
        return rod

    def _begin(self) -> None:
        """The first state: at rest, directions without more twist than at rest."""
        s, W, n = self.setting, self.num_worlds, self.num_points
        x = spread(np.asarray(s.positions, dtype=float) - self.origin, (W, n, 3), "positions")
        first = np.broadcast_to(self.model.rest_q[0], (W, 4))
        self.first_q = rotation.transported(first, np.diff(x, axis=1))
        stretch = np.linalg.norm(np.diff(x, axis=1), axis=2) / self.model.length - 1.0
        w, e = np.unravel_index(np.abs(stretch).argmax(), stretch.shape)
        if abs(stretch[w, e]) > STRETCH:
            raise ParameterError(
                f"the rope begins stretched by {100 * stretch[w, e]:.0f} %",
                where=f"edge {e} of world {w}",
                fix=f"positions must keep the lengths of its {n - 1} edges",
            )
        state = np.zeros(self.state.shape)
        state[:, Q.stop - 1] = 1.0
        state[:, X, MARGIN : MARGIN + n] = np.swapaxes(x, 1, 2)
        state[:, Q, MARGIN : MARGIN + n - 1] = np.swapaxes(self.first_q, 1, 2)
        self.state.assign(state)
        self.launch(self.kernels.begin, slice(0, W), [self.rod, self.state])


class _Job:
    """One run's arrays, shared by the groups of worlds."""

    def __init__(self, engine: ThinEngine, plan: Schedule, frames: Frames, kept: Any):
        self.engine, self.plan, self.frames = engine, plan, frames
        self.began = frames.began
        e, t = engine, engine.types
        self.on_device = device_plan(e, plan)
        self.pieces = e.zeros((e.num_worlds, 2), wp.int32)
        self.stopped = wp.full(e.num_worlds, -1, dtype=wp.int32, device=e.setting.device)
        self.points = e.array(frames.particles, wp.int32)
        shape = (len(frames.times), e.num_worlds, len(frames.particles))
        self.x = wp.full(
            shape, t.vec3(np.nan, np.nan, np.nan), dtype=t.vec3, device=e.setting.device
        )
        self.kept, self.every = (e.kept_state, 0) if kept is None else (kept, e.num_worlds)

    def advance(self, group: slice, round: Round) -> None:
        e, plan = self.engine, self.plan
        pieces = round.pieces.copy()
        for w in list(e.failures):
            if group.start <= w < group.stop:
                pieces[w - group.start, 1] = pieces[w - group.start, 0]
        put(self.pieces, group, pieces)
        e.launch(
            e.kernels.advance,
            group,
            [
                e.rod, e.paths, self.on_device, self.pieces, 0, 0, e.state, self.kept, self.every,
                STRETCH**2, self.stopped, self.x, self.points,
            ],
        )  # fmt: skip
        stopped = self.stopped.numpy()
        for w in (int(k) for k in np.flatnonzero(stopped >= 0) if group.start <= k < group.stop):
            if w in e.failures:
                continue
            s = int(stopped[w])
            begin = plan.begins[w, s]
            e.kept_time[w] = begin
            e.failures[w] = e.error(
                w,
                float(begin + plan.steps[w, s] * plan.dt[w, s]),
                f"the rope is stretched or compressed by more than {100 * STRETCH:.0f} %",
                where=f"substep {plan.dt[w, s]:.3g} s",
                fix="grippers that pull it apart go slower or less far; or a smaller substep",
            )

    def finish(self) -> None:
        e = self.engine
        x = self.x.numpy().reshape(self.frames.x.shape)
        self.frames.x[...] = x + e.origin.astype(e.setting.dtype)
        alive = [w for w in range(e.num_worlds) if w not in e.failures]
        e.kept_time[alive] = self.plan.begins[alive, self.plan.count[alive] - 1]


def device_plan(engine: ThinEngine, plan: Schedule, *, record: bool = True) -> Any:
    """The schedule as kernels take it."""
    on_device = engine.types.Plan()
    on_device.begins = engine.array(plan.begins, wp.float64)
    on_device.steps = engine.array(plan.steps, wp.int32)
    on_device.dt = engine.array(plan.dt, wp.float64)
    on_device.frame = engine.array(plan.frame if record else 0 * plan.frame - 1, wp.int32)
    return on_device


def put(array: wp.array, rows: slice, values: NDArray[Any]) -> None:
    """Set rows of an array on its device."""
    if rows.stop > rows.start and values.size:
        sent = wp.array(np.ascontiguousarray(values), dtype=array.dtype, device="cpu")
        wp.copy(array, sent, dest_offset=rows.start * (array.size // len(array)), count=sent.size)


def _pieces(
    times: NDArray[np.float64],
    frame: NDArray[np.integer],
    due: NDArray[np.bool_],
    substep: NDArray[np.float64],
    most_steps: int | None,
) -> dict[str, NDArray[Any]]:
    """[k, S] pieces between times, of equal steps no longer than substeps [k]; of one world (k = 1)
    of at most ``most_steps`` each."""
    span = np.diff(times)
    n = np.ceil(span / substep[:, None] - 1e-9)
    n = np.where(span > 0.0, np.maximum(1, n), 0).astype(int)
    dt = np.where(n > 0, span / np.maximum(n, 1), 1.0)
    if most_steps is None:
        return {"begins": times[:-1], "steps": n, "dt": dt, "frame": frame[1:], "due": due[1:]}
    (n, dt) = n[0], dt[0]
    parts = np.maximum(1, -(-n // most_steps))
    of = np.repeat(np.arange(len(n)), parts)
    part = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    last = part == parts[of] - 1
    return {
        "begins": times[of] + part * most_steps * dt[of],
        "steps": np.where(last, n[of] - part * most_steps, most_steps)[None],
        "dt": dt[of],
        "frame": np.where(last, frame[of + 1], -1),
        "due": last & due[of + 1],
    }


def _check_suits(setting: Setting) -> None:
    body = setting.body
    if body.kind != "rope":
        raise ParameterError(
            f"the thin engine has no model of a {body.kind} yet", fix="engine='mpm'"
        )
    for m in setting.materials:
        if np.isfinite(m.yield_stress):
            raise ParameterError("rods do not yield", fix="engine='mpm', or no yield_stress")


def _model(setting: Setting) -> RodModel:
    shape = (len(setting.materials), len(setting.body.line))
    return RodModel.of(
        setting.body, setting.materials, spread(setting.stiffness, shape, "stiffness")
    )
