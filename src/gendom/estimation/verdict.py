"""Whether a recording and its fit are usable: findings, each a measurement, the largest usable one
and a sentence. What exceeds its bound is a reason."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.linalg import norm
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.datasets.checks import (
    FEWEST_FRAMES,
    MAX_DENSITY,
    MIN_DENSITY,
    USUAL_SPEED,
    numbered,
    usual_speed,
)
from gendom.estimation.likelihood import HUBER, Comparison
from gendom.estimation.observed import NoiseModel, Observation, Rows
from gendom.estimation.placing import LINE_PLACES, early_points, lying_rectangle
from gendom.estimation.priors import thickness_stated
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.replay import taken
from gendom.materials.estimate import Verdict
from gendom.materials.posterior import Posterior
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.observation import breadth_across
from gendom.sim.lines import along_line

Findings = Iterator[tuple[float, float, str]]
"""Measured, the most that is usable, and what to say of more."""

NUISANCE = 5.0
"""Largest difference, in deviations, of a camera, gripper or clock from its stated value, and of
recordings of one object from each other."""

DRIFTED = 4.7
"""Likewise of two cameras of a cloth in a third of the frames: good lifts have 4.2 at most."""

DISPLACED, DISPLACED_BY_TWO, DISPLACED_CLOTH = 0.015, 0.06, 0.01
"""Largest smooth displacement between model and clouds, in the object's size. Good lifts of ropes
have 0.010 at most, ropes that slip through the fingers 0.021 and more, real cables in fast motion
0.010 to 0.016. Twice a sheet's E moves it by as much in a lift."""

STRAY, BARE, SIZE = 0.25, 0.3, (0.8, 1.25)
"""Largest shares of points far from the object, and of the object where clouds show nothing. And
sizes over the stated one of an object that clouds displace: three real cloths have 0.95 to 1.13."""

BROADER, BLURRED, NARROWER, LOST = 1.25, (0.0013, 0.0005), 1.15, 0.002
"""How much more and less than a rope's thickness cameras show, as factors and lengths [m]; more
where it is not known which camera saw a point. Pixels at edges have no depth or that of the
background: 31 good lifts of the MuJoCo scene have 0.70 to 1.06 of the thickness."""

UNITS = "is the mass in kilograms, are sizes in metres?"


def beyond(findings: Findings) -> list[str]:
    """Reasons."""
    return [said for value, most, said in findings if value > most]


def _out_of(value: float, low: float, high: float) -> float:
    """Over the nearest end of a range, above 1 outside of it."""
    return max(low / max(value, 1e-12), value / high)


def of_recording(recording: Recording, density: float | None) -> Findings:
    """Independently of the fit; of a density where mass and sizes are stated [kg/m^3]."""
    if density is not None:
        said = f"mass and sizes give a density of {density:.3g} kg/m^3: {UNITS}"
        yield _out_of(density, MIN_DENSITY[recording.object.kind], MAX_DENSITY), 1.0, said
    if recording.extra.get("static", False):
        return
    frames = np.flatnonzero(recording.frame_valid)
    lack = f"{len(frames)} of the {FEWEST_FRAMES} frames that a lift takes show points"
    yield FEWEST_FRAMES - len(frames), 0.0, lack
    if len(frames) < FEWEST_FRAMES:
        return
    path, size = recording.gripper_position[frames], recording.object.size or 1e-9
    reach = float(norm(path - path[0], axis=2).max())
    moves = reach >= 0.15 * size  # less shows almost nothing of the stiffness
    said = f"the gripper moves by {reach:.3g} m, {reach / size:.0%} of the object's size"
    yield not moves, 0.0, f"{said}: too little to tell a stiffness"
    speed = usual_speed(recording) if moves else None
    if speed is not None:
        said = f"the gripper's speed is {speed:.3g} m/s: are times in seconds and positions in"
        yield _out_of(speed, *USUAL_SPEED), 1.0, f"{said} metres?"
    yield numbered(recording), 0.0, "frames are exactly 1 s apart: are times frame numbers?"
    if recording.table_height is not None:
        depth = np.clip(0.25 * (recording.object.diameter or math.inf), 0.004, 0.01)
        under = float((recording.points[:, 2] < recording.table_height - depth).mean())
        yield under, 0.08, f"{under:.0%} of all points lie under the table: does z point up?"


def refused_before(problem: Problem) -> bool:
    """Whether a recording is not usable whatever a search finds."""
    known = "thickness" not in problem.prior.names
    return any(_of_part(p) or (known and beyond(_at_rest(p, p.base))) for p in problem.parts)


def _of_part(part: Part) -> list[str]:
    recording = part.scene.recording
    stated = recording.object.mass is not None
    return beyond(of_recording(recording, part.scene.density if stated else None))


def judge(
    problem: Problem, found: Found, posterior: Posterior, alone: Sequence[Posterior]
) -> Verdict:
    """The verdict of a fit. Reasons that concern one of several recordings begin with its name.
    Posteriors of each recording alone are compared where there are any."""
    compared, vector, reasons = found.best.compared.parts, found.best.vector, []
    for k, (part, comparison) in enumerate(zip(problem.parts, compared, strict=True)):
        fitted = beyond(_of_fit(part, comparison, found.noise[k], problem.theta(vector, k)))
        faults = _blamed_on_cameras(_of_part(part) + fitted, part, comparison)
        faults += beyond(_improbable(problem, vector, k))
        reasons += [f"{part.name}: {said}" if part.name else said for said in faults]
    reasons += beyond(_of_unknowns(problem, vector, posterior, alone))
    return Verdict(usable=not reasons, reasons=tuple(reasons))


def _of_fit(part: Part, comparison: Comparison, noise: NoiseModel, theta: Theta) -> Findings:
    scene, o, fit = part.scene, part.observation, comparison.fit(noise)
    shift, turn = np.split(fit.a[-7:-1], 2)
    most = NUISANCE * noise.shift
    if len(scene.held) > 1:
        # clouds cannot follow grippers that hold both ends: it is the object that moves otherwise
        most = max(most, DISPLACED_BY_TWO * scene.size)
    by = f"{1e3 * norm(shift):.0f} mm and turned by {math.degrees(norm(turn)):.1f} degrees"
    why = "cameras or gripper are elsewhere than stated, or the object has another size"
    moved = max(np.abs(shift).max() / most, np.abs(turn).max() / (NUISANCE * noise.turn))
    yield moved, 1.0, f"clouds would have to be moved by {by}: {why}"
    if thickness_stated(scene.recording.object):
        yield from _of_thickness(comparison, noise)
    # what is the object's own lies on it once it is displaced to the clouds
    (stray, bare), (still, empty) = (_apart(o, r) for r in (comparison.rows, fit.rows))
    shapes = comparison.axis, comparison.registered(noise)
    here, there = (norm(np.diff(x, axis=1), axis=2).mean(axis=1) for x in shapes)
    times = float(np.median((there / here)[len(here) // 2 :]))  # when least lies on the table
    large = f" and {times:.2g} times as large: is its size right?" * (_out_of(times, *SIZE) > 1.0)
    said = f"lie beside the object as simulated, {still:.0%} once it is displaced to them{large}"
    said = "do not belong to the object" if still > STRAY else said
    yield stray, STRAY, f"{stray:.0%} of all points {said}"
    said = f"is simulated, {empty:.0%} once it is displaced to them{large}"
    said = "should be: is its size right?" if empty > BARE else said
    yield bare, BARE, f"clouds show nothing where {bare:.0%} of the object {said}"
    yield from _at_rest(part, theta)
    said = f"the object moves {1e3 * noise.model:.0f} mm otherwise than any simulated one"
    whole = f"in squares {_as_a_whole(*shapes):.0%} as a whole in each frame, the rest in its shape"
    yield displaced(part, noise), 0.0, f"{said}: {whole}"


def _apart(o: Observation, rows: Rows) -> tuple[float, float]:
    """Shares of the points that are far from the object, and of the object, in the median frame,
    where clouds show nothing: beyond their own gaps."""
    own = o.counts.shape[1]
    far = np.abs(rows.rho[:, :own])[o.counts > 0.0] > 4.0 * HUBER
    bare = (rows.counts[:, own:] > 0.0) & (rows.rho[:, own:] > 0.004) & (o.markers is None)
    return float(far.mean()), float(np.median(bare.mean(axis=1)))


def _as_a_whole(here: Array, there: Array) -> float:
    """Share, in squares, of the ways from points [T, n, 3] to others that motions of each frame as
    a whole make up (Kabsch 1976)."""
    total = max(((there - here) ** 2).sum(), 1e-12)
    here, there = (x - x.mean(axis=1, keepdims=True) for x in (here, there))
    product = np.swapaxes(here, 1, 2) @ there
    along = np.linalg.svd(product, compute_uv=False)
    along[:, 2] *= np.sign(np.linalg.det(product))
    return 1.0 - float(((here**2 + there**2).sum() - 2.0 * along.sum()) / total)


def _of_thickness(comparison: Comparison, noise: NoiseModel) -> Findings:
    """A thickness that is not that of the object: by the breadth of a rope, where it is seen."""
    thick, seen = 2.0 * comparison.radius, _seen_breadth(comparison, noise)
    if seen is None:
        outside = comparison.outside(noise)
        side = "outside" if outside > 0.0 else "inside"
        said = f"points lie {1e3 * abs(outside):.1f} mm {side} an object"
        found, most = abs(outside), max(0.0025, 0.3 * thick)
    else:
        blurred = BLURRED[bool((comparison.observation.camera >= 0).any())]
        said = f"cameras see {1e3 * seen:.1f} mm across an object"
        found, most = _out_of(seen, thick / NARROWER - LOST, BROADER * thick + blurred), 1.0
    yield found, most, f"{said} {1e3 * thick:.3g} mm thick: is its thickness right?"


def _seen_breadth(comparison: Comparison, noise: NoiseModel) -> float | None:
    """Of a rope across its cameras' views [m]; None where that is not known."""
    o, cameras = comparison.observation, comparison.observation.scene.recording.camera_positions
    if cameras is None or o.markers is not None or not o.shape.rope:
        return None
    line = comparison.registered(noise)
    index, _, feet = o.shape.nearest(line, o.points)
    # beyond its ends it is no cylinder
    own = (index[..., 0] > 2) & (index[..., 1] < line.shape[1] - 3) & (o.counts > 0.0)
    ends = taken(line, index)[own]
    seen = o.points[own], feet[own], ends[:, 1] - ends[:, 0], cameras, noise.sensor
    return breadth_across(*seen, seen_by=o.camera[own])


def _blamed_on_cameras(reasons: list[str], part: Part, comparison: Comparison) -> list[str]:
    """Reasons, with that cameras disagree, where they do, in place of a wrong thickness; a fit that
    is farther from the clouds than that does not tell."""
    perceived = part.scene.recording.cameras_apart
    most = max(2.0 * part.noise.shift, comparison.rms)
    far, first, last = comparison.cameras_apart()
    # cameras may be apart beside cloths, which hides that one drifts
    drifts = far > DRIFTED * part.noise.shift and part.scene.kind == "cloth"
    if far > most and (reasons or drifts):
        said = f"in frames {first} to {last} two cameras place the object {1e3 * far:.0f} mm apart"
        said += ": do their poses, or clocks, drift?"
    elif perceived > 0.012:  # of 30 lifts with usual errors of calibration 0.008 m at most
        said = f"cameras' clouds of the object are {1e3 * perceived:.0f} mm apart: calibrate again"
    else:
        return reasons
    return [said, *(r for r in reasons if not r.endswith("its thickness right?"))]


def _at_rest(part: Part, theta: Theta) -> Findings:
    """An object at rest that is larger or smaller than stated, or lies elsewhere."""
    scene, recording, described = part.scene, part.scene.recording, part.scene.recording.object
    if scene.ordered or len(scene.held) > 1 or scene.floor is not None:
        return
    cloud = early_points(recording, 0.02 * scene.size)
    if scene.kind == "cloth":
        seen = lying_rectangle(cloud[:, :2])
        if seen is not None:
            sides = described.width or 0.0, described.height or 0.0
            stated = max(sides), min(sides)
            off = float(np.abs(np.subtract(seen, stated)).max())
            fills, told = (f"{a:.3g} x {b:.3g} m" for a, b in (seen, stated))
            said = f"at rest the cloud fills a rectangle of {fills}, the cloth is stated to be"
            yield off, NUISANCE * part.noise.shift, f"{said} {told}"
        return
    thick = theta.thickness * scene.body.thickness
    along = np.linspace(0.0, scene.size, LINE_PLACES)
    places = along_line(scene.body.points, along)[0][:, :2]
    away, nearest = KDTree(places).query(cloud[:, :2])
    far_off = max(0.015, 1.5 * thick)
    beside = float((away[nearest < len(along) - 1] > far_off).mean())
    apart = np.where(np.abs(along[:, None] - along) > 2.0 * far_off, cdist(places, places), np.inf)
    crosses = beside > 0.15 or apart.min() < 0.5 * thick
    said = f"at rest {beside:.0%} of the points lie beside the line that the others follow"
    yield crosses, 0.0, f"{said}: the rope crosses itself, or something else is in view"
    if not crosses:
        # beyond its end, straight on; nearly all of the cloud ends before
        ahead = (places[-1] - places[-2]) / norm(places[-1] - places[-2])
        tail = np.where(nearest == len(along) - 1, (cloud[:, :2] - places[-1]) @ ahead, 0.0)
        over = float(np.quantile(along[nearest] + tail, 0.99)) - scene.size
        prior, _ = scene.prior(("grip_along", "grip_height"))
        ends = "beyond" if over > 0.0 else "before"
        most = NUISANCE * math.hypot(part.noise.shift, *map(float, prior.sd))
        said = f"at rest the cloud ends {1e3 * abs(over):.0f} mm {ends} the end of an object"
        right = f"{scene.size:.3g} m long: are its length and the gripper's place right?"
        yield abs(over), most, f"{said} {right}"
    if recording.table_height is not None and thickness_stated(described):
        # over ten lifts they differ by 1.5 mm at most, of a real rope by 7 mm
        top = float(np.quantile(cloud[:, 2], 0.9)) - recording.table_height
        said = f"at rest the object reaches {1e3 * top:.0f} mm above the table, its diameter is"
        right = f"{1e3 * thick:.3g} mm: are diameter and table_height right, does z point up?"
        yield abs(top - thick), max(3.0 * part.noise.shift, 0.25 * thick), f"{said} {right}"


def displaced(part: Part, noise: NoiseModel) -> bool:
    """Whether the object moves otherwise than any simulated one."""
    of_rope = DISPLACED if len(part.scene.held) == 1 else DISPLACED_BY_TWO
    most = DISPLACED_CLOTH if part.scene.kind == "cloth" else of_rope
    return noise.model > most * part.scene.size


def _improbable(problem: Problem, vector: Array, recording: int) -> Findings:
    """A recording's own unknowns that are far from their priors."""
    prior = problem.prior
    for k in prior.of(recording):
        u, x = UNKNOWNS[prior.names[k]], float(vector[k])
        if not u.material:
            said = f"{u.symbol} would have to be {u.value(x):.3g} {u.unit} ({u.meaning})"
            off, most = abs(x - prior.mean[k]), NUISANCE * prior.sd[k]
            yield off, most, f"{said}: the stated motion or size is wrong"


def _of_unknowns(
    problem: Problem, vector: Array, posterior: Posterior, alone: Sequence[Posterior]
) -> Findings:
    """Values that no object has, and recordings that disagree."""
    prior, name, scene = problem.prior, "E_over_rho", problem.scene
    if name in prior.names:
        k = prior.index(name)
        own = math.exp(vector[k])
        inside = min(vector[k] - prior.low[k], prior.high[k] - vector[k])
        yield 1e-3, inside, "E / density lies at the end of the range that was searched"
        # fibres and rubbers have 300 to 2,500 kg/m^3, cables with copper up to 4,000; strands of
        # metal have an E above 0.1 GPa
        if scene.recording.object.mass is not None and own < 2e4:
            said = f"mass and sizes give a density of {scene.density:.3g} kg/m^3, which only metals"
            bends = f"have, but it bends like no metal (E / density {own:.3g} m^2/s^2): {UNITS}"
            yield scene.density, 4000.0, f"{said} {bends}"
    # ropes and cloths have 1 to 20 ms, and what moves too fast for its stiffness looks damped;
    # swinging cables, whose strands rub, have 30 to 160
    if not problem.captured and posterior.determined("damping"):
        low, _ = posterior.interval("damping", 0.9)
        said = f"a damping of {low:.2g} s or more is more than objects have: are times in seconds?"
        yield low, 0.05, said
    if name not in prior.names or len(alone) < 2:
        return
    at = [(float(p.mean[p.prior.index(name)]), p.sd(name)) for p in alone]
    # the two that differ by the most deviations
    deviations, a, b = max(
        (abs(at[a][0] - at[b][0]) / math.hypot(at[a][1], at[b][1]), a, b)
        for a, b in combinations(range(len(at)), 2)
    )
    names = f"{problem.parts[a].name} and {problem.parts[b].name} do not show one object"
    ends = f"{math.exp(at[a][0]):.3g} and {math.exp(at[b][0]):.3g} m^2/s^2"
    said = f"{names}: by themselves they say that E / density is {ends}"
    yield deviations, NUISANCE, f"{said}, {deviations:.0f} standard deviations apart"
