"""Reports are one valid file each that asks nothing of the network, and that acts in a browser."""

import base64
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from gendom.sim import rope
from gendom.viz import Layer, object_layer, player, write_report
from gendom.viz.player import animation_data
from viz import made_up
from viz.made_up import action, content, estimate, lift, only, outcome

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


def test_whole_report(tmp_path):
    path = tmp_path / "report.html"
    write_report(path, content())
    source = path.read_text(encoding="utf-8")
    assert len(source) < 3_000_000
    page = Page(source)
    assert not re.search(r"https?:|//[a-z]+\.", re.sub(r"base64,[^\"]*", "", source))
    links = {a.removeprefix("#") for a in page.addresses if not a.startswith("data:image/")}
    assert links and links <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    (image,), start = page.images, "data:image/jpeg;base64,"
    assert image.startswith(start) and len(page.scenes) == 2
    with Image.open(io.BytesIO(base64.b64decode(image[len(start) :], validate=True))) as shown:
        assert shown.format == "JPEG" and shown.load()
    charts = "Points to simulated surface [mm]|E / density [m²/s²]|Poisson's ratio|Grip height [mm]"
    assert page.charts == charts.split("|")
    for text in (
        "Made by a simulator.",
        "1.834 kPa",
        "95 % interval",
        "1.763 to 1.907 kPa",
        "The lift does not determine this: the interval is mostly the prior.",
        "Assumed, not measured",
        "not determined",
        "121 mm",
        "−0.9 %",
        "lies inside the interval",
        "gendom demo",
        "takes away 80 % of the error",
        "20 times as narrow as the prior",
        # sizes have units, and nothing has more digits than anybody reads
        "rope, length 260 mm, diameter 12.3 mm",
        "3.9 mm",
        "time [s] 51.46",
        "12345678",
    ):
        assert text in page.words, text
    assert not re.search(r"\d\.\d{4,}[1-9]", page.words)
    assert list(tmp_path.iterdir()) == [path]
    assert source == content().html()


def test_what_is_not_usable_has_reasons_and_no_beliefs():
    found = estimate(reasons=["the gripper rests", "the clouds are <noise>"], mass=0.03)
    words = Page(only(estimate=found).html()).words
    assert "Not usable." in words and "the gripper rests" in words and "<noise>" in words
    assert "From the object's mass and size." in words and "mass 0.03 kg" in words
    for absent in ("Prior and posterior", "interval", "True value", "The action"):
        assert absent not in words
    words = Page(only(refused=["no frames with <points>"]).html()).words
    assert "Not usable." in words and "no frames with <points>" in words
    assert "The estimate" not in words
    # goals in the plane and a worse policy that is not praised
    plane = [outcome([0.3, 0.2 + z], [0.33, 0.24 + z], [0.31, 0.2 + z]) for z in (0.0, 0.1)]
    page = Page(only(action=action(*plane)).html())
    assert page.words.count("50.0 mm") == 5  # of each goal, in the mean, in words, at the top
    assert "here the estimate did not help" in page.words


def test_all_text_is_escaped():
    bad = "<script>alert('&')</script>\""
    texts = ("title", "summary", "command", "recording_source", "cameras_note", "lift_note")
    clouds = lift(2, more=[Layer(name=bad, color="#000000", points=[np.zeros((1, 3))])])
    made = action(goal_name=bad, action_names=(bad, bad), motion=clouds, motion_note=bad)
    report = content(
        **dict.fromkeys(texts, bad),
        lift=clouds,
        estimate=estimate(reasons=[bad], notes=[bad], **dict.fromkeys(("method", "device"), bad)),
        action=made,
        next_steps=[(bad, bad)],
    )
    source = report.html()
    assert "<script>alert" not in source
    assert Page(source).words.count(bad) >= 17


def test_a_player_holds_what_it_names(monkeypatch):
    monkeypatch.setattr(player, "_FRAMES", 3)
    lines = np.linspace(0.0, 0.9, 2 * 2 * 3).reshape(2, 2, 3)
    arm = Layer(name="arm", color="#888888", points=[lines], radius=np.array([0.03, 0.05]))
    made = lift(frames=5, recorded=40, simulated=50_000, more=[arm])
    text = json.dumps(animation_data(made))
    found = json.loads(text)
    simulated, recorded, _, arm = found["layers"]
    assert found["times"] == pytest.approx([0.0, 0.2, 0.4])
    assert found["frames"] == [1, 3, 5] and found["of"] == 5
    points = np.reshape(recorded["frames"][1], (-1, 3))
    assert 1e-4 * points == pytest.approx(made.layers[1].at(2), abs=5.1e-5)
    assert len(simulated["frames"][0]) > 3 * 5_000 and len(text) < 1_000_000
    assert arm["radius"] == [300, 500] and len(arm["frames"]) == 1
    assert np.reshape(arm["frames"][0], (2, 2, 3)) == pytest.approx(1e4 * lines, abs=0.5)
    assert np.max(found["box"], axis=0)[2] == 9000


# ---- in a browser --------------------------------------------------------------------------------


FRAMES = 20


@pytest.fixture(autouse=True)
def silent(browser):
    """Whatever a test does, nothing is logged or asked for."""
    browser.logged.clear()
    browser.requested.clear()
    yield
    assert browser.logged == [] and browser.requested == []


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """All that a report can hold."""
    ends = np.tile([[[0, 0, 0], [0.1, 0, 0.4]], [[0.1, 0, 0.4], [0.3, 0, 0.2]]], (FRAMES, 1, 1, 1))
    arm = Layer(name="arm", color="#888888", points=ends, radius=np.array([0.05, 0.03]))
    goal = Layer(name="goal", color="#009E73", points=[np.array([[0.5, 0.0, 0.1]])], radius=0.01)
    tube = rope(diameter=0.02, length=0.3, start=(0.3, 0.05, 0.1))
    skin = object_layer("skin", tube, tube.points[None])
    content = made_up.content(
        lift=made_up.lift(FRAMES),
        estimate=made_up.estimate(rms_by_frame=[0.002] * FRAMES),
        action=made_up.action(motion=made_up.lift(FRAMES, more=[arm, goal, skin])),
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, content)
    return path


def drawn(browser, viewer):
    """What its canvas shows, as text."""
    browser.settle()
    return browser.evaluate(f"document.querySelector('#{viewer} canvas').toDataURL()")


@pytest.mark.parametrize(("width", "dark"), [(390, False), (800, True), (1280, False)])
def test_it_fits_and_is_silent(browser, report, width, dark):
    browser.open(report, width=width, dark=dark)
    browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    browser.settle()
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    # tables have no scroll bars of their own either
    wide = "[...document.querySelectorAll('.scroll')].filter((t) => t.scrollWidth > t.clientWidth)"
    assert browser.evaluate(f"{wide}.length") == 0
    colour = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (colour == "rgb(255, 255, 255)") is not dark


def test_the_player_shows_the_frame_that_is_asked_for(browser, report):
    browser.open(report, width=1280)
    for viewer in ("lift", "motion"):
        output = f"document.querySelector('#{viewer} output').textContent"
        seen = set()
        for frame in (0, FRAMES - 1):
            browser.act(f"#{viewer} input.time", f"value = {frame}")
            assert f"frame {frame + 1} of {FRAMES}" in browser.evaluate(output)
            seen.add(drawn(browser, viewer))
        assert len(seen) == 2
    browser.act("#lift input.time", "value = 0")
    button = "document.querySelector('#lift button.play')"
    frame = "Number(document.querySelector('#lift input.time').value)"
    browser.evaluate(f"{button}.click()")
    browser.until(f"{frame} > 0 && {button}.textContent === 'Pause'")
    browser.evaluate(f"{button}.click()")
    stood = browser.evaluate(frame)
    browser.evaluate("new Promise((done) => setTimeout(done, 300))")
    assert browser.evaluate(frame) == stood


def test_layers_go_and_come_back(browser, report):
    browser.open(report, width=800)
    before = drawn(browser, "motion")
    for layer in ("recorded", "simulated", "gripper", "arm", "goal", "skin"):
        box = f"#motion input[aria-label={layer}]"
        browser.act(box, "checked = false")
        assert drawn(browser, "motion") != before, layer
        browser.act(box, "checked = true")
        assert drawn(browser, "motion") == before
    # dragging turns the view
    before = drawn(browser, "lift")
    browser.evaluate("document.querySelector('#lift canvas').scrollIntoView({behavior: 'instant'})")
    box = "document.querySelector('#lift canvas').getBoundingClientRect()"
    x, y = (
        browser.evaluate(f"{box}.{a} + {box}.{n} / 2") for a, n in (("x", "width"), ("y", "height"))
    )
    for kind, across in (("mousePressed", 0), ("mouseMoved", 60), ("mouseReleased", 60)):
        held = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": 1}
        browser.call("Input.dispatchMouseEvent", type=kind, x=x + across, y=y, **held)
    assert drawn(browser, "lift") != before
