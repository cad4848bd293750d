"""Clouds prepared for comparison: their errors, and where on a simulated shape points belong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from gendom.arrays import Array
from gendom.estimation.markers import beside_axis
from gendom.estimation.replay import Shape, held_reach, lattice, middle, nearest_of
from gendom.estimation.scene import LiftScene
from gendom.observation import visible, visible_on_sheet

UNKNOWN_SHIFT, UNKNOWN_TURN = 0.05, 0.1
"""`NoiseModel.shift` and `turn` of cameras with unknown poses, once registered [m], [rad]."""

THIN, SKIN_OF_THIN = 0.008, 1e-5
"""Diameter of a thin rope, or thickness of a cloth, and `NoiseModel.skin` of it [m]: mixed depth at
most of its pixels widens it along the views, noise puts points on either side of a sheet, and a
larger skin would fit better than the true one."""

NO_SKIN = 1e-8
"""`NoiseModel.skin` of markers in motion, whose coordinates count, not their distance [m]."""

SHARED = 16.0
"""`NoiseModel.patch` of markers in motion, the first guess: some tenths of a second, along a
quarter of the cable."""

PLACE_SCALE, TIME_SCALE = 0.3, 0.1
"""Correlation length of displacements, in the object's size, and time, in the compared frames."""

LEAST_MODE, LEAST_MODE_OF_SIDE, LEAST_SQUARE = 0.01, 0.05, 0.02
"""Least shares of the largest one's variance of modes of displacements that count, of ropes and in
time, and of cloths along each side; and of cloths their least mean square for one of 1."""


@dataclass(frozen=True, kw_only=True)
class NoiseModel:
    """Errors of clouds against the true shape, as standard deviations."""

    sensor: float = 0.002
    """Noise of independent points [m]; the first guess."""
    model: float = 0.002
    """The simulated object's smooth displacement [m]; the first guess. 0: there is none."""
    least_sensor: float = 5e-4
    """Lower bound of the sensor noise [m]."""
    least_model: float = 3e-4
    """Lower bound of the model's displacement [m]."""
    shift: float = 0.003
    """Of the cameras' calibration [m]."""
    turn: float = 0.01
    """Likewise [rad]."""
    skin: float = 0.002
    """Of the distance of points from the true skin [m]: hairs, edges of pixels."""
    beside: float = 0.01
    """Of markers from the axis of a cable [m]: balls of 1 to 2 cm on its sheath."""
    patch: float = 4.0
    """Points of a thinned cloud, of a cloth half of them, or coordinates of markers, that share
    their noise."""
    cloud_points: int = 160
    """Points of a frame that are compared, at most; twice as many of a cloth."""
    rounds: int = 3
    """Most iterations of a registration; each pairs points and places again."""

    def of(self, scene: LiftScene, any_thickness: bool) -> NoiseModel:
        """Of a scene's cameras, and of a thin cloth, or rope whose thickness is not looked for."""
        thick, noise = scene.recording.object.diameter, self
        if scene.kind == "cloth":
            thick, any_thickness = scene.body.thickness, False
            noise = replace(noise, patch=noise.patch / 2.0)
        if thick is not None and thick < THIN and not any_thickness:
            noise = replace(noise, skin=SKIN_OF_THIN)
        if scene.registration is not None:
            return noise.with_unknown_cameras()
        if scene.captured:
            # hands and markers are measured in one frame
            return replace(noise, shift=1e-4, turn=1e-4, skin=NO_SKIN, patch=SHARED)
        return replace(noise, patch=1.0) if scene.ordered else noise

    def with_unknown_cameras(self) -> NoiseModel:
        """With the wide prior of cameras whose poses are unknown."""
        return replace(self, shift=UNKNOWN_SHIFT, turn=UNKNOWN_TURN)

    def precision(self, smooth: int = 0, beside: int = 0, apart: int = 0) -> Array:
        """[R] of displacement, markers, cameras apart, motion and skin, before anything is seen."""
        sd = [self.model] * smooth + [self.beside] * beside
        motion = [self.shift] * 3 + [self.turn] * 3
        return np.array([*sd, *motion * (apart + 1), self.skin]) ** -2.0


class Observation:
    """Clouds of a scene, prepared for comparison; their errors, first guesses where estimated."""

    def __init__(self, scene: LiftScene, noise: NoiseModel | None = None):
        self.scene = scene
        self.noise = noise or NoiseModel()
        most = self.noise.cloud_points * (1 if scene.kind == "rope" else 2)
        recording, cameras, self.clouds = scene.recording, [], []
        by = np.zeros(len(recording.points)) if recording.seen_by is None else recording.seen_by
        for t in scene.frames:
            first, last = recording.offsets[t : t + 2]
            own = slice(first, last, 1 if scene.ordered else -(-(last - first) // most))
            self.clouds.append(recording.points[own].astype(float))
            cameras.append(np.log2(np.maximum(by[own], 1e-9)))
        self.trees = [KDTree(c) for c in self.clouds]
        # how far apart what a cloud shows may lie: three of its own spacings, 5 mm at least
        near = [t.query(t.data, k=2)[0][:, 1] if t.n > 1 else 0.0 for t in self.trees]
        self.gaps = np.array([max(0.005, 3.0 * float(np.median(d))) for d in near])
        self.centre = np.mean([c.mean(axis=0) for c in self.clouds], axis=0)
        # clouds of one size, with points that do not count
        sizes = np.array([len(c) for c in self.clouds])
        own = np.arange(sizes.max())
        self.points = np.stack([c[np.where(own < len(c), own, 0)] for c in self.clouds])
        self.counts = (own < sizes[:, None]).astype(float)
        # the one camera that saw each point, -1 where several did or none is known
        camera = np.stack(
            [np.pad(c, (0, len(own) - len(c)), constant_values=-1.0) for c in cameras]
        )
        self.camera = np.where(camera % 1.0 == 0.0, camera, -1.0).astype(int)
        self.shape = Shape(scene)
        # samples that no fingers hide: farther from what is held than twice its reach
        own, share = self.shape.samples
        rest = middle(scene, scene.initial)
        x = np.einsum("mk,mka->ma", share, rest[own])
        away = np.linalg.norm(x[:, None] - scene.held, axis=2).min(axis=1)
        # a cloth's faces are seen by a camera each; [T, rows, C] how points move as these go apart
        seen = np.unique(self.camera[self.camera >= 0])[: 2 * (scene.kind == "cloth")]
        every = np.pad(self.camera, ((0, 0), (0, len(share))), constant_values=-1)[..., None]
        self.apart = 1.0 * (every == seen[:1]) - (every == seen[1:])
        self.in_view = away > 2.0 * held_reach(scene) + scene.body.thickness
        self.markers = None if scene.places is None else scene.markers
        if scene.places is None and scene.ordered:
            first = scene.recording.frame(scene.begins).astype(float)
            index, weight, _ = self.shape.nearest(rest[None], first[None])
            self.markers = index[0], weight[0]
        # functions by which displacements change, scaled by deviations: [T, R] of the frames, which
        # are denser where more happens, and [n, Q] of the middle's points
        at = np.linspace(0.0, 1.0, len(sizes))
        # with one shape alone, displacements and parameters have the same effect
        self.in_time = np.zeros((len(at), 1)) if scene.static else _modes(at, TIME_SCALE)
        if scene.captured:
            self.in_time = np.zeros((len(at), 0))
        a, b = lattice(scene)
        self.beside = beside_axis(scene) if scene.beside else np.zeros((0, 0))
        """[m, B / 3] offsets of a cable's markers from its axis."""
        self.others = 3 * self.beside.shape[1] + 6 * self.apart.shape[2] + 7
        """Numbers of errors beside the displacement's."""
        scale = PLACE_SCALE * scene.size
        if len(b) == 1:
            self.in_place = _modes(a, scale)
            return
        both = np.einsum("ai,bj->baij", *(_modes(x, scale, LEAST_MODE_OF_SIDE) for x in (a, b)))
        both = both.reshape(len(a) * len(b), -1)
        self.in_place = both[:, (both**2).mean(axis=0) > LEAST_SQUARE]

    def rows(
        self, shape: Array, r: float, in_sight: Callable[[int], Array], points: Array | None = None
    ) -> Rows:
        """The places on shapes [T, n, 3] of half thickness r [m] that points correspond to, and
        which parts of the shapes have no points near, of those that are in sight in a frame."""
        if self.markers is not None:
            return self._marker_rows(shape)
        T, points = len(shape), self.points if points is None else points
        index, weight, foot = self.shape.nearest(shape, points)
        e = points - foot
        if not self.shape.rope:
            # beside a thin sheet's edge the direction to it is noise: across it counts what exceeds
            n = self.shape.normals(shape, index, weight)
            across = (e * n).sum(axis=2)[..., None] * n
            beside = e - across
            wide = np.maximum(np.linalg.norm(beside, axis=2), 1e-9)[..., None]
            e = across + np.maximum(1.0 - 0.5 * self.shape.spacing / wide, 0.0) * beside
        size = np.linalg.norm(e, axis=2)
        normal, rho = e / np.maximum(size, 1e-9)[..., None], size - r
        own, share = self.shape.samples
        c = np.einsum("mk,tmka->tma", share, shape[:, own])
        if self.shape.rope:
            nearest = nearest_of(points, c)
        else:
            nearest = np.stack([tree.query(x)[1] for tree, x in zip(self.trees, c, strict=True)])
        near = np.take_along_axis(points, nearest[..., None], axis=1)
        gap = np.linalg.norm(near - c, axis=2)
        out = gap - r - self.gaps[:, None]
        bare = (out > 0.0) & self.in_view
        if self.scene.floor is not None:
            bare &= c[..., 2] > self.scene.floor
        # what the object hides of itself needs no points
        for t in np.flatnonzero(bare.any(axis=1)).tolist():
            bare[t] &= in_sight(t)
        stands_for = np.minimum(self.counts.sum(axis=1) / len(own), 1.0)[:, None]
        every = np.broadcast_to(own, (T, *own.shape)), np.broadcast_to(share, (T, *share.shape))
        return Rows(
            rho=np.concatenate([rho, np.where(bare, out, 0.0)], axis=1),
            normal=np.concatenate([normal, (near - c) / np.maximum(gap, 1e-9)[..., None]], axis=1),
            index=np.concatenate([index, every[0]], axis=1),
            weight=np.concatenate([weight, every[1]], axis=1),
            point=np.concatenate([points, near], axis=1),
            counts=np.concatenate([self.counts, bare * stands_for], axis=1),
            on_skin=True,
        )

    def in_sight(self, shape: Array) -> Array:
        """[m] which samples of a shape [n, 3] a camera sees."""
        (own, share), cameras = self.shape.samples, self.scene.recording.camera_positions
        c = np.einsum("mk,mka->ma", share, shape[own])
        if self.shape.rope:
            return visible(c, camera_positions=cameras)
        if cameras is None:
            return np.ones(len(c), bool)
        (normals,) = self.shape.normals(shape[None], own[None], share[None])
        index, weight = self.shape.fine
        sheet = np.einsum("mk,mka->ma", weight, shape[index])
        apart = self.shape.spacing
        return visible_on_sheet(c, normals, sheet, spacing=apart, camera_positions=cameras)

    def _marker_rows(self, shape: Array) -> Rows:
        """All three coordinates of a marker count: markers are few and accurate."""
        assert self.markers is not None
        index = np.repeat(self.markers[0], 3, axis=0)
        weight = np.repeat(self.markers[1], 3, axis=0)
        T, rows = len(shape), len(index)
        c = np.einsum("mk,tmka->tma", self.markers[1], shape[:, self.markers[0]])
        return Rows(
            rho=(self.points - c).reshape(T, rows),
            normal=np.broadcast_to(np.tile(np.eye(3), (rows // 3, 1)), (T, rows, 3)),
            index=np.broadcast_to(index, (T, *index.shape)),
            weight=np.broadcast_to(weight, (T, *weight.shape)),
            point=np.repeat(self.points, 3, axis=1),
            counts=np.repeat(self.counts, 3, axis=1),
            on_skin=False,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Rows:
    """m residuals of each of T frames."""

    rho: Array
    """[T, m] [m]."""
    normal: Array
    """[T, m, 3] directions in which the object moves to reduce them."""
    index: Array
    """[T, m, k] points of the middle around the foot."""
    weight: Array
    """[T, m, k] their shares."""
    point: Array
    """[T, m, 3] of the cloud [m]."""
    counts: Array
    """[T, m] how many points each stands for."""
    on_skin: bool
    """Whether points are on the skin, not on the middle."""

    def soft_root(self, limit: float, rho: Array) -> Array:
        """[T, m] by how much residuals [T, m] beyond a limit [m] pull less than in squares; of
        markers that of all three coordinates."""
        squares = rho**2
        if not self.on_skin:
            squares = np.repeat(squares.reshape(len(rho), -1, 3).sum(axis=2), 3, axis=1)
        return np.sqrt(1.0 + squares / limit**2)

    def parameter_derivatives(self, J: Array, widens: Array) -> Array:
        """[T, m, P] by how much residuals fall with parameters that change shapes by J
        [T, n, 3, P] and half their thickness by ``widens`` [P]."""
        _, n, _, P = J.shape
        along = self.weight[..., None] * self.normal[:, :, None]
        found = self._sparse(along, 3 * n) @ J.reshape(-1, P)
        return found.reshape(*self.rho.shape, P) + (widens if self.on_skin else 0.0)

    def displacing(self, modes: Array) -> Array:
        """[T, m, 3 Q] likewise with the displacements of each frame by modes [n, Q] in place."""
        (T, m), (n, Q) = self.rho.shape, modes.shape
        psi = self._sparse(self.weight[..., None], n) @ np.tile(modes, (T, 1))
        return (psi.reshape(T, m, Q, 1) * self.normal[:, :, None]).reshape(*self.rho.shape, 3 * Q)

    def _sparse(self, values: Array, size: int) -> csr_array:
        """[T m, T size] of values [T, m, k, c] at the components c of a frame's points."""
        T, m, k, c = values.shape
        frame = size * np.arange(T)[:, None, None, None]
        column = frame + c * self.index[..., None] + np.arange(c)
        begins = k * c * np.arange(T * m + 1)
        return csr_array((values.ravel(), column.ravel(), begins), shape=(T * m, T * size))

    def fixed(self, centre: Array) -> Array:
        """[T, m, 7] likewise with a shift, a turn about a centre [3] [m], and the skin."""
        turned = -np.cross(self.point - centre, self.normal)
        return np.concatenate([-self.normal, turned, np.ones((*self.rho.shape, 1))], axis=2)


def _modes(at: Array, scale: float, least: float = LEAST_MODE) -> Array:
    """[n, R] with R R^T near the covariance of a Gaussian process at places [n], of as few columns
    as ``least`` of the greatest variance allows."""
    values, vectors = np.linalg.eigh(np.exp(-0.5 * ((at[:, None] - at) / scale) ** 2))
    keep = values > least * values[-1]
    return vectors[:, keep][:, ::-1] * np.sqrt(values[keep][::-1])
