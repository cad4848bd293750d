"""Recorded runs and their reverse: derivatives of a loss by all inputs.

A group of worlds goes through segments, some substeps inside one frame. Where memory holds every
substep, the forward run records them. Otherwise it keeps the state at the beginning of each
segment, from which the segment is run again and recorded when it is to be reversed.
"""

# pyright: basic

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.sim.gradients import Gradients
from gendom.sim.mpm.kernels import SUMS, make_advance, make_reverse
from gendom.sim.mpm.model import Worlds
from gendom.sim.mpm.particles import DRAG, LAM, MASS, MU
from gendom.sim.mpm.runner import REBUILD, Group, Plan, Program, for_groups
from gendom.sim.mpm.step import GRID_FULL

SHORTEST, LONGEST, LONGEST_ON_CPU = 8, 256, 64
"""Bounds on the substeps of a segment."""

SUBSTEPS_A_LAYOUT = 2
"""Room for layouts in a recording of the forward run, which may end where they do."""


class Tape:
    """A run that can be differentiated.

    Args:
        program: What worlds run; they have not run before.
        memory: Bound on what is recorded [bytes]; at least one segment is.
    """

    def __init__(self, program: Program, memory: float):
        self.program, self.memory = program, memory
        self.groups = program.groups()
        self.segments: list[list[Segment]] = [[] for _ in self.groups]
        self._cuda = program.worlds.device.is_cuda
        program.load(make_advance(program.variant, taped=True))
        program.load(make_reverse(program.variant))

    def forward(self, times: Array, began: float) -> Array:
        """[T, W, N, 3] positions at the times, from the time ``began`` [s].

        Raises:
            SimulationError: If a world diverges.
        """
        s = self.program.worlds
        W, N = s.num_worlds, s.num_particles
        x: Any = wp.empty((len(times), W, N), dtype=s.types.vec3, device=s.device)
        self._plan = plan = self.program.plan(began, times, np.arange(N), x)
        row = _row_bytes(self.program, SUBSTEPS_A_LAYOUT)
        substeps = plan.steps.sum(axis=0)
        needed = sum(len(g.own) * int(substeps[g.own].max()) * row for g in self.groups)
        keeps = needed <= self.memory

        def one_group(group: Group) -> None:
            segments = self.segments[self.groups.index(group)]
            group.begin()
            for f in range(len(times)):
                while (group.read("frame") <= f).any():
                    segments.append(self._run_segment(group, f, keeps=keeps))
            group.end()

        for_groups(self.groups, one_group)
        return x.numpy() + s.origin.astype(s.numpy_type)

    def _run_segment(self, group: Group, f: int, *, keeps: bool) -> "Segment":
        s, plan = self.program.worlds, self._plan
        segment = Segment(group.own, f, Snapshot(group))
        left = int((plan.steps[f, group.own] - segment.start.step).max())
        more = True
        while more:
            if keeps and left:
                substeps = min(LONGEST if self._cuda else LONGEST_ON_CPU, left)
                segment.recording = self._record(group, segment, substeps, None)
                more = False
            else:
                done = int((group.read("age") - segment.start.age).max())
                group.advance(plan, self._segment_substeps() - done, f + 1)
                more = bool((group.read("status") == GRID_FULL).any())
            if not group.look(plan, keep_going=False) and s.failures:
                raise s.failures[min(s.failures)]
        segment.set_end(group, plan)
        return segment

    def _segment_substeps(self) -> int:
        """Substeps that the memory holds at once."""
        if not self._cuda:
            return LONGEST_ON_CPU
        row = self.program.worlds.num_worlds * _row_bytes(self.program, 1)
        return min(LONGEST, max(SHORTEST, int(self.memory / row)))

    def _record(
        self, group: Group, segment: "Segment", substeps: int, spare: "TapedStates | None"
    ) -> "TapedStates":
        """Run a segment from its beginning and keep everything that its reverse needs.

        Into ``spare`` where that has the room.
        """
        s, plan = self.program.worlds, self._plan
        again = spare is not None or segment.end is not None
        while True:
            layouts = substeps if again else -(-substeps // SUBSTEPS_A_LAYOUT)
            if spare is None or spare.room != s.room or spare.substeps < substeps:
                spare = None  # its memory first
                spare = TapedStates(self.program, group, substeps, layouts)
            segment.start.restore(group)
            group.record(plan, spare, most=substeps, frames=segment.frame + 1)
            full = group.read("status") == GRID_FULL
            if not full.any():
                return spare
            # made where the segment begins, grids may need a little more than they did
            s.make_room(spare.grid, group.layouts[full])
            group.begin()

    def backward(self, positions_bar: Array) -> Gradients:
        """Derivatives by all inputs, given those [T, W, N, 3] by the positions of ``forward``."""
        sums = Sums(self.program)

        def one_group(group: Group) -> None:
            spare: TapedStates | None = None
            group.begin()
            # frames without substeps have no segments
            frame = len(positions_bar)
            for segment in reversed(self.segments[self.groups.index(group)]):
                while frame > segment.frame:
                    frame -= 1
                    sums.add_positions(group.own, positions_bar[frame][group.own])
                spare = self._reverse(group, segment, sums, spare)
            while frame > 0:
                frame -= 1
                sums.add_positions(group.own, positions_bar[frame][group.own])
            group.end()

        for_groups(self.groups, one_group)
        return sums.gradients()

    def _reverse(
        self, group: Group, segment: "Segment", sums: "Sums", spare: "TapedStates | None"
    ) -> "TapedStates | None":
        """Carry derivatives from the end of a segment to its beginning."""
        s, program = self.program.worlds, self.program
        if not segment.substeps:
            return spare
        recording = segment.recording
        if recording is None:
            recording = spare = self._record(group, segment, segment.substeps, spare)
        recording.grid.velocity_bar = wp.empty_like(recording.grid.velocity)
        program.launch(make_reverse(program.variant), group.order, [
            group.shared, *segment.arrays(s, self._plan), s.device_model, s.paths, s.grips,
            recording.grid, recording.tape, sums.adjoint, sums.state, sums.conditions,
        ])  # fmt: skip
        segment.recording = None
        return spare


class Snapshot:
    """State and clock of a group of worlds, and what grippers hold."""

    def __init__(self, group: Group):
        arrays, on_cuda = self._arrays(group), group.worlds.device.is_cuda
        self._kept = [wp.clone(a) if on_cuda else a.numpy()[group.own] for a in arrays]
        self.step, self.age, self.frame = map(group.read, ("step", "age", "frame"))

    def restore(self, group: Group) -> None:
        """Set the worlds back; their grids are rebuilt first."""
        for array, values in zip(self._arrays(group), self._kept, strict=True):
            if isinstance(values, wp.array):
                wp.copy(array, values)
            else:
                array.numpy()[group.own] = values
        clock = {"step": self.step, "age": self.age, "frame": self.frame}
        for name, values in {**clock, "status": 0, "travel": REBUILD}.items():
            group.set_clock(name, values)

    @staticmethod
    def _arrays(group: Group) -> list[wp.array]:
        s = group.worlds
        holds = [s.grips.free, s.grips.held_by] if s.grips.count.shape[1] else []
        state = [getattr(s.state, name) for name in (*s.carried, "low")]
        return [array for array in (*state, *holds) if array.size]


@dataclass
class Segment:
    """Some substeps of one frame."""

    own: NDArray[np.integer]
    """[n] the worlds."""
    frame: int
    start: Snapshot
    end: NDArray[np.integer] | None = None
    """[n] substeps of the frame that are done at the end."""
    recording: "TapedStates | None" = None
    """If it is kept from the forward run."""

    def set_end(self, group: Group, plan: Plan) -> None:
        """Keep how far the worlds have come now."""
        step, frame = group.read("step"), group.read("frame")
        steps = plan.steps[self.frame, group.own]
        end = np.where(frame > self.frame, steps, step)
        # those that were through before have not moved
        self.end = np.where(self.start.frame > self.frame, self.start.step, end)

    @property
    def substeps(self) -> int:
        """Of the world that has most."""
        assert self.end is not None
        return int((self.end - self.start.step).max())

    def arrays(self, s: Worlds, plan: Plan) -> tuple[Any, Any, Any]:
        """For the kernel: where the worlds begin [s], how many substeps they have, the clock."""
        assert self.end is not None
        own, W = self.own, s.num_worlds
        began, dt, slots, age = np.zeros((4, W))
        dt[own] = self.substep(plan)
        began[own] = plan.time[self.frame] + self.start.step * dt[own]
        slots[own] = self.end - self.start.step
        age[own] = self.start.age
        clock = s.types.Clock()
        clock.dt, clock.age = s.array(dt, wp.float64), s.array(age, wp.int32)
        return s.array(began, wp.float64), s.array(slots, wp.int32), clock

    def substep(self, plan: Plan) -> Array:
        """[n] length of the substeps [s]."""
        steps = np.maximum(plan.steps[self.frame, self.own], 1)
        return (plan.time[self.frame + 1] - plan.time[self.frame]) / steps


class TapedStates:
    """States, grids and layouts of consecutive substeps of a group of worlds."""

    def __init__(self, program: Program, group: Group, substeps: int, layouts: int):
        s, variant = program.worlds, program.variant
        self.room, self.substeps = s.room, substeps
        n, N = group.shared, s.num_particles
        # nothing is read before it was written: memory that is never needed is never touched
        rows = substeps * n
        self.grid = s.make_grid(n, layouts * n, rows, wp.empty)
        self.tape = s.allocate(
            s.types.Records,
            wp.empty,
            of=(rows, variant.taped, N),
            layout_of=rows,
            **dict.fromkeys(("order", "place"), (layouts * n, N)),
        )


def _row_bytes(program: Program, substeps_a_layout: int) -> float:
    """Memory that a recorded substep of one world takes [bytes]."""
    s = program.worlds
    X, Y, M = s.room
    N, real = s.num_particles, s.numpy_type.itemsize
    layout = 4 * (3 * X * Y + 2 * N + 7)
    return real * (program.variant.taped * N + 4 * M) + layout / substeps_a_layout


class Sums:
    """Derivatives by state and parameters while they are summed up."""

    def __init__(self, program: Program):
        self.program = program
        s = program.worlds
        types, W, N = s.types, s.num_worlds, s.num_particles
        G, K = s.paths.time.shape[1:]
        self.state = s.make_state()
        self.state.sums = s.zeros((W, SUMS, N), s.real)
        self.adjoint = program.records(sums=(W, SUMS, N))
        self.conditions = s.allocate(
            types.ConditionsAdjoint,
            **dict.fromkeys(("friction", "velocity_damping", "damping", "gravity"), W),
            **dict.fromkeys(("position", "turn"), (W, G, K)),
            radius=(W, G),
            touched=(W, N // s.setting.body.section),
            **dict.fromkeys(("weight", "place"), (W, G, N)),
            **dict.fromkeys(("centre", "rotation", "velocity", "spin"), s.grips.closed.shape),
        )

    def add_positions(self, own: NDArray[np.integer], bar: Array) -> None:
        """Add a loss's own derivative by the positions now [n, N, 3] of some worlds [1/m]."""
        now = self.state.x.numpy()
        now[own] += bar
        if self.program.worlds.device.is_cuda:
            self.state.x.assign(now)

    def gradients(self) -> Gradients:
        """What the sums mean for the numbers that a user gave."""
        s, by = self.program.worlds, self.conditions
        materials, body = s.setting.materials, s.setting.body
        E = np.array([m.E for m in materials])[:, None]
        nu = np.array([m.nu for m in materials])[:, None]
        sums = self.state.sums.numpy().astype(float)
        # mu = E / (2 (1 + nu)), lam = E nu / ((1 + nu) (1 - k nu)), times the stiffness
        constraint = body.lateral_constraint
        room = (1.0 + nu) * (1.0 - constraint * nu)
        mu_E = 1.0 / (2.0 * (1.0 + nu))
        lam_E = nu / room
        mu_nu = -E / (2.0 * (1.0 + nu) ** 2)
        lam_nu = E * (1.0 + constraint * nu**2) / room**2
        by_E = sums[:, MU] * mu_E + sums[:, LAM] * lam_E
        return Gradients(
            E=(by_E * s.stiffness).sum(axis=1),
            nu=((sums[:, MU] * mu_nu + sums[:, LAM] * lam_nu) * s.stiffness).sum(axis=1),
            density=sums[:, MASS].sum(axis=1) * body.volume,
            stiffness=by_E * E,
            damping=np.array(by.damping.numpy()),
            velocity_damping=np.array(by.velocity_damping.numpy()),
            air_density=sums[:, DRAG].sum(axis=1) * s.drag_by_air,
            friction=np.array(by.friction.numpy()),
            self_friction=np.zeros(s.num_worlds),
            gravity=np.array(by.gravity.numpy()),
            positions=np.array(self.state.x.numpy()),
            velocities=np.array(self.state.v.numpy()),
            gripper_positions=np.array(by.position.numpy()),
            gripper_rotations=np.array(by.turn.numpy()),
            gripper_radius=np.array(by.radius.numpy()),
        )
