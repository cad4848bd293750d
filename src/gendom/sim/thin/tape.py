"""Reverse mode of thin bodies: pieces are recomputed from checkpoints, then transposed."""

import math
from abc import ABC, abstractmethod
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.gradients import Gradients
from gendom.sim.setting import Frames
from gendom.sim.thin import rotation
from gendom.sim.thin.contact import LISTED, kept_turns
from gendom.sim.thin.grips import (
    Grip,
    border_of_rod_adjoint,
    border_of_shell_adjoint,
    close_adjoint,
    released_adjoint,
)
from gendom.sim.thin.poses import Paths
from gendom.sim.thin.rods import Rods, slower
from gendom.sim.thin.run import Event, Round, device_plan, put
from gendom.sim.thin.schedule import Schedule
from gendom.sim.thin.shells import Shells
from gendom.sim.thin.slopes import WEAVE, Slopes
from gendom.sim.thin.types import (
    DAMPING,
    DISTANCE,
    DRAG,
    FRICTION,
    GRAVITY,
    MODEL_BARS,
    PER_MASS,
    RADIUS,
    SELF_FRICTION,
    VELOCITY_DAMPING,
    V,
    X,
)

PER_TURN = 14
"""Component of derivatives with respect to a rod's model."""

TURN, SPIN_BAR = slice(6, 9), slice(9, 12)
"""Components of derivatives with respect to a rod's state: rotations of directions, and spins."""


class ThinTape(ABC):
    """A run of thin bodies that can be differentiated.

    Args:
        engine: An engine that has not been run.

    The number of checkpoints and the number of steps in a piece are both about the square root of
    the total number of steps: less memory would require running pieces several times.
    """

    def __init__(self, engine: Any):
        self.engine = engine
        self.rounds: list[tuple[slice, Round]] = []
        engine.load("reverse", "begin_adjoint")

    def forward(self, times: NDArray[np.float64], began: float) -> NDArray[np.floating]:
        """Simulate, and return points at the given times, [T, W, n, 3] [m]."""
        e = self.engine
        T, W, n = len(times), e.num_worlds, e.num_points
        x = np.empty((T, W, n, 3), dtype=e.setting.dtype)
        frames = Frames(began, times, np.arange(n), x, None, False)
        self.first_x, self.first_v = e.component(X), e.component(V)
        self.first = wp.clone(e.state)
        self.plan = self.record(frames)
        return x

    def record(self, frames: Frames) -> Schedule:
        """Simulate, and keep what the reverse pass needs."""
        e, W = self.engine, self.engine.num_worlds
        steps = math.ceil((frames.times[-1] - frames.began) / e.setting.substep.min()) + 1
        self.most = max(2, math.ceil(math.sqrt(steps)))
        pieces = e.schedule(frames, self.most).steps.shape[1]
        self.rows = e.state_rows + LISTED * e.body.contact
        self.kept = e.zeros((pieces * W, self.rows, e.row_length))
        return e.run_rounds(
            frames,
            lambda group, round: self.rounds.append((group, self._with_held(group, round))),
            most_steps=self.most,
            kept=self.kept,
        )

    def _with_held(self, group: slice, round: Round) -> Round:
        """Store the held points of a round, which the reverse pass copies to the kernels again."""
        e = self.engine
        round.held = (e.holds[group].copy(), e.stiffer[group].copy(), self._places(group))
        return round

    def _places(self, group: slice) -> NDArray[Any]:
        G = self.engine.closed.shape[1]
        return self.engine.body.place.numpy()[group.start * G : group.stop * G].copy()

    def backward(self, bar: NDArray[np.floating]) -> Gradients:
        """Derivatives with respect to all inputs, given those by the points of ``forward``."""
        e = self.engine
        W, n, G = e.num_worlds, e.num_points, e.closed.shape[1]
        k = e.types
        self.bars = k.Bars()
        self.bars.state = e.zeros((W, e.state_bars, e.row_length))
        self.bars.model = e.zeros((W, MODEL_BARS, e.row_length))
        self.bars.scratch = e.zeros((W, e.scratch_bars, e.row_length))
        self.bars.place = e.zeros((W * G, 6, e.row_length))
        self.bars.centre = e.zeros((W, G), k.vec3)
        self.bars.turn = e.zeros((W, G), k.vec3)
        shape = e.stacked["time"].shape
        self.bars.position = e.zeros(shape, wp.vec3d)
        self.bars.path_turn = e.zeros(shape, wp.vec3d)
        self.frames_bar = e.array(bar, k.vec3)
        self.plan_on_device = device_plan(e, self.plan)
        self.silent = device_plan(e, self.plan, record=False)
        self.host = Paths(e.stacked)
        self.model_bar = np.zeros((W, MODEL_BARS, n))
        self.radius_bar = np.zeros((W, G))
        self.stiffer_bar = np.zeros((W, G, len(e.stiffened), n))
        groups = list(e.groups())

        def one(group: slice) -> None:
            for of, round in reversed(self.rounds):
                if of == group:
                    self._reverse_round(group, round)
            self._reverse_begin(group)

        with ThreadPoolExecutor(max_workers=e.setting.threads) as pool:
            for done in [pool.submit(one, group) for group in groups]:
                done.result()
        return self._gradients()

    # ---- one group of worlds ---------------------------------------------------------------------

    def _reverse_round(self, group: slice, round: Round) -> None:
        e = self.engine
        holds, stiffer, places = round.held
        e.holds[group], e.stiffer[group] = holds, stiffer
        G = e.closed.shape[1]
        put(e.body.place, slice(group.start * G, group.stop * G), places)
        worlds = np.arange(group.start, group.stop)
        e.hold(worlds)
        self.reverse_steps(group, round)
        self._take_model(group)
        for event in reversed(round.events):
            self._reverse_event(group, event)

    def reverse_steps(self, group: slice, round: Round) -> None:
        """Transpose the steps of a group's round."""
        e = self.engine
        W, count = e.num_worlds, group.stop - group.start
        worlds = np.arange(group.start, group.stop)
        length = round.pieces[:, 1] - round.pieces[:, 0]
        P = e.row_length
        rows = e.zeros((count * (self.most + 1), self.rows, P))
        turns = kept_turns(e, count)
        for back in range(int(length.max(initial=0))):
            s = np.where(back < length, round.pieces[:, 1] - 1 - back, -1).astype(np.int32)
            alive = s >= 0
            kept = np.arange(count)
            size = self.rows * P
            for k in kept[alive]:
                begins = int(worlds[k] + s[k] * W) * size
                wp.copy(rows, self.kept, dest_offset=int(k) * size, src_offset=begins, count=size)
            pieces = np.stack([s, s + 1], axis=1).astype(np.int32)
            pieces[~alive] = 0
            whole = np.zeros((W, 2), dtype=np.int32)
            whole[group] = pieces
            every = np.full(W, -1, dtype=np.int32)
            every[group] = s
            none = wp.full(W, -1, dtype=wp.int32, device=e.setting.device)
            never = e.zeros(W, wp.float64)
            dummy = wp.zeros((0, 0, 0), dtype=e.types.vec3, device=e.setting.device)
            nobody = wp.zeros(0, dtype=wp.int32, device=e.setting.device)
            e.launch(
                e.kernels.advance, group,
                [e.body, e.paths, self.silent, e.array(whole, wp.int32), group.start, count, rows,
                 rows, -1, 1e30, 1e30, none, never, dummy, nobody],
            )  # fmt: skip
            e.launch(
                e.kernels.reverse, group,
                [e.body, e.paths, self.plan_on_device, e.array(every, wp.int32), group.start, count,
                 rows, self.frames_bar, self.bars, turns],
            )  # fmt: skip

    def _take_model(self, group: slice) -> None:
        """Add derivatives by the model without grippers, and by the grippers' borders."""
        e = self.engine
        found = self.bars.model.numpy()[group][..., e.slots].astype(float)
        put(self.bars.model, group, np.zeros((len(found), MODEL_BARS, e.row_length)))
        own = e.stiffer[group]
        stiffer = own.prod(axis=1)
        bars = self.unstiffened(group, stiffer, found)
        self.model_bar[group] += found
        closed = e.holds[group].any(axis=2)[:, :, None, None]
        self.stiffer_bar[group] += np.where(closed, (bars * stiffer)[:, None] / own, 0.0)

    def _reverse_event(self, group: slice, event: Event) -> None:
        e, g, w = self.engine, event.g, event.worlds
        G = e.closed.shape[1]
        local = w - group.start
        state = self.bars.state.numpy()[group].copy()

        def part(which: slice) -> NDArray[np.float64]:
            return np.swapaxes(state[local, which][..., e.slots], 1, 2).astype(float)

        def take(which: slice, values: NDArray[np.floating]) -> None:
            state[local, which] = e.rows(np.swapaxes(values, 1, 2))

        if event.closes:
            places = self.bars.place.numpy()[w * G + g][..., e.slots].astype(float)
            x_bar, q_bar, pose_bar = close_adjoint(event.grip, event.x, event.pose, places)
            by_x, by_centre, by_radius = self.border_adjoint(event, self.stiffer_bar[w, g])
            pose_bar.centre += by_centre
            self.radius_bar[w, g] += by_radius
            take(X, part(X) + x_bar + by_x)
            self.take_turns(part, take, q_bar)
            self.host.pose_adjoint(g, w, event.time, pose_bar)
        else:
            v_bar, spin_bar = part(V), self.spins(part)
            x_bar, pose_bar = released_adjoint(event.x, event.pose, event.grip, v_bar, spin_bar)
            take(X, part(X) + x_bar)
            take(V, np.where((event.grip.holds & 1)[..., None] > 0, 0.0, v_bar))
            self.stop_spins(part, take, event.grip)
            self.host.pose_adjoint(g, w, event.time, pose_bar)
        put(self.bars.state, group, state)

    def _reverse_begin(self, group: slice) -> None:
        e = self.engine
        P = e.row_length
        put(self.bars.scratch, group, np.zeros((group.stop - group.start, e.scratch_bars, P)))
        e.launch(e.kernels.begin_adjoint, group, [e.body, self.first, 0, self.bars])
        found = self.bars.model.numpy()[group][..., e.slots].astype(float)
        self.model_bar[group, self.rest_rows] += found[:, self.rest_rows]

    # ---- sums ------------------------------------------------------------------------------------

    def _gradients(self) -> Gradients:
        e, s, m = self.engine, self.engine.setting, self.model_bar
        bars = self.bars.state.numpy()
        state = np.swapaxes(bars[..., e.slots].astype(float), 1, 2)
        x_bar, v_bar = self.by_start(state)
        own = {name: self.by_parameter(name) for name in e.parameters()}
        weave = [own.pop(name) for name in WEAVE if name in own]
        found = Gradients(
            E=self.by_parameter("E"),
            nu=self.by_parameter("nu"),
            density=self.by_parameter("density"),
            stiffness=self.by_shares(),
            damping=m[:, DAMPING].sum(axis=1),
            velocity_damping=m[:, VELOCITY_DAMPING].sum(axis=1),
            air_density=m[:, DRAG] @ e.drag_by_air,
            friction=m[:, FRICTION].sum(axis=1),
            self_friction=m[:, SELF_FRICTION].sum(axis=1),
            gravity=m[:, GRAVITY].sum(axis=2),
            positions=x_bar,
            velocities=v_bar,
            gripper_positions=self.bars.position.numpy() + self.host.position_bar,
            gripper_rotations=self.bars.path_turn.numpy() + self.host.turn_bar,
            gripper_radius=self.radius_bar,
            rest_strains=np.swapaxes(m[:, self.rest_rows], 1, 2),
            weave=np.stack(weave, axis=1) if weave else None,
            **own,
        )
        for name, values in vars(found).items():
            if values is not None and not np.isfinite(values).all():
                w = int(np.argwhere(~np.isfinite(values))[0][0])
                raise s.error(
                    w,
                    float(self.plan.begins[w].max()),
                    f"the derivative by {name} is not finite",
                    where=f"{s.dtype}",
                    fix="use float64, a shorter rollout, or more damping",
                )
        return found

    def by_parameter(self, name: str) -> NDArray[np.float64]:
        """Derivatives by a parameter of each world's model, [W]."""
        e, m = self.engine, self.model_bar
        by, R = e.slopes(name), e.body.stiffness.shape[1]
        drag = e.air_density[:, None] * e.drag_by_air
        touching = 0.5 * m[:, RADIUS] + m[:, DISTANCE]
        found = np.sum(m[:, :R] * by.stiffness, axis=1) - m[:, PER_MASS] * e.per_mass * by.mass
        found += m[:, DRAG] * drag * by.drag + touching * by.thickness
        return np.sum(found + self.by_turning(by), axis=1)

    # ---- defined by each kind of body ------------------------------------------------------------

    rest_rows: ClassVar[slice]
    """Components of derivatives with respect to stress-free strains."""

    @abstractmethod
    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """Convert derivatives ``found`` by the stiffness with borders to those by the stiffness
        without borders, in place; return the derivatives by ``stiffer`` [k, M, n]."""

    @abstractmethod
    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """See ``border_of_rod_adjoint``."""

    @abstractmethod
    def by_shares(self) -> NDArray[np.float64]:
        """Derivatives by the share of E at each point, [W, n]."""

    def by_turning(self, by: Slopes) -> NDArray[np.floating]:
        """Derivatives by a parameter through the inertia of edges, [W, n]."""
        del by  # shells have none
        return np.zeros(())

    def by_start(self, state: NDArray[np.floating]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Derivatives by initial positions and velocities [W, n, 3], given those by the state."""
        return state[..., X].copy(), state[..., V].copy()

    def take_turns(self, part: Any, take: Any, q_bar: NDArray[np.floating]) -> None:
        """Add derivatives by rotations of directions [k, n, 3]."""
        del part, take, q_bar  # shells have no directions

    def spins(self, part: Any) -> NDArray[np.floating]:
        """Derivatives by spins, [k, n, 3]."""
        return np.zeros_like(part(V))

    def stop_spins(self, part: Any, take: Any, grip: Grip) -> None:
        """Set derivatives by the spins of held edges to 0."""
        del part, take, grip  # shells have no spins


class RodTape(ThinTape):
    """Tape of rods."""

    engine: Rods
    rest_rows = slice(6, 12)

    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        e, one = self.engine, stiffer[:, 0]
        bar = np.sum(found[:, 3:6] * e.model.stiffness[group, 3:], axis=1)
        found[:, 3:6] *= stiffer
        # edges beside stiffer joints have more inertia, according to the stiffer joint
        slow = slower(one)
        by_slow = -found[:, PER_TURN] * e.per_turn[group] / slow**2
        found[:, PER_TURN] /= slow
        at = (one == slow) & (slow > 1.0)
        bar += np.where(at, by_slow, 0.0)
        after = (one[:, 1:] == slow[:, :-1]) & (slow[:, :-1] > 1.0) & ~at[:, :-1]
        bar[:, 1:] += np.where(after, by_slow[:, :-1], 0.0)
        return bar[:, None]

    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        length = self.engine.model.length
        return border_of_rod_adjoint(event.grip, event.x, event.pose, length, stiffer_bar)

    def by_shares(self) -> NDArray[np.float64]:
        e = self.engine
        return e.model.share_bar(e.setting.materials, self.model_bar[:, :6])

    def by_turning(self, by: Slopes) -> NDArray[np.floating]:
        return -self.model_bar[:, PER_TURN] * self.engine.per_turn * by.inertia

    def by_start(self, state: NDArray[np.floating]) -> tuple[NDArray[Any], NDArray[Any]]:
        x_bar, v_bar = super().by_start(state)
        q_bar, spin_bar = state[:, :-1, TURN], state[:, :-1, SPIN_BAR]
        # initial spins are those of edges that rotate with their points
        d, dv = np.diff(self.first_x, axis=1), np.diff(self.first_v, axis=1)
        square = np.sum(d**2, axis=2, keepdims=True)
        spin = np.cross(d, dv) / square
        _to_ends(v_bar, np.cross(spin_bar, d) / square)
        turned = np.cross(dv, spin_bar) - 2.0 * np.sum(spin * spin_bar, 2, keepdims=True) * d
        _to_ends(x_bar, turned / square)
        first = np.broadcast_to(self.engine.model.rest_q[0], (len(x_bar), 4))
        _to_ends(x_bar, rotation.transported_adjoint(first, d, q_bar))
        return x_bar, v_bar

    def take_turns(self, part: Any, take: Any, q_bar: NDArray[np.floating]) -> None:
        take(TURN, part(TURN) + q_bar)

    def spins(self, part: Any) -> NDArray[np.floating]:
        return part(SPIN_BAR)

    def stop_spins(self, part: Any, take: Any, grip: Grip) -> None:
        take(SPIN_BAR, np.where((grip.holds & 2)[..., None] > 0, 0.0, part(SPIN_BAR)))


class ShellTape(ThinTape):
    """Tape of shells."""

    engine: Shells
    rest_rows = slice(8, 11)

    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        e = self.engine
        modulus = (e.modulus * e.share[:, None])[group, 4:6]
        bar = found[:, 4:6] * modulus
        found[:, 4:6] *= stiffer
        return bar

    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        model = self.engine.model
        return border_of_shell_adjoint(event.grip, event.x, event.pose, model, stiffer_bar)

    def by_shares(self) -> NDArray[np.float64]:
        return np.sum(self.model_bar[:, :8] * self.engine.modulus, axis=1)


def _to_ends(points: NDArray[np.floating], edges: NDArray[np.floating]) -> None:
    """Add derivatives by edges x_(e+1) - x_e [W, n - 1, 3] to the derivatives by points."""
    points[:, 1:] += edges
    points[:, :-1] -= edges
