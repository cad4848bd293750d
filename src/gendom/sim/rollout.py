"""Derivatives through whole simulations, by reverse mode with recorded or repeated substeps."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.sim import kernels
from gendom.sim.reverse import NOT_FINITE, make_reverse
from gendom.sim.simulator import Simulator

MEMORY = 512 << 20
"""Default bound on what a rollout keeps for its reverse [bytes]."""

STRETCH = 64
"""Substeps that are recorded, and reversed, at a time."""


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """Derivatives of a loss by everything that a simulation was given.

    Not differentiated: when grippers open and close, what they hold, how they turn, the substep's
    length, and whether a grid node sticks, slides or is held.
    """

    E: NDArray[np.float64]
    """[W] by Young's modulus [1/Pa]."""
    nu: NDArray[np.float64]
    """[W] by Poisson's ratio."""
    density: NDArray[np.float64]
    """[W] by density [m^3/kg]."""
    yield_stress: NDArray[np.float64]
    """[W] by yield stress [1/Pa]; 0 where nothing yields."""
    stiffness: NDArray[np.float64]
    """[W, N] by each particle's share of E."""
    damping: NDArray[np.float64]
    """[W] by the rate of damping [s]."""
    friction: NDArray[np.float64]
    """[W] by the table's coefficient of friction."""
    gravity: NDArray[np.float64]
    """[W, 3] by gravity [s^2/m]."""
    positions: NDArray[np.floating]
    """[W, N, 3] by the initial positions, the rest shape unchanged [1/m]."""
    velocities: NDArray[np.floating]
    """[W, N, 3] by the initial velocities [s/m]."""
    gripper_positions: NDArray[np.float64]
    """[W, G, K, 3] by the grippers' positions at their knots [1/m]; shorter paths repeat their
    last knot, whose derivatives stand at the first of the repeats."""


class Rollout:
    """A simulation that remembers enough to be differentiated.

    ``forward`` runs it; ``backward`` takes the derivative of any loss by the recorded positions
    and returns that by everything that went in. Where recording every substep would need more
    than ``memory``, states are kept every few substeps and the stretches between are run again.

    Args:
        simulator: Not run before; on the CPU.
        memory: Bound on what is kept [bytes].

    Raises:
        ParameterError: If the simulator has been run or stands on another device.
    """

    def __init__(self, simulator: Simulator, *, memory: float = MEMORY):
        if simulator.device.is_cuda:
            raise ParameterError("derivatives by reverse mode are made on the CPU: device='cpu'")
        if simulator._views["age"].any():
            raise ParameterError("a rollout starts from a simulator that has not been run")
        self.simulator = simulator
        self.memory = memory
        self._stretches: list[list[_Stretch]] = []
        self._times: NDArray[np.float64] | None = None

    def forward(self, times: ArrayLike) -> NDArray[np.floating]:
        """Simulate to each of the given times, as ``Simulator.run`` does.

        Returns:
            [T, W, N, 3] positions [m].

        Raises:
            ParameterError: If the times run backwards, or if called twice.
            SimulationError: If a world diverges.
        """
        if self._times is not None:
            raise ParameterError("a rollout runs forward once; make another one")
        s = self.simulator
        began = s.time
        t = s._checked(times)
        self._stretches = [_plan(s, w, began, t) for w in range(s.num_worlds)]
        substeps = sum(stretch.substeps for world in self._stretches for stretch in world)
        keeps_all = substeps * _Recording.bytes_a_substep(s) <= self.memory
        frames = np.empty((len(t), s.num_worlds, s.body.num_particles, 3), dtype=s.dtype)

        def one_world(w: int) -> None:
            grid = s._make_grid(1)
            for stretch in self._stretches[w]:
                begin = {name: view[w].copy() for name, view in s._state_views.items()}
                if not stretch.substeps:
                    pass
                elif keeps_all:
                    stretch.recording = _record(s, w, stretch, begin)
                    for name, rows in stretch.recording.rows.items():
                        s._state_views[name][w] = rows.numpy()[stretch.substeps]
                else:
                    stretch.begin = begin
                    _begin(s, w, stretch)
                    grid = s._advance_world(w, stretch.time, grid)
                if stretch.ends_frame >= 0:
                    frames[stretch.ends_frame, w] = s._state_views["x"][w]

        _for_worlds(s, one_world)
        s.time = float(t[-1])
        self._times = t
        return frames

    def backward(self, positions_bar: ArrayLike) -> Gradients:
        """Derivatives of a loss from its derivative by the positions of ``forward``.

        Args:
            positions_bar: [T, W, N, 3] derivative of the loss by each recorded position [1/m].

        Raises:
            ParameterError: If shapes do not fit or ``forward`` was not called.
            SimulationError: If a derivative is not finite: names particle, time and cause.
        """
        if self._times is None:
            raise ParameterError("call forward before backward")
        s = self.simulator
        W, N = s.num_worlds, s.body.num_particles
        bar = np.asarray(positions_bar, dtype=float)
        if bar.shape != (len(self._times), W, N, 3):
            raise ParameterError(
                f"positions_bar must be {(len(self._times), W, N, 3)}, got {bar.shape}"
            )
        if not np.isfinite(bar).all():
            raise ParameterError("positions_bar holds numbers that are not finite")
        sums = _Sums(s)

        def one_world(w: int) -> None:
            spare: _Recording | None = None
            for stretch in reversed(self._stretches[w]):
                if stretch.ends_frame >= 0:
                    sums.views["x"][w] += bar[stretch.ends_frame, w]
                if stretch.substeps:
                    recording = stretch.recording
                    if recording is None:
                        assert stretch.begin is not None  # kept by forward
                        recording = spare = _record(s, w, stretch, stretch.begin, spare)
                    _reverse(s, w, stretch, recording, sums)

        _for_worlds(s, one_world)
        return sums.gradients(s)


@dataclass
class _Stretch:
    """Consecutive substeps of one world inside one frame."""

    time: float  # of the frame's substep 0 [s]
    dt: float  # [s]
    begun: int  # number in the frame of the first substep
    age: int  # substeps before it in all
    substeps: int
    ends_frame: int  # the frame that its last substep completes, or -1
    begin: dict[str, NDArray[Any]] | None = None
    recording: "_Recording | None" = None


def _plan(s: Simulator, w: int, began: float, times: NDArray[np.float64]) -> list[_Stretch]:
    """Cut a world's substeps into stretches that end with frames."""
    plan: list[_Stretch] = []
    now, age = began, 0
    for f, until in enumerate(times):
        n, dt = (value.item() for value in s._divide(w, until - now))
        cuts = [*range(0, n, STRETCH), n] if n else [0, 0]
        for a, b in itertools.pairwise(cuts):
            ends = f if b == n else -1
            plan.append(_Stretch(now, dt, a, age + a, b - a, ends))
        age += n
        now = float(until)
    return plan


class _Recording:
    """States, grids and layouts of consecutive substeps of one world."""

    def __init__(self, s: Simulator, slots: int):
        # nothing is read before it was written: memory that is never needed is never touched
        shape = (slots + 1, s.body.num_particles)
        k = s._k
        self.slots = slots
        self.grid = s._make_grid(slots, make=wp.empty)
        self.rows = {
            "x": wp.empty(shape, dtype=k.vec3, device=s.device),
            "v": wp.empty(shape, dtype=k.vec3, device=s.device),
            "C": wp.empty(shape, dtype=k.mat33, device=s.device),
            "F": wp.empty(shape, dtype=k.mat33, device=s.device),
        }
        self.velocity = s._zeros((1, self.grid["grid"].shape[1]), k.vec4)

    @staticmethod
    def bytes_a_substep(s: Simulator) -> int:
        X, Y, M = s._columns
        real = np.dtype(s.dtype).itemsize
        return real * (24 * s.body.num_particles + 4 * M) + 4 * (3 * X * Y + 2 * M + 6)


def _begin(s: Simulator, w: int, stretch: _Stretch) -> None:
    """Set world w's counters to the stretch; its columns are laid anew first."""
    views = s._views
    views["step"][w] = stretch.begun
    views["steps"][w] = stretch.begun + stretch.substeps
    views["dt"][w] = stretch.dt
    views["age"][w] = stretch.age
    views["travel"][w] = 1e30
    views["status"][w] = kernels.OK


def _record(
    s: Simulator,
    w: int,
    stretch: _Stretch,
    begin: dict[str, NDArray[Any]],
    spare: _Recording | None = None,
) -> _Recording:
    """Run a stretch from its first state and keep everything its reverse needs.

    Into ``spare`` where that is long enough.
    """
    recording = spare
    if recording is None or recording.slots < stretch.substeps:
        recording = _Recording(s, stretch.substeps)
    while True:
        for name, rows in recording.rows.items():
            rows.numpy()[0] = begin[name]
        _begin(s, w, stretch)
        s._launch_advance(w, stretch.time, recording.grid, recording.rows, 0, 1, recording.velocity)
        status = s._views["status"][w]
        if status != kernels.GRID_FULL:
            break
        s._make_room(recording.grid["bounds"].numpy()[:1], recording.grid)
        recording = _Recording(s, stretch.substeps)
    if status != kernels.OK:
        raise s._failure(w, stretch.time, s._views)
    return recording


def _reverse(s: Simulator, w: int, stretch: _Stretch, recording: _Recording, sums: "_Sums") -> None:
    """Carry world w's derivatives from the end of a recorded stretch to its beginning."""
    a, r, g, b = s._world, recording.rows, recording.grid, sums.arrays
    nodes = g["grid"].shape[1]
    wp.launch(
        make_reverse(s._real, s.law, plastic=s._plastic),
        dim=1,
        inputs=[
            w, stretch.substeps, stretch.begun, stretch.age, stretch.time, stretch.dt,
            a["mu"], a["lam"], a["yield_stress"], a["mass"], s.body.volume,
            s._lattice, s._rest_frames, s._recovery,
            s.body.dx, s._z0, a["gravity"], a["damping"],
            int(s._table is not None), a["friction"], *s._walls(),
            a["path_time"], a["path_position"], a["path_spin"],
            a["hold_from"], a["hold_until"], a["grip_radius"],
            a["grip_centre"], a["grip_velocity"], a["grip_spin"], a["grip_closed"],
            r["x"], r["v"], r["C"], r["F"],
            g["bounds"], g["start"], g["cell"], g["level"], g["count"], g["layout_of"], g["grid"],
            recording.velocity, s._zeros((1, nodes), s._k.vec4),
            b["grip_centre"], b["grip_velocity"], b["keep"],
            b["x"], b["v"], b["C"], b["F"],
            b["mu"], b["lam"], b["mass"], b["yield"],
            b["friction"], b["damping"], b["gravity"], b["path"],
            b["status"], b["slot"], a["culprit"],
        ],
        device=s.device,
    )  # fmt: skip
    if sums.views["status"][w] == NOT_FINITE:
        raise _overflow(s, w, stretch, recording, sums)


def _overflow(s: Simulator, w: int, stretch: _Stretch, recording: _Recording, sums: "_Sums"):
    slot, particle = int(sums.views["slot"][w]), int(s._views["culprit"][w])
    m = s.materials[w]
    time = stretch.time + (stretch.begun + slot) * stretch.dt
    J = float(np.linalg.det(recording.rows["F"].numpy()[slot, particle].astype(float)))
    cause = (
        f"its volume is {J:.2g} of that at rest, where the stress law is singular"
        if J < 0.1
        else f"derivatives grew beyond {s.dtype} over the substeps after it"
    )
    return SimulationError(
        f"the derivative by the state of particle {particle} is not finite: {cause}",
        where=f"world {w}, substep {stretch.age + slot} ({time:.4f} s; E {m.E:.6g} Pa, "
        f"nu {m.nu:.4g}, density {m.density:.6g} kg/m^3)",
        fix="use float64, a shorter rollout, or more damping",
        world=w,
        time=time,
        parameters={"E": m.E, "nu": m.nu, "density": m.density},
        particle=particle,
    )


class _Sums:
    """Derivatives by state and parameters while they are summed up."""

    def __init__(self, s: Simulator):
        W, N = s.num_worlds, s.body.num_particles
        G, K = s._world["path_time"].shape[1:]
        k, real = s._k, s._real
        self.arrays = {
            "x": s._zeros((W, N), k.vec3),
            "v": s._zeros((W, N), k.vec3),
            "C": s._zeros((W, N), k.mat33),
            "F": s._zeros((W, N), k.mat33),
            "mu": s._zeros((W, N), real),
            "lam": s._zeros((W, N), real),
            "mass": s._zeros((W, N), real),
            "yield": s._zeros((W, N), real),
            "friction": s._zeros(W, wp.float64),
            "damping": s._zeros(W, wp.float64),
            "gravity": s._zeros(W, wp.vec3d),
            "path": s._zeros((W, G, K), wp.vec3d),
            "grip_centre": s._zeros((W, G), wp.vec3d),
            "grip_velocity": s._zeros((W, G), wp.vec3d),
            "keep": s._zeros(W, wp.float64),
            "status": s._zeros(W, wp.int32),
            "slot": s._zeros(W, wp.int32),
        }
        self.views: dict[str, NDArray[Any]] = {n: a.numpy() for n, a in self.arrays.items()}

    def gradients(self, s: Simulator) -> Gradients:
        """What the sums mean for the numbers that a user gave."""
        v = self.views
        E = np.array([m.E for m in s.materials])[:, None]
        nu = np.array([m.nu for m in s.materials])[:, None]
        mu_bar, lam_bar = v["mu"].astype(float), v["lam"].astype(float)
        # mu = E / (2 (1 + nu)), lam = E nu / ((1 + nu) (1 - 2 nu)), times the stiffness
        mu_E = 1.0 / (2.0 * (1.0 + nu))
        lam_E = nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        mu_nu = -E / (2.0 * (1.0 + nu) ** 2)
        lam_nu = E * (1.0 + 2.0 * nu**2) / ((1.0 + nu) * (1.0 - 2.0 * nu)) ** 2
        by_E = mu_bar * mu_E + lam_bar * lam_E
        path = np.array(v["path"])
        for w, grippers in enumerate(s._every_gripper):
            for g, gripper in enumerate(grippers):
                last = len(np.asarray(gripper.time)) - 1
                path[w, g, last] += path[w, g, last + 1 :].sum(axis=0)
                path[w, g, last + 1 :] = 0.0
        return Gradients(
            E=(by_E * s.stiffness).sum(axis=1),
            nu=((mu_bar * mu_nu + lam_bar * lam_nu) * s.stiffness).sum(axis=1),
            density=v["mass"].astype(float).sum(axis=1) * s.body.volume,
            yield_stress=v["yield"].astype(float).sum(axis=1),
            stiffness=by_E * E,
            damping=np.array(v["damping"]),
            friction=np.array(v["friction"]),
            gravity=np.array(v["gravity"]),
            positions=np.array(v["x"]),
            velocities=np.array(v["v"]),
            gripper_positions=path,
        )


def _for_worlds(s: Simulator, work: Any) -> None:
    """Do the work for every world on the simulator's threads; the first failure is raised."""
    order = np.argsort(s.substep)
    with ThreadPoolExecutor(max_workers=s.threads) as pool:
        for job in [pool.submit(work, int(w)) for w in order]:
            job.result()
