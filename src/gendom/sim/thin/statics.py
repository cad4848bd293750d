"""The search for equilibria of thin bodies, frame by frame, each from the previous shape.

Relaxation (``relaxing``) finds a shape close to equilibrium and its contacts; Newton's method
(``balance``) then converges quadratically. Grippers close and open at their times, on shapes in
equilibrium.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.device import making
from gendom.sim.equilibria import Equilibria
from gendom.sim.thin import rotation
from gendom.sim.thin.balance import Balance, copied
from gendom.sim.thin.engine import CFL
from gendom.sim.thin.poses import Paths
from gendom.sim.thin.precision import doubled, take_state
from gendom.sim.thin.run import put
from gendom.sim.thin.sensitivity import Sensitivity
from gendom.sim.thin.tears import LOCAL_STRETCH, STRETCH, tear_error
from gendom.sim.thin.types import X

WAY = 0.005
"""Distance that grippers move in a relaxation step [spacings]."""

SAMPLES = 16
"""Number of pieces in which the length of a gripper's path is measured."""

BATCH = 400
"""Relaxation steps before the first attempt of Newton's method."""

NEAR = 0.1
"""Residual below which Newton's method is attempted."""

TOLERANCE, CONTACT_TOLERANCE = 1e-6, 0.02
"""Default tolerances for residuals without and with self-contact, whose impulses are only
approximate: the solver makes a few iterations in each step."""


class Search:
    """One call of ``Simulator.equilibria``.

    The search is in float64 even if the simulation is in float32: in stiff bodies the weight of a
    point is smaller than the float32 rounding error of the elastic forces.

    Args:
        engine: Rods or shells.
        times: [T] times of the frames [s].
        began: Time of the initial state [s].
        tolerance: Largest residual, or None for the defaults; never below the rounding error.
        most_steps: Maximum number of relaxation steps in a frame.
        increments: Equilibria for each frame.
        keep_going: Whether to continue when a world fails or a frame does not converge.
        derivatives: Names of parameters, see ``Sensitivity``.
    """

    def __init__(
        self,
        engine: Any,
        times: NDArray[np.float64],
        began: float,
        *,
        tolerance: float | None,
        most_steps: int,
        increments: int,
        keep_going: bool,
        derivatives: Sequence[str],
    ):
        self.given, self.engine = engine, doubled(engine)
        self.times, self.began = times, began
        self.most_steps, self.increments = most_steps, increments
        self.keep_going = keep_going
        e, T, W = self.engine, len(times), engine.num_worlds
        self.body = self._body()
        self.balance = Balance(e, self.body)
        self.sensitivity = Sensitivity(self.balance, derivatives, began=engine.used)
        engine.used = True
        default = CONTACT_TOLERANCE if e.setting.self_contact else TOLERANCE
        self.tolerance = max(tolerance or default, self.balance.rounding)
        damped = np.array([m.damping > 0.0 for m in e.setting.materials])
        # with damping, the step limit is that of twice the stiffness
        dt = CFL * e.longest * np.where(damped, np.sqrt(2.0), 1.0)
        self.dt = e.array(dt)
        self.begin, self.end = e.zeros(W, wp.float64), e.zeros(W, wp.float64)
        self.moves, self.steps = e.zeros(W, wp.int32), e.zeros(W, wp.int32)
        self.left = e.zeros(W)
        self.marks = e.zeros((W, 3, e.row_length))
        self.taken, self.stopped = e.zeros(W, wp.int32), e.zeros(W, wp.int32)
        n = e.num_points
        self.x = np.full((T, W, n, 3), np.nan, dtype=engine.setting.dtype)
        self.residual = np.full((T, W), np.inf)
        self.steps_taken = np.zeros((T, W), dtype=int)
        self.solves = np.zeros((T, W), dtype=int)
        self.derivatives = {
            name: np.full((T, W, n, 3, *self.sensitivity.shapes.get(name, ())), np.nan)
            for name in self.sensitivity.columns
        }
        self.kernels = self.balance.tangent.kernels
        with making:
            for name in ("relax", "balance", "tangent"):
                module = getattr(self.kernels, name).module
                wp.load_module(module, device=e.setting.device, block_dim=e.block)

    def _body(self) -> Any:
        """The engine's body without damping and air, with anchors for friction."""
        e = self.engine
        body = copied(e, e.body)
        W = e.num_worlds
        body.damping, body.velocity_damping = e.zeros(W), e.zeros(W)
        body.inertia = wp.clone(e.body.inertia)
        body.anchored = 1
        body.anchor = e.zeros((W, 3, e.row_length))
        return body

    def run(self) -> Equilibria:
        """Find the equilibria of all worlds in all frames.

        Raises:
            SimulationError: If a world fails or a frame does not converge, unless ``keep_going``
                is set.
        """
        e = self.engine
        with ThreadPoolExecutor(max_workers=e.setting.threads) as pool:
            for done in [pool.submit(self._run_group, group) for group in e.groups()]:
                done.result()
        e.last_dt[:] = 0.0
        if self.given is not e:
            take_state(self.given, e)
        if e.failures and not self.keep_going:
            raise e.failures[min(e.failures)]
        converged = self.residual <= self.tolerance
        if not converged.all() and not self.keep_going:
            frame, w = (int(k[0]) for k in np.nonzero(~converged))
            raise self._unconverged(frame, w)
        return Equilibria(
            times=self.times,
            positions=self.x,
            residual=self.residual,
            converged=converged,
            steps=self.steps_taken,
            solves=self.solves,
            derivatives=self.derivatives,
        )

    def _unconverged(self, frame: int, w: int) -> Any:
        return self.engine.setting.error(
            w,
            float(self.times[frame]),
            f"no equilibrium was found: {self.residual[frame, w]:.2g} of a point's weight is not "
            f"balanced in frame {frame}, allowed is {self.tolerance:.2g}",
            where=f"{self.steps_taken[frame, w]} steps of relaxation",
            fix="more frames, more steps (most_steps), a larger tolerance, or keep_going=True",
        )

    # ---- one group of worlds ---------------------------------------------------------------------

    def _run_group(self, group: slice) -> None:
        e = self.engine
        plans = {w: self._stations(w) for w in range(group.start, group.stop)}
        for k in range(max(len(plan) for plan in plans.values())):
            begun = {
                w: plan[k - 1][0] if k else self.began
                for w, plan in plans.items()
                if k < len(plan) and w not in e.failures
            }
            if not begun:
                return
            worlds, now = np.array(list(begun)), np.array(list(begun.values()))
            self.sensitivity.switch(e.switch(worlds, now))
            self._check_held(worlds, now)
            for w in begun:
                if w in e.torn and plans[w][k][0] > e.torn[w].time:
                    e.failures[w] = tear_error(e, w)
            stations = {w: (t, *plans[w][k]) for w, t in begun.items() if w not in e.failures}
            if stations:
                self._station(group, stations)

    def _stations(self, w: int) -> list[tuple[float, int]]:
        """Times at which equilibria are needed, in order, with their frames; -1: gripper event."""
        e = self.engine
        switches = {
            float(t)
            for name in ("hold_from", "hold_until")
            for t in e.stacked[name][w]
            if self.began < t < self.times[-1] and t not in self.times
        }
        before = np.concatenate([[self.began], self.times[:-1]])
        shares = np.arange(1, self.increments) / self.increments
        between = (before + shares[:, None] * (self.times - before)).reshape(-1)
        stations = [(float(t), f) for f, t in enumerate(self.times)]
        return sorted(stations + [(float(t), -1) for t in {*between, *switches}])

    def _check_held(self, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> None:
        """Check that the body is supported: a freely falling body has no equilibrium."""
        e, s = self.engine, self.engine.setting
        if s.table is not None or s.box is not None:
            return
        falls = np.any(self.balance.gravity[worlds] != 0.0, axis=1)
        falls &= ~np.any(e.holds[worlds] & 1, axis=(1, 2))
        for w, t in zip(worlds[falls].tolist(), now[falls].tolist(), strict=True):
            e.failures[w] = s.error(
                w,
                t,
                "there is no equilibrium: nothing holds the body",
                where="no gripper is closed, and there is no table",
                fix="a gripper that holds it, or a table below it",
            )

    def _station(self, group: slice, stations: dict[int, tuple[float, float, int]]) -> None:
        """Find equilibria of worlds in a group; stations hold (start time, end time, frame)."""
        e, W = self.engine, self.engine.num_worlds
        worlds = np.array(list(stations), dtype=int)
        begins, ends = (np.array([of[k] for of in stations.values()]) for k in (0, 1))
        self._prepare(group, worlds, begins, ends)
        moves, steps = np.zeros(W, dtype=int), np.zeros(W, dtype=int)
        moves[worlds] = self._moves(worlds, begins, ends)
        steps[worlds] = BATCH + moves[worlds]
        most = self.most_steps + moves
        near, solves = np.full(W, NEAR), np.zeros(W, dtype=int)
        restless, going = set(stations), moves
        while restless:
            left = self._relax(group, going, steps)
            going = 0 * moves
            taken, stopped = self.taken.numpy(), self.stopped.numpy()
            for w in sorted(restless):
                if stopped[w]:
                    e.failures[w] = self._stretched(w, stations[w][1])
                elif left[w] > self.tolerance and left[w] <= near[w]:
                    solves[w] += self.balance.solve(w, self.tolerance)
                    near[w] = 0.1 * left[w]
                    left[w] = self._left_of(group, w)
                if w in e.failures or left[w] <= self.tolerance or taken[w] >= most[w]:
                    restless.discard(w)
            steps = np.array([w in restless for w in range(W)]) * np.minimum(
                2 * steps, most - taken
            )
        left, taken, x = self._left(), self.taken.numpy(), e.component(X)
        for w, (_, t, f) in stations.items():
            if w not in e.failures:
                self._differentiate(w, t)
            if w not in e.failures and f >= 0:
                self.x[f, w] = x[w] + e.origin
                self.residual[f, w], self.solves[f, w] = left[w], solves[w]
                self.steps_taken[f, w] = taken[w]
                for name, values in self.sensitivity.values(w).items():
                    self.derivatives[name][f, w] = values

    def _prepare(
        self, group: slice, worlds: NDArray[Any], begins: NDArray[Any], ends: NDArray[Any]
    ) -> None:
        """Set the anchors of friction to the current shapes, and the start and end times."""
        e, k = self.engine, group.stop - group.start
        state = e.state.numpy()[group]
        e.kept_time[worlds] = begins
        put(e.kept_state, group, state)
        put(self.body.anchor, group, state[:, X])
        self.sensitivity.begin(worlds)
        inertia = e.body.inertia.numpy()[group].copy()
        inertia[:, 2 if e.kind == "rod" else 1] = 0.0  # no air drag
        put(self.body.inertia, group, inertia)
        for array, values in ((self.begin, begins), (self.end, ends)):
            times = np.zeros(k)
            times[worlds - group.start] = values
            put(array, group, times)
        put(self.taken, group, np.zeros(k, dtype=np.int32))

    def _differentiate(self, w: int, time: float) -> None:
        if self.derivatives:
            try:
                self.sensitivity.solve(w, time)
            except SimulationError as error:
                self.engine.failures[w] = error

    def _moves(
        self, worlds: NDArray[np.int64], begins: NDArray[np.float64], ends: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Number of steps in which grippers move along their paths, [k]."""
        e = self.engine
        k, G = len(worlds), e.closed.shape[1]
        longest = np.zeros(k)
        paths, shares = Paths(e.stacked), np.linspace(0.0, 1.0, SAMPLES + 1)[:, None]
        times = (begins + shares * (ends - begins)).reshape(-1)
        for g in range(G):
            pose = paths.pose(g, np.tile(worlds, SAMPLES + 1), times)
            centre, q = pose.centre.reshape(-1, k, 3), pose.q.reshape(-1, k, 4)
            angle = 2.0 * np.linalg.norm(rotation.between(q[:-1], q[1:])[..., :3], axis=2)
            place = e.body.place.numpy()[worlds * G + g][:, :3][..., e.slots]
            held = (e.holds[worlds, g] & 1) > 0
            size = np.where(held, np.linalg.norm(place, axis=1), 0.0).max(axis=1) + e.spacing
            way = np.linalg.norm(np.diff(centre, axis=0), axis=2) + size * angle
            longest = np.maximum(longest, np.where(held.any(axis=1), way.sum(axis=0), 0.0))
        return np.ceil(longest / (WAY * e.spacing)).astype(int) + 1

    def _relax(self, group: slice, moves: NDArray[Any], steps: NDArray[Any]) -> NDArray[np.float64]:
        """Relax a group's worlds by ``steps`` steps and return their residuals [W]."""
        e = self.engine
        put(self.moves, group, moves[group].astype(np.int32))
        put(self.steps, group, steps[group].astype(np.int32))
        least = e.array(self.tolerance * self.balance.unit)
        e.launch(
            self.kernels.relax,
            group,
            [
                self.body, e.paths, self.begin, self.end, self.moves, self.steps, self.dt, least,
                LOCAL_STRETCH**2, STRETCH, e.state, self.marks, self.left, self.taken, self.stopped,
            ],
        )  # fmt: skip
        return self._left()

    def _left(self) -> NDArray[np.float64]:
        return self.left.numpy().astype(float) / self.balance.unit

    def _left_of(self, group: slice, w: int) -> float:
        """Residual of one world, computed by a step from rest."""
        one = np.zeros(self.engine.num_worlds, dtype=np.int32)
        one[w] = 1
        return float(self._relax(group, 0 * one, one)[w])

    def _stretched(self, w: int, time: float) -> Any:
        return self.engine.setting.error(
            w,
            time,
            f"the body is stretched or compressed by more than {100 * STRETCH:.0f} % in the mean, "
            f"or somewhere by more than {100 * LOCAL_STRETCH:.0f} %",
            where="search for an equilibrium",
            fix="grippers that pull it apart go less far, or more frames",
        )
