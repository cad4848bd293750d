"""`adam`: the paper's own method, gradients through the simulation and Adam.

Recorded and simulated clouds become densities on one grid of 64 cells; the loss is their L1
distance, the mean over the frames. The simulator's reverse mode gives its slope by modulus,
Poisson's ratio, damping and friction; by the other unknowns (grip, delay) it is a difference
between worlds side by side. Steps are those of Adam (Kingma and Ba 2015). Source: Kuroki et al.
(2024), section III-C.

Unlike theirs, steps are taken in the transformed unknowns, so in the logarithm of the modulus; step
sizes follow a cosine schedule, the iterate with the least loss is the result, and the uncertainty
comes from the likelihood there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from experiments.evolution import finished, only_part
from experiments.skins import surface_transpose
from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.estimation.likelihood import Comparison, Comparisons
from gendom.estimation.methods.search import best_of, first_starts
from gendom.estimation.problem import Found, Problem, Start
from gendom.estimation.replay import lattice, middle, simulator_of
from gendom.observation import visible

SCANNED = 16
"""Moduli of the scan that precedes the search, over the whole range."""

STEPS = 4
"""For each of `EstimateSettings.max_iterations`; 25 make the authors' 100."""

RATE, LAST_RATE = 0.02, 0.02
"""First step, in widest steps of the unknowns: 2 % of E and 0.002 of nu, as the authors'; the last
step's share of that (theirs: 1)."""

DECAY = 0.9, 0.999
"""Of the means of gradients and of their squares."""


def adam(problem: Problem, *, initial: Sequence[Array] = (), steps: int = STEPS) -> Found:
    """Search, and keep the best so far if interrupted.

    Args:
        problem: What is looked for.
        initial: [P] transformed: where to begin instead of at the best of a scan.
        steps: For each of `EstimateSettings.max_iterations`.

    Raises:
        SimulationError: No start can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    prior, most = problem.prior, steps * problem.settings.max_iterations
    _, starts = first_starts(problem, SCANNED, initial)
    interrupted = False
    try:
        loss = DensityLoss(problem)
        low, high = prior.within(2.0)
        descents = [_Descent(s, np.clip(s.vector, low, high)) for s in starts]
        for iteration in range(1, most + 1):
            if iteration % 10 == 1:  # the visible points are determined again
                for d in descents:
                    d.seen = None
            loss.evaluate([d for d in descents if not d.start.done])
            going = [d for d in descents if not d.start.done]
            if not going:
                break
            turn = 0.5 * (1.0 + math.cos(math.pi * (iteration - 1) / most))
            for d in going:
                d.step(RATE * (LAST_RATE + (1.0 - LAST_RATE) * turn) * prior.widest)
                d.vector = np.clip(d.vector, low, high)
            problem.tell("adam", iteration, most, best_of(starts) or starts[0])
    except KeyboardInterrupt:
        interrupted = True
        if best_of(starts) is None:
            raise
    for s in starts:
        s.done = True
    return finished(problem, starts, interrupted)


@dataclass(eq=False)
class _Descent:
    """One start on its way; `Start.vector` is the best place so far."""

    start: Start
    vector: Array
    """[P] where it is."""
    gradient: Array = field(default_factory=lambda: np.zeros(0))
    """[P] of the loss there."""
    seen: list[Array] | None = None
    """T masks of the skin's points that cameras see."""
    mean: Array | float = 0.0
    square: Array | float = 0.0

    def step(self, rate: Array) -> None:
        """One of Adam's, with rates [P]."""
        n, (a, b) = self.start.iterations, DECAY
        self.mean = a * self.mean + (1.0 - a) * self.gradient
        self.square = b * self.square + (1.0 - b) * self.gradient**2
        size = np.sqrt(self.square / (1.0 - b**n)) + 1e-12
        self.vector = self.vector - rate * self.mean / (1.0 - a**n) / size


class DensityLoss:
    """L1 distance between densities of recorded clouds and of a simulated object, of one recording.

    Raises:
        ParameterError: The thickness is looked for.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        self.part = only_part(problem)
        what, fix = "compares objects as thick as stated", "use gauss-newton"
        require("thickness" not in problem.prior.names, what, where="method adam", fix=fix)
        scene = self.part.scene
        clouds = [scene.recording.frame(t).astype(float) for t in scene.frames]
        path = scene.recording.gripper_position.reshape(-1, 3)
        around = np.concatenate([*clouds, scene.initial, path])
        self.grid = DensityGrid.around(around, margin=0.05 * scene.size, resolution=64)
        self.recorded = np.stack([self.grid.splat(cloud) for cloud in clouds])

    def shown(self, x: Array) -> Array:
        """[T, M, 3] points that stand for the object at positions [T, N, 3]: recorded markers, or
        its skin [m]."""
        markers = self.part.observation.markers
        if markers is None:
            return np.asarray(self.part.scene.body.surface(x), dtype=float)
        index, weight = markers
        return np.einsum("mk,tmka->tma", weight, middle(self.part.scene, x)[:, index])

    def seen(self, points: Array) -> list[Array]:
        """T masks [M] of the points [T, M, 3] that a recording would show."""
        scene = self.part.scene
        masks = [np.ones(points.shape[1], dtype=bool) for _ in points]
        if self.part.observation.markers is not None:
            return masks
        cameras = scene.recording.camera_positions
        for mask, p in zip(masks, points, strict=True):
            if scene.kind == "rope" or cameras is not None:
                mask &= visible(p, camera_positions=cameras)
            if scene.floor is not None and (mask & (p[:, 2] > scene.floor)).any():
                mask &= p[:, 2] > scene.floor
        return masks

    def value(self, x: Array, seen: Sequence[Array]) -> float:
        """Loss at positions [T, N, 3]; 2 at most."""
        return self._compare(self.shown(x), seen)[0]

    def value_and_gradient(self, x: Array, seen: Sequence[Array]) -> tuple[float, Array]:
        """That, and its derivative by the positions [T, N, 3] [1/m]."""
        value, bar = self._compare(self.shown(x), seen, derivative=True)
        if self.part.observation.markers is None:
            return value, surface_transpose(self.part.scene.body, x, bar)
        index, weight = self.part.observation.markers
        of_middle = np.zeros((len(lattice(self.part.scene)[0]), len(x), 3))
        for k, share in zip(index.T, weight.T, strict=True):
            np.add.at(of_middle, k, share[:, None, None] * np.swapaxes(bar, 0, 1))
        # each point of the middle is the mean of the particles of a section
        count = x.shape[1] // len(of_middle)
        return value, np.repeat(np.swapaxes(of_middle, 0, 1), count, axis=1) / count

    def _compare(
        self, shown: Array, seen: Sequence[Array], *, derivative: bool = False
    ) -> tuple[float, Array]:
        """Loss of points [T, M, 3], and its derivative by them if wanted."""
        T, M = shown.shape[:2]
        # hidden points lie off the grid and have no weight
        points = np.where(np.array(seen)[..., None], shown, self.grid.origin - 9.0 * self.grid.cell)
        share = (M / np.maximum(np.sum(seen, axis=1), 1))[:, None]
        total, bar = 0.0, np.zeros(shown.shape)
        together = max(1, (1 << 21) // self.grid.num_nodes)
        for t in (slice(k, k + together) for k in range(0, T, together)):
            off = self.grid.splat(points[t]) * share[t] - self.recorded[t]
            total += float(np.abs(off).sum()) / T
            if derivative:
                bar[t] = self.grid.splat_transpose(points[t], np.sign(off) * share[t] / T)
        return total, bar

    def evaluate(self, descents: Sequence[_Descent]) -> None:
        """Loss and slope of some descents from one batch; those that diverge are done."""
        from gendom.sim import Rollout  # Warp, which takes long to import

        problem, prior = self.problem, self.problem.prior
        going = list(descents)
        while going:
            thetas = [problem.theta(d.vector) for d in going]
            simulator, times = simulator_of(problem.scene, thetas)
            rollout = Rollout(simulator)
            try:
                x = rollout.forward(times).astype(float)
                bar = np.zeros(x.shape)
                values = []
                for w, d in enumerate(going):
                    d.seen = d.seen or self.seen(self.shown(x[:, w]))
                    value, bar[:, w] = self.value_and_gradient(x[:, w], d.seen)
                    values.append(value)
                reverse = rollout.backward(bar)
                break
            except SimulationError as error:
                if error.world is None:
                    raise
                going.pop(error.world).start.done = True
        else:
            return
        by = {name: getattr(reverse, name) for name in ("nu", "damping", "friction")}
        by["E_over_rho"] = problem.scene.density * reverse.E
        others = [k for k, name in enumerate(prior.names) if name not in by]
        worlds, steps = [], []
        for d in going:
            for k in others:
                h = -prior.step[k] if d.vector[k] + prior.step[k] > prior.high[k] else prior.step[k]
                worlds.append(d.vector + h * np.eye(len(d.vector))[k])
                steps.append(h)
        beside = problem.positions(worlds) if worlds else np.zeros((len(x), 0, *x.shape[2:]))
        for w, (d, theta) in enumerate(zip(going, thetas, strict=True)):
            assert d.seen is not None
            d.gradient = np.zeros(len(d.vector))
            for k, u in enumerate(prior.unknowns):
                if u.name in by:
                    d.gradient[k] = by[u.name][w] * (theta[u.name] if u.log else 1.0)
            for n, k in enumerate(others, start=w * len(others)):
                y = beside[:, n]
                if np.isfinite(y).all():
                    d.gradient[k] = (self.value(y, d.seen) - values[w]) / steps[n]
            s = d.start
            s.iterations += 1
            if values[w] < s.value:
                o, axis = self.part.observation, middle(problem.scene, x[:, w])
                still = np.zeros((*axis.shape, 0)), o.shape.radius, np.zeros(0)
                here = Comparison(o, axis, *still)
                s.vector, s.comparison, s.value = d.vector, Comparisons((here,)), values[w]


@dataclass(frozen=True, kw_only=True)
class DensityGrid:
    """A box of cells on which clouds become densities.

    A point gives each of the 27 nodes around it a weight that falls with distance: the product
    of quadratic B-splines of its position in the cell. Weights of a cloud sum to one, so a cloud
    of 100 points compares with one of 1,000. Source: Kuroki et al. (2024), section III-C.
    """

    origin: Array
    """[3] position of node (0, 0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""
    shape: tuple[int, int, int]
    """Nodes along x, y, z."""

    @classmethod
    def around(cls, points: ArrayLike, *, margin: float = 0.0, resolution: int = 64) -> DensityGrid:
        """The smallest grid of cubic cells around points [n, 3] [m].

        Args:
            points: [n, 3] [m].
            margin: Space to leave on every side [m].
            resolution: Nodes along the longest side; the paper's by default.

        Raises:
            ParameterError: If there are no points or they all coincide without a margin.
        """
        p = np.asarray(points, dtype=float).reshape(-1, 3)
        some = len(p) > 0 and np.isfinite(p).all()
        require(some, "a density grid needs finite points to stand around")
        require(resolution >= 4, f"a density grid needs 4 nodes or more, got {resolution}")
        low, high = p.min(axis=0) - margin, p.max(axis=0) + margin
        cell = float((high - low).max()) / (resolution - 3)
        require(cell > 0.0, "all points coincide: give the density grid a margin [m]")
        shape = np.minimum(np.ceil((high - low) / cell).astype(int) + 3, resolution)
        x, y, z = (int(n) for n in shape)
        return cls(origin=low - cell, cell=cell, shape=(x, y, z))

    @property
    def num_nodes(self) -> int:
        return int(np.prod(self.shape))

    def splat(self, points: ArrayLike) -> Array:
        """Densities [..., X * Y * Z] of clouds [..., n, 3]; a node off the grid takes nothing.

        Each cloud's weights sum to one when it lies on the grid.
        """
        p = np.asarray(points, dtype=float)
        lead, n = p.shape[:-2], p.shape[-2]
        index, weights, _ = self._stencil(p.reshape(-1, n, 3))
        index += (np.arange(len(index)) * self.num_nodes)[:, None, None, None, None]
        x, y, z = np.moveaxis(weights, 2, 0)
        weight = (x / n)[..., None, None] * y[..., None, :, None] * z[..., None, None, :]
        total = len(index) * self.num_nodes
        sums = np.bincount(index.ravel(), weight.ravel(), minlength=total)
        return sums.astype(float).reshape(*lead, self.num_nodes)

    def splat_transpose(self, points: ArrayLike, adjoint: ArrayLike) -> Array:
        """Derivative of a loss by the points of clouds, from that by their densities.

        Args:
            points: [..., n, 3] clouds [m].
            adjoint: [..., X * Y * Z] derivative of the loss by what `splat` makes of them.

        Returns:
            [..., n, 3] [1/m].
        """
        p = np.asarray(points, dtype=float)
        n = p.shape[-2]
        index, weights, derivatives = self._stencil(p.reshape(-1, n, 3))
        flat = np.asarray(adjoint, dtype=float).reshape(len(index), self.num_nodes)
        gathered = np.take_along_axis(flat, index.reshape(len(index), -1), axis=1)
        gathered = gathered.reshape(index.shape)
        found = np.empty((len(index), n, 3))
        for axis in range(3):
            x, y, z = ((derivatives if a == axis else weights)[:, :, a, :] for a in range(3))
            found[..., axis] = np.einsum("lnijk,lni,lnj,lnk->ln", gathered, x, y, z, optimize=True)
        return (found / (n * self.cell)).reshape(p.shape)

    def _stencil(self, p: Array) -> tuple[Array, Array, Array]:
        """Nodes [L, n, 3, 3, 3] around points [L, n, 3], the weights [L, n, 3 axes, 3] whose
        products they take, and their derivatives by the position in cells."""
        q = (p - self.origin) / self.cell
        base = np.floor(q - 0.5).astype(np.int64)
        f = q - base
        w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
        dw = np.stack([f - 1.5, 2.0 - 2.0 * f, f - 0.5], axis=-1)
        node = base[..., None] + np.arange(3)
        size = np.array(self.shape)[:, None]
        on = (node >= 0) & (node < size)
        node = np.clip(node, 0, size - 1)
        _, Y, Z = self.shape
        x, y, z = np.moveaxis(node, 2, 0)
        index = (x[..., None, None] * Y + y[..., None, :, None]) * Z + z[..., None, None, :]
        return index, np.where(on, w, 0.0), np.where(on, dw, 0.0)
