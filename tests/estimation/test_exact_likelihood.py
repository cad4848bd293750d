"""Fits of small problems beside a slow reference: dense matrices, derivatives by differences."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from gendom.estimation import likelihood
from gendom.estimation.likelihood import HUBER, Comparison, Comparisons, shared
from gendom.estimation.observed import NoiseModel, Rows

T, N, M = 4, 4, 30
NOISE = NoiseModel(sensor=0.003, model=0.004, patch=2.0, shift=0.01, turn=0.02, skin=0.003)


class Seen:
    """An observation in which each row belongs to one place of the shape and one direction."""

    def __init__(self, seed=0, rows=M, on_skin=True, beside=False, far=0.0, apart=0):
        rng = np.random.default_rng(seed)
        self.rng, self.on_skin, self.own = rng, on_skin, rows - 6 * on_skin
        self.axis = rng.normal(size=(T, N, 3)) * 0.1
        self.index = rng.integers(N, size=(T, rows, 2))
        share = rng.random((T, rows, 1))
        self.weight = np.concatenate([share, 1.0 - share], axis=2)
        n = rng.normal(size=(T, rows, 3))
        self.normal = n / np.linalg.norm(n, axis=2, keepdims=True)
        if not on_skin:
            self.normal = np.broadcast_to(np.tile(np.eye(3), (rows // 3, 1)), (T, rows, 3))
        off = 0.004 * rng.normal(size=(T, rows, 1)) + far * (rng.random((T, rows, 1)) < 0.2)
        self.point = self.feet(self.axis) + off * self.normal
        self.every = (rng.random((T, rows)) < 0.9) * rng.choice([1.0, 0.5], size=(T, rows))
        self.every[:, :3] = 1.0
        self.counts = self.every[:, : self.own]
        self.centre, self.noise = np.array([0.1, -0.2, 0.3]), NOISE
        self.in_time, self.in_place = rng.normal(size=(T, 2)), rng.normal(size=(N, 2))
        self.beside = rng.normal(size=(5, 2)) if beside else np.zeros((0, 0))
        self.apart = rng.integers(-1, 2, size=(T, rows, apart))
        self.apart[:, self.own :] = 0
        self.others = 3 * self.beside.shape[1] + 6 * apart + 7
        self.scene = SimpleNamespace(beside=beside, frames=(4, 6, 9, 11), captured=not on_skin)
        self.shape = SimpleNamespace(radius=0.002, rope=True, taken_from=lambda other, J: J)
        self.camera = np.zeros((T, self.own), int)
        self.markers = None if on_skin else (0, 0)

    def feet(self, shape):
        own = shape[np.arange(T)[:, None, None], self.index]
        return (self.weight[..., None] * own).sum(axis=2)

    def in_sight(self, shape):
        return np.ones(N, bool)

    @property
    def points(self):
        return self.point[:, : self.own]

    def rho(self, shape, r, points=None):
        own = self.points if points is None else points
        point = np.concatenate([own, self.point[:, self.own :]], axis=1)
        return ((point - self.feet(shape)) * self.normal).sum(axis=2) - r * self.on_skin

    def rows(self, shape, r, in_sight, points=None):
        rho = self.rho(shape, r, points)
        on = self.feet(shape) + (rho + r * self.on_skin)[..., None] * self.normal
        return Rows(
            rho=rho, normal=self.normal, index=self.index, weight=self.weight, point=on,
            counts=self.every, on_skin=self.on_skin,
        )  # fmt: skip


FRAMES = np.linalg.qr(np.random.default_rng(7).normal(size=(T, N, 3, 3)))[0]
SPREAD = np.random.default_rng(8).normal(size=(N, 5))


@pytest.fixture(autouse=True)
def frames(monkeypatch):
    """Of a cable's cross-sections, and what its markers say of its points, by chance."""
    monkeypatch.setattr(likelihood, "material_frames", lambda scene, x: FRAMES[:, None])
    monkeypatch.setattr(likelihood, "spread", lambda scene: SPREAD)
    monkeypatch.setattr(
        likelihood, "aside", lambda scene, f, off: np.einsum("tnab,nb->tna", f, SPREAD @ off)
    )


def compared(seen: Any, P=2, **options) -> Comparison:
    J, widens = seen.rng.normal(size=(T, N, 3, P)) * 0.1, seen.rng.normal(size=P) * 0.01
    return Comparison(seen, seen.axis, J, 0.0015, widens, **options)


def displaced(c: Any, a, theta):
    """[T, n, 3] and half the thickness: the model of errors, written in loops."""
    o, shape, S = c.observation, c.axis + c.J @ theta, 0
    own = 3 * o.beside.shape[1] + 6 * o.apart.shape[2]
    if len(a) > 7 + own:
        S = len(a) - 7 - own
        coefficients = a[:S].reshape(2, 2, 3)
        for t in range(T):
            for n in range(N):
                for r in range(2):
                    for q in range(2):
                        by = o.in_time[t, r] * o.in_place[n, q] * coefficients[r, q]
                        shape[t, n] = shape[t, n] + by
    if o.scene.beside:
        off = SPREAD @ (o.beside @ a[S:-7].reshape(2, 3))
        shape = shape + np.array([[FRAMES[t, n] @ off[n] for n in range(N)] for t in range(T)])
    shift, turn = a[-7:-4], a[-4:-1]
    moved = shape - shift - np.cross(np.broadcast_to(turn, shape.shape), shape - o.centre)
    return moved, c.radius + c.widens @ theta


def residuals(c, a, theta):
    shape, r = displaced(c, a, theta)
    o, points = c.observation, c.observation.points
    for k in range(o.apart.shape[2]):
        shift, turn = a[-13 - 6 * k :][:6].reshape(2, 3)
        way = shift + np.cross(np.broadcast_to(turn, points.shape), points - o.centre)
        points = points + o.apart[:, : o.own, k, None] * way
    return o.rho(shape, r, points) - a[-1]


def reference(c, a, noise):
    """Of all that a fit says at a registration: by differences, which are exact here."""
    o, R, P = c.observation, len(a), c.J.shape[3]
    x = np.concatenate([a, np.zeros(P)])
    f = lambda x: residuals(c, x[:R], x[R:])  # noqa: E731
    D = -np.stack([(f(x + h) - f(x - h)) / 0.02 for h in 0.01 * np.eye(R + P)], axis=2)
    rho = f(x)
    size = np.abs(rho)
    if not o.on_skin:  # of all three coordinates
        size = np.repeat(np.linalg.norm(rho.reshape(T, -1, 3), axis=2), 3, axis=1)
    root = np.sqrt(1.0 + (size / HUBER) ** 2)
    W, weight = o.every / root, 1.0 / (noise.patch * noise.sensor**2)
    H = weight * np.einsum("tm,tmi,tmj->ij", W, D, D)
    g = weight * np.einsum("tm,tmi,tm->ti", W, D, rho)
    beside, C = 3 * o.beside.shape[1], o.apart.shape[2]
    sd = [noise.model] * (R - 7 - beside - 6 * C) + [noise.beside] * beside
    motion = [noise.shift] * 3 + [noise.turn] * 3
    precision = np.array([*sd, *motion * (C + 1), noise.skin]) ** -2.0
    Mt, cross = H[:R, :R] + np.diag(precision), H[:R, R:]
    downhill = g.sum(axis=0)[:R] - precision * a
    step, follows = np.linalg.solve(Mt, downhill), np.linalg.solve(Mt, cross)
    loss = float((o.every * 2.0 * rho**2 / (1.0 + root)).sum())
    return SimpleNamespace(
        step=step, follows=follows, gain=step @ downhill, loss=loss, D=D, W=W, rho=rho,
        precision=precision,
        value=weight * loss + precision @ a**2, gradient=cross.T @ step - g.sum(axis=0)[R:],
        hessian=H[R:, R:] - cross.T @ follows, pulls=g[:, R:] - g[:, :R] @ follows,
        rms=np.sqrt(loss / o.every.sum()),
    )  # fmt: skip


CASES = [
    ({}, NOISE),
    ({"far": 0.05}, NOISE),
    ({}, replace(NOISE, model=0.0)),
    ({"apart": 1, "far": 0.05}, NOISE),
    ({"on_skin": False, "beside": True}, NOISE),
    ({"on_skin": False, "beside": True}, replace(NOISE, model=0.0)),
]


@pytest.mark.parametrize(("options", "noise"), CASES)
@pytest.mark.parametrize("rounds", [0, 1, 3])
def test_a_fit_is_that_of_dense_matrices(options, noise, rounds):
    """Steps, value, gradient, curvature and each frame's pull, of a registration that ended early
    and of one that ended by itself. What a turn does to other derivatives is left out, so turns
    are small where it is linearised again."""
    turn = 1e-7 if rounds else noise.turn
    c: Any = compared(Seen(**options))
    noise = replace(noise, rounds=rounds, turn=turn)
    own = 6 * c.observation.scene.beside + 6 * options.get("apart", 0)
    a = np.zeros(7 + own + 12 * (noise.model > 0.0))
    for left in range(rounds, -1, -1):
        known = reference(c, a, noise)
        if known.gain < 0.1 or left == 0:
            break
        a = a + known.step
    fit = c.fit(noise)
    np.testing.assert_allclose(fit.a, a, rtol=1e-4, atol=1e-9)
    assert fit.value == pytest.approx(known.value - known.gain * (known.gain < 0.1), rel=1e-6)
    for name in ("step", "follows", "gradient", "hessian", "gain", "loss", "rms"):
        own, wanted = getattr(fit, name), getattr(known, name)
        np.testing.assert_allclose(own, wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
    if noise.model == 0.0:  # the motion of markers has no other displacement
        np.testing.assert_allclose(fit.pulls, known.pulls, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(fit.pulls.sum(axis=0) + 0.0, known.pulls.sum(axis=0), rtol=1e-4)
    np.testing.assert_allclose(c.registered(noise), displaced(c, a, np.zeros(2))[0], atol=1e-6)
    at = np.array([[0.3, 0.1, -0.2]])
    wanted = at - a[-7:-4] - np.cross(a[-4:-1], at - c.observation.centre)
    np.testing.assert_allclose(c.moved(at, c.fit(noise).a), wanted, atol=1e-6)
    own = known.rho[:, : c.observation.own][c.observation.counts > 0.0] + a[-1]
    middle = np.median(own) if c.observation.on_skin else 0.0
    assert c.outside(noise) == pytest.approx(middle, abs=1e-6)
    assert c.fit(noise) is fit
    a = a + 0.1 * np.arange(1.0, len(a) + 1.0)  # far off
    c._last = replace(fit, a=a)
    np.testing.assert_allclose(c.registered(noise), displaced(c, a, np.zeros(2))[0])
    wanted = at - a[-7:-4] - np.cross(a[-4:-1], at - c.observation.centre)
    np.testing.assert_allclose(c.moved(at, c.fit(noise).a), wanted)


def test_a_registration_begins_where_the_last_one_or_a_neighbour_s_ended():
    c, other, fixed = compared(Seen()), compared(Seen(seed=1)), replace(NOISE, rounds=0)
    c.warm_start(other)  # has none
    assert not c.fit(fixed).a.any() and c.fit(fixed).rows is c.rows
    first = c.fit(NOISE)
    assert first.a.any() and np.array_equal(c.fit(fixed).a, first.a)
    assert c.fit(fixed).rows is first.rows and c.fit(fixed) is not first
    near, without = compared(Seen()), replace(fixed, model=0.0)
    Comparisons((near,)).warm_start(Comparisons((c,)))
    assert np.array_equal(near.fit(fixed).a, first.a)
    assert np.array_equal(near.fit(without).a, np.zeros(7))  # of a displacement that is not there
    # by the linear model with which parameters move it
    ahead, way = compared(Seen()), np.array([0.3, -0.1])
    Comparisons((ahead,)).warm_start(Comparisons((c,)), [way])
    last = c.fit(fixed)
    np.testing.assert_array_equal(ahead.fit(fixed).a, last.a + last.step - last.follows @ way)
    with pytest.raises(ValueError, match="zip"):
        Comparisons((near,)).warm_start(Comparisons(()))


def test_derivatives_of_a_neighbour_change_no_more_than_they_must():
    """By Broyden's rule; the registration stays, however far it had come."""
    c, other = compared(Seen(far=0.05)), compared(Seen(seed=1))
    noise = replace(NOISE, rounds=1, turn=1e-7)
    before = c.fit(noise)
    assert before.gain > 0.1
    c.inherit_derivatives(other, np.zeros(2), np.ones(2))
    assert np.array_equal(c.J, other.J) and np.array_equal(c.widens, other.widens)
    step, weight = np.array([0.5, -2.0]), np.array([0.3, 0.025])
    c.inherit_derivatives(other, step, weight)
    np.testing.assert_allclose(c.J @ step, c.axis - other.axis, atol=1e-12)
    # the least change, in squares over weights, goes along them
    change = c.J - other.J
    wanted = change[..., :1] * (weight * step) / (weight * step)[0]
    np.testing.assert_allclose(change, wanted, atol=1e-12)
    after = c.fit(noise)
    assert np.array_equal(after.a, before.a) and after.rows is before.rows
    known = reference(c, after.a, noise)
    np.testing.assert_allclose(after.gradient, known.gradient, rtol=1e-4)
    assert not np.allclose(after.gradient, before.gradient, rtol=0.1)
    near = compared(Seen())
    near.warm_start(other)
    other.inherit_derivatives(c, np.zeros(2), np.ones(2))
    near.warm_start(other)
    assert not near.fit(replace(noise, rounds=0)).a.any()
    more = replace(noise, sensor=0.0031)
    assert not np.array_equal(c.fit(more).a, before.a)  # another noise moves it on


def test_markers_beside_an_axis_that_were_found_before():
    seen: Any = Seen(on_skin=False, beside=True)
    off = 0.01 * seen.rng.normal(size=(5, 3))
    c = compared(seen, offsets=tuple(map(tuple, off)))
    beside = np.array([[FRAMES[t, n] @ (SPREAD @ off)[n] for n in range(N)] for t in range(T)])
    np.testing.assert_allclose(c.rows.rho, seen.rho(c.axis + beside, 0.0))
    fit = c.fit(replace(NOISE, rounds=0))
    np.testing.assert_allclose(fit.rows.rho, seen.rho(c.axis, 0.0))
    a = np.arange(1.0, 26.0)
    np.testing.assert_allclose(c.beside(a), seen.beside @ a[12:18].reshape(2, 3))
    np.testing.assert_allclose(c.beside(a[12:]), seen.beside @ a[12:18].reshape(2, 3))


def test_distances_count_as_points_do():
    c: Any = compared(Seen(far=0.05))
    rho, counts, own = c.observation.rho(c.axis, 0.0015), c.observation.every, c.observation.own
    frames = [
        np.sqrt(np.mean(r[:own][w[:own] > 0.0] ** 2)) for r, w in zip(rho, counts, strict=True)
    ]
    assert c.rms_by_frame() == pytest.approx(frames)
    huber = 2.0 * HUBER**2 * (np.sqrt(1.0 + (rho / HUBER) ** 2) - 1.0)
    rms = np.sqrt((counts * huber).sum() / counts.sum())
    assert c.rms == pytest.approx(rms)
    plain = Comparison(c.observation, c.axis, c.J[..., :0], 0.002, c.widens[:0])
    fit = plain.fit(NOISE)
    assert (fit.gradient.shape, fit.hessian.shape, fit.pulls.shape) == ((0,), (0, 0), (T, 0))
    both = Comparisons((c, plain))
    assert both.rms == pytest.approx(np.sqrt((c.rms**2 + plain.rms**2) / 2.0))


@pytest.mark.parametrize(("points", "told"), [(101, True), (100, False)])
def test_cameras_are_apart_by_the_rigid_motions_of_their_points(points, told):
    """In the first third of the frames, where one camera's points are off; of ridge regressions by
    rows that are added. A camera that is not known, and points that do not count, say nothing."""
    seen: Any = Seen(rows=158)
    camera = np.repeat([0, 5, -1], [51, 51, 50])
    seen.camera[:], seen.counts = camera, np.ones((T, seen.own))
    seen.counts[1, points - 51 : 51] = 0.0  # so many of the first camera count
    seen.point[:2, :51] += 0.01
    seen.point[:, 102:] += 0.3
    c: Any = compared(seen)
    far, first, last = c.cameras_apart()
    if not told:
        assert (far, first, last) == (0.0, 0, 0)
        return
    found, rho = [], seen.rho(c.axis, 0.0015)
    sd = np.array([0.05] * 3 + [0.1] * 3 + [seen.noise.skin])
    for one in (0, 5):
        mine = np.zeros_like(rho, bool)
        mine[:2, : seen.own] = (camera == one) & (seen.counts[:2] > 0.0)
        r, n, on = rho[mine], seen.normal[mine], c.rows.point[mine] - seen.centre
        A = np.concatenate([-n, -np.cross(on, n), np.ones((len(r), 1))], axis=1)
        w = (1.0 + (r / HUBER) ** 2) ** -0.25 / seen.noise.sensor
        rows = np.concatenate([w[:, None] * A, np.diag(1.0 / sd)])
        found.append(np.linalg.lstsq(rows, np.append(w * r, np.zeros(7)), rcond=None)[0][:3])
    assert far == pytest.approx(np.linalg.norm(found[0] - found[1]), rel=1e-6)
    assert (first, last) == (4, 6) and far > 0.005


def test_noise_is_that_of_the_greatest_marginal_likelihood():
    """Of Gaussians with small residuals; not below its bounds."""
    seen: Any = Seen(seed=3, rows=60)
    seen.every[:], seen.counts[:] = 1.0, 1.0
    seen.point = seen.feet(seen.axis) + 1e-5 * seen.rng.normal(size=(T, 60, 1)) * seen.normal
    true, smooth = NoiseModel(sensor=2e-5, model=4e-5, patch=1.0, rounds=0), 12
    c: Any = compared(seen)
    c.radius = 0.0
    D = reference(c, np.zeros(19), true).D.reshape(-1, 21)[:, :smooth]
    y = c.observation.rho(c.axis, 0.0) + (D @ (4e-5 * seen.rng.normal(size=smooth))).reshape(T, 60)
    seen.point = seen.feet(seen.axis) + y[..., None] * seen.normal
    still = replace(true, shift=1e-9, turn=1e-9, skin=1e-9, least_sensor=1e-9, least_model=1e-9)
    begin = replace(still, sensor=1e-5, model=1e-5)
    c = compared(seen)
    c.radius = 0.0
    found = c.fit(begin).updated_noise(4000)

    def cost(x):
        C = np.exp(2.0 * x[0]) * np.eye(len(D)) + np.exp(2.0 * x[1]) * D @ D.T
        return np.linalg.slogdet(C)[1] + y.ravel() @ np.linalg.solve(C, y.ravel())

    best = np.exp(minimize(cost, np.log([2e-5, 4e-5]), method="Nelder-Mead").x)
    assert (found.sensor, found.model) == pytest.approx(best, rel=2e-3)
    assert (found.patch, found.shift) == (1.0, 1e-9)
    seen.every *= 2.0  # of two that share their noise
    twice = c.fit(replace(begin, patch=2.0)).updated_noise(4000)
    assert (twice.sensor, twice.model) == pytest.approx(best, rel=2e-3)
    bounded = c.fit(replace(begin, least_sensor=1.0, least_model=2.0)).updated_noise(1)
    assert (bounded.sensor, bounded.model) == (1.0, 2.0)
    # of 9.6 points, fewer than unknowns, a tenth counts
    seen.every[:], still = 0.04, replace(begin, model=4e-3, sensor=2e-5)
    fit, known = c.fit(still), reference(c, np.zeros(19), still)
    r, D, W = known.rho.ravel(), known.D.reshape(-1, 21)[:, :19], known.W.ravel()
    precision, A = still.precision(12, 0), (W[:, None] * D).T / still.sensor**2
    spread = np.linalg.inv(A @ D + np.diag(precision))
    off, used = spread @ A @ r, 19.0 - np.diag(spread) @ precision
    assert 9.6 - used < 0.96
    left = known.loss + W @ ((r - D @ off) ** 2 - r**2)
    wanted = math.sqrt(left / max(9.6 - used, 0.96))
    found = fit.updated_noise(1)
    assert found.sensor == pytest.approx(wanted, rel=1e-4)
    wanted = math.sqrt((off[:12] @ off[:12] + np.diag(spread)[:12].sum()) / 12.0)
    assert found.model == pytest.approx(wanted, rel=1e-4)


def test_noise_of_markers_counts_residuals_that_last():
    """In time and along the cable, by sums of correlations."""
    seen: Any = Seen(on_skin=False, beside=True)
    rng, times = np.random.default_rng(2), 200
    e = np.cumsum(rng.normal(size=(times, 4, 3)), axis=0)
    e = 0.003 * (e[8:] - e[:-8]).repeat(3, axis=1)
    fit = compared(seen).fit(replace(NOISE, rounds=0))
    rows = replace(fit.rows, rho=(e + 0.05).reshape(len(e), -1))
    noise = replace(NOISE, least_sensor=1e-3, least_model=1e-4)
    found = replace(fit, rows=rows, noise=noise).correlated_noise()
    off = e - e.mean(axis=0)
    square = (off**2).mean()

    def lasting(x):
        total, lag = 1.0, 1
        while lag < len(x) and (r := (x[lag:] * x[:-lag]).mean() / (x**2).mean()) > 0.0:
            total, lag = total + 2.0 * r, lag + 1
        return total

    patch = lasting(off) * lasting(np.swapaxes(off, 0, 1))
    assert patch > 15.0 and shared(off) == pytest.approx(lasting(off))
    assert found.sensor == pytest.approx(np.sqrt(square)) and found.patch == pytest.approx(patch)
    assert found.model == pytest.approx(np.sqrt(square - 1e-6))
    coarse = replace(noise, least_sensor=1.0, least_model=0.5)
    found = replace(fit, rows=rows, noise=coarse).correlated_noise()
    assert (found.sensor, found.model) == (1.0, 0.5)
    assert found.patch == pytest.approx(1.0 + (patch - 1.0) * square)
    assert shared(np.zeros((4, 2))) == 1.0 and shared(np.ones((4, 2))) == pytest.approx(7.0)
