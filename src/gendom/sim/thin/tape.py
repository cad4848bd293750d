"""Reverse mode of thin bodies: pieces are recomputed from checkpoints, then transposed."""

import math

import numpy as np
import warp as wp

from gendom.arrays import Array
from gendom.sim.gradients import Gradients
from gendom.sim.paths import HostPaths
from gendom.sim.setting import Frames
from gendom.sim.thin import types
from gendom.sim.thin.contact import LISTED
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import border_adjoint, close_adjoint, released_adjoint
from gendom.sim.thin.run import Event, Run, Schedule, put


class ThinTape:
    """A run of thin bodies that can be differentiated.

    Args:
        engine: An engine that has not been run.

    The number of checkpoints and the number of steps in a piece are both about the square root of
    the total number of steps: less memory would require running pieces several times.
    """

    def __init__(self, engine: ThinEngine):
        self.engine = engine
        self.rounds: list[tuple[slice, list[Event], Array, Array, Array]] = []
        """Groups of worlds, and of each part of their run between two events: what happens at its
        start, its pieces [k, 2], and what grippers hold."""
        engine.load("advance", "reverse", "begin_adjoint")

    def forward(self, times: Array, began: float) -> Array:
        """Simulate, and return points at the given times, [T, W, n, 3] [m]."""
        e = self.engine
        T, W, n = len(times), e.num_worlds, e.num_points
        x = np.empty((T, W, n, 3), dtype=e.setting.dtype)
        frames = Frames(began, times, np.arange(n), x, None, False)
        self.first = wp.clone(e.state)
        steps = math.ceil((times[-1] - began) / e.setting.substep.min()) + 1
        self.most = max(2, math.ceil(math.sqrt(steps)))
        pieces = Schedule(frames, e, self.most).steps.shape[1]
        self.rows = e.model.state_rows + LISTED * e.device_model.contact
        self.kept = e.zeros((pieces * W, self.rows, e.row_length))

        def keep(group: slice, events: list[Event], pieces: Array) -> None:
            held = e.holds[group].copy(), e.stiffer[group].copy()
            self.rounds.append((group, events, pieces, *held))

        self.plan = e.run(frames, after=keep, most_steps=self.most, kept=self.kept)
        return x

    def backward(self, bar: Array) -> Gradients:
        """Derivatives with respect to all inputs, given those by the points of ``forward``."""
        e = self.engine
        W, n, G = e.num_worlds, e.num_points, e.closed.shape[1]
        self.frames_bar = e.array(bar, e.types.vec3)
        self.host = HostPaths(e.stacked)
        self.model_rows = types.MODEL_ROWS + e.device_model.obstacles.shape[1]
        self.model_bar = np.zeros((W, self.model_rows, n))
        m, P = e.model, e.row_length
        self.adjoint = e.allocate(
            e.types.ModelAdjoint, state=(W, m.state_bars, P), model=(W, self.model_rows, P),
            scratch=(W, m.scratch_bars, P), place=(W * G, 6, P), centre=(W, G), turn=(W, G),
            **dict.fromkeys(("position", "path_turn"), e.stacked["time"].shape),
        )  # fmt: skip
        self.radius_bar = np.zeros((W, G))
        self.stiffer_bar = np.zeros(e.stiffer.shape)

        def reverse(group: slice) -> None:
            for of, events, pieces, *held in reversed(self.rounds):
                if of == group:
                    e.holds[group], e.stiffer[group] = held  # places are as they closed on them
                    e.hold(np.arange(group.start, group.stop))
                    self._reverse_steps(group, pieces)
                    self._take_model(group)
                    for event in reversed(events):
                        self._reverse_event(group, event)
            nothing = np.zeros((group.stop - group.start, m.scratch_bars, P))
            put(self.adjoint.scratch, group, nothing)
            e.launch(e.kernels.begin_adjoint, group, [e.device_model, self.first, self.adjoint])

        e.in_threads(reverse, e.groups())
        return self._gradients()

    # ---- one group of worlds ---------------------------------------------------------------------

    def _reverse_steps(self, group: slice, pieces: Array) -> None:
        """Transpose the steps of a group's pieces [k, 2], the last first: each is recomputed in
        ``rows`` from its start."""
        e, model = self.engine, self.engine.device_model
        count = group.stop - group.start
        rows = e.zeros((count * (self.most + 1), self.rows, e.row_length))
        turns = e.zeros((count * model.contact, 9 * model.contact_most_turns, e.row_length))
        run = Run(e, self.plan).on_device
        run.offset, run.stride, run.state, run.kept = group.start, count, rows, rows
        given = [model, e.device_paths, run]
        length, size = pieces[:, 1] - pieces[:, 0], self.rows * e.row_length
        for back in range(int(length.max(initial=0))):
            there, s = back < length, pieces[:, 1] - 1 - back
            for k in np.flatnonzero(there).tolist():
                begins = int(group.start + k + s[k] * e.num_worlds) * size
                wp.copy(rows, self.kept, dest_offset=k * size, src_offset=begins, count=size)
            put(run.piece, group, np.where(there[:, None], np.stack([s, s + 1], axis=1), 0))
            e.launch(e.kernels.advance, group, given)
            e.launch(e.kernels.reverse, group, [*given, self.frames_bar, self.adjoint, turns])

    def _take_model(self, group: slice) -> None:
        """Add derivatives by the model without grippers, and by the grippers' borders."""
        e = self.engine
        found = self.adjoint.model.numpy()[group][..., e.slots].astype(float)
        put(self.adjoint.model, group, np.zeros((len(found), self.model_rows, e.row_length)))
        own = e.stiffer[group]
        stiffer = own.prod(axis=1)
        by_stiffer = e.model.unstiffened(group, stiffer, found)
        self.model_bar[group] += found
        closed = np.asarray(e.holds[group].any(axis=2))[:, :, None, None]
        self.stiffer_bar[group] += np.where(closed, (by_stiffer * stiffer)[:, None] / own, 0.0)

    def _reverse_event(self, group: slice, event: Event) -> None:
        e, g, w = self.engine, event.g, event.worlds
        G = e.closed.shape[1]
        local = w - group.start
        state = self.adjoint.state.numpy()[group].copy()

        def part(which: slice) -> Array:
            return np.swapaxes(state[local, which][..., e.slots], 1, 2).astype(float)

        def take(which: slice, values: Array) -> None:
            state[local, which] = e.rows(np.swapaxes(values, 1, 2))

        if event.closes:
            places = self.adjoint.place.numpy()[w * G + g][..., e.slots].astype(float)
            x_bar, q_bar, pose_bar = close_adjoint(event.grip, event.x, event.pose, places)
            by_x, by_centre, by_radius = border_adjoint(
                event.grip, e.model.lines, event.x, event.pose, self.stiffer_bar[w, g]
            )
            pose_bar.centre += by_centre
            self.radius_bar[w, g] += by_radius
            take(types.X, part(types.X) + x_bar + by_x)
            if e.model.directed:
                take(types.TURN_BAR, part(types.TURN_BAR) + q_bar)
        else:
            holds = event.grip.holds
            point, edge = (np.asarray(holds & what)[..., None] > 0 for what in (1, 2))
            v_bar = part(types.V)
            spin_bar = part(types.SPIN_BAR) if e.model.directed else np.zeros_like(v_bar)
            x_bar, pose_bar = released_adjoint(event.x, event.pose, holds, v_bar, spin_bar)
            take(types.X, part(types.X) + x_bar)
            take(types.V, np.where(point, 0.0, v_bar))
            if e.model.directed:
                take(types.SPIN_BAR, np.where(edge, 0.0, spin_bar))
        self.host.pose_adjoint(g, w, event.time, pose_bar)
        put(self.adjoint.state, group, state)

    # ---- sums ------------------------------------------------------------------------------------

    def _gradients(self) -> Gradients:
        e, m = self.engine, self.model_bar
        first = self.adjoint.state.numpy()[..., e.slots].astype(float)
        x, v = e.component(types.X, self.first), e.component(types.V, self.first)
        x_bar, v_bar = e.model.by_start(x, v, np.swapaxes(first, 1, 2))
        own = ("membrane",) * bool(np.isfinite(e.setting.parameters["membrane"]).any())
        parameters = ("E", "nu", "density", "thickness", *own, *e.model.woven)
        return Gradients(
            stiffness=e.model.share_bar(m[:, : e.device_model.stiffness.shape[1]]),
            damping=m[:, types.DAMPING].sum(axis=1),
            velocity_damping=m[:, types.VELOCITY_DAMPING].sum(axis=1),
            air_density=np.sum(m[:, types.DRAG] * e.model.drag, axis=1),
            friction=m[:, types.FRICTION].sum(axis=1),
            self_friction=m[:, types.SELF_FRICTION].sum(axis=1),
            obstacle_friction=m[:, types.MODEL_ROWS :].sum(axis=2),
            gravity=m[:, types.GRAVITY].sum(axis=2),
            positions=x_bar,
            velocities=v_bar,
            gripper_positions=self.adjoint.position.numpy() + self.host.position_bar,
            gripper_rotations=self.adjoint.path_turn.numpy() + self.host.turn_bar,
            gripper_radius=self.radius_bar,
            **{name: self._by_parameter(name) for name in parameters},
        )

    def _by_parameter(self, name: str) -> Array:
        """Derivatives by a parameter of each world's model, [W], through its coefficients.

        Source of the complex step: Squire and Trapp (1998), "Using complex variables to estimate
        derivatives of real functions".
        """
        e, m, h = self.engine, self.model_bar, 1e-30
        p = types.parameters_of(e.model.thickness, e.setting.parameters)
        slopes = e.model.coefficients(p | {name: p[name] + 1j * h})
        stiffness, mass, inertia, drag = (np.imag(values) / h for values in slopes)
        found = np.sum(m[:, : stiffness.shape[1]] * stiffness, axis=1)
        found -= m[:, types.PER_MASS] * e.per_mass**2 * mass
        found -= m[:, types.PER_TURN] * e.model.per_turn**2 * inertia
        found += m[:, types.DRAG] * e.air_density[:, None] * drag
        if name == "thickness":  # the body touches at half of it
            found += 0.5 * m[:, types.RADIUS] + m[:, types.DISTANCE]
        return np.sum(found, axis=1)
