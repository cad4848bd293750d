"""Recorded runs and their reverse: derivatives of a loss by all inputs.

A group of worlds goes through segments, some substeps inside one frame. The forward run of a short
rollout records them; else it keeps the state at the beginning of each segment, from which the
segment is run again and recorded when it is to be reversed.
"""

# pyright: basic

from typing import Any

import numpy as np
import warp as wp

from gendom.arrays import Array
from gendom.sim.gradients import Gradients
from gendom.sim.mpm.engine import REBUILD, Group, MpmEngine
from gendom.sim.mpm.kernels import SUMS, make_advance, make_reverse
from gendom.sim.mpm.particles import DRAG, LAM, MASS, MU
from gendom.sim.mpm.types import GRID_FULL

SHORTEST, LONGEST, LONGEST_ON_CPU = 8, 256, 64
"""Bounds on the substeps of a segment."""

MEMORY = {"cpu": 64 << 20, "cuda": 8 << 30}
"""Bound on what is recorded: of a short rollout all, of others a segment on CUDA [bytes]."""

BY_WORLD = ("friction", "velocity_damping", "damping", "gravity")
"""Conditions that each world has one of."""


class Tape:
    """A run that can be differentiated.

    Args:
        engine: Its worlds have not run before.
    """

    def __init__(self, engine: MpmEngine):
        self.engine = engine
        self._memory = MEMORY["cuda" if engine.setting.device.is_cuda else "cpu"]
        self.segments: list[list[Segment]] = []
        """Of each group of worlds."""
        engine.load(make_advance(engine.variant, taped=False))
        engine.load(make_advance(engine.variant, taped=True))
        engine.load(make_reverse(engine.variant))

    def forward(self, times: Array, began: float) -> Array:
        """[T, W, N, 3] positions at the times, from the time ``began`` [s].

        Raises:
            SimulationError: If a world diverges.
        """
        e, groups = self.engine, self.engine.groups()
        self._plan = plan = e.plan(began, times, np.arange(e.num_points))
        steps = plan.steps.numpy().sum(axis=0)
        rows = sum(g.count * int(steps[g.worlds].max()) for g in groups)
        self._short = rows * self._row_bytes() <= self._memory
        self.segments = [[] for _ in groups]

        def go(k: int) -> None:
            group = groups[k]
            group.begin()
            for f in range(len(times)):
                while (group.read("frame") <= f).any():
                    segment = Segment(group, f)
                    self._run(segment)
                    self.segments[k].append(segment)
            del group.grid

        e.in_threads(go, range(len(groups)))
        return plan.x.numpy() + e.origin.astype(e.setting.dtype)

    def _run(self, segment: "Segment") -> None:
        """Run a segment for the first time."""
        group, plan, more = segment.group, self._plan, True
        left = int((plan.steps.numpy()[segment.frame, group.worlds] - segment.step).max())
        while more:
            done = int((group.read("age") - segment.age).max())
            most = self._segment_substeps() - done
            if self._short and left:
                segment.recorded = self._record(segment, min(most, left), None)
            else:
                group.advance(plan, most, segment.frame + 1, group.grid)
            more = bool((group.read("status") == GRID_FULL).any())
            group.look(plan, keep_going=False)
            self.engine.raise_failures(keep_going=False)
        segment.finish(plan)

    def _segment_substeps(self) -> int:
        """Substeps that are recorded at once."""
        if not self.engine.setting.device.is_cuda:
            return LONGEST_ON_CPU
        row = self.engine.num_worlds * self._row_bytes()
        return min(LONGEST, max(SHORTEST, self._memory // row))

    def _row_bytes(self) -> int:
        """Memory that a recorded substep of one world takes [bytes]."""
        e, (X, Y, M), N = self.engine, self.engine.room, self.engine.num_points
        numbers = np.dtype(e.setting.dtype).itemsize * (e.variant.taped * N + 4 * M)
        return numbers + 4 * (3 * X * Y + 2 * N + 7)

    def _record(
        self, segment: "Segment", substeps: int, spare: "TapedStates | None"
    ) -> "TapedStates":
        """Run a segment from its beginning and keep everything that its reverse needs.

        Into ``spare`` where that has the room.
        """
        e, group = self.engine, segment.group
        while True:
            if spare is None or spare.room != e.room or spare.substeps < substeps:
                spare = None  # its memory first
                spare = TapedStates(group, substeps)
            segment.restore()
            group.advance(self._plan, substeps, segment.frame + 1, spare.grid, spare.tape)
            full = group.read("status") == GRID_FULL
            if not full.any():
                return spare
            # made where the segment begins, grids may need a little more than they did
            e.make_room(spare.grid, np.flatnonzero(full))
            group.begin()

    def backward(self, positions_bar: Array) -> Gradients:
        """Derivatives by all inputs, given those [T, W, N, 3] by the positions of ``forward``."""
        e, sums = self.engine, Sums(self.engine)

        def go_back(segments: list[Segment]) -> None:
            spare: TapedStates | None = None
            group = segments[0].group
            group.begin()
            for f in reversed(range(len(positions_bar))):
                sums.add_positions(group, positions_bar[f])
                for segment in [s for s in reversed(segments) if s.frame == f and s.substeps.any()]:
                    recorded = segment.recorded
                    if recorded is None:
                        recorded = spare = self._record(segment, int(segment.substeps.max()), spare)
                    recorded.grid.velocity_bar = wp.empty_like(recorded.grid.velocity)
                    group.launch(make_reverse(e.variant), [
                        *segment.arrays(self._plan), e.device_model, e.paths, e.grips,
                        recorded.grid, recorded.tape, sums.adjoint, sums.state, sums.conditions,
                    ])  # fmt: skip
                    segment.recorded = None
            del group.grid

        e.in_threads(go_back, self.segments)
        return sums.gradients()


class Segment:
    """Some substeps of one frame of a group of worlds, which are now at its beginning: their state,
    their clock and what grippers hold."""

    def __init__(self, group: Group, frame: int):
        self.group, self.frame = group, frame
        self.kept = [wp.clone(array) for array in self._arrays()]
        self.step, self.age, self._frames = map(group.read, ("step", "age", "frame"))
        self.substeps = np.zeros_like(self.step)
        """[n] of each world."""
        self.recorded: TapedStates | None = None
        """If the first run has recorded it."""

    def _arrays(self) -> list[wp.array]:
        e = self.group.engine
        holds = [e.grips.free, e.grips.held_by] if e.grips.count.shape[1] else []
        state = [getattr(e.state, name) for name in (*e.carried, "low")]
        return [array[self.group.worlds] for array in (*state, *holds) if array.size]

    def restore(self) -> None:
        """Set the worlds back; their grids are rebuilt first."""
        for array, values in zip(self._arrays(), self.kept, strict=True):
            wp.copy(array, values)
        clock = {"step": self.step, "age": self.age, "frame": self._frames}
        self.group.set_clock(**clock, status=0, travel=REBUILD)

    def finish(self, plan: Any) -> None:
        """Keep how far the worlds have come now."""
        through = self.group.read("frame") > self.frame
        steps = plan.steps.numpy()[self.frame, self.group.worlds]
        end = np.where(through, steps, self.group.read("step"))
        # those that were through before have not moved
        self.substeps = np.where(self._frames > self.frame, 0, end - self.step)

    def arrays(self, plan: Any) -> tuple[Any, Any, Any]:
        """For the kernel: where the worlds begin [s], how many substeps they have, the clock."""
        e, own, f = self.group.engine, self.group.worlds, self.frame
        began, dt, substeps, age = np.zeros((4, e.num_worlds))
        dt[own] = plan.dt.numpy()[f, own]
        began[own] = plan.time.numpy()[f] + self.step * dt[own]
        substeps[own], age[own] = self.substeps, self.age
        clock = e.types.Clock()
        clock.dt, clock.age = e.array(dt, wp.float64), e.array(age, wp.int32)
        return e.array(began, wp.float64), e.array(substeps, wp.int32), clock


class TapedStates:
    """States, grids and layouts of consecutive substeps of a group of worlds."""

    def __init__(self, group: Group, substeps: int):
        e, n = group.engine, substeps * group.count
        self.room, self.substeps = e.room, substeps
        # nothing is read before it was written: memory that is never needed is never touched
        self.grid = e.make_grid(group.count, n, n, wp.empty)
        self.tape = e.allocate(
            e.types.Records,
            wp.empty,
            of=(n, e.variant.taped, e.num_points),
            layout_of=n,
            **dict.fromkeys(("order", "place"), (n, e.num_points)),
        )


class Sums:
    """Derivatives by state and parameters while they are summed up."""

    def __init__(self, engine: MpmEngine):
        self.engine = s = engine
        types, W, N = s.types, s.num_worlds, s.num_points
        G, K = s.paths.time.shape[1:]
        self.state = s.make_state()
        self.state.sums = s.zeros((W, SUMS, N))
        self.adjoint = s.records(sums=(W, SUMS, N))
        self.conditions = s.allocate(
            types.ConditionsAdjoint,
            **dict.fromkeys(BY_WORLD, W),
            **dict.fromkeys(("position", "turn"), (W, G, K)),
            radius=(W, G),
            touched=(W, N // s.setting.body.section),
            **dict.fromkeys(("weight", "place"), (W, G, N)),
            **dict.fromkeys(("centre", "rotation", "velocity", "spin"), (W, G)),
        )

    def add_positions(self, group: Group, bar: Array) -> None:
        """Add a loss's own derivative by the positions now [W, N, 3] [1/m], of a group's worlds."""
        now = self.state.x[group.worlds]
        now.assign(now.numpy() + bar[group.worlds])

    def gradients(self) -> Gradients:
        """What the sums mean for the numbers that a user gave."""
        s, by = self.engine, self.conditions
        materials, body = s.setting.materials, s.setting.body
        sums, h = self.state.sums.numpy().astype(float), 1e-30
        E, nu = (np.array([[getattr(m, name)] for m in materials]) for name in ("E", "nu"))

        def through_moduli(E: Array, nu: Array) -> Array:
            """Derivatives [W, N] by what is changed by h i, through mu and lam (complex step)."""
            mu = E / (2.0 * (1.0 + nu))
            lam = 2.0 * mu * nu / (1.0 - body.lateral_constraint * nu)
            return (sums[:, MU] * mu.imag + sums[:, LAM] * lam.imag) / h

        by_E, by_nu = through_moduli(E + 1j * h, nu), through_moduli(E, nu + 1j * h)
        return Gradients(
            E=(by_E * s.stiffness).sum(axis=1),
            nu=(by_nu * s.stiffness).sum(axis=1),
            density=sums[:, MASS].sum(axis=1) * body.volume,
            stiffness=by_E * E,
            air_density=sums[:, DRAG].sum(axis=1) * s.drag_by_air,
            self_friction=np.zeros(s.num_worlds),
            positions=np.array(self.state.x.numpy()),
            velocities=np.array(self.state.v.numpy()),
            gripper_positions=np.array(by.position.numpy()),
            gripper_rotations=np.array(by.turn.numpy()),
            gripper_radius=np.array(by.radius.numpy()),
            **{name: np.array(getattr(by, name).numpy()) for name in BY_WORLD},
        )
