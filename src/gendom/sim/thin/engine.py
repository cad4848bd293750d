"""Engine of ``Simulator`` for rods and shells: W worlds, their grippers and their runs."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError, SimulationError
from gendom.sim.device import load_kernels
from gendom.sim.engine import Engine
from gendom.sim.gripper import Grippers
from gendom.sim.obstacles import check_thick, numbers_of_obstacles
from gendom.sim.paths import HostPaths, Pose, paths_on
from gendom.sim.setting import Frames, Setting, spread
from gendom.sim.thin.contact import PAIRS, contact_arrays
from gendom.sim.thin.grips import LOCAL_STRETCH, STRETCH, Grip, Ties, close, released
from gendom.sim.thin.rods import RodModel
from gendom.sim.thin.run import Event, Run, Schedule, put
from gendom.sim.thin.shells import ShellModel
from gendom.sim.thin.step import make_kernels
from gendom.sim.thin.types import SPIN, Q, V, X, make_types

SHORTEST_SUBSTEP = 1e-9
"""Below, the steps of two seconds outnumber their counter of 32 bits [s]."""

MOST_HELD, MOST_GRIPPERS = 4, 15
"""Of rods in the registers of 32 CUDA threads: points in each, and grippers, at most."""

OTHER_SHARED = 16384
"""What kernels have in shared memory beside the scratch, at most [bytes]."""

LANES = 16
"""Of a CPU's SIMD register, at most."""

GROUP, SHARES = 16, 32
"""Maximum number of worlds that a CPU thread simulates at a time, of many a share of all."""


class ThinEngine(Engine):
    """W rods or shells of one shape.

    Raises:
        ParameterError: If arguments do not fit together.
    """

    def __init__(self, setting: Setting, *, substep: float | None, cfl: float | None):
        super().__init__(setting)
        W, n, G = self.num_worlds, len(setting.body.points), self.stacked["radius"].shape[1]
        self.num_points = n
        self.air_density = spread(setting.air_density, (W,), "air_density")
        self.model = m = (RodModel if setting.body.kind == "rope" else ShellModel)(setting)
        damping = setting.parameters["damping"]
        share = cfl or np.where(damping > 0.0, m.cfl, m.undamped_cfl)
        limits = substep or share * m.longest_step()
        self.setting = s = replace(setting, substep=np.broadcast_to(limits, W))
        fix = "a softer or denser material, fewer points, or a longer substep"
        s.check_substep(SHORTEST_SUBSTEP, fix=fix)
        self.types = make_types(self.real)
        short = m.kind == "rod" and n <= 32 * MOST_HELD and G <= MOST_GRIPPERS
        self.held = -(-n // 32) if s.device.is_cuda and short and not s.self_contact else 0
        """Points of a rod that a thread's registers hold; 0: its state is in memory."""
        alone = m.kind == "rod" and not s.self_contact and not any(s.obstacles)
        self.interleaved = s.interleaved and alone and not s.device.is_cuda
        """Whether worlds are side by side in the lanes of a CPU."""
        self.kernels = make_kernels(self.real, m.kind, self.held, *self._room())
        self.threads = m.threads_on_cuda if s.device.is_cuda else 1
        """Of a world."""
        self.block = self.threads if self.threads > 1 else 256
        """Threads of a CUDA block."""
        self.per_mass = 1.0 / m.mass
        self.slots, self.row_length = m.slots, m.row_length
        adjacent = slice(int(m.slots[0]), int(m.slots[0]) + n)
        self.columns = adjacent if m.slots[-1] < adjacent.stop else m.slots
        """As an index of rows: a slice where there are no gaps, which is faster."""
        self.paths = HostPaths(self.stacked)
        self.device_paths = paths_on(s.device, self.stacked, self.real)
        self.closed = np.zeros((W, G), dtype=int)
        """[W, G] 0: not yet closed, 1: closed, 2: opened."""
        self.holds = np.zeros((W, G, n), dtype=np.int32)
        self.stiffer = np.ones((W, G, len(m.lines), n))
        along = np.append(0.0, np.cumsum(m.lines[0].length))[:, None]
        rest = along if isinstance(m, RodModel) else s.body.points
        self.ties = Ties(rest, (W, G), s) if G > 1 else None
        self.device_model = model = self._device_model()
        led = ("place", "holds", "inertia", "loose")
        self._led = {name: getattr(model, name).numpy() for name in led}
        """Arrays of the kernels' model that change where grippers close and open, on the host."""
        self.state = self.zeros((W, m.state_rows, self.row_length))
        self.now = s.start_time
        """Time of the state [s]."""
        self.last_dt = np.zeros(W)
        """[W] length of the last step [s]; 0 where velocities are those at the current time."""
        x = self.first_positions(n)
        # identical initial positions are looked at once
        self.first = self._first_state(x[:1] if x.strides[0] == 0 else x)
        """The state on the host until something moves, or None."""
        self.state.assign(np.ascontiguousarray(self.first))
        self._loaded: set[str] = set()
        self.load("begin", "advance_interleaved" if self.interleaved else "advance")
        self.launch(self.kernels.begin, slice(0, W), [self.device_model, self.state])

    def _first_state(self, different: Array) -> Array:
        """State [W, ., P] at rest, with points [W, n, 3], or [1, n, 3] in all worlds."""
        for lines in self.model.lines:
            step = np.linalg.norm(np.diff(lines.of(different), axis=1), axis=2)
            stretch = (step / lines.length - 1.0).reshape(len(different), len(lines.index), -1)
            w, l, k = np.unravel_index(np.abs(stretch).argmax(), stretch.shape)
            if abs(stretch[w, l, k]) > STRETCH:
                kind, most = self.setting.body.kind, 100 * stretch[w, l, k]
                raise ParameterError(
                    f"the {kind} begins stretched by {most:.0f} %",
                    where=f"world {w}, points {lines.index[l, k]} and {lines.index[l, k + 1]}",
                    fix="positions must keep the distances of neighbours in body.points",
                )
        if self.setting.self_contact:
            for one in different:
                self.model.check_apart(one)
        state = np.zeros((len(different), *self.state.shape[1:]), dtype=self.setting.dtype)
        state[:, X, self.slots] = np.swapaxes(different, 1, 2)
        if isinstance(self.model, RodModel):
            state[:, Q.stop - 1] = 1.0
            q = self.model.directions(different)
            state[:, Q, self.slots[:-1]] = np.swapaxes(q, 1, 2)
        return np.broadcast_to(state, self.state.shape)

    # ---- state -----------------------------------------------------------------------------------

    def rows(self, values: Array) -> Array:
        """Arrange values [..., n] in rows [..., P]."""
        some = values[:1] if values.strides[0] == 0 else values  # the same in all
        rows = np.zeros((*some.shape[:-1], self.row_length), dtype=self.setting.dtype)
        rows[..., self.columns] = some
        return np.broadcast_to(rows, (*values.shape[:-1], self.row_length))

    def component(self, which: slice, rows: Any = None) -> Array:
        """Components [W, n, k] of the state, or of other rows."""
        return self.pick(which, (self.state if rows is None else rows).numpy())

    def pick(self, which: slice, rows: Array, worlds: NDArray[np.int64] | None = None) -> Array:
        """Components [k, n, .] of rows [W, ., P], of worlds [k]."""
        worlds = np.arange(len(rows)) if worlds is None else worlds
        alike = rows.strides[0] == 0
        some = rows[:1] if alike else rows[self.every(worlds)]
        found = np.swapaxes(some[:, which][..., self.columns], 1, 2).astype(float)
        return np.broadcast_to(found, (len(worlds), *found.shape[1:])) if alike else found

    def every(self, worlds: NDArray[np.int64]) -> Any:
        """Worlds [k] as an index: all of them as a slice, which copies nothing."""
        return slice(None) if len(worlds) == self.num_worlds else worlds

    def positions(self) -> Array:
        """Positions of points, [W, n, 3] [m]."""
        return (self.component(X) + self.origin).astype(self.setting.dtype)

    def velocities(self) -> Array:
        """Velocities of points, [W, n, 3] [m/s]; held ones have their gripper's."""
        x, v = self.component(X), self.component(V)
        for g in range(self.closed.shape[1]):
            w = np.flatnonzero(self.closed[:, g] == 1)
            k, i = np.nonzero(self.holds[w, g] & 1)
            centre, velocity, spin = self.paths.motion(g, w, np.full(len(w), self.now))
            v[w[k], i] = velocity[k]
            if spin.any():
                v[w[k], i] += np.cross(spin[k], x[w[k], i] - centre[k])
        return v.astype(self.setting.dtype)

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set points' velocities [W, n, 3] [m/s]; edges of rods rotate with them, not twisting."""
        none = not np.any(np.asarray(affine))
        require(none, f"{self.model.kind}s have no affine velocities", fix="engine='mpm'")
        v = spread(v, (self.num_worlds, self.num_points, 3), "velocities")
        rows = self.state.numpy()
        rows[:, V, self.slots] = np.swapaxes(v, 1, 2)
        self.first = None
        if isinstance(self.model, RodModel):
            spins = self.model.spins(self.component(X), v)
            rows[:, SPIN, self.slots[:-1]] = np.swapaxes(spins, 1, 2)
        self.state.assign(rows)
        self.last_dt = np.zeros(self.num_worlds)

    def set_positions(self, x: Array) -> None:
        """Set points' positions [W, n, 3] [m]."""
        rows = self.state.numpy()
        rows[:, X, self.slots] = np.swapaxes(x - self.origin, 1, 2)
        self.first = None
        self.state.assign(rows)
        self.launch(self.kernels.begin, slice(0, self.num_worlds), [self.device_model, self.state])

    # ---- running ---------------------------------------------------------------------------------

    def run(
        self, frames: Frames, *, after: Callable[[slice, list[Event], Array], None] | None = None,
        most_steps: int | None = None, kept: Any = None,
    ) -> Schedule:  # fmt: skip
        """Simulate all worlds to all times.

        Args:
            frames: Frames to record.
            after: Called from the threads for each group of worlds and each round between events.
            most_steps: Maximum number of steps in a piece.
            kept: [S, W, ...] array that receives the states at the start of pieces, if any.

        Raises:
            SimulationError: If a world diverges, unless ``keep_going`` is set.
        """
        run = Run(self, Schedule(frames, self, most_steps), frames, kept)
        self.in_threads(partial(self._go, run, after), self.groups())
        self.used, self.now, self.last_dt = True, float(frames.times[-1]), run.plan.last_dt
        frames.x[...] = run.x.numpy().reshape(frames.x.shape)
        if self.origin.any():
            frames.x[...] += self.origin.astype(frames.x.dtype)
        if frames.on_frame is not None:
            frames.on_frame(len(frames.times))
        self.raise_failures(keep_going=frames.keep_going)
        return run.plan

    def _go(self, run: Run, after: Callable[..., None] | None, group: slice) -> None:
        """Take a group of worlds through a run, from one gripper event to the next."""
        plan, worlds = run.plan, np.arange(group.start, group.stop)
        at, count = np.zeros(len(worlds), dtype=int), plan.count[worlds].copy()
        while (at < count).any():
            going = at < count
            now = plan.time(worlds, np.minimum(at, np.maximum(count - 1, 0)))
            events = self.switch(worlds[going], now[going])
            until = np.where(going, plan.until(group, at), at)
            until = np.where(np.isin(worlds, list(self.failures)), at, until)
            apart = {}
            if self.ties is not None and not self.ties.are_safe(self.paths, group):
                apart = self._apart_in(plan, worlds, at, until)
            pieces = np.stack([at, until], axis=1).astype(np.int32)
            put(run.on_device.piece, group, pieces)
            run.launch(group)
            self.note_stopped(run.on_device, group)
            for w, error in apart.items():
                self.failures.setdefault(w, error)
            if after is not None:
                after(group, events, pieces)
            count[np.isin(worlds, list(self.failures))] = 0
            at = until

    def note_stopped(self, run: Any, group: slice) -> None:
        """Keep the errors of worlds of a group that a run on the device has stopped."""
        pieces = run.stopped.numpy()[group]
        for k in np.flatnonzero(pieces >= 0).tolist():
            if group.start + k not in self.failures:
                self.failures[group.start + k] = self._failure(group.start + k, pieces[k], run)

    def _apart_in(
        self, plan: Schedule, worlds: NDArray[np.int64], at: Array, until: Array
    ) -> dict[int, SimulationError]:
        """Errors of worlds [k] that grippers will pull apart in the pieces from ``at`` to ``until``
        [k], which then ends before that."""
        some = np.flatnonzero(until > at)
        w, last = worlds[some], until[some] - 1
        ends = plan.begins[w] + (plan.done[w] + plan.steps[w]) * plan.dt[w]
        times = plan.time(w, at[some]), ends[np.arange(len(w)), last]
        errors = self.ties.broken(self.paths, w, *times) if self.ties else {}
        for row in np.flatnonzero(np.isin(w, list(errors))).tolist():
            k = some[row]
            pieces = ends[row, at[k] : until[k]]
            until[k] = at[k] + np.count_nonzero(pieces <= float(errors[int(worlds[k])].time or 0.0))
        return errors

    def groups(self, most: int = GROUP, least: int = 1) -> list[slice]:
        """Groups of worlds, at least and at most so many, that are launched together; with as many
        steps where each thread of a CPU takes one."""
        W, threads = self.num_worlds, self.setting.threads
        most = max(most, W // SHARES)
        size = W if self.threads > 1 else max(least, min(most, -(-W // threads)))
        size = -(-size // LANES) * LANES if self.interleaved else size
        ends = np.arange(0, W + size, size).clip(max=W)
        if len(ends) == threads + 1 and not self.interleaved:
            steps = 1.0 / self.setting.substep
            done = (np.cumsum(steps) - 0.5 * steps) / steps.sum()
            ends[1:-1] = np.searchsorted(done, np.arange(1, threads) / threads)
        return [slice(first, end) for first, end in pairwise(ends.tolist()) if end > first]

    def _failure(self, w: int, s: int, run: Any) -> SimulationError:
        """Why world w stopped in piece s of a run on the device."""
        error, model = self.setting.error, self.device_model
        begins, done, dt = (of.numpy()[w, s] for of in (run.begins, run.done, run.dt))
        if (model.pair_counts.numpy()[w : w + 1, 0].sum(axis=1) > model.near.shape[1]).any():
            return error(
                w, float(begins + done * dt), f"more than {PAIRS} pairs a point are about to meet",
                where="contact of the body with itself", fix="fewer points, or a thinner body",
            )  # fmt: skip
        return error(
            w, float(run.stopped_at.numpy()[w]),
            f"the body is stretched or compressed by more than {100 * STRETCH:.0f} % in the "
            f"mean, or somewhere by more than {100 * LOCAL_STRETCH:.0f} %",
            where=f"substep {dt:.3g} s",
            fix="slower grippers, obstacles or velocities, or a smaller substep",
        )  # fmt: skip

    # ---- grippers --------------------------------------------------------------------------------

    def switch(self, worlds: NDArray[np.int64], now: Array) -> list[Event]:
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
        if events:
            self.hold(np.unique(np.concatenate([event.worlds for event in events])))
        return events

    def _close(self, g: int, worlds: NDArray[np.int64], now: Array) -> Event:
        rows = self.state.numpy() if self.first is None else self.first
        own, pose = self.every(worlds), self.paths.pose(g, worlds, now)
        x, radius = self.pick(X, rows, worlds), self.stacked["radius"][own, g]
        q = self.pick(Q, rows, worlds)[:, :-1] if self.model.directed else x
        given = (x, q, self.holds[own], radius, *vars(pose).values())
        # worlds that begin alike hold alike
        alike = all(of.strides[0] == 0 or (of == of[:1]).all() for of in given)
        x1, q1, holds1, radius1, *of = (a[:1] if alike else a for a in given)
        held = self.model.held(x1, of[0], radius1, np.bitwise_or.reduce(holds1, axis=1))
        q1 = q1 if self.model.directed else None
        grip = close(x1, q1, Pose(*of), radius1, held, self.model.lines)
        grip = grip.repeated(len(worlds), self.model.lines) if alike else grip
        self.closed[worlds, g] = 1
        for k in np.flatnonzero(~grip.holds.any(axis=1)).tolist():
            w, centre = int(worlds[k]), pose.centre[k]
            far = np.linalg.norm(x[k] - centre, axis=1).min()
            self.failures[w] = self.setting.error(
                w,
                float(now[k]),
                f"gripper {g} closed on nothing",
                where=f"it is at {(centre + self.origin).round(4).tolist()} m, its radius "
                f"{self.stacked['radius'][w, g]:.4g} m, the nearest point {far:.4g} m away",
                fix="move its path to the object",
            )
        self.holds[own, g] = grip.holds
        self.stiffer[own, g] = grip.stiffer
        place = self._led["place"].reshape(*self.closed.shape, -1, self.row_length)
        place[own, g] = self.rows(grip.place)
        return Event(g, True, worlds, now, pose, grip, x)

    def _open(self, g: int, worlds: NDArray[np.int64], now: Array) -> Event:
        rows = self.state.numpy()
        x = self.pick(X, rows, worlds)
        pose = self.paths.pose(g, worlds, now)
        grip = Grip(self.holds[worlds, g].copy(), np.empty(0), self.stiffer[worlds, g].copy(), [])
        held = np.flatnonzero(grip.holds.any(axis=0))
        w, at = worlds[:, None], self.slots[held]
        for which, some in zip(
            (V, SPIN), released(x[:, held], pose, grip.holds[:, held]), strict=True
        ):
            for k in range(3 * (which is V or self.model.directed)):
                rows[w, which.start + k, at] += some[..., k]
        if self.setting.device.is_cuda:  # on the CPU they are the array's own memory
            self.state.assign(rows)
        self.closed[worlds, g] = 2
        self.holds[worlds, g] = 0
        self.stiffer[worlds, g] = 1.0
        return Event(g, False, worlds, now, pose, grip, x)

    def hold(self, worlds: NDArray[np.int64]) -> None:
        """Copy what worlds [k] hold, and the stiffness at its borders, to the kernels' model."""
        own, led, m = self.every(worlds), self._led, self.model
        led["holds"][own] = holds = self.holds[own]
        if self.ties is not None:
            place = led["place"].reshape(*self.closed.shape, -1, self.row_length)
            self.ties.hold(worlds, holds, place[own, :, :3][..., self.columns])
        borders = self.rows(m.at_borders(own, self.stiffer[own].prod(axis=1)))
        for k, row in enumerate(m.border_rows):
            led["inertia"][own, row] = borders[:, k]
        if self.setting.self_contact:
            free = 1.0 - np.any(holds & 1, axis=1)
            led["loose"][own] = self.rows((self.per_mass[own] * free)[:, None])
        if self.setting.device.is_cuda:  # on the CPU it is the kernels' own memory
            for name, values in led.items():
                getattr(self.device_model, name).assign(values)

    def gripper_forces(self) -> Array:
        """Forces of the body on grippers, [W, G, 3] [N]: momentum that held points would gain in a
        short step if they were let go, over its length."""
        self.load("let_go")
        W, dt = self.num_worlds, float(self.setting.substep.min())
        rows = self.zeros((2 * W, *self.state.shape[1:]))
        wp.copy(rows, self.state, count=self.state.size)
        self.launch(self.kernels.let_go, slice(0, W), [self.device_model, dt, rows])
        found = self.pick(V, rows.numpy())
        force = (self.model.mass / dt)[..., None] * (found[W:] - found[:W])
        held = np.where(self.closed == 1, 1, 0)[..., None] * (self.holds & 1)
        return np.einsum("wgn,wnk->wgk", held, force)

    # ---- arrays ----------------------------------------------------------------------------------

    def load(self, *names: str) -> None:
        """Compile kernels, or load them from Warp's cache, before threads call them."""
        for name in set(names) - self._loaded:
            self._loaded.add(name)
            load_kernels(getattr(self.kernels, name).module, self.setting.device, self.block)

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
            block_dim=self.block,
            record_cmd=record_cmd,
        )

    def _room(self) -> tuple[int, int]:
        """Length of rows that CUDA keeps in shared memory for a shell, 0 if there is no room, and
        how many blocks with such rows a multiprocessor takes."""
        device, m = self.setting.device, self.model
        if m.kind == "rod" or not device.is_cuda:
            return 0, 0
        room = ShellModel.shared_rows * m.row_length
        taken = room * np.dtype(self.setting.dtype).itemsize + OTHER_SHARED
        blocks = min(device.max_shared_memory_per_block // taken, 2)
        return m.row_length * min(blocks, 1), blocks

    def _device_model(self) -> Any:
        s, W, n, m = self.setting, self.num_worlds, self.num_points, self.model
        friction = s.table.friction if s.table is not None else 0.0
        radius = s.body.thickness / 2.0
        check_thick(s.obstacles, radius, m.widest)
        of_points = {
            "loose": self.per_mass[: W * int(s.self_contact), None],
            **m.arrays(s, self.air_density), **contact_arrays(s, n, m.widest),
        }  # fmt: skip
        for name, value in of_points.items():
            if isinstance(value, np.ndarray) and value.ndim > 1 and value.dtype != np.int32:
                of_points[name] = self.rows(value)
        made = self.filled(
            self.types.ThinModel, points=n, radius=radius, table=int(s.table is not None),
            slot=self.slots, gravity=spread(s.gravity, (W, 3), "gravity"), holds=self.holds,
            obstacles=numbers_of_obstacles(s.obstacles),
            damping=s.parameters["damping"],
            velocity_damping=spread(s.velocity_damping, (W,), "velocity_damping"),
            friction=spread(friction, (W,), "friction"), **of_points,
        )  # fmt: skip
        made.scratch = self.zeros((W, m.scratch_rows, self.row_length))
        pairs = W * made.contact, PAIRS * n, 2
        empty: Any = wp.empty  # only what counts tell of is ever read
        for name in ("near", "close", "touching"):
            setattr(made, name, empty(pairs, dtype=wp.int32, device=s.device))
        room = 28 + 7 * self.closed.shape[1] + 36 * (n + 2) + 10 * (self.holds[0].size + 1)
        # aligned; the last group takes no less than others
        made.interleaved = self.zeros((W + LANES, room) if self.interleaved else (0, 0))
        made.place = self.zeros((W * self.closed.shape[1], 7, self.row_length))
        paths = dict(Grippers.of(s.obstacles).arrays)
        paths["position"] = paths["position"] - self.origin
        made.obstacle_paths = paths_on(s.device, paths, self.real)
        return made
