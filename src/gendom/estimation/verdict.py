"""Whether a recording and its fit are usable, with reasons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gendom.datasets import Recording
from gendom.datasets.checks import (
    FEWEST_FRAMES,
    MAX_DENSITY,
    MIN_DENSITY,
    USUAL_SPEED,
    numbered,
    usual_speed,
)
from gendom.estimation.likelihood import Comparison, NoiseModel
from gendom.estimation.placing import (
    LINE_PLACES,
    early_points,
    lying_rectangle,
    with_points,
)
from gendom.estimation.priors import thickness_stated
from gendom.estimation.problem import Found, Part, Problem
from gendom.materials.estimate import Verdict
from gendom.materials.posterior import Posterior
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.sim.lines import along_line

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """Bounds beyond which a fit is not usable; shares are of the object's size."""

    frames: int = FEWEST_FRAMES
    """Fewest frames with points."""
    moved: float = 0.15
    """Shortest path of a gripper: less shows almost nothing of the stiffness."""
    speed: tuple[float, float] = USUAL_SPEED
    """Slowest and fastest usual speed of a gripper [m/s]; other values mean a wrong unit
    of time."""
    certain: float = 0.9
    """Probability of an interval that holds impossible values only."""
    damping: float = 0.05
    """Damping that a recording must not show to be exceeded [s]: ropes and cloths have 1 to 20 ms,
    and what moves too fast for its stiffness looks damped."""
    at_rest: float = 0.02
    """A gripper has not lifted an object before it has moved by more, in the object's size."""
    beside: tuple[float, float, float] = (0.015, 1.5, 0.15)
    """Points of a rope at rest lie along one line: beside it is what is farther from it than the
    larger of the first [m] and the second [diameters], for a share above the third the rope
    crosses itself."""
    end: float = 0.99
    """Share of a cloud of a rope at rest that ends before the rope does."""
    top: float = 0.9
    """Share of such a cloud that lies lower than the rope's top."""
    height: float = 3.0
    """Largest difference between the top of a rope at rest and its diameter, in deviations of the
    cameras' place. Over ten lifts it is 1.5 mm at most, of a real rope 7 mm."""
    height_in_diameters: float = 0.25
    """The same in diameters, of thick ropes; the larger one counts."""
    lightest: Mapping[str, float] = field(default_factory=lambda: MIN_DENSITY)
    """Least density by kind [kg/m^3]; smaller ones mean a wrong unit of mass or length."""
    heaviest: float = MAX_DENSITY
    """Likewise the largest [kg/m^3]."""
    metal: tuple[float, float] = (4000.0, 2e4)
    """What is denser than the first [kg/m^3] is of metal, and bends with an E / density of more
    than the second [m^2/s^2]: fibres and rubbers have 300 to 2,500 kg/m^3, cables with copper up to
    4,000, and strands of metal an E above 0.1 GPa."""
    off: float = 0.035
    """Farthest mean distance of points from the fitted skin. Over 60 good lifts of ropes 0.25 to
    0.36 m long the root mean square is 4.3 mm at most."""
    sensor: float = 0.012
    """The same for small objects [m]: the noise of a poor depth camera."""
    displaced: float = 0.015
    """Largest smooth displacement between model and clouds of a rope that one gripper holds. Over
    those lifts it is 0.010 at most, 0.007 of a real rope; ropes that slip through the fingers have
    0.021 and more, with an E that is four and more times too small."""
    displaced_by_two: float = 0.06
    """The same of a rope between two grippers; of real cables in fast motion 0.010 to 0.016."""
    displaced_cloth: float = 0.01
    """The same of a cloth. Twice its E moves a sheet in a lift by as much (2 to 5 mm of a diagonal
    of 0.42 m): a larger displacement hides the effect of E."""
    bare: float = 0.3
    """Largest share of the object that clouds do not show, in the median frame."""
    gap: float = 0.004
    """A place counts as not shown where clouds end so far from it, beyond their own gaps [m]."""
    stray: float = 0.25
    """Largest share of points farther away than `far` times `NoiseModel.huber_width`."""
    far: float = 4.0
    below: float = 0.08
    """Largest share of points that lie under the stated table: by 1 cm and more, of a rope by a
    quarter of its diameter (and 4 mm) and more."""
    nuisance: float = 5.0
    """Largest difference, in deviations, of a camera, gripper or clock from its stated value, and
    of recordings of one object from each other."""
    apart: float = 2.0
    """Largest distance between two cameras' clouds, in deviations of a camera's place."""
    clouds_apart: float = 0.012
    """Largest one that perception measured [m]; of 30 lifts with usual errors of calibration
    0.008 at most."""
    skin: tuple[float, float] = (0.0025, 0.3)
    """Largest distance of points from the skin of an object as thick as stated: the larger of the
    first [m] and the second times the thickness."""


def recording_faults(
    recording: Recording, density: float | None, settings: VerdictSettings | None = None
) -> list[str]:
    """Why a recording is not usable, independently of the fit.

    Args:
        recording: A valid one.
        density: Mass over volume where both are stated [kg/m^3].
        settings: Bounds.
    """
    s = settings or VerdictSettings()
    found = _impossible_density(recording.object.kind, density, s)
    frames = np.flatnonzero(recording.frame_valid)
    if recording.extra.get("static", False):
        return found
    if len(frames) < s.frames:
        said = f"{len(frames)} of the {s.frames} frames that a lift takes show points"
        return [*found, said]
    path, size = recording.gripper_position[frames], recording.object.size or 0.0
    reach = float(norm(path - path[0], axis=2).max())
    if reach < s.moved * size:
        found.append(
            f"the gripper moves by {reach:.3g} m, {reach / max(size, 1e-9):.0%} of the object's "
            f"size: too little to tell a stiffness"
        )
    else:
        speed = usual_speed(recording)
        if speed is not None and not s.speed[0] <= speed <= s.speed[1]:
            found.append(
                f"the gripper's speed is {speed:.3g} m/s: are times in seconds and positions "
                "in metres?"
            )
    if numbered(recording):
        found.append("frames are exactly 1 s apart: are times frame numbers?")
    if recording.table_height is not None:
        thick = recording.object.diameter
        depth = 0.01 if thick is None else min(0.01, max(0.004, 0.25 * thick))
        under = float((recording.points[:, 2] < recording.table_height - depth).mean())
        if under > s.below:
            found.append(f"{under:.0%} of all points lie under the table: does z point up?")
    return found


def _impossible_density(kind: str, density: float | None, s: VerdictSettings) -> list[str]:
    if density is None or s.lightest.get(kind, 0.0) <= density <= s.heaviest:
        return []
    return [
        f"mass and sizes give a density of {density:.3g} kg/m^3: is the mass in kilograms, are "
        "sizes in metres?"
    ]


def refused_before(problem: Problem, settings: VerdictSettings | None = None) -> bool:
    """Whether a recording is not usable whatever a search finds."""
    s = settings or VerdictSettings()
    for part in problem.parts:
        scene, known = part.scene, "thickness" not in problem.prior.names
        density = None if scene.recording.object.mass is None else scene.density
        if recording_faults(scene.recording, density, s):
            return True
        if known and _at_rest(part, part.base, s):
            return True
    return False


def judge(
    problem: Problem,
    found: Found,
    posterior: Posterior,
    alone: Sequence[Posterior],
    settings: VerdictSettings | None = None,
) -> Verdict:
    """The verdict of a fit. Reasons that concern one of several recordings begin with its name.

    Args:
        problem: The problem.
        found: The result of the search.
        posterior: Of all recordings.
        alone: Posteriors of each recording alone; empty where they are not compared.
        settings: Bounds.
    """
    s, compared = settings or VerdictSettings(), found.best.comparison
    assert compared is not None
    reasons = []
    for k, (part, comparison) in enumerate(zip(problem.parts, compared.parts, strict=True)):
        theta = problem.theta(found.best.vector, k)
        faults = _faults(part, comparison, found.noise[k], theta, s)
        faults += _improbable(problem, found.best.vector, k, s)
        reasons += [part.named(reason) for reason in faults]
    reasons += _impossible_modulus(problem, found.best.vector, s)
    if not problem.captured:  # swinging cables, whose strands rub, have 0.03 to 0.16 s
        reasons += _damped(posterior, s)
    reasons += _disagreeing(problem, alone, s)
    return Verdict(usable=not reasons, reasons=tuple(reasons))


def _faults(
    part: Part, comparison: Comparison, noise: NoiseModel, theta: Theta, s: VerdictSettings
) -> list[str]:
    """Why a recording, or its fit, is not usable."""
    scene, observation = part.scene, part.observation
    density = None if scene.recording.object.mass is None else scene.density
    reasons = recording_faults(scene.recording, density, s) + _misplaced(part, comparison, noise, s)
    rows = comparison.rows
    own = observation.counts.shape[1]
    real = observation.counts > 0.0
    away = np.abs(rows.rho[:, :own])[real]
    mean = float(away.mean())
    if mean > max(s.off * scene.size, s.sensor):
        reasons.append(
            f"points lie {1e3 * mean:.0f} mm from the best fit in the mean, where "
            f"{1e3 * max(s.off * scene.size, s.sensor):.0f} mm are usual at most"
        )
    stray = float((away > s.far * observation.noise.huber_width).mean())
    if stray > s.stray:
        reasons.append(f"{stray:.0%} of all points do not belong to the object")
    if observation.markers is None:
        bare = (rows.counts[:, own:] > 0.0) & (rows.rho[:, own:] > s.gap)
        share = float(np.median(bare.mean(axis=1)))
        if share > s.bare:
            reasons.append(
                f"clouds show nothing where {share:.0%} of the object should be: is its size right?"
            )
    reasons += _at_rest(part, theta, s)
    if displaced(part, noise, s):
        reasons.append(
            f"the object moves {1e3 * noise.model:.0f} mm otherwise than any simulated one"
        )
    return _blamed_on_cameras(reasons, part, comparison, s)


def _blamed_on_cameras(
    reasons: list[str], part: Part, comparison: Comparison, s: VerdictSettings
) -> list[str]:
    """Reasons, with that cameras disagree, where they do, in place of a wrong thickness."""
    perceived = part.scene.recording.cameras_apart
    far, first, last = comparison.cameras_apart() if reasons else (0.0, 0, 0)
    if far > s.apart * part.noise.shift:
        said = (
            f"in frames {first} to {last} two cameras place the object {1e3 * far:.0f} mm apart: "
            "do their poses, or clocks, drift?"
        )
    elif perceived > s.clouds_apart:
        said = f"cameras' clouds of the object are {1e3 * perceived:.0f} mm apart: calibrate again"
    else:
        return reasons
    return [said, *(r for r in reasons if not r.endswith("its thickness right?"))]


def _misplaced(
    part: Part, comparison: Comparison, noise: NoiseModel, s: VerdictSettings
) -> list[str]:
    """Cameras, or an object's thickness, that are far from what is stated."""
    shift, turn = np.split(comparison.fit(noise).a[-7:-1], 2)
    reasons = []
    most = s.nuisance * noise.shift
    if len(part.scene.held) > 1:
        # clouds cannot follow grippers that hold both ends: it is the object that moves otherwise
        most = max(most, s.displaced_by_two * part.scene.size)
    if np.abs(shift).max() > most or np.abs(turn).max() > s.nuisance * noise.turn:
        reasons.append(
            f"clouds would have to be moved by {1e3 * norm(shift):.0f} mm and turned by "
            f"{math.degrees(norm(turn)):.1f} degrees: cameras or gripper are elsewhere "
            "than stated, or the object has another size"
        )
    thick = part.scene.body.thickness
    stated = thickness_stated(part.scene.recording.object)
    outside = comparison.outside(noise) if stated else 0.0
    if abs(outside) > max(s.skin[0], s.skin[1] * thick):
        side = "outside" if outside > 0.0 else "inside"
        reasons.append(
            f"points lie {1e3 * abs(outside):.1f} mm {side} an object {1e3 * thick:.3g} mm thick: "
            "is its thickness right?"
        )
    return reasons


def _at_rest(part: Part, theta: Theta, s: VerdictSettings) -> list[str]:
    """An object at rest that is larger or smaller than stated, or lies elsewhere."""
    scene, recording = part.scene, part.scene.recording
    if scene.ordered or len(scene.held) > 1 or scene.floor is not None:
        return []
    if scene.kind == "cloth":
        return _lying(part, s)
    thick = theta.thickness * scene.body.thickness
    prior, _ = scene.prior(("grip_along", "grip_height"))
    cloud = early_points(recording, with_points(recording), s.at_rest * scene.size)
    reasons: list[str] = []
    along = np.linspace(0.0, scene.size, LINE_PLACES)
    places = along_line(scene.body.points, along)[0][:, :2]
    away, nearest = KDTree(places).query(cloud[:, :2])
    # beyond its end, straight on
    ahead = (places[-1] - places[-2]) / norm(places[-1] - places[-2])
    tail = np.where(nearest == len(along) - 1, (cloud[:, :2] - places[-1]) @ ahead, 0.0)
    beyond = float(np.quantile(along[nearest] + tail, s.end)) - scene.size
    place = math.hypot(part.noise.shift, *map(float, prior.sd))
    far_off = max(s.beside[0], s.beside[1] * thick)
    beside = float((away[nearest < len(along) - 1] > far_off).mean())
    apart = np.where(np.abs(along[:, None] - along) > 2.0 * far_off, cdist(places, places), np.inf)
    if beside > s.beside[2] or apart.min() < 0.5 * thick:
        reasons.append(
            f"at rest {beside:.0%} of the points lie beside the line that the others follow: the "
            "rope crosses itself, or something else is in view"
        )
    elif abs(beyond) > s.nuisance * place:
        ends = "beyond" if beyond > 0.0 else "before"
        reasons.append(
            f"at rest the cloud ends {1e3 * abs(beyond):.0f} mm {ends} the end of an object "
            f"{scene.size:.3g} m long: are its length and the gripper's place right?"
        )
    if recording.table_height is not None and thickness_stated(recording.object):
        top = float(np.quantile(cloud[:, 2], s.top)) - recording.table_height
        if abs(top - thick) > max(s.height * part.noise.shift, s.height_in_diameters * thick):
            reasons.append(
                f"at rest the object reaches {1e3 * top:.0f} mm above the table, its diameter is "
                f"{1e3 * thick:.3g} mm: are diameter and table_height right, does z point up?"
            )
    return reasons


def _lying(part: Part, s: VerdictSettings) -> list[str]:
    """A cloth that lies flat, with other sides than stated."""
    scene, described = part.scene, part.scene.recording.object
    every = with_points(scene.recording)
    cloud = early_points(scene.recording, every, s.at_rest * scene.size)
    seen = lying_rectangle(cloud[:, :2])
    if seen is None:
        return []
    assert described.width is not None and described.height is not None
    stated = sorted((described.width, described.height), reverse=True)
    if max(abs(a - b) for a, b in zip(seen, stated, strict=True)) <= s.nuisance * part.noise.shift:
        return []
    return [
        f"at rest the cloud fills a rectangle of {seen[0]:.3g} x {seen[1]:.3g} m, the cloth is "
        f"stated to be {stated[0]:.3g} x {stated[1]:.3g} m"
    ]


def displaced(
    part: Part, noise: NoiseModel, settings: VerdictSettings | None = None, times: float = 1.0
) -> bool:
    """Whether the object moves otherwise than any simulated one, by so many times what is
    usable."""
    s, scene = settings or VerdictSettings(), part.scene
    most = s.displaced if len(scene.held) == 1 else s.displaced_by_two
    if scene.kind == "cloth":
        most = s.displaced_cloth
    return noise.model > times * most * scene.size


def _impossible_modulus(problem: Problem, vector: Array, s: VerdictSettings) -> list[str]:
    """A modulus at a bound of the search, or one that an object of its density cannot have."""
    prior, scene = problem.prior, problem.scene
    if "E_over_rho" not in prior.names:
        return []
    k, found = prior.index("E_over_rho"), []
    if min(vector[k] - prior.low[k], prior.high[k] - vector[k]) < 1e-3:
        found.append("E / density lies at the end of the range that was searched")
    own, density = math.exp(vector[k]), scene.density
    if scene.recording.object.mass is not None and density > s.metal[0] and own < s.metal[1]:
        found.append(
            f"mass and sizes give a density of {density:.3g} kg/m^3, which only metals have, but "
            f"it bends like no metal (E / density {own:.3g} m^2/s^2): is the mass in kilograms, "
            "are sizes in metres?"
        )
    return found


def _damped(posterior: Posterior, s: VerdictSettings) -> list[str]:
    """More damping than objects have."""
    if not posterior.determined("damping"):
        return []
    low, _ = posterior.interval("damping", s.certain)
    if low < s.damping:
        return []
    return [f"a damping of {low:.2g} s or more is more than objects have: are times in seconds?"]


def _improbable(problem: Problem, vector: Array, recording: int, s: VerdictSettings) -> list[str]:
    """A recording's own unknowns that are far from their priors."""
    prior, far = problem.prior, []
    for k in prior.of(recording):
        u, x = UNKNOWNS[prior.names[k]], float(vector[k])
        if not u.material and abs(x - prior.mean[k]) > s.nuisance * prior.sd[k]:
            far.append(
                f"{u.symbol} would have to be {u.value(x):.3g} {u.unit} ({u.meaning}): the stated "
                "motion or size is wrong"
            )
    return far


def _disagreeing(problem: Problem, alone: Sequence[Posterior], s: VerdictSettings) -> list[str]:
    """Recordings that disagree in E / density: the two that differ by the most deviations."""
    name = "E_over_rho"
    if name not in problem.prior.names:
        return []
    at = [float(p.mean[p.prior.index(name)]) for p in alone]
    sd = [p.sd(name) for p in alone]
    pairs = combinations(range(len(at)), 2)
    apart = ((abs(at[a] - at[b]) / math.hypot(sd[a], sd[b]), a, b) for a, b in pairs)
    deviations, a, b = max(apart, default=(0.0, 0, 0))
    if deviations <= s.nuisance:
        return []
    (one, low), (other, high) = ((problem.parts[n].name, math.exp(at[n])) for n in (a, b))
    return [
        f"{one} and {other} do not show one object: by themselves they say that E / density is "
        f"{low:.3g} and {high:.3g} m^2/s^2, {deviations:.0f} standard deviations apart"
    ]
