"""Each bound of a verdict from both sides, and what is said beyond it."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.datasets import ObjectDescription, Recording
from gendom.estimation import Theta, verdict
from gendom.estimation.observed import NoiseModel
from gendom.materials.posterior import Posterior, prior_of

NS: Any = SimpleNamespace
NOISE = NoiseModel(shift=0.003, turn=0.01, model=0.002)
ROPE = ObjectDescription(kind="rope", length=0.4, diameter=0.01, mass=0.02)
CLOTH = ObjectDescription(kind="cloth", width=0.3, height=0.5, mass=0.02)
WIDE = replace(CLOTH, width=0.5, height=0.3)
THICK, THIN, BAR, UNSTATED = (replace(ROPE, diameter=d) for d in (0.03, 0.002, 0.05, None))


def patched(name, value, find):
    """All findings where a function of the module gives this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, name, value)
        return list(find())


def recording(step=0.03, dt=0.5, frames=4, under=0, described=ROPE, static=False, **changes):
    """A gripper that goes up evenly; 100 points a frame, some of which lie under."""
    clouds, z = [], np.arange(frames) * step
    for _ in range(frames):
        cloud = np.tile([0.0, 0.0, 0.2], (100, 1))
        cloud[:under, 2] = 0.1 - changes.get("depth", 0.006)
        clouds.append(cloud)
    return Recording.from_frames(
        clouds, time=dt * np.arange(frames), object=described,
        table_height=changes.get("table", 0.1), extra={"static": static},
        gripper_position=np.stack([0.0 * z, 0.0 * z, z], axis=1),
    )  # fmt: skip


def recorded(density=None, **changes):
    return verdict.of_recording(recording(**changes), density)


HALF = {"under": 50}
OF_RECORDINGS = [
    ({}, {"density": 120.1}, {"density": 119.9}, "density of 120 kg"),
    ({"described": CLOTH, "step": 0.1}, {"density": 30.1}, {"density": 29.9}, "of 29.9 kg"),
    ({}, {"density": 11990.0}, {"density": 12100.0}, "density of 1.21e.04 kg"),
    ({}, {}, {"static": True, "frames": 1, "density": 119.9}, "density of 120 kg"),
    ({}, {"frames": 4}, {"frames": 3}, "3 of the 4 frames that a lift takes show points"),
    ({}, {"step": 0.0201}, {"step": 0.0199}, "moves by 0.0597 m, 15% of the object"),
    ({}, {"dt": 0.0151}, {"dt": 0.0149}, "speed is 2.01 m/s: are times"),
    ({}, {"dt": 59.9}, {"dt": 60.1}, "speed is 0.000499 m/s: are times"),
    ({"dt": 1.0}, {"frames": 9}, {"frames": 10}, "exactly 1 s apart"),
    # by a quarter of the thickness, at least 4 and at most 10 mm, 1 cm where it is not known
    ({}, {"under": 8}, {"under": 9}, "9% of all points lie under"),
    (HALF | {"described": THIN}, {"depth": 0.0039}, {"depth": 0.0041}, "50% of all points"),
    (HALF | {"described": THICK}, {"depth": 0.0074}, {"depth": 0.0076}, "50% of all points"),
    (HALF | {"described": BAR}, {"depth": 0.0099}, {"depth": 0.0101}, "50% of all points"),
    (HALF | {"described": UNSTATED}, {"depth": 0.0099}, {"depth": 0.0101}, "50% of all po"),
    (HALF, {"table": None}, {}, "50% of all points lie under"),
]


CORNER = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.1, 0.0]])
"""A line whose end points along y."""


def lying(line=CORNER, thick=0.01, described=ROPE, table=0.5, first=100, sides=None, **changes):
    """At rest; of a cloth whose sides these seem to be."""
    names = [n for n in ("end", "beside", "off", "top") if n in changes]
    cloud = along(**{n: changes.pop(n) for n in names})[:first]
    place = NS(
        object=described, table_height=table, gripper_position=np.zeros((1, 1, 3)), num_frames=1,
        frame_valid=[True], frame=lambda t: cloud,
    )  # fmt: skip
    sd = np.array([0.004, 0.012])  # with 3 mm of the cameras 13 mm in all
    scene = NS(
        ordered=False, held=[0], floor=None, kind=described.kind, size=0.4, recording=place,
        body=NS(points=line, thickness=0.5 * thick), prior=lambda names: (NS(sd=sd), names),
    )  # fmt: skip
    vars(scene).update(changes)
    seen = lambda points: sides if points.shape == (100, 2) else (9.0, 9.0)  # noqa: E731
    part = NS(scene=scene, noise=NOISE)
    return patched("lying_rectangle", seen, lambda: verdict._at_rest(part, NS(thickness=2.0)))


def along(end=0.1, beside=0, off=0.0, top=0.01):
    """90 points along the first side, 10 at the end; of all so many lie beside it."""
    cloud = np.stack([np.linspace(0.0, 0.28, 90), np.zeros(90), np.zeros(90)], axis=1)
    cloud = np.concatenate([cloud, np.tile([0.3, end, 0.0], (10, 1))])
    cloud[20 : 20 + beside, 1] = -off
    return cloud + np.array([0.0, 0.0, 0.5 + top])


def legs(gap):
    """A line there and back."""
    return np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, gap, 0.0], [gap, gap, 0.0]])


def folded(at):
    """A line of 0.4 m that turns back there, 4.9 mm beside itself."""
    return np.array([[0, 0, 0], [at, 0, 0], [at, 0.0049, 0], [2.0 * at - 0.3951, 0.0049, 0]])


BESIDE, TWO_LEGS = "at rest 16% of the points lie beside", {"first": 60}
OF_LYING = [
    ({}, {"end": 0.1649}, {"end": 0.1651}, "ends 65 mm beyond the end of an object 0.4 m"),
    ({}, {"end": 0.0351}, {"end": 0.0340}, "ends 66 mm before the end of an object 0.4 m"),
    ({"off": 0.0151}, {"beside": 13}, {"beside": 14}, BESIDE),
    ({"beside": 14}, {"off": 0.0149}, {"off": 0.0151}, BESIDE),
    ({"beside": 14, "thick": 0.02, "top": 0.02}, {"off": 0.0299}, {"off": 0.0301}, BESIDE),
    (TWO_LEGS, None, {"line": legs(0.0051)}, "ends .* before"),
    (TWO_LEGS, None, {"line": legs(0.0049)}, "at rest 0% of the points lie beside"),
    (TWO_LEGS, None, {"line": folded(0.38)}, "at rest 0% of the points lie beside"),
    (TWO_LEGS, None, {"line": folded(0.385)}, "ends .* before"),  # 25 mm along it
    ({}, {"top": 0.0189}, {"top": 0.0191}, "reaches 19 mm above the table"),
    ({}, {"top": 0.0011}, {"top": 0.0009}, "reaches 1 mm above the table"),
    ({"thick": 0.04}, {"top": 0.0499}, {"top": 0.0501}, "reaches 50 mm above the table"),
    ({"top": 0.0501}, {"table": None}, {}, "reaches 50 mm above the table"),
    ({"top": 0.0501}, {"described": UNSTATED}, {}, "its diameter is 10 mm"),
    # what says nothing of how it lies
    ({"end": 0.3}, {"ordered": True}, {}, "beyond"),
    ({"end": 0.3}, {"held": [0, 1]}, {}, "beyond"),
    ({"end": 0.3}, {"floor": 0.2}, {}, "beyond"),
    *[({"described": described, "sides": (0.5, 0.3)}, {"sides": inside}, {"sides": outside},
       f"rectangle of {fills} m, the cloth is stated to be 0.5 x 0.3 m")
      for described in (CLOTH, WIDE)  # however its sides are named
      for inside, outside, fills in (((0.5149, 0.2851), (0.5151, 0.3), "0.515 x 0.3"),
                                     (None, (0.5, 0.2849), "0.5 x 0.285"))],
]  # fmt: skip


def fits(
    shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), held=(0,), size=0.4, stray=0, far=0.0,
    markers=None, bare=(0, 0, 0), gap=0.0, stands_for=1.0, model=0.002, kind="rope",
    described=UNSTATED, thick=0.01, seen=None, away=0.0, known=True, still=1.0, grown=1.0,
):  # fmt: skip
    """Of a rope of 0.4 m, whose thickness is stated or not, with its breadth as cameras see it;
    displaced to the clouds it is as far from them times ``still``, and has grown or turned."""
    rho, counts = np.zeros((3, 13)), np.ones((3, 13))
    counts[2, 2], counts[:, 3:] = 0.0, 0.0  # eight of nine points count
    rho[:, :3].flat[:stray] = far
    rho[2, 2] = 1.0  # does not count
    for t, n in enumerate(bare):
        rho[t, 3 : 3 + n], counts[t, 3 : 3 + n] = gap, stands_for
    camera = np.array([[-1, 0 if known else -1]])
    observation = NS(counts=counts[:, :3], markers=markers, camera=camera)
    a = np.array([9.0, 9.0, *shift, *turn, 9.0])
    axis = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]])
    moved = axis[..., [1, 0, 2]] * [-1.0, 1.0, 1.0] if grown == 1.0 else axis * grown
    fitted = NS(
        rows=NS(rho=rho, counts=counts), radius=0.5 * thick, outside=lambda noise: away,
        fit=lambda noise: NS(a=a, rows=NS(rho=still * rho, counts=counts)),
        observation=observation, axis=axis, registered=lambda noise: moved + 0.3,
    )  # fmt: skip
    of = NS(object=described)
    scene = NS(held=held, size=size, kind=kind, recording=of, ordered=True)
    noise = replace(NOISE, model=model)
    part = NS(scene=scene, observation=observation, noise=noise)
    found = lambda: verdict._of_fit(part, fitted, noise, Theta(E_over_rho=1.0))  # noqa: E731
    return patched("_seen_breadth", lambda *_: seen, found)


def aside(x):
    return {"shift": (x, 0.0, 0.0)}


STATED, EVERY = {"described": ROPE}, {"bare": (4, 4, 4)}
NONE, OTHERWISE = "nothing where 40%", "otherwise than any simulated"
OF_FITS = [
    ({}, aside(-0.0149), aside(-0.0151), "be moved by 15 mm and turned by 0.0 degrees"),
    ({}, {}, {"shift": (0.0, 0.03, 0.04)}, "be moved by 50 mm and turned by 0.0 degrees"),
    ({}, {"turn": (0.0, 0.0499, -0.0499)}, {"turn": (0.0, 0.0, -0.0501)}, "by 2.9 degrees"),
    ({"held": (0, 1)}, aside(0.0239), aside(0.0241), "be moved by 24 mm and turned by 0.0"),
    ({"held": (0, 1), "size": 0.1}, aside(0.0149), aside(0.0151), "be moved by 15 mm"),
    # a quarter of the eight points that count, beyond 24 mm
    ({"far": 0.03}, {"stray": 2}, {"stray": 3}, "38% of all points do not belong"),
    ({"stray": 3}, {"far": 0.0239}, {"far": -0.0241}, "38% of all points do not belong"),
    ({"stray": 3, "far": 0.03}, None, {"still": 0.81}, "38% of all points do not belong"),
    ({"stray": 3, "far": 0.03}, None, {"still": 0.79},
     "38% of all points lie beside the object as simulated, 0% once it is displaced to them$"),
    ({"stray": 3, "far": 0.03, "still": 0.7}, None, {"grown": 1.24}, "displaced to them$"),
    ({"stray": 3, "far": 0.03, "still": 0.7}, None, {"grown": 1.26},
     "to them and 1.3 times as large: is its size right"),
    ({"stray": 3, "markers": 0}, {"far": 0.0239}, {"far": 0.0241}, "38% of all points"),
    # three tenths of ten places in the median of three frames
    ({"gap": 0.0041}, {"bare": (3, 3, 9)}, {"bare": (4, 1, 4)}, NONE),
    (EVERY, {"gap": 0.0039}, {"gap": 0.0041}, NONE),
    (EVERY | {"gap": 0.0041}, {"stands_for": 0.0}, {"stands_for": 0.4}, NONE),
    (EVERY | {"gap": 0.0041}, {"markers": 0}, {}, f"{NONE} of the object should be: is its size"),
    (EVERY | {"gap": 0.005}, None, {"still": 0.81}, f"{NONE} of the object should be: is its si"),
    (EVERY | {"gap": 0.005}, None, {"still": 0.79},
     f"{NONE} of the object is simulated, 0% once it is displaced to them$"),
    (EVERY | {"gap": 0.005, "still": 0.7}, None, {"grown": 0.79},
     "to them and 0.79 times as large: is its size right"),
    ({}, {"model": 0.00599}, {"model": 0.00601}, "moves 6 mm otherwise than any"),
    ({"model": 0.007}, None, {}, "7 mm .*: in squares 100% as a whole in each frame"),
    ({"model": 0.007}, None, {"grown": 2.0}, "in squares 45% as a whole"),
    ({"held": (0, 1)}, {"model": 0.02399}, {"model": 0.02401}, OTHERWISE),
    ({"kind": "cloth"}, {"model": 0.00399}, {"model": 0.00401}, OTHERWISE),
    (STATED, {"away": 0.0029}, {"away": 0.0031}, "points lie 3.1 mm outside an object 10 mm"),
    (STATED, {"away": -0.0029}, {"away": -0.0031}, "points lie 3.1 mm inside an object 10 mm"),
    (STATED | {"thick": 0.004}, {"away": 0.0024}, {"away": -0.0026}, "2.6 mm inside an object"),
    # 1.25 times and 0.5 mm more, 1.3 mm where cameras are not known; 1.15 times and 2 mm less
    (STATED, {"seen": 0.01299, "away": 9.0}, {"seen": 0.01301}, "see 13.0 mm across an obj"),
    (STATED | {"known": False}, {"seen": 0.01379}, {"seen": 0.01381}, "see 13.8 mm across"),
    (STATED | {"thick": 0.023}, {"seen": 0.01801}, {"seen": 0.01799}, "18.0 mm across an obj"),
]  # fmt: skip


PRIOR = prior_of(("E_over_rho", "damping", "grip_height", "delay"))


def known(lnE=7.0, sd=0.1, damping=0.01, wide=0.2):
    mean = np.array([lnE, math.log(damping), 0.0, 0.0])
    sds = np.array([sd, wide, 0.001, 0.001])
    return Posterior(prior=PRIOR, mean=mean, covariance=np.diag(sds**2), bases=())


METAL, END = "density of 4e.03 kg.* only metals", "lies at the end of the range"
SURE, LESS, NOT = known(7.0, 0.03), known(7.4, 0.04), known(9.0, 1.0)
OWN, FAR = {"names": ("damping", "grip_height")}, PRIOR.sd[2]
"""What is unknown of a known material."""


def unknown(lnE=7.0, share=0.0, density=1000.0, mass=0.1, captured=False, alone=(),
            names=PRIOR.names, **of):  # fmt: skip
    """A grip so many deviations higher than stated; the object's own damping is far from usual."""
    scene = NS(density=density, recording=NS(object=NS(mass=mass)))
    problem = NS(prior=prior_of(names), scene=scene, captured=captured)
    problem.parts = [NS(name=n) for n in "abc"]
    vector = np.array([lnE, *(PRIOR.mean + np.array([9.0, 9.0, share, 0.0]) * PRIOR.sd)[1:]])
    yield from verdict._improbable(NS(prior=PRIOR), vector, 0)
    yield from verdict._of_unknowns(problem, vector, known(**of), alone)


OF_UNKNOWNS = [
    ({}, {"share": 4.99}, {"share": 5.01}, f"would have to be {5.01 * FAR:.3g} m .*: the stated"),
    ({}, {"share": -4.99}, {"share": -5.01}, "would have to be -"),
    ({}, {"lnE": PRIOR.low[0] + 1.1e-3}, {"lnE": PRIOR.low[0] + 0.9e-3}, END),
    ({}, {"lnE": PRIOR.high[0] - 1.1e-3}, {"lnE": PRIOR.high[0] - 0.9e-3}, END),
    ({"density": 4001.0}, {"lnE": math.log(20000.5)}, {"lnE": math.log(19999.5)}, METAL),
    ({}, {"density": 3999.0}, {"density": 4001.0}, METAL),
    ({"density": 4001.0}, {"mass": None}, {}, METAL),
    # the lower end of 90 % of exp(N(ln 0.07, 0.2)) is 0.07 exp(-0.329)
    ({}, {"damping": 0.0694}, {"damping": 0.0696}, "a damping of 0.05 s or more"),
    ({"damping": 0.2}, {"captured": True}, {}, "a damping of 0.14 s or more"),
    ({"damping": 0.9}, {"wide": 0.51 * PRIOR.sd[1]}, {}, "a damping of 0.2 s or more"),
    ({}, {"alone": [known(7.0), known(7.7)]}, {"alone": [known(7.0), known(7.71)]},
     r"a and b do .* is 1.1e.03 and 2.23e.03 m.*, 5 standard deviations"),
    # of three the two that differ by the most deviations, not by the most
    ({}, {"alone": [known(7.71)]}, {"alone": [SURE, LESS, NOT]}, "a and b .* 8 standard dev"),
    ({}, {}, {"alone": [NOT, SURE, LESS]}, "b and c do not show one object.* 8 standard dev"),
    # of a known material only its damping is looked at
    ({"lnE": PRIOR.low[0]}, OWN, {}, END),
    ({"density": 4001.0}, OWN, {}, METAL),
    ({"alone": [known(7.0), known(9.0)]}, OWN, {}, "a and b"),
    (OWN, {"damping": 0.0694}, {"damping": 0.0696}, "a damping of 0.05 s or more"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("find", "common", "inside", "outside", "said"),
    [
        (find, *row)
        for find, rows in (
            (recorded, OF_RECORDINGS), (lying, OF_LYING), (fits, OF_FITS), (unknown, OF_UNKNOWNS),
        )
        for row in rows
    ],
)  # fmt: skip
def test_each_bound(find, common, inside, outside, said):
    """Of findings within it nothing is said, and of those beyond it this."""
    reasons = verdict.beyond(find(**(common | outside)))
    assert len(reasons) == 1 and re.search(said, reasons[0]), reasons
    if inside is not None:
        assert verdict.beyond(find(**(common | inside))) == []


def test_breadth_is_seen_away_from_both_ends(monkeypatch):
    """Of points that count, beside the line as it is registered."""
    line = np.cumsum(np.arange(24.0).reshape(1, 8, 3), axis=1)
    first = np.array([[2, 3, 4, 4, 3]])
    index = np.stack([first, first + 1], axis=2)
    points, feet = np.arange(15.0).reshape(1, 5, 3), -np.arange(15.0).reshape(1, 5, 3)
    shape = NS(rope=True, nearest=lambda x, p: (index, None, feet) if p is points else None)
    observed = NS(
        scene=NS(recording=NS(camera_positions="cameras")), markers=None, shape=shape,
        points=points, counts=np.array([[1.0, 1.0, 1.0, 1.0, 0.0]]), camera=np.arange(5)[None],
    )  # fmt: skip
    compared, got = NS(observation=observed, registered=lambda noise: line), []

    def breadth(*seen, seen_by):
        got.extend([*seen, seen_by])
        return 0.007

    monkeypatch.setattr(verdict, "breadth_across", breadth)
    assert verdict._seen_breadth(compared, NOISE) == 0.007
    # of the first points 0 to 2 and the last three no segment counts: 3 to 4 does
    own = [1]
    np.testing.assert_array_equal(got[0], points[0, own])
    np.testing.assert_array_equal(got[1], feet[0, own])
    np.testing.assert_array_equal(got[2], line[0, [4]] - line[0, [3]])
    assert got[3] == "cameras" and got[4] == NOISE.sensor and got[5].tolist() == [1]
    for changes in ({"markers": 0}, {"shape": NS(rope=False)}):
        other = NS(**{**vars(observed), **changes})
        assert verdict._seen_breadth(NS(observation=other), NOISE) is None
    observed.scene.recording.camera_positions = None
    assert verdict._seen_breadth(compared, NOISE) is None


@pytest.mark.parametrize(
    ("far", "rms", "perceived", "said"),
    [
        (0.0059, 0.001, 0.0, None),
        (0.0061, 0.001, 0.02, "frames 3 to 7 two cameras place the object 6 mm apart"),
        (0.0059, 0.0061, 0.0119, None),
        (0.0061, 0.0062, 0.0121, "clouds of the object are 12 mm apart"),
    ],
)
def test_cameras_are_blamed_where_they_disagree(far, rms, perceived, said):
    part = NS(scene=NS(recording=NS(cameras_apart=perceived)), noise=NOISE)
    compared = NS(cameras_apart=lambda: (far, 3, 7), rms=rms)
    faults = ["is its thickness right?", "other"]
    found = verdict._blamed_on_cameras(faults, part, compared)
    assert found == faults if said is None else said in found[0] and found[1:] == ["other"]
    alone = verdict._blamed_on_cameras([], part, compared)
    assert [f"are {1e3 * perceived:.0f} mm apart" in one for one in alone] == [True] * (
        perceived > 0.012
    )


def test_a_verdict_has_all_reasons_by_recording(monkeypatch):
    """In order: the recording, its fit, what is improbable; then those of all together."""
    weightless, parts = replace(ROPE, mass=None), []
    for k, name in enumerate(("", "second")):
        seen = recording(frames=3 + k, described=weightless)
        scene = NS(recording=seen, density=1e5)
        parts.append(NS(scene=scene, name=name, noise=NOISE, base="base", k=k))
    compared = [NS(cameras_apart=lambda: (0.0, 0, 0), rms=0.0, k=k) for k in range(2)]
    best = NS(compared=NS(parts=compared), vector="vector")
    found = NS(best=best, noise=["noise 0", "noise 1"])
    problem = NS(parts=parts, theta=lambda v, k: f"theta {k}", prior=NS(names=("E_over_rho",)))

    def of_fit(part, comparison, noise, theta):
        yield 1.0, 1.0, "not more than usable"
        yield 2.0, 1.0, f"fit {part.k} {comparison.k} {noise} {theta}"

    monkeypatch.setattr(verdict, "_of_fit", of_fit)
    monkeypatch.setattr(verdict, "_improbable", lambda p, v, k: iter([(2.0, 1.0, f"odd {v} {k}")]))
    every = lambda p, v, post, alone: iter([(2.0, 1.0, f"all {v} {post} {alone}")])  # noqa: E731
    monkeypatch.setattr(verdict, "_of_unknowns", every)
    said = verdict.judge(problem, found, "posterior", "alone")  # type: ignore[arg-type]
    assert said.reasons == (
        "3 of the 4 frames that a lift takes show points",
        "fit 0 0 noise 0 theta 0",
        "odd vector 0",
        "second: fit 1 1 noise 1 theta 1",
        "second: odd vector 1",
        "all vector posterior alone",
    )
    assert not said.usable
    assert verdict.refused_before(problem)
    elsewhere = lambda part, theta: iter([(theta == "base", 0.0, "lies elsewhere")])  # noqa: E731
    monkeypatch.setattr(verdict, "_at_rest", elsewhere)
    problem.parts = parts[1:]
    assert verdict.refused_before(problem)
    problem.prior.names = ("thickness",)
    assert not verdict.refused_before(problem)
    parts[1].scene.recording = recording()
    assert verdict.refused_before(problem)  # a mass that gives 100,000 kg/m^3
    problem.parts, compared[:] = [], []
    monkeypatch.setattr(verdict, "_of_unknowns", lambda *_: iter(()))
    assert verdict.judge(problem, found, "posterior", "alone").usable  # type: ignore[arg-type]
