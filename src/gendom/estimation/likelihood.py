"""How likely clouds are, given a simulated shape: distances to its skin, with correlated errors.

A point p of a cloud lies on the skin: with c the nearest point of the middle line (or surface) and
r half the thickness, rho = |p - c| - r is noise. Where the simulated object sticks out of the cloud
by more than the cloud has gaps, the distance to the nearest point of the cloud counts as a
residual, too. Beside noise there are systematic errors: a rigid motion of the cameras, an offset of
the skin, and a smooth displacement of the model, correlated between neighbouring frames. These have
Gaussian priors (of the displacement a Gaussian process of low rank; Rasmussen and Williams 2006,
sections 2.7 and 8.1). The misfit that they leave, with their cost, is the likelihood of the
parameters. How large noise and displacement are is estimated from the recording itself, by
expectation and maximisation (Dempster et al. 1977).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from gendom.arrays import Array
from gendom.estimation.markers import Offsets, aside, material_frames, spread
from gendom.estimation.observed import NoiseModel, Observation, Rows

HUBER = 0.006
"""Distance beyond which a point's pull grows no further [m]: Huber's loss, smoothed."""

REGISTERED = 0.1
"""A registration ends where a step lowers -2 log likelihood by no more than this."""


def misfit(rows: Rows, rho: Array) -> float:
    """Smoothed sum of squares of residuals [T, m] [m^2]."""
    return float((rows.counts * 2.0 * rho**2 / (1.0 + rows.soft_root(HUBER, rho))).sum())


@dataclass(eq=False)
class Comparison:
    """Clouds beside one simulated shape."""

    observation: Observation
    axis: Array
    """[T, n, 3] the shape, of a cable with markers beside it the axis [m]."""
    J: Array
    """[T, n, 3, P] how it changes with the transformed parameters [m]."""
    radius: float
    """Half its thickness [m]."""
    widens: Array
    """[P] how that changes with the transformed parameters [m]."""
    offsets: Offsets = ()
    """[m, 3] by which markers are beside it [m], where that was found before."""

    def __post_init__(self) -> None:
        self._last: Fit | None = None
        self._near: Fit | None = None
        self._first = np.zeros(0)
        self._in_sight = cache(lambda t: self.observation.in_sight(self.axis[t]))

    def warm_start(self, other: Comparison, step: Array | None = None) -> None:
        """Start the registration from the result of a comparison nearby, or from where that goes
        with a step [P] from there to here, transformed."""
        if other._last is not None:
            last = other._last
            self._first = last.a if step is None else last.a + last.step - last.follows @ step

    def inherit_derivatives(self, other: Comparison, step: Array, weight: Array) -> None:
        """Take over the derivatives of a comparison of these frames and perhaps later ones, a step
        [P] away, with the smallest change that agrees with both shapes, by squares with weights [P]
        (Broyden 1965); with as many points if there is a step."""
        J = self.observation.shape.taken_from(other.observation.shape, other.J[: len(self.axis)])
        size = float(step @ (weight * step))
        if size > 0.0:
            missing = self.axis - other.axis - J @ step
            J = J + missing[..., None] * (weight * step / size)
        self.J, self.widens = J, other.widens
        self._near, self._last = self._last or self._near, None

    @cached_property
    def frames(self) -> Array:
        """[T, n, 3, 3] of a cable's cross-sections."""
        return material_frames(self.observation.scene, self.axis[:, None])[:, 0]

    @cached_property
    def rows(self) -> Rows:
        """Of the shape as it is, of a cable the line through its markers."""
        shape = self.axis
        if self.offsets:
            shape = shape + aside(self.observation.scene, self.frames, np.array(self.offsets))
        return self._rows(shape)

    def _rows(self, shape: Array, points: Array | None = None) -> Rows:
        """Of a shape near it, which hides the same of itself."""
        return self.observation.rows(shape, self.radius, self._in_sight, points)

    def rms_by_frame(self) -> list[float]:
        """Distance of each frame's points from the skin [m]."""
        own = self.rows.counts[:, : self.observation.counts.shape[1]] > 0.0
        squares = self.rows.rho[:, : own.shape[1]] ** 2 * own
        return np.sqrt(squares.sum(axis=1) / own.sum(axis=1)).tolist()

    @cached_property
    def rms(self) -> float:
        """Robust root mean square distance of points from the skin, and of skin without points from
        the points [m]."""
        return math.sqrt(misfit(self.rows, self.rows.rho) / max(self.rows.counts.sum(), 1e-9))

    def cameras_apart(self) -> tuple[float, int, int]:
        """How far two cameras' clouds are from each other at the object, in the third of the frames
        where they are farthest [m], and from which frame to which; 0 where it is not known.

        By the rigid motion with which each camera's points lie on the simulated skin.
        """
        o, farthest = self.observation, (0.0, 0, 0)
        own, noise = o.counts.shape[1], o.noise.with_unknown_cameras()
        rho, D = self.rows.rho[:, :own], self.rows.fixed(o.centre)[:, :own]
        weight = o.counts / np.sqrt(1.0 + (rho / HUBER) ** 2) / noise.sensor**2
        for part in np.array_split(np.arange(len(rho)), 3):
            shifts = []
            for camera in np.unique(o.camera[part]):
                mine = (o.camera[part] == camera) & (weight[part] > 0.0)
                if camera >= 0 and mine.sum() > 100:
                    A, w = D[part][mine], weight[part][mine]
                    H = A.T @ (w[:, None] * A) + np.diag(noise.precision())
                    shifts.append(np.linalg.solve(H, A.T @ (w * rho[part][mine]))[:3])
            for a, b in combinations(shifts, 2):
                first, last = (o.scene.frames[t] for t in part[[0, -1]])
                farthest = max(farthest, (float(np.linalg.norm(a - b)), first, last))
        return farthest

    def fit(self, noise: NoiseModel) -> Fit:
        """Motion, skin and displacement, registered for this noise by Gauss-Newton steps under
        their priors, and what is left of the gradient by parameters where those follow."""
        o, last, near = self.observation, self._last, self._last or self._near
        if last is None or last.noise != noise:
            smooth = 3 * o.in_time.shape[1] * o.in_place.shape[1] if noise.model > 0.0 else 0
            R = smooth + o.others
            if near is not None and len(near.a) == R:
                last = self._linearised(near.a, noise, near.rows)
            else:
                first = self._first if len(self._first) == R else np.zeros(R)
                last = self._linearised(first, noise)
            # with other derivatives alone it stays where it is
            stays = near is not None and near.noise == noise
            for _ in range(0 if stays else noise.rounds):
                if last.gain < REGISTERED:
                    break
                last = self._linearised(last.a + last.step, noise)
            self._last = last
        return last

    def registered(self, noise: NoiseModel) -> Array:
        """[T, n, 3] the shape as clouds show it, displaced and moved [m]."""
        return self._displaced(self.fit(noise).a)

    def outside(self, noise: NoiseModel) -> float:
        """Median distance of points from the skin of the registered object, 0 of markers [m]."""
        o, rows = self.observation, self.fit(noise).rows
        points = rows.rho[:, : o.counts.shape[1]][o.counts > 0.0]
        return float(np.median(points)) if rows.on_skin else 0.0

    def _smooth_of(self, a: Array) -> int:
        """S, numbers of the displacement in ``a``, which may have none."""
        return len(a) - self.observation.others

    def beside(self, a: Array) -> Array:
        """[m, 3] by which a cable's markers are beside the axis, of ``a`` [R] [m]."""
        own = self.observation.beside
        return own @ a[self._smooth_of(a) : -7].reshape(own.shape[1], 3)

    def _displaced(self, a: Array) -> Array:
        """[T, n, 3] the shape displaced, offset and moved by ``a`` [R] [m]."""
        o, shape, S = self.observation, self.axis, self._smooth_of(a)
        if S:
            U, B = o.in_time, o.in_place
            smooth = (U @ a[:S].reshape(U.shape[1], -1)).reshape(len(U), -1, 3)
            shape = shape + np.einsum("nq,tqa->tna", B, smooth)
        if o.scene.beside:
            shape = shape + aside(o.scene, self.frames, self.beside(a))
        return self.moved(shape, a)

    def _apart(self, a: Array) -> Array:
        """[T, m, 3] points moved by how far cameras are apart in ``a`` [m]."""
        o, (shift, turn) = self.observation, np.split(a[-13:-7], 2)
        if not o.apart.size:
            return o.points
        way = o.apart[:, : o.points.shape[1]]
        return o.points + way * (shift + np.cross(turn, o.points - o.centre))

    def _by_offsets(self, rows: Rows) -> Array:
        """[T, m, B] by how much residuals fall with the markers' offsets."""
        o = self.observation
        along = np.einsum("tmk,tmkq->tmkq", rows.weight, (spread(o.scene) @ o.beside)[rows.index])
        frames = self.frames[np.arange(len(rows.rho))[:, None, None], rows.index]
        found = np.einsum("tmkq,tmkab,tma->tmqb", along, frames, rows.normal, optimize=True)
        return found.reshape(*rows.rho.shape, -1)

    def moved(self, shape: Array, a: Array) -> Array:
        """A shape [..., 3] with the rigid motion of ``a`` [R], as cameras show it [m]."""
        return shape - a[-7:-4] - np.cross(a[-4:-1], shape - self.observation.centre)

    def _linearised(self, a: Array, noise: NoiseModel, rows: Rows | None = None) -> Fit:
        """Residuals about the shape displaced by ``a`` [R], of points that are paired anew where
        their rows are not given."""
        o, S, R = self.observation, self._smooth_of(a), len(a)
        if rows is None:
            moved = a.any() or self.offsets
            rows = self._rows(self._displaced(a), self._apart(a)) if moved else self.rows
        rho = rows.rho - a[-1]
        # by the displacement of each frame, which all frames' coefficients make up; by offsets,
        # rigid motion and skin; what is left; by parameters
        U, G = o.in_time[:, :S], rows.displacing(o.in_place[:, :S])
        own = [self._by_offsets(rows)] if o.scene.beside else []
        fixed = rows.fixed(o.centre)
        own += [o.apart * fixed[..., :6]] if o.apart.size else []
        own += [fixed, rho[..., None]]
        own += [rows.parameter_derivatives(self.J, self.widens)] if self.J.size else []
        D = np.concatenate(own, axis=2)
        # weighted by how likely they are
        w = (rows.counts / rows.soft_root(HUBER, rho))[..., None]
        Gt, each = np.swapaxes(w * G, 1, 2), np.swapaxes(w * D, 1, 2) @ D
        cross = np.einsum("tr,tqd->rqd", U, Gt @ D, optimize=True).reshape(S, D.shape[2])
        square = np.einsum("tr,ts,tqp->rqsp", U, U, Gt @ G, optimize=True).reshape(S, S)
        products = np.block([[square, cross], [cross.T, each.sum(axis=0)]])
        precision = noise.precision(S, 3 * o.beside.shape[1], o.apart.shape[2])
        weight = 1.0 / (noise.patch * noise.sensor**2)
        M = weight * products[:R, :R] + np.diag(precision)
        downhill = weight * products[:R, R] - precision * a
        by = weight * products[:R, R + 1 :]
        solved = cho_solve(cho_factor(M, lower=True), np.column_stack([downhill, by]))
        step, follows = solved[:, 0], solved[:, 1:]
        gain, loss = float(step @ downhill), misfit(rows, rho)
        # a small step is not taken, but counts
        value = weight * loss + float(precision @ a**2) - gain * (gain < REGISTERED)
        # residuals fall as the object moves along its normals
        gradient = by.T @ step - weight * products[R, R + 1 :]
        hessian = weight * products[R + 1 :, R + 1 :] - by.T @ follows
        pulls = each[:, R - S, R - S + 1 :] - each[:, R - S, : R - S] @ follows[S:]
        likely = value, gradient, hessian, weight * pulls
        return Fit(noise, a, S, precision, rows, products, loss, step, follows, gain, *likely)


@dataclass(frozen=True, eq=False)
class Comparisons:
    """Clouds of all recordings of an object beside simulated shapes."""

    parts: tuple[Comparison, ...]

    @property
    def rms(self) -> float:
        """`Comparison.rms` of all, each recording counting alike [m]."""
        return math.sqrt(sum(c.rms**2 for c in self.parts) / len(self.parts))

    def warm_start(self, other: Comparisons, steps: Sequence[Array | None] = ()) -> None:
        """Start the registrations from the results of comparisons nearby, or from where those go
        with steps [P_k] from there to here."""
        steps = steps or [None] * len(self.parts)
        for mine, theirs, step in zip(self.parts, other.parts, steps, strict=True):
            mine.warm_start(theirs, step)


@dataclass(frozen=True, eq=False)
class Fit:
    """Clouds beside one simulated shape, registered."""

    noise: NoiseModel
    a: Array
    """[R] displacement's S, B of markers beside the axis, cameras apart, motion [rad], skin [m]."""
    smooth: int
    """S."""
    precision: Array
    """Of ``a`` before anything is seen."""
    rows: Rows
    products: Array
    """[R + 1 + P] squared, weighted, of residuals' derivatives by ``a``, of residuals, and of their
    derivatives by parameters."""
    loss: float
    """Smoothed sum of squares [m^2]."""
    step: Array
    """[R] that is not taken any more."""
    follows: Array
    """[R, P] by how much ``a`` falls with the parameters."""
    gain: float
    """By which it would lower the value."""
    value: float
    """-2 log likelihood at the registered nuisance parameters, up to a constant that depends on the
    noise only."""
    gradient: Array
    """[P] half its slope."""
    hessian: Array
    """[P, P] half its curvature, with the nuisance parameters marginalised."""
    pulls: Array
    """[T, P] half the gradient of each frame, of markers in motion."""

    @property
    def rms(self) -> float:
        """Distance of points from the registered skin [m]."""
        return math.sqrt(self.loss / max(self.rows.counts.sum(), 1e-9))

    def correlated_noise(self) -> NoiseModel:
        """Noise of markers in motion: how large their residuals are, and how many share theirs by
        their correlation in time and along the cable."""
        noise, e = self.noise, self.rows.rho.reshape(len(self.rows.rho), -1, 3)
        e = e - e.mean(axis=0)  # what stays is a marker's place
        square = float(np.mean(e**2))
        sensor = max(math.sqrt(square), noise.least_sensor)
        # what is added to a smaller residual is independent
        patch = 1.0 + (shared(e) * shared(np.swapaxes(e, 0, 1)) - 1.0) * square / sensor**2
        # what lasts is no noise: so much is not explained
        model = max(math.sqrt(max(square - noise.least_sensor**2, 0.0)), noise.least_model)
        return replace(noise, sensor=sensor, model=model, patch=patch)

    def updated_noise(self, rounds: int = 6) -> NoiseModel:
        """Noise of higher likelihood: rounds of expectation and maximisation with fixed pairs."""
        noise, S, R, prior = self.noise, self.smooth, len(self.a), self.precision.copy()
        # of the residuals alone, in m^2
        D, slope = self.products[:R, :R] / noise.patch, self.products[:R, R] / noise.patch
        total, count = self.loss / noise.patch, self.rows.counts.sum() / noise.patch
        for _ in range(rounds):
            prior[:S] = noise.model**-2.0
            spread = np.linalg.inv(D / noise.sensor**2 + np.diag(prior))
            a = spread @ (slope + D @ self.a) / noise.sensor**2
            off, own = a - self.a, np.diag(spread)
            loss = max(total - float((2.0 * slope - D @ off) @ off), 0.0)
            model = math.sqrt(float(a[:S] @ a[:S] + own[:S].sum()) / S)
            used = R - float(own @ prior)
            sensor = max(math.sqrt(loss / max(count - used, 0.1 * count)), noise.least_sensor)
            noise = replace(noise, model=max(model, noise.least_model), sensor=sensor)
        return noise


def shared(e: Array) -> float:
    """How many successive ones of residuals [T, ...] count as one: one, and twice their
    correlations up to the first that is not positive (Geyer 1992, "Practical Markov chain Monte
    Carlo")."""
    total, least = 1.0, float(np.mean(e**2)) + 1e-30
    for lag in range(1, len(e)):
        correlation = float(np.mean(e[lag:] * e[:-lag])) / least
        if correlation <= 0.0:
            break
        total += 2.0 * correlation
    return total
