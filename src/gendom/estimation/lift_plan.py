"""Experimental design: which predefined lift determines an object's parameters best.

Objects are drawn from their prior, and each lift of each is simulated as the arm
carries it out and as noisy cameras show it. The expected posterior of an estimate from those clouds
follows from the estimator's likelihood, priors, noise and calibration, at the true parameters
(Bayesian experimental design with a Gaussian posterior; Chaloner and Verdinelli 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from gendom.arguments import check_choice, require
from gendom.arrays import Array
from gendom.datasets import ObjectDescription, Recording
from gendom.datasets.checks import MAX_DENSITY
from gendom.datasets.recording_form import joined
from gendom.errors import RobotError, SimulationError
from gendom.estimation.intervals import IntervalCalibration, posterior_of
from gendom.estimation.methods.search import estimated_noise
from gendom.estimation.problem import EstimateSettings, Found, Problem, Start
from gendom.estimation.replay import replay
from gendom.estimation.scene import LiftScene, SceneSettings
from gendom.estimation.tip import with_tip
from gendom.materials import KINDS, Item, Material, Rope, catalogue, size_of, thickness_of
from gendom.materials.posterior import Prior, half_width
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.observation import visible
from gendom.reality import Trial, arm_motion, as_real, end_of, lift, lift_cameras
from gendom.reality.objects import description
from gendom.robot import LIFT_ENDS, XARM7, JointMotion, LiftMotion, predefined_lift
from gendom.robot.motions import FREE_RISE, LIFT_FRAME_RATE, RISE

SHOWN = {"E": "E_over_rho", "damping": "damping", "friction": "friction"}
"""Parameters whose information is compared: names of `UNKNOWNS`. Density is known, or only E /
density counts."""

CLOUD_POINTS = {"rope": 320, "cloth": 1400}
"""Points of a frame, twice what an estimate compares."""


@dataclass(frozen=True, kw_only=True)
class ObjectClass:
    """Objects to lift: sizes within ranges, all other parameters from the estimator's priors.

    Raises:
        ParameterError: A range is invalid, or there is no such kind or material.
    """

    kind: str
    """``rope`` or ``cloth``."""
    size: tuple[float, float]
    """Length of a rope, side of a cloth, from and to [m]."""
    thickness: tuple[float, float]
    """Diameter of a rope, thickness of a cloth [m]."""
    mass: tuple[float, float] | None = None
    """[kg]; None: the material's typical density, or 1,000 kg/m^3."""
    material: str | None = None
    """A name of `gendom.materials.catalogue`; None: unknown."""

    def __post_init__(self) -> None:
        require(self.kind in KINDS, f"is {self.kind!r}", where="kind", fix="give rope or cloth")
        for where, ends in self._ranges.items():
            what = f"is {ends[0]:g} to {ends[1]:g}"
            fix = "give one number above 0, or the lower end and then the higher one"
            require(0.0 < ends[0] <= ends[1] < math.inf, what, where=where, fix=fix)
        if self.material is not None:
            what = f"{self.material} is no material of a {self.kind}"
            fix = f"gendom materials lists each {self.kind}"
            fits = catalogue.get(self.material).kind == self.kind
            require(fits, what, where="material", fix=fix)
        for share in (0.0, 1.0):
            self.at(share)

    @property
    def _ranges(self) -> dict[str, tuple[float, float]]:
        """Those that are stated, by name."""
        names, ends = (*KINDS[self.kind].sizes, "mass"), (self.size, self.thickness, self.mass)
        return {name: own for name, own in zip(names, ends, strict=True) if own is not None}

    def at(self, *shares: float) -> Item:
        """The object whose size, thickness and mass lie at these shares of their ranges, or all at
        one; of its material only the density counts.

        Raises:
            ParameterError: There is no such object.
        """
        each = zip(self._ranges.items(), shares * 3 if len(shares) == 1 else shares, strict=False)
        own = {n: low + share * (high - low) for (n, (low, high)), share in each}
        mass, density = own.pop("mass", None), 1000.0
        sizes: dict[str, Any] = dict(own)
        made: Any = KINDS[self.kind](**sizes)
        if self.material is not None:
            density = catalogue.get(self.material).density.typical
        if mass is not None:
            density = made.material.density * mass / made.mass
            what = f"is {mass:g} kg, a density of {density:.3g} kg/m^3"
            fix = "it looks like grams; divide by 1000"
            require(density <= MAX_DENSITY, what, where="mass", fix=fix)
        return replace(made, material=Material(density=density))


@dataclass(frozen=True, kw_only=True)
class LiftPlanSettings:
    """Motions to compare, parameters that count, and the number of objects.

    Raises:
        ParameterError: A value is out of its range.
    """

    aim: str = "all"
    """What a motion is chosen for: a key of `SHOWN`, or all."""
    ends: tuple[str, ...] = LIFT_ENDS
    """Ends that are compared: hold, swing, drop."""
    rises: tuple[float, ...] = (RISE, FREE_RISE)
    """Heights that are compared, in lengths of a rope or sides of a cloth."""
    speeds: tuple[float, ...] = ()
    """Speeds that are compared [m/s]; by default that of the predefined lift, and twice that."""
    draws: int = 4
    """Objects that are drawn."""
    seed: int = 0
    """Of objects and noise."""
    level: float = 0.9
    """Probability of the intervals."""

    def __post_init__(self) -> None:
        check_choice("aim", self.aim, (*SHOWN, "all"), where="for")
        for name, least in (("draws", 1), ("seed", 0)):
            value = getattr(self, name)
            require(value >= least, f"is {value}", where=name, fix=f"give {least} or more")
        level, fix = f"is {self.level}", "give 0 to 1, as 0.9"
        require(0.0 < self.level < 1.0, level, where="level", fix=fix)

    @property
    def aims(self) -> tuple[str, ...]:
        """Keys of `SHOWN` that count."""
        return tuple(SHOWN) if self.aim == "all" else (self.aim,)

    def motions(self, kind: str) -> list[LiftMotion]:
        """All motions that are compared, the plain hold first.

        Raises:
            RobotError: There is no such end, or a rise or speed is not above 0.
        """
        plain = predefined_lift(kind)
        speeds = self.speeds or (plain.speed, 2.0 * plain.speed)
        every = product(self.ends, self.rises, speeds)
        made = (LiftMotion(kind=kind, end=e, rise=rise, speed=v) for e, rise, v in every)
        return list(dict.fromkeys((plain, *made)))


def rolls(motion: LiftMotion) -> bool:
    """Whether a rope moves fast on the table: a round one rolls there and the simulator's slides,
    so that estimates are wrong by more than their intervals say (docs/reality.md)."""
    fast = motion.kind == "rope" and motion.end != "hold"
    return fast and (motion.end == "drop" or motion.rise < FREE_RISE)


@dataclass(frozen=True, kw_only=True)
class MotionForecast:
    """The information that one motion is expected to give about drawn objects."""

    motion: LiftMotion
    sd: tuple[Mapping[str, float], ...]
    """Deviations of the posterior by keys of `SHOWN`, transformed, for each object that can be
    lifted so and simulated."""
    faults: tuple[str, ...] = ()
    """Why the others cannot, without repetitions."""

    def half_width(self, name: str, level: float) -> float:
        """Of the expected interval, in transformed units; NaN without information."""
        own = [sd[name] for sd in self.sd]
        return half_width(level) * float(np.mean(own)) if own else math.nan


@dataclass(frozen=True, kw_only=True)
class LiftPlan:
    """Motions compared."""

    objects: ObjectClass
    settings: LiftPlanSettings
    prior_sd: Mapping[str, float]
    """By keys of `SHOWN`, transformed."""
    rows: tuple[MotionForecast, ...]
    """The plain hold first."""

    def score(self, row: MotionForecast) -> float:
        """Mean logarithm of the ratio of prior to posterior deviation, over objects and the
        parameters aimed at; 0 for an object that gives no information."""
        aims = self.settings.aims
        gains = (math.log(self.prior_sd[name] / sd[name]) for sd in row.sd for name in aims)
        return sum(gains) / (self.settings.draws * len(aims))

    def gain(self, row: MotionForecast) -> float:
        """By how much intervals are narrower than after the plain hold, the geometric mean."""
        return math.exp(self.score(row) - self.score(self.rows[0]))

    @property
    def chosen(self) -> MotionForecast:
        """The row with the highest score; one after which ropes roll only if there is no other."""
        done = [row for row in self.rows if row.sd]
        asked = [row for row in done if row.motion.end in self.settings.ends] or done
        steady = [row for row in asked if not rolls(row.motion)]
        return max(steady or asked, key=self.score)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; half widths of ln E, ln damping and friction."""
        level, chosen = self.settings.level, self.rows.index(self.chosen)
        rows = [
            {
                "lift": vars(row.motion),
                "half_width": {n: row.half_width(n, level) if row.sd else None for n in SHOWN},
                "carried_out": len(row.sd),
                "gain": self.gain(row),
                "rolls": rolls(row.motion),
                "sd": row.sd,
                "faults": row.faults,
            }
            for row in self.rows
        ]
        return {"format": "gendom-lift-plan/1", **vars(self), "chosen": chosen, "rows": rows}


def plan_lift(
    objects: ObjectClass,
    settings: LiftPlanSettings | None = None,
    *,
    on_done: Callable[[int, int], None] = lambda done, total: None,
) -> LiftPlan:
    """Compare predefined lifts by the expected posterior of an estimate; ``on_done`` is called with
    the number of lifts done, and of all.

    Raises:
        ParameterError: The material is of another kind, or there is no object of it so large.
        RobotError: No motion of any object can be carried out and simulated.
    """
    settings = settings or LiftPlanSettings()
    motions, rows, prior_sd = settings.motions(objects.kind), [], {}
    shares = (np.random.default_rng([settings.seed, n]).random(3) for n in range(settings.draws))
    drawn = [objects.at(*three) for three in shares]
    for motion in motions:
        found: list[Mapping[str, float]] = []
        faults: dict[str, None] = {}
        for n, item in enumerate(drawn):
            trial = lift(as_real(item), motion)
            try:
                arm = arm_motion(trial, lift_cameras(trial.item))
                lying = recorded_lift(trial, arm, LIFT_FRAME_RATE[motion.end])
                prior_sd, sd = forecast(lying, objects.material, [settings.seed, n])
                found.append(sd)
            except (RobotError, SimulationError) as error:
                faults[str(error)] = None
            on_done(len(rows) * len(drawn) + n + 1, len(motions) * len(drawn))
        rows.append(MotionForecast(motion=motion, sd=tuple(found), faults=tuple(faults)))
    said = next(iter(rows[0].faults), "")
    what = f"no object can be lifted by any of {len(rows)} motions: {said}"
    fix = "lift smaller objects, or less high"
    require(any(row.sd for row in rows), what, where="plan", fix=fix, error=RobotError)
    return LiftPlan(objects=objects, settings=settings, prior_sd=prior_sd, rows=tuple(rows))


def forecast(
    lying: Recording, material: str | None, seed: Sequence[int]
) -> tuple[dict[str, float], dict[str, float]]:
    """Standard deviations before and after an estimate from one lift (of `recorded_lift`) of an
    object drawn from the prior, by keys of `SHOWN`, transformed, and calibrated as the estimator's;
    the same seed gives like objects for other lifts.

    Raises:
        SimulationError: The drawn object cannot be simulated.
    """
    coarse = 15 if lying.object.kind == "cloth" else None
    settings = EstimateSettings(scene=SceneSettings(material=material, points=coarse, threads=1))
    scene, rng = LiftScene.of(lying, settings.scene), np.random.default_rng([*seed, 1])
    prior, base = scene.prior()
    truth, comparison = drawn(prior, rng), None
    (shown,) = imagined(scene, [prior.theta(truth, base)], settings.noise.sensor, rng)
    if shown is not None:
        problem = Problem([replace(scene, recording=shown)], settings)
        (comparison,) = problem.compare([truth])
    if comparison is None:
        raise SimulationError(f"a drawn {lying.object.kind} could not be simulated")
    start = Start(initial=truth, vector=truth, comparison=comparison)
    noise = estimated_noise(comparison, problem.first_noise())
    found = Found(best=start, starts=[start], noise=noise)
    _, added, _ = with_tip(problem, found)
    posterior = posterior_of(problem, found, IntervalCalibration.of(scene.kind), added)
    before = {name: float(scene.prior((unknown,))[0].sd[0]) for name, unknown in SHOWN.items()}
    # unknowns that such a recording does not determine keep their priors
    own = {name: posterior.sd(u) for name, u in SHOWN.items() if u in prior.names}
    return before, before | own


def drawn(prior: Prior, rng: np.random.Generator) -> Array:
    """[P] transformed values drawn from a prior; by name, so that other lifts are drawn alike."""
    shares = dict(zip(UNKNOWNS, rng.random(len(UNKNOWNS)), strict=True))
    own = np.array([shares[name] for name in prior.names])
    low, high = (ndtr((end - prior.mean) / prior.sd) for end in (prior.low, prior.high))
    return prior.mean + prior.sd * ndtri(low + own * (high - low))


def imagined(
    scene: LiftScene, thetas: Sequence[Theta], noise: float, rng: np.random.Generator
) -> list[Recording | None]:
    """Recordings of a scene's lift of objects with these parameters, by cameras with some noise
    [m]; None where one could not be simulated. Only frames that are compared, and those before,
    show points."""
    lying, found = scene.recording, []
    every_x = np.swapaxes(replay(scene, thetas, keep_going=True), 0, 1)
    for x, theta in zip(every_x, thetas, strict=True):
        if not np.isfinite(x).all():
            found.append(None)
            continue
        shown = {t: lying.frame(t) for t in range(scene.frames[0])}
        for t, skin in zip(scene.frames, scene.body_of(theta).surface(x), strict=True):
            if scene.kind == "rope":
                skin = skin[visible(skin, camera_positions=lying.camera_positions)]
            most = min(CLOUD_POINTS[scene.kind], len(skin))
            skin = skin[rng.choice(len(skin), size=most, replace=False)]
            shown[t] = skin + noise * rng.standard_normal(skin.shape)
        every = [shown.get(t, np.zeros((0, 3))) for t in range(lying.num_frames)]
        found.append(replace(lying, **joined(every)))
    return found


def recorded_lift(trial: Trial, arm: JointMotion, frame_rate: float) -> Recording:
    """The recording of a lift as the arm carries it out, with clouds of the object left lying."""
    item, layout = trial.item, trial.layout
    closes = next(e.time for e in arm.events if e.closed)
    seconds = end_of(trial, arm) - closes
    times = np.arange(int(seconds * frame_rate + 1e-9) + 1) / frame_rate
    ticks = size_of(item) * np.linspace(0.0, 1.0, 40)
    along, across = np.asarray(layout.along), np.asarray(layout.across)
    lying = np.asarray(layout.origin) + np.outer(ticks, along)
    if not isinstance(item, Rope):
        lying = (lying[:, None] + np.outer(ticks, across)).reshape(-1, 3)
    lying[:, 2] = thickness_of(item)
    held = {"grasp": trial.grasp, "grasp_radius": trial.reach, "grasp_inset": trial.inset}
    return Recording.from_frames(
        [lying] * len(times),
        time=times,
        gripper_position=arm.tcp_at(XARM7, closes + times)[:, :3, 3],
        gripper_closed=[bool(arm.closed_at(closes + t)) for t in times],
        object=ObjectDescription(**description(item), **held),
        table_height=0.0,
        gripper_source="measured",
        quasi_static=trial.quasi_static,
        camera_positions=np.array([c.position for c in lift_cameras(item)]),
        source="gendom.estimation.lift_plan",
    )
