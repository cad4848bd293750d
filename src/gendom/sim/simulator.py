"""Batched simulation of one body in many worlds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import (
    check_integers,
    check_list,
    check_number,
    check_numbers,
    check_type,
    require,
)
from gendom.arrays import Array
from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.materials.parameters import WEAVE, Columnar, parameters_of
from gendom.shown import Shown
from gendom.sim.bodies import Body
from gendom.sim.device import cores, making, open_device
from gendom.sim.gripper import Gripper, Grippers, Targets, hands_of_worlds, of_worlds
from gendom.sim.mpm.engine import MpmEngine
from gendom.sim.obstacles import Obstacle, Table, check_clear
from gendom.sim.setting import Frames, Physics, Setting, Solver, Variation
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.run import Steps

START_INSIDE = 0.1
"""Greatest initial depth of a body in a table or obstacle [cells, or diameters of a rod]; contact
pushes it out."""

ATTRIBUTES = ("body", "materials", "time", "dtype", "device", "engine")
"""Of a simulator."""


class Simulator(Shown):
    """Simulate one body in W worlds that differ in material, friction, gravity, damping and paths.

    All worlds share the body's geometry. State arrays are [W, N]; nothing is stored for space
    that the body does not occupy.

    Args:
        body: The body to simulate, at rest.
        materials: One material for each world.
        grippers: Grippers shared by all worlds, or one sequence of them for each world, or all as
            arrays (``Grippers``).
        table: Table, or None for open space.
        obstacles: Boxes, spheres and capsules that rods and shells meet, shared by all worlds or
            one sequence for each world.
        physics: Gravity, air, damping and self-contact.
        solver: Engine, steps, precision and device.
        variation: How worlds' bodies differ from ``body``.
        positions: [N, 3] or [W, N, 3] initial positions of particles (default: ``body.x``) or
            points (default: ``body.points``) [m].
        start_time: Time of the initial state [s].

    Raises:
        ParameterError: If an argument is of another type or shape, out of its range or not finite,
            arguments do not fit together, or the material needs substeps that are too short.
        DeviceError: If the device does not exist.
    """

    def __init__(
        self,
        body: Body,
        materials: Sequence[Material],
        *,
        grippers: Grippers | Sequence[Gripper] | Sequence[Sequence[Gripper]] = (),
        table: Table | None = None,
        obstacles: Sequence[Obstacle] | Sequence[Sequence[Obstacle]] = (),
        physics: Physics = Physics(),
        solver: Solver = Solver(),
        variation: Variation = Variation(),
        positions: ArrayLike | None = None,
        start_time: float = 0.0,
    ):
        check_type("body", body, Body)
        if not isinstance(materials, Columnar):
            check_list("materials", materials, Material)
        check_type("table", table, Table, optional=True)
        check_type("physics", physics, Physics)
        check_type("solver", solver, Solver)
        check_type("variation", variation, Variation)
        require(materials, "a simulation needs at least one material (one a world)")
        check_number("start_time", start_time)
        thin, W = engine_of(body, solver) == "thin", len(materials)
        every, hands = of_worlds("obstacles", obstacles, Obstacle, W), hands_of_worlds(grippers, W)
        rest = body.points if thin else body.x
        parameters = parameters_of(materials)
        _check_fits(body, len(rest), thin, parameters, any(map(len, every)), variation)
        x = rest if positions is None else positions
        x = check_numbers("positions", x, rest.shape, ("W", *rest.shape))
        section, unit = (1, body.thickness) if thin else (body.section, body.dx)
        centres = x.reshape(*x.shape[:-2], -1, section, 3).mean(axis=-2)
        check_clear(body, centres, START_INSIDE * unit, table, every, start_time)
        self.body = body
        self.materials = materials if isinstance(materials, Columnar) else tuple(materials)
        self.time = start_time
        self.dtype = solver.dtype or ("float64" if thin else "float32")
        self.device = open_device(solver.device)
        setting = Setting(
            body=body, materials=self.materials, parameters=parameters, grippers=hands,
            table=table, obstacles=every, positions=x, start_time=start_time, dtype=self.dtype,
            device=self.device, threads=solver.threads or cores(), interleaved=solver.interleaved,
            variation=variation, **vars(physics),
        )  # fmt: skip
        kind = ThinEngine if thin else MpmEngine
        with making:
            self.engine = kind(setting, substep=solver.substep, cfl=solver.cfl)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in ATTRIBUTES:  # it would change nothing
            fix = "make another simulator; Simulator.step moves grippers"
            raise ParameterError(f"a simulator has no {name} that can be set", fix=fix)
        super().__setattr__(name, value)

    def _shown(self) -> tuple[str, list[tuple[str, str]]]:
        kind = self.engine.model.kind if isinstance(self.engine, ThinEngine) else "mpm"
        worlds = f"{self.num_worlds} world{'s' * (self.num_worlds != 1)}"
        return f"Simulator ({self.body.kind}, {worlds})", [
            ("engine", f"{kind}, {self.dtype}, {self.device}"),
            ("points", f"{self.num_points} in each world"),
            ("time", f"{self.time:.4g} s"),
            ("substep", f"{self.substep.min():.3g} s at least"),
            ("diverged", f"{len(self.failures)} worlds"),
        ]

    @property
    def num_worlds(self) -> int:
        return len(self.materials)

    @property
    def failures(self) -> dict[int, SimulationError]:
        """Errors of the worlds that diverged."""
        return self.engine.failures

    @property
    def num_points(self) -> int:
        """Number of particles, or of points of a rod or shell."""
        return self.engine.num_points

    @property
    def substep(self) -> Array:
        """[W] longest substep of each world [s]."""
        return self.engine.setting.substep

    def positions(self) -> Array:
        """Current positions of particles or points, [W, N, 3] [m]."""
        return self.engine.positions()

    def velocities(self) -> Array:
        """Velocities, [W, N, 3] [m/s].

        Those of particles are of now, those of points half a step ago; held points of rods and
        shells have the speed at which their gripper has come here.
        """
        return self.engine.velocities()

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set velocities of particles or points.

        Args:
            v: [3], [N, 3] or [W, N, 3] [m/s].
            affine: Affine velocities C, [3, 3], [N, 3, 3] or [W, N, 3, 3] [1/s]. A spinning body
                needs them; otherwise it loses some of its spin at once.

        Raises:
            ParameterError: If shapes do not fit or a number is not finite.
        """
        N = self.num_points
        v = check_numbers("velocities v", v, (3,), (N, 3), ("W", N, 3))
        affine = check_numbers("affine", affine, (), (3, 3), (N, 3, 3), ("W", N, 3, 3))
        self.engine.set_velocities(v, affine)

    def set_positions(self, x: ArrayLike) -> None:
        """Set positions [W, N, 3] of points as they were simulated [m]: a cloth's folds may cross,
        which those that it begins with may not."""
        if isinstance(self.engine, MpmEngine):
            raise ParameterError("particles cannot be put elsewhere", fix="engine='thin'")
        self.engine.set_positions(check_numbers("positions", x, ("W", self.num_points, 3)))

    def run(
        self,
        times: ArrayLike,
        *,
        on_frame: Callable[[int], None] | None = None,
        particles: ArrayLike | None = None,
        keep_going: bool = False,
    ) -> Array:
        """Simulate to each of the given times.

        Args:
            times: [T] not decreasing, not before ``self.time`` [s].
            on_frame: Called with the number of frames done, from one thread at a time.
            particles: [P] indices of the particles to record (default: all).
            keep_going: Stop only the worlds that diverge instead of raising an error. Their errors
                are in ``failures``, and their positions are NaN from then on.

        Returns:
            [T, W, P, 3] positions [m].

        Raises:
            ParameterError: If the times decrease, or an argument is of another type or range.
            SimulationError: If a world diverges or a particle inverts, unless ``keep_going`` is
                set. The error names world, time and parameters.
        """
        t = self.checked(times)
        check_type("on_frame", on_frame, Callable, optional=True)
        check_type("keep_going", keep_going, bool)
        every = np.arange(self.num_points) if particles is None else particles
        picked = check_integers("particles", every, ("P",), most=self.num_points - 1)
        x = np.empty((len(t), self.num_worlds, len(picked), 3), dtype=self.dtype)
        self.engine.run(Frames(self.time, t, picked, x, on_frame, keep_going))
        self.time = float(t[-1])
        return x

    def step(self, dt: float, targets: Targets | None = None, *, keep_going: bool = False) -> None:
        """Simulate all worlds for a while, with grippers under control.

        ``positions``, ``velocities`` and ``gripper_forces`` then tell how things are.

        Args:
            dt: How long [s].
            targets: Where grippers are at the end of the step. From the first of them on, paths
                that the simulator was made with no longer count. None: they go on along their
                paths, or stay where the last targets took them.
            keep_going: As of ``run``.

        Raises:
            ParameterError: If ``dt`` is not positive, targets do not fit the grippers, or the
                engine is the MPM.
            SimulationError: As ``run``.
        """
        check_number("dt", dt, above=0.0)
        check_type("targets", targets, Targets, optional=True)
        until = self.time + dt
        engine = self._thin("steps")
        if targets is not None:
            checked = targets.of(*engine.closed.shape)
            engine.steps = engine.steps or Steps(engine)
            engine.steps.lead(until, *checked)
        if engine.steps is None:
            self.run([until], particles=[], keep_going=keep_going)
            return
        engine.steps.take(until, keep_going=keep_going)
        self.time = until

    def gripper_forces(self) -> Array:
        """Forces of the body on grippers, [W, G, 3] [N]; 0 of open ones.

        What held points are pulled by and weigh, without the inertia of what is held.

        Raises:
            ParameterError: If the engine is the MPM.
        """
        return self._thin("forces at grippers").gripper_forces()

    def _thin(self, what: str) -> ThinEngine:
        if not isinstance(self.engine, ThinEngine):
            raise ParameterError(f"the MPM has no {what}", fix="engine='thin'")
        return self.engine

    def checked(self, times: ArrayLike) -> Array:
        """Return ``times`` as an array [T], after checking that the simulator can be run to them.

        Raises:
            ParameterError: If they are not numbers, decrease, are not finite or lie before the
                simulator's time.
        """
        t = np.atleast_1d(check_numbers("times", times, (), ("T",)))
        if not len(t):
            raise ParameterError("times must not be empty")
        if np.any(np.diff(np.concatenate([[self.time], t])) < 0.0):
            raise ParameterError("times must not decrease nor lie before the simulator's time")
        return t


def engine_of(body: Body, solver: Solver) -> str:
    """The engine of a body's simulation: the solver's, or the body's usual one."""
    return solver.engine or ("thin" if body.kind in ("rope", "cloth") else "mpm")


def _check_fits(
    body: Body, N: int, thin: bool, parameters: Mapping[str, Array], meets: bool,
    variation: Variation,
) -> None:  # fmt: skip
    """Check that a body of N particles or points has what only some bodies may have."""
    variation.check(N)
    rod, shell = thin and body.kind == "rope", thin and body.kind == "cloth"
    membrane = not np.isnan(parameters["membrane"]).all()
    threads = any((parameters[name] != 1.0).any() for name in WEAVE)
    for where, given, allowed, only in (
        ("materials", membrane, thin, "rods and shells have a modulus of their own along them"),
        ("materials", threads, shell, f"shells have threads ({', '.join(WEAVE)})"),
        ("mass", None, thin, "rods and shells have points of other masses"),
        ("natural_curvature", None, rod, "rods may begin with stress"),
        ("stretch", None, rod, "rods may be longer than at rest"),
        ("turning", variation.turning != 1.0, rod, "rods' edges turn"),
        ("diameter", variation.diameter is not None, rod, "rods differ in their diameter"),
        ("obstacles", meets, thin, "rods and shells meet obstacles"),
    ):
        if given is None:
            given = bool(np.any(np.asarray(getattr(variation, where)) != 1.0))
        what = f"only {only}, not a {body.kind} of the {'thin' if thin else 'mpm'} engine"
        fix = "leave that out, or take engine='thin'"
        require(allowed or not given, what, where=where, fix=fix)
