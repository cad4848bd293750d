"""Batched simulation of one body in many worlds."""

import contextlib
import functools
import math
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.errors import DeviceError, ParameterError, SimulationError
from gendom.files import atomic_path
from gendom.materials import Material
from gendom.sim import kernels
from gendom.sim.bodies import Body
from gendom.sim.columns import CELL_BITS
from gendom.sim.gripper import Gripper

GRAVITY = (0.0, 0.0, -9.81)
"""Standard gravity, z up [m/s^2]."""

CFL = 0.4
"""Default share of the time in which a pressure wave crosses one cell."""

RECOVERY = 1000.0
"""Default rate at which F follows the particles' positions [1/s]."""

SUBSTEPS_A_GRAPH = 8
"""Substeps recorded in one CUDA graph."""

LARGEST_GRID = 1 << 24
"""Nodes a world may use; a run that wants more has an object that flies apart."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A horizontal plane that nothing falls through, with Coulomb friction per world."""

    height: float
    """[m]."""
    friction: float | ArrayLike = 0.3
    """Coefficient of friction, one number or [W]."""

    def __post_init__(self) -> None:
        check_numbers("table height", self.height)
        check_numbers("friction", self.friction, least=0.0)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Walls: no velocity outwards beyond them."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        check_numbers("box", (self.lower, self.upper))
        if np.any(np.asarray(self.lower) >= np.asarray(self.upper)):
            raise ParameterError(f"box must have lower < upper, got {self.lower}, {self.upper}")


class Simulator:
    """MLS-MPM of W worlds that differ in material, friction, gravity, damping and gripper paths.

    All worlds share the body's geometry. State arrays are [W, N]; nothing is stored for space
    that the body does not occupy.

    Args:
        body: What is simulated, at rest.
        materials: One a world.
        grippers: Grippers shared by all worlds, or one sequence of them for each world.
        table: Table, or None for open space.
        gravity: [3] or [W, 3] [m/s^2].
        damping: Rate at which velocities decay, one number or [W] [1/s].
        box: Walls, or None.
        recovery: Rate at which F of an elastic body follows its particles' positions [1/s];
            0 switches this off. Yielding bodies keep their own F.
        law: Elastic law, see ``gendom.materials.laws.LAWS``.
        substep: Fixed substep [s], or None for ``cfl`` times each world's stability limit.
        cfl: Share of the limit dx / wave speed (see ``stable_substep``).
        stiffness: Share of its material's E that each particle has, [N] or [W, N] [-].
        positions: [N, 3] or [W, N, 3] initial positions, if not the body's own [m].
        start_time: Time of the initial state [s].
        dtype: ``float32`` or ``float64``.
        device: ``cpu``, ``cuda`` or ``cuda:0`` and so on.
        threads: Worlds simulated side by side on the CPU (default: all cores given to us).

    Raises:
        ParameterError: If arguments do not fit together.
        DeviceError: If the device is not there.
    """

    def __init__(
        self,
        body: Body,
        materials: Sequence[Material],
        *,
        grippers: Sequence[Gripper] | Sequence[Sequence[Gripper]] = (),
        table: Table | None = None,
        gravity: ArrayLike = GRAVITY,
        damping: float | ArrayLike = 0.0,
        box: Box | None = None,
        recovery: float = RECOVERY,
        law: str = "neo-hookean",
        substep: float | None = None,
        cfl: float = CFL,
        stiffness: ArrayLike = 1.0,
        positions: ArrayLike | None = None,
        start_time: float = 0.0,
        dtype: str = "float32",
        device: str = "cpu",
        threads: int | None = None,
    ):
        if not materials:
            raise ParameterError("a simulation needs at least one material (one a world)")
        if dtype not in ("float32", "float64"):
            raise ParameterError(f"dtype must be float32 or float64, got {dtype!r}")
        check_numbers("damping", damping, least=0.0)
        check_numbers("recovery", recovery, least=0.0)
        check_numbers("gravity", gravity)
        check_numbers("start_time", start_time)
        check_numbers("cfl", cfl, above=0.0)
        if substep is not None:
            check_numbers("substep", substep, above=0.0)
        if threads is not None and threads < 1:
            raise ParameterError(f"threads must be at least 1, got {threads}")
        W = len(materials)
        self.body = body
        self.materials = tuple(materials)
        self.time = start_time
        self.device = open_device(device)
        self.dtype = dtype
        self.threads = threads or _cores()
        self._numpy = np.dtype(dtype)
        self._real = wp.float32 if dtype == "float32" else wp.float64
        self.law = law
        plastic = any(math.isfinite(m.yield_stress) for m in materials)
        try:
            self._k = kernels.make_kernels(self._real, law, plastic=plastic)
        except ValueError as error:
            raise ParameterError(str(error)) from None
        check_numbers("stiffness", stiffness, above=0.0)
        self.stiffness = self._spread(stiffness, (W, body.num_particles), "stiffness")
        stiffest = np.sqrt(self.stiffness.max(axis=1))
        self.failures: dict[int, SimulationError] = {}
        self._keep_going = False
        self.substep = np.array(
            [
                substep or stable_substep(m, body.dx, cfl=cfl) / s
                for m, s in zip(materials, stiffest, strict=True)
            ]
        )

        lame = np.array([m.lame for m in materials])
        k, real = self._k, self._real
        every = [self._grippers_of(grippers, w) for w in range(W)]
        count = {len(g) for g in every}
        if len(count) != 1:
            raise ParameterError(f"every world needs the same number of grippers, got {count}")
        self._every_gripper = every
        paths = _stack_paths(every)
        G = count.pop()
        friction = table.friction if table is not None else 0.0
        self._plastic = plastic
        self._recovery = 0.0 if plastic else recovery
        self._lattice = self._array(body.lattice, wp.int32)
        self._rest_frames = self._array(body.rest_frames, k.mat33)
        self._box = box
        self._table = table
        self._z0 = table.height if table is not None else 0.0
        self._world = {
            "mu": self._array(lame[:, :1] * self.stiffness, real),
            "lam": self._array(lame[:, 1:] * self.stiffness, real),
            "yield_stress": self._array(
                np.minimum([m.yield_stress for m in materials], 1e30), real
            ),
            "mass": self._array(np.array([m.density for m in materials]) * body.volume, real),
            "gravity": self._array(self._spread(gravity, (W, 3), "gravity"), k.vec3),
            "damping": self._array(self._spread(damping, (W,), "damping"), real),
            "friction": self._array(self._spread(friction, (W,), "friction"), real),
            "path_time": self._array(paths["time"], wp.float64),
            "path_position": self._array(paths["position"], wp.vec3d),
            "path_spin": self._array(paths["spin"], wp.vec3d),
            "hold_from": self._array(paths["hold_from"], wp.float64),
            "hold_until": self._array(paths["hold_until"], wp.float64),
            "grip_radius": self._array(paths["radius"], real),
            "grip_centre": self._zeros((W, G), k.vec3),
            "grip_velocity": self._zeros((W, G), k.vec3),
            "grip_spin": self._zeros((W, G), k.vec3),
            "grip_closed": self._zeros((W, G), wp.int32),
            "dt": self._zeros(W, wp.float64),
            "step": self._zeros(W, wp.int32),
            "age": self._zeros(W, wp.int32),
            "steps": self._zeros(W, wp.int32),
            "travel": self._zeros(W, real),
            "status": self._zeros(W, wp.int32),
            "culprit": self._zeros(W, wp.int32),
        }
        N = body.num_particles
        x0 = body.x if positions is None else np.asarray(positions, dtype=float)
        x0 = self._spread(x0, (W, N, 3), "positions")
        if not np.isfinite(x0).all():
            raise ParameterError("positions hold numbers that are not finite")
        self._state = {
            "x": self._array(x0, k.vec3),
            "v": self._zeros((W, N), k.vec3),
            "C": self._zeros((W, N), k.mat33),
            "F": self._array(np.broadcast_to(np.eye(3), (W, N, 3, 3)), k.mat33),
        }
        self._columns = _room_for(x0, body.dx)
        self._views: dict[str, NDArray[Any]] = {}
        self._state_views: dict[str, NDArray[Any]] = {}
        if not self.device.is_cuda:
            self._views = {name: a.numpy() for name, a in self._world.items()}
            self._state_views = {name: a.numpy() for name, a in self._state.items()}
        self._last_good = {name: wp.clone(a) for name, a in self._state.items()}
        self._last_good_time = np.full(W, start_time)
        self._scratch: dict[str, wp.array] = {}
        self._graph: Any = None
        self._graphs = 1

    # ---- what a user reads -------------------------------------------------------------------

    @property
    def num_worlds(self) -> int:
        return len(self.materials)

    def positions(self) -> NDArray[Any]:
        """[W, N, 3] particle positions now [m]."""
        return np.array(self._state["x"].numpy())

    def velocities(self) -> NDArray[Any]:
        """[W, N, 3] particle velocities now [m/s]."""
        return np.array(self._state["v"].numpy())

    def affine_velocities(self) -> NDArray[Any]:
        """[W, N, 3, 3] affine velocities C now: what APIC carries of a particle's surroundings,
        the velocity gradient of a rigid or evenly stretching body [1/s]."""
        return np.array(self._state["C"].numpy())

    def deformation_gradients(self) -> NDArray[Any]:
        """[W, N, 3, 3] deformation gradients F now [-]."""
        return np.array(self._state["F"].numpy())

    def substeps_done(self) -> NDArray[Any]:
        """[W] substeps that each world has done."""
        return np.array(self._world["age"].numpy())

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set particle velocities.

        Args:
            v: [3], [N, 3] or [W, N, 3] [m/s].
            affine: Affine velocities C, [3, 3], [N, 3, 3] or [W, N, 3, 3] [1/s]. Without them a
                body that is to spin loses some of its spin at once.

        Raises:
            ParameterError: If shapes do not fit.
        """
        shape = (self.num_worlds, self.body.num_particles, 3)
        C = self._spread(affine, (*shape, 3), "affine velocities")
        self._state["v"].assign(self._spread(v, shape, "velocities").astype(self._numpy))
        self._state["C"].assign(C.astype(self._numpy))

    def save_state(self, path: str | Path, *, last_good: bool = False) -> None:
        """Write x, v, C, F, the time and the parameters of all worlds to an ``.npz`` file.

        Args:
            path: File to write, atomically.
            last_good: The state at the start of the last frame, each world's own (``time`` is then
                [W]); after a failure the last that means anything.
        """
        kept = self._last_good if last_good else self._state
        state = {name: a.numpy() for name, a in kept.items()}
        with atomic_path(Path(path)) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(
                file,
                time=self._last_good_time if last_good else self.time,
                E=[m.E for m in self.materials],
                nu=[m.nu for m in self.materials],
                density=[m.density for m in self.materials],
                substep=self.substep,
                **state,  # pyright: ignore[reportArgumentType]
            )

    def run(
        self,
        times: ArrayLike,
        *,
        on_frame: Callable[[int], None] | None = None,
        particles: ArrayLike | None = None,
        keep_going: bool = False,
    ) -> NDArray[np.floating]:
        """Simulate to each of the given times.

        Args:
            times: [T] not decreasing, not before ``self.time`` [s].
            on_frame: Called with the number of frames done, from one thread at a time.
            particles: [P] indices of the particles to record (default: all).
            keep_going: Let a world that diverges stand still while the others go on; its error is
                found in ``failures``, and its positions are NaN from then on.

        Returns:
            [T, W, P, 3] positions [m].

        Raises:
            ParameterError: If the times run backwards.
            SimulationError: If a world diverges or a particle turns inside out, unless told to
                keep going. The error names
                world, time and parameters; ``save_state(path, last_good=True)`` then keeps the
                last frame before it.
        """
        t = self._checked(times)
        chosen = slice(None) if particles is None else np.asarray(particles, dtype=int)
        try:
            picked = np.arange(self.body.num_particles)[chosen]
        except IndexError:
            raise ParameterError(
                f"particles must be indices below {self.body.num_particles}"
            ) from None
        frames = np.empty((len(t), self.num_worlds, len(picked), 3), dtype=self._numpy)
        self._keep_going = keep_going
        if self.device.is_cuda:
            self._run_batch(t, frames, picked, on_frame)
        else:
            self._run_cpu(t, frames, picked, on_frame)
        self.time = float(t[-1])
        return frames

    def _checked(self, times: ArrayLike) -> NDArray[np.float64]:
        """[T] times that the simulator can be run to."""
        t = np.atleast_1d(np.asarray(times, dtype=float))
        if t.ndim != 1 or len(t) == 0 or not np.isfinite(t).all():
            raise ParameterError("times must be a non-empty list of finite numbers [s]")
        if np.any(np.diff(np.concatenate([[self.time], t])) < 0.0):
            raise ParameterError("times must not decrease nor lie before the simulator's time")
        return t

    # ---- CPU: every thread takes a world from the first frame to the last -----------------------

    def _run_cpu(self, times, frames, picked, on_frame) -> None:
        views = self._views
        began = self.time
        done = np.zeros(self.num_worlds, dtype=int)
        stop = False

        def one_world(w: int) -> None:
            grid = self._make_grid(1)
            views["travel"][w] = 1e30
            now = began
            for f, until in enumerate(times):
                if stop:
                    return
                self._last_good_time[w] = now
                for name, good in self._last_good.items():
                    good.numpy()[w] = self._state_views[name][w]
                self._plan(views, w, until - now)
                if w not in self.failures:
                    try:
                        grid = self._advance_world(w, now, grid)
                    except SimulationError as error:
                        self.failures[w] = error
                if w in self.failures:
                    if not self._keep_going:
                        return
                    frames[f:, w] = np.nan
                    done[w] = len(times)
                    return
                now = until
                frames[f, w] = self._state_views["x"][w, picked]
                done[w] = f + 1

        # the slowest worlds go first, so that no thread ends alone
        order = np.argsort(self.substep)
        with ThreadPoolExecutor(max_workers=self.threads) as pool:
            jobs = [pool.submit(one_world, int(w)) for w in order]
            try:
                reported = 0
                while not all(job.done() for job in jobs):
                    for job in jobs:
                        if not job.done():
                            _wait(job)
                            break
                    if on_frame is not None and done.min() > reported:
                        reported = int(done.min())
                        on_frame(reported)
            except BaseException:
                stop = True
                raise
        if on_frame is not None and done.min() > reported:
            on_frame(int(done.min()))
        for job in jobs:
            job.result()
        if self.failures and not self._keep_going:
            raise self.failures[min(self.failures)]

    def _advance_world(self, w: int, now: float, grid: dict[str, wp.array]) -> dict[str, wp.array]:
        """Take world w through its planned substeps; returns the grid, larger if it had to grow.

        Raises:
            SimulationError: If the world diverges.
        """
        views = self._views
        while views["step"][w] < views["steps"][w]:
            self._launch_advance(w, now, grid, self._state, w, 0, grid["grid"])
            status = views["status"][w]
            if status == kernels.GRID_FULL:
                try:
                    grid = self._grow_grid(grid)
                except _GridExhausted:
                    views["status"][w] = status = kernels.DIVERGED
            if status not in (kernels.OK, kernels.GRID_FULL):
                raise self._failure(w, now, views)
        return grid

    def _launch_advance(
        self,
        w: int,
        now: float,
        grid: dict[str, wp.array],
        rows: dict[str, wp.array],
        first: int,
        stride: int,
        velocity: wp.array,
    ) -> None:
        """Call the kernel on state rows and grid; see there for ``first`` and ``stride``."""
        a = self._world
        wp.launch(
            self._k.advance,
            dim=1,
            inputs=[
                w, a["step"], a["age"], a["steps"], now, a["dt"],
                a["mu"], a["lam"], a["yield_stress"], a["mass"], self.body.volume,
                self._lattice, self._rest_frames, self._recovery,
                self.body.dx, self._z0, a["gravity"], a["damping"],
                int(self._table is not None), a["friction"], *self._walls(),
                a["path_time"], a["path_position"], a["path_spin"],
                a["hold_from"], a["hold_until"], a["grip_radius"],
                a["grip_centre"], a["grip_velocity"], a["grip_spin"], a["grip_closed"],
                first, stride, rows["x"], rows["v"], rows["C"], rows["F"],
                *(grid[name] for name in _GRID_ORDER), grid["layout_of"], grid["grid"],
                velocity, a["travel"], a["status"], a["culprit"],
            ],
            device=self.device,
        )  # fmt: skip

    # ---- CUDA: all worlds in lockstep, substeps replayed from a graph --------------------------

    def _run_batch(self, times, frames, picked, on_frame) -> None:
        self._begin_batch()
        chosen = self._state["x"][:, wp.array(picked, dtype=wp.int32, device=self.device)]
        now = self.time
        for f, until in enumerate(times):
            for name, array in self._state.items():
                wp.copy(self._last_good[name], array)
            self._last_good_time[:] = now
            self._plan_batch(now, until)
            while self._advance_batch(now):
                pass
            now = float(until)
            self.time = now
            frames[f] = chosen.contiguous().numpy()
            frames[f, list(self.failures)] = np.nan
            if on_frame is not None:
                on_frame(f + 1)

    def _begin_batch(self) -> None:
        """Make the batch's grid if there is none; columns are laid anew in any case."""
        a, W = self._world, self.num_worlds
        if not self._scratch:
            self._scratch = self._make_grid(W) | {
                "fastest": self._zeros((W, SUBSTEPS_A_GRAPH), self._real),
                "trouble": self._zeros(W, wp.int32),
                "done": self._zeros(W, wp.int32),
                "stale": self._zeros(W, wp.int32),
                "time": self._zeros(1, wp.float64),
            }
            self._scratch["velocity"] = self._zeros(self._scratch["grid"].shape, self._k.vec4)
            placed = (SUBSTEPS_A_GRAPH * W, a["grip_closed"].shape[1])
            for name in ("grip_centre", "grip_velocity", "grip_spin", "grip_closed"):
                self._scratch[name] = self._zeros(placed, a[name].dtype)
        self._graph = None
        self._graphs = 1
        a["travel"].fill_(1e30)

    def _plan_batch(self, now: float, until: float) -> None:
        """Set every world's counters to the frame from ``now`` to ``until`` [s]."""
        a = self._world
        steps, dt = self._divide(slice(None), until - now)
        steps[list(self.failures)] = 0
        a["steps"].assign(steps)
        a["dt"].assign(dt)
        a["step"].zero_()
        a["status"].zero_()
        self._scratch["time"].fill_(now)

    def _advance_batch(self, now: float, *, most: int = 1 << 30) -> bool:
        """Take all worlds through some of their planned substeps, at most so many graphs.

        Returns:
            Whether there is more to do.

        Raises:
            SimulationError: If a world diverges, unless told to keep going.
        """
        a, g = self._world, self._scratch
        left = int((a["steps"].numpy() - a["step"].numpy()).max())
        if left <= 0:
            return False
        if self._graph is None and self.device.is_cuda:
            with wp.ScopedCapture(device=self.device) as capture:
                self._launch_graph()
            self._graph = capture.graph
        # a few at first: a world that finds no room for its nodes is soon noticed
        self._graphs = min(2 * self._graphs, math.ceil(left / SUBSTEPS_A_GRAPH), most)
        for _ in range(self._graphs):
            if self._graph is None:
                self._launch_graph()
            else:
                wp.capture_launch(self._graph)
        self._launch_tally(g)
        return self._settle_batch(now)

    def _settle_batch(self, now: float) -> bool:
        """See to worlds that found no room or failed; whether there is more to do.

        Raises:
            SimulationError: If a world diverged, unless told to keep going.
        """
        a, g = self._world, self._scratch
        status = a["status"].numpy()
        full = status == kernels.GRID_FULL
        if full.any():
            g |= self._grow_grid(g)
            g["velocity"] = self._zeros(g["grid"].shape, self._k.vec4)
            self._graph = None
            self._graphs = 1
            a["travel"].fill_(1e30)
            status = np.where(full, kernels.OK, status).astype(np.int32)
            a["status"].assign(status)
        failed = np.flatnonzero(status != kernels.OK)
        if len(failed):
            views = {n: a[n].numpy() for n in ("status", "step", "steps", "dt", "culprit")}
            for w in failed:
                self.failures.setdefault(int(w), self._failure(int(w), now, views))
            if not self._keep_going:
                raise self.failures[int(failed[0])]
            views["steps"][failed] = views["step"][failed]
            a["steps"].assign(views["steps"])
        return bool((a["steps"].numpy() > a["step"].numpy()).any())

    def _launch_graph(self) -> None:
        self._launch_layout(self._scratch)
        for r in range(SUBSTEPS_A_GRAPH):
            self._launch_substep(self._scratch, r, self._state, self._state)

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device, block_dim=128)

    def _launch_tally(self, g: dict[str, wp.array]) -> None:
        a = self._world
        self._launch(self._k.tally, self.num_worlds, [
            self.body.dx, a["dt"], a["step"], a["age"], a["travel"], a["status"], g["trouble"],
            g["done"], g["fastest"], g["stale"], g["bounds"], g["count"],
        ])  # fmt: skip

    def _launch_layout(self, g: dict[str, wp.array]) -> None:
        """Begin a graph: place its grippers, lay the columns of worlds that travelled too far."""
        k, a = self._k, self._world
        W, N = self.num_worlds, self.body.num_particles
        x, dx, stale = self._state["x"], self.body.dx, g["stale"]
        low, high = g["low"], g["high"]
        self._launch_tally(g)
        self._launch(k.place, (SUBSTEPS_A_GRAPH, W), [
            a["step"], a["dt"], g["time"], a["path_time"], a["path_position"], a["path_spin"],
            a["hold_from"], a["hold_until"],
            g["grip_centre"], g["grip_velocity"], g["grip_spin"], g["grip_closed"],
        ])  # fmt: skip
        self._launch(k.locate, (W, N), [stale, x, dx, g["bounds"]])
        self._launch(k.empty, low.shape, [stale, low, high])
        self._launch(k.mark, (W, N), [stale, x, dx, self._z0, g["bounds"], low, high])
        self._launch(k.lay, low.shape, [
            stale, *(g[name] for name in _GRID_ORDER), a["status"],
        ])  # fmt: skip

    def _launch_substep(
        self,
        g: dict[str, wp.array],
        r: int,
        before: dict[str, wp.array],
        after: dict[str, wp.array],
        momentum: wp.array | None = None,
    ) -> None:
        """Substep r of a graph, from one state to the next, for every world that still runs.

        ``momentum`` is an empty grid that stays as the substep left it, for the reverse.
        """
        k, a, s = self._k, self._world, before
        recorded = momentum is not None
        momentum = g["grid"] if momentum is None else momentum
        W, N = self.num_worlds, self.body.num_particles
        going = [
            r, self.body.dx, a["dt"], a["step"], a["steps"], a["status"], g["trouble"],
            a["travel"], g["fastest"],
        ]  # fmt: skip
        grip = [g["grip_centre"], g["grip_velocity"], g["grip_spin"], g["grip_closed"]]
        self._launch(k.p2g, (W, N), [
            *going, g["stale"], a["age"], self._lattice, self._rest_frames, self._recovery,
            s["x"], s["v"], s["C"], s["F"], a["mu"], a["lam"], a["mass"], self.body.volume,
            self._z0, g["bounds"], g["start"], momentum,
        ])  # fmt: skip
        self._launch(k.grid_update, (W, g["grid"].shape[1]), [
            *going, self._z0, a["gravity"], a["damping"], int(self._table is not None),
            a["friction"], *self._walls(), *grip, a["grip_radius"],
            g["bounds"], g["cell"], g["level"], g["count"], int(recorded), momentum,
            g["velocity"],
        ])  # fmt: skip
        self._launch(k.g2p, (W, N), [
            *going, g["done"], a["mu"], a["yield_stress"], self._z0, g["bounds"], g["start"],
            g["velocity"], s["x"], s["F"], after["x"], after["v"], after["C"], after["F"],
            a["culprit"],
        ])  # fmt: skip

    # ---- shared by both devices ------------------------------------------------------------------

    def _divide(self, w: int | slice, interval: float) -> tuple[Any, Any]:
        """Number and length [s] of a frame's equal substeps, no longer than each world's limit."""
        if not interval > 0.0:
            return 0 * self.substep[w].astype(np.int32), 0.0 * self.substep[w]
        n = np.maximum(1, np.ceil(interval / self.substep[w] - 1e-9)).astype(np.int32)
        return n, interval / n

    def _plan(self, views, w: int, interval: float) -> None:
        """Set world w's counters to a frame's interval [s]."""
        views["steps"][w], views["dt"][w] = self._divide(w, interval)
        views["step"][w] = 0
        views["status"][w] = kernels.OK

    def _failure(self, w: int, frame_start: float, views) -> SimulationError:
        m = self.materials[w]
        time = frame_start + float(views["step"][w]) * float(views["dt"][w])
        inverted = views["status"][w] == kernels.INVERTED
        what = (
            "a particle turned inside out"
            if inverted
            else "velocities grew beyond one cell a substep"
        )
        return SimulationError(
            what,
            where=f"world {w} at {time:.4f} s (E {m.E:.6g} Pa, nu {m.nu:.4g}, density "
            f"{m.density:.6g} kg/m^3, substep {views['dt'][w]:.3g} s)",
            fix="use a smaller substep or cfl, or slower gripper motion",
            world=w,
            time=time,
            parameters={"E": m.E, "nu": m.nu, "density": m.density},
            particle=int(views["culprit"][w]) if inverted else None,
        )

    def _walls(self) -> tuple[int, Any, Any]:
        """Whether there are walls, and where."""
        if self._box is None:
            return 0, self._k.vec3(), self._k.vec3()
        return 1, self._k.vec3(*self._box.lower), self._k.vec3(*self._box.upper)

    def _make_grid(self, layouts: int, *, make: Any = wp.zeros) -> dict[str, wp.array]:
        X, Y, M = self._columns

        def array(shape: Any, dtype: Any) -> wp.array:
            return make(shape, dtype=dtype, device=self.device)

        return {
            "bounds": array((layouts, 4), wp.int32),
            "low": array((layouts, X, Y), wp.int32),
            "high": array((layouts, X, Y), wp.int32),
            "start": array((layouts, X, Y), wp.int32),
            "cell": array((layouts, M), wp.int32),
            "level": array((layouts, M), wp.int32),
            "count": array(layouts, wp.int32),
            "layout_of": array(layouts, wp.int32),
            "grid": array((layouts, M), self._k.vec4),
        }

    def _grow_grid(self, grid: dict[str, wp.array]) -> dict[str, wp.array]:
        """A larger grid for the same worlds; its columns are laid anew before the next substep."""
        bounds = grid["bounds"].numpy()
        self._make_room(bounds, grid)
        return self._make_grid(len(bounds))

    def _make_room(self, bounds: NDArray[Any], grid: dict[str, wp.array]) -> None:
        """Let later grids hold these bounds [L, 4], for which this grid was too small."""
        window = (bounds[:, 2:] - bounds[:, :2] + 1).max(axis=0)
        X, Y, M = self._columns
        have = grid["low"].shape[1:]
        limit = 1 << CELL_BITS
        if window.max() > limit or M > LARGEST_GRID:
            raise _GridExhausted
        if window[0] > have[0] or window[1] > have[1]:
            X = max(X, min(limit, int(window[0]) + 8))
            Y = max(Y, min(limit, int(window[1]) + 8))
        else:
            M = max(M, 2 * grid["grid"].shape[1])
        self._columns = (X, Y, M)

    @staticmethod
    def _grippers_of(grippers: Sequence[Any], w: int) -> Sequence[Gripper]:
        if len(grippers) and not isinstance(grippers[0], Gripper):
            if w >= len(grippers):
                raise ParameterError(f"no grippers given for world {w} of the batch")
            return grippers[w]
        return grippers

    def _spread(self, values: Any, shape: tuple[int, ...], name: str) -> NDArray[np.floating]:
        try:
            return np.broadcast_to(np.asarray(values, dtype=float), shape)
        except ValueError:
            raise ParameterError(
                f"{name} has shape {np.shape(values)}, which does not fit {shape}"
            ) from None

    def _array(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _zeros(self, shape: Any, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)


def check_numbers(
    name: str, values: ArrayLike, *, least: float = -math.inf, above: float = -math.inf
) -> None:
    """Refuse numbers that are not finite or lie below ``least``, or not above ``above``.

    Raises:
        ParameterError: With the name and the offending values.
    """
    a = np.asarray(values, dtype=float)
    if not np.isfinite(a).all() or (a < least).any() or (a <= above).any():
        limit = f" and above {above:g}" if above > -math.inf else ""
        limit = f" and at least {least:g}" if least > -math.inf else limit
        raise ParameterError(f"{name} must be finite{limit}, got {values}")


class _GridExhausted(Exception):
    """The object spreads over more nodes than any real one does."""


_GRID_ORDER = ("bounds", "low", "high", "start", "cell", "level", "count")


def stable_substep(material: Material, dx: float, *, cfl: float = CFL) -> float:
    """Longest substep [s] at a share ``cfl`` of the Courant limit dx / wave speed.

    The wave speed is that of small strains; ``CFL`` leaves room for stiffening under compression.
    Source: Courant, Friedrichs and Lewy (1928).
    """
    return cfl * dx / material.wave_speed


def open_device(name: str) -> Any:
    """The Warp device of that name.

    Raises:
        DeviceError: If there is none, with what to use instead.
    """
    _start_warp()
    try:
        if name.startswith("cuda") and not wp.is_cuda_available():
            raise ValueError(name)
        return wp.get_device(name)
    except (ValueError, RuntimeError):
        raise DeviceError(
            f"there is no device {name!r} on this machine",
            where="device",
            fix="use --device cpu, or install an NVIDIA driver for cuda",
        ) from None


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _start_warp() -> None:
    """Start Warp without its banner and its remark that a machine has no GPU."""
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
    sys.stderr.flush()
    kept = os.dup(2)  # the remark comes from native code, past sys.stderr
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _stack_paths(every: Sequence[Sequence[Gripper]]) -> dict[str, NDArray[np.floating]]:
    """Gripper paths as arrays [W, G, K]; shorter ones repeat their last knot."""
    W, G = len(every), len(every[0])
    K = max([2] + [len(np.asarray(g.time)) for grippers in every for g in grippers])
    out = {
        "time": np.zeros((W, G, K)),
        "position": np.zeros((W, G, K, 3)),
        "spin": np.zeros((W, G, K, 3)),
        "hold_from": np.zeros((W, G)),
        "hold_until": np.zeros((W, G)),
        "radius": np.zeros((W, G)),
    }
    for w, grippers in enumerate(every):
        for g, gripper in enumerate(grippers):
            t = np.asarray(gripper.time)
            out["time"][w, g] = np.concatenate([t, np.full(K - len(t), t[-1])])
            out["position"][w, g] = np.concatenate(
                [gripper.position, np.repeat(np.asarray(gripper.position)[-1:], K - len(t), 0)]
            )
            out["spin"][w, g, : len(t)] = gripper.spin
            out["hold_from"][w, g] = gripper.hold_from
            out["hold_until"][w, g] = gripper.hold_until
            out["radius"][w, g] = gripper.radius
    return out


def _room_for(x: NDArray[np.floating], dx: float) -> tuple[int, int, int]:
    """Columns in x and y and nodes that the first grid offers; grows when the body needs more."""
    extent = (x.max(axis=1) - x.min(axis=1)).max(axis=0) / dx
    side = int(np.ceil(extent[:2].max())) + 8
    cell = np.floor(x[0] / dx).astype(np.int64)
    cell -= cell.min(axis=0)
    cells = len(np.unique(np.ravel_multi_index(tuple(cell.T), tuple(cell.max(axis=0) + 1))))
    return min(side, 1 << CELL_BITS), min(side, 1 << CELL_BITS), 8 * cells + 256


def _wait(job) -> None:
    with contextlib.suppress(TimeoutError):
        job.exception(timeout=0.05)
