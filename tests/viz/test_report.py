"""Reports are one valid file each that asks nothing of the network."""

import base64
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from gendom.errors import GendomError
from gendom.viz import (
    ActionSummary,
    CloudSequence,
    EstimateSummary,
    LiftPictures,
    Provenance,
    ReachOutcome,
    ReportContent,
    write_report,
)
from gendom.viz.report import lift as lift_section
from gendom.viz.report.action import WITH, WITHOUT
from gendom.viz.report.content import render_report
from gendom.viz.report.lift import encode_scene
from viz import made_up
from viz.made_up import content, estimate, outcomes, run

VOID = {"meta", "img", "input", "br", "link", "hr"}


class Page(HTMLParser):
    """Collects text, images and addresses, and checks that every element is closed."""

    def __init__(self, source):
        super().__init__()
        self.open, self.text, self.images, self.addresses, self.ids = [], [], [], [], []
        self.charts, self.scenes = [], []
        self.feed(source)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.addresses += [v for k, v in attrs if k in ("src", "href", "srcset", "action", "data")]
        if tag == "svg" and "aria-label" in attributes:
            self.charts.append(attributes["aria-label"])
        if "id" in attributes:
            self.ids.append(attributes["id"])
        if tag == "img":
            assert attributes["alt"]
            self.images.append(attributes["src"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.text.append(data)
        elif data.startswith("{"):
            self.scenes.append(json.loads(data))

    @property
    def words(self):
        return re.sub(r"\s+", " ", " ".join(self.text))


def test_whole_report(make_lift, tmp_path):
    path = tmp_path / "report.html"
    write_report(path, content(make_lift()))
    source = path.read_text(encoding="utf-8")
    assert len(source) < 3_000_000
    page = Page(source)
    assert not re.search(r"https?:|//[a-z]+\.", re.sub(r"base64,[^\"]*", "", source))
    links = {a.removeprefix("#") for a in page.addresses if not a.startswith("data:image/")}
    assert links and links <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert [decode(image) for image in page.images] == ["jpeg"] and len(page.scenes) == 1
    assert page.charts == [
        "Chamfer distance of both clouds [mm]",
        "Distance of the clouds from the fit [mm]",
        "Young's modulus [kPa]",
        "Paths of the rope's tip: height [m]",
    ]
    for text in (
        "Made by a simulator.",
        "1.834 kPa",
        "95 % interval",
        "1.790 to 1.902 kPa",
        "The lift does not determine this: the interval is mostly the prior.",
        "Assumed, not measured",
        "not determined",
        "113 mm",
        "−0.9 %",
        "lies inside the interval",
        "gendom demo",
        "all 7",
        "takes away 80 % of the error",
    ):
        assert text in page.words, text
    assert list(tmp_path.iterdir()) == [path]


def decode(address):
    """The kind of an image in a data address, after a look inside."""
    match = re.fullmatch(r"data:image/([a-z]+);base64,(.+)", address)
    assert match
    with Image.open(io.BytesIO(base64.b64decode(match[2], validate=True))) as image:
        image.load()
        assert image.format == match[1].upper()
    return match[1]


def test_numbers_are_for_people():
    """Sizes have units, and nothing is given to more digits than anybody reads."""
    described = {"kind": "rope", "length": 0.28, "diameter": 0.0123456789, "mass": 0.03008389125}
    described |= {"width": None}
    numbers = {"rms": 0.00385042488550871, "seconds": 51.45626372600009, "seed": 12345678}
    summary = EstimateSummary(values=estimate(object=described, **numbers))
    made = Provenance(stage_seconds={"estimate": 51.45626372600009})
    page = Page(render_report(ReportContent(title="Plain", estimate=summary, provenance=made)))
    for text in (
        "rope, length 280 mm, diameter 12.3 mm, mass 0.03008 kg",
        "3.9 mm",
        "time [s] 51.46",
        "12345678",
    ):
        assert text in page.words, text
    assert not re.search(r"\d\.\d{4,}[1-9]", page.words.replace("0.03008", ""))


def test_same_content_same_bytes(make_lift):
    first, second = (render_report(content(make_lift(frames=3))) for _ in range(2))
    assert first == second


def test_beliefs_stand_beside_what_was_found():
    """95 % intervals in the unknowns' units, cut at what was searched."""
    summary = EstimateSummary(values=estimate(posterior=made_up.POSTERIOR, bounds={}))
    page = render_report(ReportContent(title="Beliefs", estimate=summary))
    words = Page(page).words
    for text in (
        "Specific modulus E / ρ [m²/s²] 500 to 5e+04 1.76e+03 to 1.91e+03",
        "Grip height [mm] −3.92 to 3.92 0.804 to 1.2",
    ):
        assert text in words, text
    assert "150 times as narrow as the prior" in words and "20 times as narrow" in words
    assert Page(page).charts.count("Specific modulus E / ρ [m²/s²]") == 1


def test_a_search_has_a_line_for_each_stage_of_each_start():
    entries = [
        {"start": start, "stage": stage, "iteration": k, "loss": 0.01 / k, "E": 1e3}
        for start, stage, first in ((0, "coarse", 1), (0, "fine", 4), (1, "coarse", 1))
        for k in range(first, first + 3)
    ]
    summary = EstimateSummary(values=estimate(history=entries))
    words = Page(render_report(ReportContent(title="S", estimate=summary))).words
    for label in ("start 1, coarse", "start 1, fine", "start 2, coarse"):
        assert words.count(label) == 2, label  # of the distance and of E
    assert "start 2, fine" not in words


def test_distances_over_time_are_drawn(make_lift):
    """Where the clouds are those of the frames that were compared."""
    clouds = CloudSequence(**make_lift(frames=4))
    counts = []
    for rms in ([0.001] * 4, [0.001] * 3):
        summary = EstimateSummary(values=estimate(rms_by_frame=rms))
        report = ReportContent(title="R", lift=LiftPictures(clouds=clouds), estimate=summary)
        counts.append(len(Page(render_report(report)).charts))
    assert counts[0] == counts[1] + 1


def test_what_is_not_usable_has_reasons_and_no_beliefs():
    verdict = {"usable": False, "reasons": ["the gripper rests", "the clouds are <noise>"]}
    summary = EstimateSummary(
        values=estimate(verdict=verdict, intervals=None, posterior=made_up.POSTERIOR)
    )
    page = render_report(ReportContent(title="Verdict", estimate=summary))
    words = Page(page).words
    assert "Not usable." in words and "the gripper rests" in words and "<noise>" in words
    assert "Prior and posterior" not in words and "interval" not in words


def test_missing_parts_are_left_out():
    page = Page(render_report(ReportContent(title="Nothing")))
    assert page.images == page.charts == [] and "The action" not in page.words
    bare = EstimateSummary(values={"E": 2e6, "nu": 0.3})
    page = Page(render_report(ReportContent(title="Bare", estimate=bare)))
    assert "2 MPa" in page.words
    for absent in ("interval", "True value", "Density", "Distance", "erdict", "usable"):
        assert absent not in page.words


def test_one_goal_one_policy_and_a_goal_in_the_plane(make_lift):
    one = ActionSummary(outcomes=[ReachOutcome(goal=np.array([0.3]), runs={WITH: run([0.31])})])
    page = Page(render_report(ReportContent(title="One", action=one)))
    assert "ithout parameters" not in page.words and "10.0 mm" in page.words
    assert page.charts == ["Paths of the rope's tip: height [m]"]
    plane = [
        ReachOutcome(goal=np.array([0.3, 0.2 + dz]), runs={WITH: run([0.33, 0.24 + dz])})
        for dz in (0.0, 0.1)
    ]
    page = Page(render_report(ReportContent(title="Plane", action=ActionSummary(outcomes=plane))))
    assert page.words.count("50.0 mm") == 4  # of each goal, in the mean, and at the top


def test_a_worse_policy_is_not_praised():
    worse = ReachOutcome(goal=np.array([0.3]), runs={WITH: run([0.35]), WITHOUT: run([0.31])})
    source = render_report(ReportContent(title="Worse", action=ActionSummary(outcomes=[worse])))
    assert "here the estimate did not help" in source


def test_all_text_is_escaped(make_lift):
    bad = "<script>alert('&')</script>\""
    report = content(
        make_lift(frames=2),
        title=bad,
        summary=bad,
        recording_source=bad,
        lift=LiftPictures(clouds=CloudSequence(**make_lift(frames=2)), note=bad),
        estimate=EstimateSummary(
            values=estimate(method=bad, device=bad, seed=bad, object={"kind": bad, bad: 1.0})
        ),
        action=ActionSummary(outcomes=outcomes(), goal_name=bad, action_names=(bad, bad)),
        provenance=Provenance(
            commands=(bad,),
            date=bad,
            device=bad,
            seeds={bad: 1},
            stage_seconds={bad: 1.0},
            warnings=(bad,),
        ),
        next_steps=[(bad, bad)],
    )
    source = render_report(report)
    assert "<script>alert" not in source
    assert Page(source).words.count(bad) >= 20


def test_scene_holds_the_points_it_names(make_lift, monkeypatch):
    lift = make_lift(frames=5, recorded=40, simulated=50_000)
    monkeypatch.setattr(lift_section, "_FRAMES", 3)
    scene = json.loads(encode_scene(CloudSequence(**lift)))
    data = base64.b64decode(scene["points"])
    points = np.frombuffer(data, dtype="<u2").reshape(-1, 3) / 65535.0
    low, high = np.array(scene["low"]), np.array(scene["high"])
    points = low + points * (high - low)
    simulated, recorded = scene["clouds"]
    assert recorded["offsets"][-1] == len(points)
    assert len(data) <= 420_000
    assert scene["times"] == pytest.approx([0.0, 0.2, 0.4])
    kept = points[recorded["offsets"][1] : recorded["offsets"][2]]
    inside = ((lift["recorded"][2] > low) & (lift["recorded"][2] < high)).all(axis=1)
    assert kept[inside] == pytest.approx(lift["recorded"][2][inside], abs=1e-5)
    assert np.diff(simulated["offsets"]).min() > 10_000


def test_scene_holds_arm_and_goal(make_lift, monkeypatch):
    arm = np.linspace(0.0, 0.4, 5 * 2 * 2 * 3).reshape(5, 2, 2, 3)
    goal = np.array([[0.9, 0.0, 0.2]])
    held = {"arm": arm, "arm_radius": np.array([0.03, 0.05]), "goal": goal}
    monkeypatch.setattr(lift_section, "_FRAMES", 2)
    scene = json.loads(encode_scene(CloudSequence(**make_lift(frames=5), **held)))
    assert scene["arm"]["radius"] == [30, 50] and len(scene["arm"]["ends"]) == 2
    assert np.reshape(scene["arm"]["ends"][1], (2, 2, 3)) == pytest.approx(1e3 * arm[4], abs=0.5)
    assert scene["goal"] == goal.tolist() and scene["high"][0] == 0.9
    assert scene["frames"] == [1, 5] and scene["of"] == 5


def test_what_could_not_be_estimated_says_why():
    refused = ReportContent(title="R", refused=["no frames with <points>"])
    words = Page(render_report(refused)).words
    assert "Not usable." in words and "no frames with <points>" in words


def test_failure_keeps_the_old_file(make_lift, tmp_path):
    path = tmp_path / "report.html"
    path.write_text("old")
    lift = LiftPictures(clouds=CloudSequence(**make_lift(frames=2)), view="nowhere")
    with pytest.raises(GendomError, match="view: is 'nowhere'"):
        write_report(path, content(make_lift(frames=2), lift=lift))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_viz_needs_neither_estimation_nor_policies(run_python):
    code = (
        "import sys, gendom.viz; "
        "print(*sorted(m for m in sys.modules if m.startswith('gendom.') or m == 'torch' "
        "or m == 'warp' or m == 'matplotlib'))"
    )
    found = {".".join(name.split(".")[:2]) for name in run_python(code).split()}
    own = {"gendom.arguments", "gendom.errors", "gendom.files", "gendom.installation"}
    assert found == own | {"gendom.materials", "gendom.plugins", "gendom.shown", "gendom.viz"}
