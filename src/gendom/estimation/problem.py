"""Input and output of every method of estimation."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from gendom.arguments import check_choice, require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.datasets.recording_form import SIZES
from gendom.errors import SimulationError
from gendom.estimation.likelihood import Comparison, Comparisons
from gendom.estimation.observed import NoiseModel, Observation
from gendom.estimation.replay import Shape, middle, replay_axis
from gendom.estimation.scene import COARSE_FRAMES, COARSE_POINTS, LiftScene, SceneSettings
from gendom.materials.posterior import Prior, joint_prior, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta

SIZES_OF_OBJECT = tuple(size for size in SIZES if not size.startswith("grasp"))
"""Fields of an object's description that all of its recordings share."""

APART = "estimate each by itself"

LIMP, ASTRAY = 0.065, 0.01
"""Bending length below which cloths may buckle as they hang, and how much farther than in other
frames clouds then are from one that has buckled to the other side, in diagonals."""

PLACED, MOST_PLACED = 5e-4, 3
"""Change of markers' places beside an axis that does not count, root mean square [m], and how often
they are looked for."""


@dataclass(frozen=True, kw_only=True)
class EstimateSettings:
    """How parameters are estimated; written into every result."""

    method: str = "gauss-newton"
    """Method of the search: gauss-newton or another package's (docs/estimation.md)."""
    starts: int = 3
    """Number of starts of a search: the best of a scan, and random ones; of ropes in one hand the
    best ones of a finer scan."""
    unknowns: tuple[str, ...] = ()
    """Unknowns to estimate, such as E_over_rho grip_height; by default those that a recording
    of this kind may determine."""
    also: tuple[str, ...] = ()
    """Further ones, such as tip_mass (a knot or a sheath at a rope's end) or thickness."""
    frames: Literal["all", "last"] = "all"
    """Frames that are compared."""
    camera_pose: Literal["stated", "unknown"] | None = None
    """unknown: the cameras are not calibrated to the robot, and their pose is estimated, too; by
    default as each recording says (cameras_calibrated, docs/recordings.md)."""
    max_iterations: int = 25
    """Batches that a search may simulate; of `gauss-newton`, whose trials need no derivatives, half
    of them."""
    seed: int = 0
    """Seed of all random draws."""
    level: float = 0.9
    """Nominal probability of the intervals."""
    scene: SceneSettings = field(default_factory=SceneSettings)
    noise: NoiseModel = field(default_factory=NoiseModel)

    def __post_init__(self) -> None:
        check_choice("frames", self.frames, ("all", "last"))
        check_choice("camera_pose", self.camera_pose or "stated", ("stated", "unknown"))
        require(0.0 < self.level < 1.0, f"level must lie between 0 and 1, got {self.level}")
        for name, least in (("starts", 1), ("max_iterations", 2), ("seed", 0)):
            value = getattr(self, name)
            require(value >= least, f"{name} must be at least {least}, got {value}")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of an estimation."""

    stage: str
    iteration: int
    most: int
    """Largest number of iterations."""
    best: Theta
    rms: float
    """Distance of the clouds from the best fit's skin [m]."""


@dataclass(kw_only=True)
class Start:
    """A start of a search, and its current point."""

    initial: Array
    """[P] transformed."""
    vector: Array
    """[P] transformed."""
    comparison: Comparisons | None = None
    value: float = math.inf
    """Of the method's objective."""
    won: float = math.inf
    """By how much the last step lowered it."""
    damping: float = 1e-3
    """Levenberg's and Marquardt's."""
    iterations: int = 0
    done: bool = False
    renew: bool = False
    """Whether the comparison's derivatives, of a neighbour, are too inaccurate to be used."""
    exact: bool = False
    """Whether they are its own."""
    precise: bool = True
    """Whether they are to be taken with all points."""
    coarse: bool = True
    """Whether it has been compared in a coarse problem at most."""

    @property
    def compared(self) -> Comparisons:
        """`comparison` of a start that could be simulated."""
        assert self.comparison is not None
        return self.comparison


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a method has found."""

    best: Start
    starts: Sequence[Start]
    noise: tuple[NoiseModel, ...]
    """Of each recording; its comparison is evaluated with it."""
    interrupted: bool = False
    others: tuple[Array, ...] = ()
    """[P] where other starts have ended that are about as likely as the best one."""
    covariance: Array | None = None
    """[P, P] transformed, of methods that state their own; None: that of the likelihood."""
    problem: Problem | None = None
    """The same with another resolution, where a method has changed it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One recording of a problem."""

    scene: LiftScene
    base: Theta
    """Values of everything that is not estimated."""
    shown: Array
    """[P_k] the problem's unknowns that this recording depends on."""
    noise: NoiseModel
    """First guess."""
    name: str
    """For people; empty where it is the only one."""

    @cached_property
    def observation(self) -> Observation:
        return Observation(self.scene, self.noise)

    def _fewer(self, points: int) -> LiftScene:
        """The scene with so many points, unless settings fix their number or few are saved."""
        scene, points = self.scene, max(points, COARSE_POINTS[self.scene.kind])
        fixed = not scene.thin or scene.settings.points is not None
        return scene if fixed or scene.along < 1.3 * points else scene.simulated_with(points)

    @cached_property
    def coarser(self) -> LiftScene:
        """The scene with the points with which a search begins."""
        return self._fewer((self.scene.along + 1) // 2 if self.scene.limp else 0)

    @cached_property
    def sketch(self) -> LiftScene:
        """The scene that shows how shapes change."""
        rope = self.scene.kind == "rope"
        return self.coarser if rope else self._fewer(2 * self.scene.along // 3)

    @cached_property
    def coarse(self) -> Part:
        """For the first stage of a search: fewer simulated points; of a cloth also fewer recorded
        ones, of a rope fewer frames, if enough those without fast motion, which depends on the
        earlier motion, too."""
        scene, noise = self.coarser, self.noise
        if scene.kind == "rope":
            frames = scene.calm if len(scene.calm) >= 6 else scene.frames
            every = 1 if scene.captured else -(-len(frames) // COARSE_FRAMES)
            scene = replace(scene, frames=frames[::every])
        elif scene is not self.scene:
            # fewer points of equal total weight
            noise = replace(noise, cloud_points=noise.cloud_points // 4, patch=noise.patch / 4)
        same = scene.frames == self.scene.frames and scene.body is self.scene.body
        return self if same else replace(self, scene=scene, noise=noise)


class Problem:
    """Scenes of one object with unknowns, as a function to minimise.

    Arguments are those of `gendom.estimation.estimate`.

    Raises:
        ParameterError: A scene has none of the wanted unknowns, or the objects differ.
    """

    def __init__(
        self,
        scenes: Sequence[LiftScene],
        settings: EstimateSettings,
        on_progress: Callable[[Progress], None] | None = None,
        known: Theta | None = None,
        names: Sequence[str] = (),
    ):
        names = names or recording_names(len(scenes))
        _check_one_object(scenes, names)
        if settings.frames == "last":
            scenes = [replace(s, frames=s.frames[-1:], calm=s.frames[-1:]) for s in scenes]
        self.settings = settings
        believed = [scene.prior(settings.unknowns, settings.also) for scene in scenes]
        self.prior: Prior = joint_prior([prior for prior, _ in believed])
        made = []
        for k, (scene, (prior, base)) in enumerate(zip(scenes, believed, strict=True)):
            base = base if known is None else prior.theta(prior.mean, known)
            shown = np.array([self.prior.index(n, k) for n in prior.names], dtype=np.intp)
            noise = settings.noise.of(scene, "thickness" in prior.names)
            made.append(Part(scene=scene, base=base, shown=shown, noise=noise, name=names[k]))
        self.parts: tuple[Part, ...] = tuple(made)
        self._on_progress = on_progress
        self.placed = 0
        """How often markers were found beside the axis."""

    @property
    def scene(self) -> LiftScene:
        """The first recording's; the object, the engine and the resolution are those of all."""
        return self.parts[0].scene

    @property
    def captured(self) -> bool:
        """Whether all recordings are of markers in motion, which are seen without errors."""
        return all(part.scene.captured for part in self.parts)

    @property
    def lifted_rope(self) -> bool:
        """Whether it is one lift of a rope by one hand."""
        one = len(self.parts) == len(self.scene.held) == 1 and not self.scene.static
        return one and self.scene.kind == "rope" and self.scene.thin

    @property
    def bases(self) -> tuple[Theta, ...]:
        """For each recording everything that is not looked for."""
        return tuple(part.base for part in self.parts)

    def _with(self, parts: Sequence[Part], **changes: Any) -> Problem:
        """The same with other parts, and attributes."""
        other = copy.copy(self)
        other.__dict__.pop("coarse", None)
        vars(other).update(changes, parts=tuple(parts))
        return other

    @cached_property
    def coarse(self) -> Problem:
        """The same with coarse parts, see there."""
        parts = tuple(part.coarse for part in self.parts)
        return self if parts == self.parts else self._with(parts)

    def finer(self, vector: Array) -> Problem:
        """The same with the resolution that the found parameters need, see `LiftScene.finer`."""
        scenes = [p.scene.finer(self.theta(vector, k)) for k, p in enumerate(self.parts)]
        both = list(zip(self.parts, scenes, strict=True))
        same = all(s is p.scene for p, s in both)
        return self if same else self._with([replace(p, scene=s) for p, s in both])

    def followed(self, vector: Array) -> Problem:
        """The same without the last frames of limp cloths, from where clouds leave the simulated
        one: a sheet that buckles may do so to either side, for less than is known of it."""
        found, parts = None, []
        for k, part in enumerate(self.parts):
            scene, theta = part.scene, self.theta(vector, k)
            if scene.bending_length(theta.E_over_rho, theta.thickness) < LIMP * scene.size:
                (found,) = [found] if found else self.compare([vector], derivatives=False)
            off = np.array(found.parts[k].rms_by_frame() if found else [0.0])
            astray = int(np.argmax([*(off - off.min() > ASTRAY * scene.size), True]))
            if max(5, len(off) // 3) <= astray < len(off):
                note = f"from frame {scene.frames[astray]} on the cloth has buckled otherwise than"
                notes = (*scene.notes, f"{note} a simulated one: these frames are not compared")
                scene = replace(scene, frames=scene.frames[:astray], notes=notes)
                part = replace(part, scene=scene)
            parts.append(part)
        return self._with(parts)

    def beside(self, found: Found) -> Problem:
        """The same with the markers of a cable as far beside its axis as was found, in the mean of
        its recordings; itself where they are already."""
        own = zip(found.best.compared.parts, found.noise, strict=True)
        seen = [c.beside(c.fit(noise).a) for c, noise in own if c.observation.scene.beside]
        if not seen:
            return self
        mean = np.mean(seen, axis=0)
        before = np.asarray(self.parts[0].base.offsets or np.zeros_like(mean))
        if np.sqrt(np.mean((mean - before) ** 2)) < PLACED or self.placed == MOST_PLACED:
            return self
        parts = [replace(p, base=p.base.with_offsets(mean)) for p in self.parts]
        return self._with(parts, placed=self.placed + 1)

    def with_unknown(self, name: str) -> Problem:
        """The same of one recording with one more unknown, the last one."""
        (part,) = self.parts
        part = replace(part, shown=np.append(part.shown, len(part.shown)))
        return self._with([part], prior=self.prior.followed_by(prior_of([name])))

    def alone(self, recording: int) -> Problem:
        """The same of one recording."""
        k = self.parts[recording].shown
        own = replace(self.parts[recording], shown=np.arange(len(k)), name="")
        return self._with([own], prior=self.prior.alone(k), _on_progress=None)

    def first_noise(self, **changes: Any) -> tuple[NoiseModel, ...]:
        """First guess of each recording's noise, with changes."""
        return tuple(replace(part.noise, **changes) for part in self.parts)

    def theta(self, vector: Sequence[float] | Array, recording: int = 0) -> Theta:
        return self.prior.theta(vector, self.parts[recording].base, recording)

    def tell(self, stage: str, iteration: int, most: int, best: Start) -> None:
        """Report progress."""
        if self._on_progress is not None:
            rms = math.nan if best.comparison is None else best.comparison.rms
            own = {"stage": stage, "iteration": iteration, "most": most, "rms": rms}
            self._on_progress(Progress(**own, best=self.theta(best.vector)))

    def positions(
        self, vectors: Sequence[Array], recording: int = 0, scene: LiftScene | None = None
    ) -> Array:
        """[T, W, N, 3] positions in a recording, or a coarser scene of it, at transformed
        parameters, of a cable its axis, NaN where a world diverges [m]."""
        thetas = [self.theta(v, recording) for v in vectors]
        return replay_axis(scene or self.parts[recording].scene, thetas, keep_going=True)

    def compare(
        self,
        vectors: Sequence[Array],
        *,
        derivatives: bool = True,
        free: Sequence[int] | None = None,
        sketched: bool | None = None,
    ) -> list[Comparisons | None]:
        """Comparisons at transformed parameters [P], None where a world diverges, from one batch
        for each recording; with derivatives by the free parameters of these indices (default:
        all), those by others are 0, sketched with few points; False: with all, of ropes."""
        prior, columns = self.prior, []
        steps = [np.where(v + prior.step > prior.high, -prior.step, prior.step) for v in vectors]
        among = (range(len(prior.names)) if free is None else free) if derivatives else ()
        for recording, part in enumerate(self.parts):
            # by the unknowns that it depends on
            moved = np.flatnonzero(np.isin(part.shown, among))
            which = part.shown[moved]
            along = self._along(which)
            back = np.linalg.inv(along[np.ix_(which, which)])
            worlds = [
                [v, *(v + along[k] * h[k] for k in which)]
                for v, h in zip(vectors, steps, strict=True)
            ]
            sketch = sketched is not False or part.scene.kind == "cloth"
            few = part.sketch if sketch and derivatives else part.scene
            shapes, changes = self._shapes(worlds, recording, few)
            found: list[Comparison | None] = []
            for own, here, change, h in zip(worlds, shapes, changes, steps, strict=True):
                if not (np.isfinite(here).all() and np.isfinite(change).all()):
                    found.append(None)
                    continue
                times = np.array([self.theta(v, recording).thickness for v in own])
                r = part.observation.shape.radius * times
                # parameters that are not free do not change the shape
                widens = np.zeros(len(part.shown) if derivatives else 0)
                J = np.zeros((*here.shape, len(widens)))
                J[..., moved] = change / h[which] @ back.T
                widens[moved] = back @ ((r[1:] - r[0]) / h[which])
                made = part.observation, here, J, float(r[0]), widens, part.base.offsets
                found.append(Comparison(*made))
            columns.append(found)
        rows = zip(*columns, strict=True)
        return [None if None in row else Comparisons(row) for row in rows]

    def _shapes(
        self, worlds: Sequence[Sequence[Array]], recording: int, few: LiftScene
    ) -> tuple[Sequence[Array], Sequence[Array]]:
        """Of a recording the shapes [T, n, 3] at the first of each row of places, and by how much
        they change from there to the others [T, n, 3, k] [m], in a scene that may be coarser; NaN
        where a world diverges."""
        part, every = self.parts[recording], [v for row in worlds for v in row]
        with ThreadPoolExecutor(max_workers=1) as beside:
            own = () if few is part.scene else [row[0] for row in worlds]
            whole = beside.submit(self.positions, own, recording) if own else None
            x = middle(few, self.positions(every, recording, few))
        rows = np.split(x, np.cumsum([len(row) for row in worlds])[:-1], axis=1)
        shapes = [own[:, 0] for own in rows]
        changes = [np.moveaxis(own[:, 1:] - own[:, :1], 1, -1) for own in rows]
        if whole is None:
            return shapes, changes
        to, of, x = part.observation.shape, Shape(few), middle(part.scene, whole.result())
        return list(np.swapaxes(x, 0, 1)), [to.taken_from(of, change) for change in changes]

    def inherit_derivatives(
        self, near: Comparisons, other: Comparisons, step: Array, weight: Array
    ) -> None:
        """`Comparison.inherit_derivatives` of all, from comparisons a step [P] away."""
        for part, mine, theirs in zip(self.parts, near.parts, other.parts, strict=True):
            mine.inherit_derivatives(theirs, step[part.shown], weight[part.shown])

    def _along(self, moved: Array) -> Array:
        """[P, P] the direction in which each unknown's step goes, where these are moved."""
        along, own = np.eye(len(self.prior.names)), [self.prior.names[k] for k in moved]
        for k, unknown in zip(moved, own, strict=True):
            for name, share in UNKNOWNS[unknown].steps_with:
                if name in own:
                    along[k, moved[own.index(name)]] = share
        return along

    def value(self, vector: Array, comparison: Comparisons, noise: Sequence[NoiseModel]) -> float:
        """-2 log of likelihood times prior, up to a constant that depends on the noise only."""
        off = (vector - self.prior.mean) / self.prior.sd
        fits = (c.fit(n).value for c, n in zip(comparison.parts, noise, strict=True))
        return sum(fits) + float(off @ off)

    def values(
        self,
        vectors: Sequence[Array],
        comparisons: Sequence[Comparisons | None],
        noise: Sequence[NoiseModel],
        near: Start | None = None,
    ) -> list[float]:
        """`value` of each, infinite where it could not be simulated; registrations begin with the
        result of a start nearby, of cloths with where that goes with the parameters."""

        def one(vector: Array, comparison: Comparisons | None) -> float:
            if comparison is None:
                return math.inf
            if near is not None and near.comparison is not None:
                ways = [(vector - near.vector)[part.shown] for part in self.parts]
                comparison.warm_start(near.comparison, ways if self.scene.kind == "cloth" else ())
            return self.value(vector, comparison, noise)

        with ThreadPoolExecutor(max_workers=self.settings.scene.threads) as pool:
            return list(pool.map(one, vectors, comparisons))

    def gradient_and_hessian(
        self, start: Start, noise: Sequence[NoiseModel]
    ) -> tuple[Array, Array]:
        """Half of the gradient [P] and of the Hessian [P, P] of `value`."""
        precision, off = self.prior.sd**-2.0, start.vector - self.prior.mean
        gradient, hessian = precision * off, np.diag(precision)
        for part, compared, own in zip(self.parts, start.compared.parts, noise, strict=True):
            fit, k = compared.fit(own), part.shown
            gradient[k] += fit.gradient
            hessian[np.ix_(k, k)] += fit.hessian
        return gradient, hessian

    def nothing_runs(self) -> SimulationError:
        frames = ", ".join(str(len(part.scene.frames)) for part in self.parts)
        where = f"{self.settings.method}, {frames} frames"
        fix = "check the recording's units and gripper path with gendom check"
        return SimulationError("no start could be simulated", where=where, fix=fix)


def recording_names(count: int) -> tuple[str, ...]:
    """Default names of recordings."""
    return ("",) if count == 1 else tuple(f"recording {k + 1}" for k in range(count))


def _check_one_object(scenes: Sequence[LiftScene], names: Sequence[str]) -> None:
    """Refuse recordings whose object descriptions differ."""
    require(scenes, "there is no recording", fix="give one or more")
    what = f"{len(scenes)} recordings have {len(names)} names"
    require(len(names) == len(scenes), what, where="names")
    first = scenes[0].recording
    stated = {size: getattr(first.object, size) for size in SIZES_OF_OBJECT}
    for scene, name in zip(scenes[1:], names[1:], strict=True):
        check_object(scene.recording, first.object.kind, stated, where=name, of=names[0])
        here, there = (len(s.recording.frame(s.begins)) for s in (scene, scenes[0]))
        what = f"shows {here} markers in order, {names[0]} {there}"
        require(here == there or not scenes[0].captured, what, where=name, fix=APART)


def check_object(
    recording: Recording, kind: str, stated: Mapping[str, float | None], *, where: str, of: str
) -> None:
    """Refuse a recording of another object than one of this kind with these sizes [m] and mass
    [kg], None where not known, as ``of`` says.

    Raises:
        ParameterError: It shows another one.
    """
    described, said = recording.object, recording.extra
    captured = said.get("ordered_markers", False) and not said.get("static", False)
    what = f"shows a {described.kind}, {of} a {kind}"
    require(described.kind == kind, what, where=where, fix=APART)
    for size, there in stated.items():
        here = getattr(described, size)
        # the length between two hands is measured, real ones to 0.5 %
        alike = 0.01 if size == "length" and captured else 1e-6
        same = math.isclose(here or 0.0, there or 0.0, rel_tol=alike)  # sizes are above 0
        texts = ["not stated" if v is None else f"{v:g}" for v in (here, there)]
        fix = f"state the same for all recordings if they show one object, else {APART}"
        require(same, f"{size} is {texts[0]}, in {of} {texts[1]}", where=where, fix=fix)
