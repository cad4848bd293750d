"""The reverse mode of rods: pieces of steps are run again from kept states, then transposed."""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.gradients import Gradients
from gendom.sim.mpm.types import make_types as make_path_types
from gendom.sim.setting import Frames, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.engine import Event, Round, ThinEngine, device_plan, put
from gendom.sim.thin.grips import Paths, close_adjoint, released_adjoint
from gendom.sim.thin.rod import material_gradients
from gendom.sim.thin.types import (
    MARGIN,
    MODEL_BARS,
    Q_BAR,
    SCRATCH_BARS,
    SPIN_BAR,
    STATE,
    STATE_BARS,
    V_BAR,
    X_BAR,
    X,
    in_rows,
    row_length,
)

BENDING, PER_MASS, PER_TURN, DRAG = slice(3, 6), 12, 13, 14
REST_STRAINS, GRAVITY, DAMPING, FRICTION, VELOCITY_DAMPING = slice(6, 12), slice(15, 18), 18, 19, 20
"""Components of derivatives by the model, see ``native/rod_adjoint.h``."""


class RodTape:
    """A run of rods that can be differentiated.

    Args:
        engine: Not run before.
        memory: Bound on what is kept [bytes]; half of it for kept states, half for recorded steps.
    """

    def __init__(self, engine: ThinEngine, memory: float):
        self.engine = engine
        self.memory = memory
        self.rounds: list[tuple[slice, Round]] = []

    def forward(self, times: NDArray[np.float64], began: float) -> NDArray[np.floating]:
        """[T, W, n, 3] points at the given times [m]."""
        e = self.engine
        T, W, n = len(times), e.num_worlds, e.num_points
        x = np.empty((T, W, n, 3), dtype=e.setting.dtype)
        frames = Frames(began, times, np.arange(n), x, None, False)
        steps = math.ceil((times[-1] - began) / e.setting.substep.min()) + 1
        room = self.memory / (W * STATE * row_length(n) * np.dtype(e.setting.dtype).itemsize)
        self.most = int(max(2, min(math.ceil(math.sqrt(steps)), room)))
        self.first_x, self.first_v = e.component(X), e.component(slice(3, 6))
        self.first = wp.clone(e.state)
        pieces = e.schedule(frames, self.most).steps.shape[1]
        self.kept = e.zeros((pieces * W, STATE, row_length(n)))
        self.plan = e.run_rounds(
            frames,
            lambda group, round: self.rounds.append((group, self._with_held(group, round))),
            most_steps=self.most,
            kept=self.kept,
        )
        return x

    def _with_held(self, group: slice, round: Round) -> Round:
        """Remember what grippers hold in a round, which kernels must be told again."""
        e = self.engine
        round.held = (e.holds[group].copy(), e.stiffer[group].copy(), self._places(group))
        return round

    def _places(self, group: slice) -> NDArray[Any]:
        G = len(self.engine.grips)
        return self.engine.rod.place.numpy()[group.start * G : group.stop * G].copy()

    def backward(self, bar: NDArray[np.floating]) -> Gradients:
        """Derivatives from those by the points of ``forward``."""
        e = self.engine
        W, n, G = e.num_worlds, e.num_points, len(e.grips)
        k = e.types
        self.bars = k.Bars()
        self.bars.state = e.zeros((W, STATE_BARS, row_length(n)))
        self.bars.model = e.zeros((W, MODEL_BARS, row_length(n)))
        self.bars.scratch = e.zeros((W, SCRATCH_BARS, row_length(n)))
        self.bars.place = e.zeros((W * G, 6, row_length(n)))
        self.bars.centre = e.zeros((W, G), k.vec3)
        self.bars.turn = e.zeros((W, G), k.vec3)
        self.scene_bars = make_path_types(e.real).SceneBars()
        shape = e.stacked["time"].shape
        self.scene_bars.position = e.zeros(shape, wp.vec3d)
        self.scene_bars.turn = e.zeros(shape, wp.vec3d)
        self.frames_bar = e.array(bar, k.vec3)
        self.plan_on_device = device_plan(e, self.plan)
        self.silent = device_plan(e, self.plan, record=False)
        self.host = Paths(e.stacked)
        self.model_bar = np.zeros((W, MODEL_BARS, n))
        self.radius_bar = np.zeros((W, G))
        self.stiffer_bar = np.zeros((W, G, n))
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
        W, count = e.num_worlds, group.stop - group.start
        e.holds[group], e.stiffer[group] = holds, stiffer
        G = len(e.grips)
        put(e.rod.place, slice(group.start * G, group.stop * G), places)
        worlds = np.arange(group.start, group.stop)
        self._hold(group)
        length = round.pieces[:, 1] - round.pieces[:, 0]
        P = row_length(e.num_points)
        rows = e.zeros((count * (self.most + 1), STATE, P))
        for back in range(int(length.max(initial=0))):
            s = np.where(back < length, round.pieces[:, 1] - 1 - back, -1).astype(np.int32)
            alive = s >= 0
            kept = np.arange(count)
            size = STATE * P
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
            dummy = wp.zeros((0, 0, 0), dtype=e.types.vec3, device=e.setting.device)
            nobody = wp.zeros(0, dtype=wp.int32, device=e.setting.device)
            e.launch(
                e.kernels.advance, group,
                [e.rod, e.paths, self.silent, e.array(whole, wp.int32), group.start, count, rows,
                 rows, -1, 1e30, none, dummy, nobody],
            )  # fmt: skip
            e.launch(
                e.kernels.reverse, group,
                [e.rod, e.paths, self.plan_on_device, e.array(every, wp.int32), group.start, count,
                 rows, self.frames_bar, self.bars, self.scene_bars],
            )  # fmt: skip
        self._take_model(group)
        for event in reversed(round.events):
            self._reverse_event(group, event)

    def _hold(self, group: slice) -> None:
        e = self.engine
        n = e.num_points
        put(e.rod.holds, group, e.holds[group])
        stiffer = e.stiffer[group].prod(axis=1)
        inertia = e.rod.inertia.numpy()[group].copy()
        inertia[:, 3, MARGIN : MARGIN + n] = stiffer
        inertia[:, 1, MARGIN : MARGIN + n] = e.per_turn[group] / e.slower(stiffer)
        put(e.rod.inertia, group, inertia)

    def _take_model(self, group: slice) -> None:
        """Move derivatives by the model to where those by unheld joints are, and those by the
        border's stiffness to the grippers."""
        e, n = self.engine, self.engine.num_points
        found = self.bars.model.numpy()[group][..., MARGIN : MARGIN + n].astype(float)
        put(self.bars.model, group, np.zeros((len(found), MODEL_BARS, row_length(n))))
        own = e.stiffer[group]
        stiffer = own.prod(axis=1)
        B = e.model.stiffness[group, 3:]
        stiffer_bar = np.sum(found[:, BENDING] * B, axis=1)
        found[:, BENDING] *= stiffer[:, None]
        # edges beside stiffer joints turn by more inertia, that of the stiffer one
        slower = e.slower(stiffer)
        slower_bar = -found[:, PER_TURN] * e.per_turn[group] / slower**2
        found[:, PER_TURN] /= slower
        at = (stiffer == slower) & (slower > 1.0)
        stiffer_bar += np.where(at, slower_bar, 0.0)
        after = (stiffer[:, 1:] == slower[:, :-1]) & (slower[:, :-1] > 1.0) & ~at[:, :-1]
        stiffer_bar[:, 1:] += np.where(after, slower_bar[:, :-1], 0.0)
        self.model_bar[group] += found
        closed = e.holds[group].any(axis=2, keepdims=True)
        self.stiffer_bar[group] += np.where(closed, (stiffer_bar * stiffer)[:, None] / own, 0.0)

    def _reverse_event(self, group: slice, event: Event) -> None:
        e, n, g, w = self.engine, self.engine.num_points, event.g, event.worlds
        G = len(e.grips)
        local = w - group.start
        state = self.bars.state.numpy()[group].copy()

        def part(which: slice) -> NDArray[np.float64]:
            return np.swapaxes(state[local, which, MARGIN : MARGIN + n], 1, 2).astype(float)

        def take(which: slice, values: NDArray[np.floating]) -> None:
            state[local, which] = in_rows(np.swapaxes(values, 1, 2), n)

        if event.closes:
            rows = w * G + g
            places = self.bars.place.numpy()[rows][..., MARGIN : MARGIN + n].astype(float)
            x_bar, q_bar, pose_bar, radius_bar = close_adjoint(
                event.grip, event.x, event.pose, e.model.length, places, self.stiffer_bar[w, g]
            )
            take(X_BAR, part(X_BAR) + x_bar)
            turns = part(Q_BAR)
            turns[:, :-1] += q_bar
            take(Q_BAR, turns)
            self.radius_bar[w, g] += radius_bar
            self.host.pose_adjoint(g, w, event.time, pose_bar)
        else:
            v_bar, spin_bar = part(V_BAR), part(SPIN_BAR)
            x_bar, pose_bar = released_adjoint(event.x, event.pose, event.grip, v_bar, spin_bar)
            take(X_BAR, part(X_BAR) + x_bar)
            take(V_BAR, np.where((event.grip.holds & 1)[..., None] > 0, 0.0, v_bar))
            take(SPIN_BAR, np.where((event.grip.holds & 2)[..., None] > 0, 0.0, spin_bar))
            self.host.pose_adjoint(g, w, event.time, pose_bar)
        put(self.bars.state, group, state)

    def _reverse_begin(self, group: slice) -> None:
        e = self.engine
        P = row_length(e.num_points)
        put(self.bars.scratch, group, np.zeros((group.stop - group.start, SCRATCH_BARS, P)))
        e.launch(e.kernels.begin_adjoint, group, [e.rod, self.first, 0, self.bars])
        # joints' lagged strains were taken with no gripper closed
        n = e.num_points
        found = self.bars.model.numpy()[group][..., MARGIN : MARGIN + n].astype(float)
        self.model_bar[group, REST_STRAINS] += found[:, REST_STRAINS]

    # ---- sums ------------------------------------------------------------------------------------

    def _gradients(self) -> Gradients:
        e, s, m = self.engine, self.engine.setting, self.model_bar
        W, n = e.num_worlds, e.num_points
        state = self.bars.state.numpy()[..., MARGIN : MARGIN + n].astype(float)
        x_bar, v_bar, q_bar, spin_bar = (
            np.swapaxes(state[:, c], 1, 2) for c in (X_BAR, V_BAR, Q_BAR, SPIN_BAR)
        )
        x_bar, v_bar = x_bar.copy(), v_bar.copy()
        # spins are those of edges that turn with their points
        d, dv = np.diff(self.first_x, axis=1), np.diff(self.first_v, axis=1)
        square = np.sum(d**2, axis=2, keepdims=True)
        spin, bar = np.cross(d, dv) / square, spin_bar[:, :-1]
        _to_ends(v_bar, np.cross(bar, d) / square)
        turned = np.cross(dv, bar) - 2.0 * np.sum(spin * bar, axis=2, keepdims=True) * d
        _to_ends(x_bar, turned / square)
        first = np.broadcast_to(e.model.rest_q[0], (W, 4))
        _to_ends(x_bar, rotation.transported_adjoint(first, d, q_bar[:, :-1]))
        share = spread(s.stiffness, (W, n), "stiffness")
        E, nu, stiffness = material_gradients(
            e.model.section, s.materials, share, e.model.length, m[:, :6]
        )
        density = np.array([material.density for material in s.materials])
        by_inertia = m[:, PER_MASS] / e.model.mass + m[:, PER_TURN] * e.per_turn
        position = self.scene_bars.position.numpy() + self.host.position_bar
        rotations = self.scene_bars.turn.numpy() + self.host.turn_bar
        found = Gradients(
            E=E,
            nu=nu,
            density=-by_inertia.sum(axis=1) / density,
            yield_stress=np.zeros(W),
            stiffness=stiffness,
            damping=m[:, DAMPING].sum(axis=1),
            velocity_damping=m[:, VELOCITY_DAMPING].sum(axis=1),
            air_density=m[:, DRAG] @ e.drag_by_air,
            friction=m[:, FRICTION].sum(axis=1),
            gravity=m[:, GRAVITY].sum(axis=2),
            positions=x_bar,
            velocities=v_bar,
            gripper_positions=position,
            gripper_rotations=rotations,
            gripper_radius=self.radius_bar,
            rest_strains=np.swapaxes(m[:, REST_STRAINS], 1, 2),
        )
        for name, values in vars(found).items():
            if values is not None and not np.isfinite(values).all():
                w = int(np.argwhere(~np.isfinite(values))[0][0])
                raise SimulationError(
                    f"the derivative by {name} is not finite",
                    where=f"world {w}",
                    fix="a smaller substep, or a loss that is finite",
                    world=w,
                )
        return found


def _to_ends(points: NDArray[np.floating], edges: NDArray[np.floating]) -> None:
    """Add derivatives by edges x_(e+1) - x_e [W, n - 1, 3] to those by points."""
    points[:, 1:] += edges
    points[:, :-1] -= edges
