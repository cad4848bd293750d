"""A report in a real browser: what it logs and loads, whether it fits, whether its controls act."""

import numpy as np
import pytest

from gendom.sim import rope
from gendom.viz import Layer, object_layer, write_report
from viz import made_up

FRAMES = 20


@pytest.fixture(autouse=True)
def silent(browser):
    """Whatever a test does, nothing is logged or asked for."""
    yield
    assert browser.logged == [] and browser.requested == []


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """All that a report can hold."""
    ends = np.zeros((FRAMES, 2, 2, 3))
    ends[:, 0, 1] = ends[:, 1, 0] = [0.1, 0.0, 0.4]
    ends[:, 1, 1] = [0.3, 0.0, 0.2]
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


def test_the_slider_moves_the_view(browser, report):
    browser.open(report, width=1280)
    for viewer in ("lift", "motion"):
        output = f"document.querySelector('#{viewer} output').textContent"
        seen = set()
        for frame in (0, FRAMES - 1):
            browser.act(f"#{viewer} input.time", f"value = {frame}")
            assert f"frame {frame + 1} of {FRAMES}" in browser.evaluate(output)
            seen.add(drawn(browser, viewer))
        assert len(seen) == 2


def test_play_goes_on_until_pause(browser, report):
    browser.open(report, width=800)
    browser.act("#lift input.time", "value = 0")
    button = "document.querySelector('#lift button.play')"
    frame = "Number(document.querySelector('#lift input.time').value)"
    browser.evaluate(f"{button}.click()")
    browser.until(f"{frame} > 0")
    assert browser.evaluate(f"{button}.textContent") == "Pause"
    browser.evaluate(f"{button}.click()")
    assert browser.evaluate(f"{button}.textContent") == "Play"
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
    browser.open(report, width=800)
    before = drawn(browser, "lift")
    browser.evaluate("document.querySelector('#lift canvas').scrollIntoView({behavior: 'instant'})")
    x, y = browser.evaluate(
        "(() => { const b = document.querySelector('#lift canvas').getBoundingClientRect();"
        "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    for kind, across in (("mousePressed", 0), ("mouseMoved", 60), ("mouseReleased", 60)):
        held = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": 1}
        browser.call("Input.dispatchMouseEvent", type=kind, x=x + across, y=y, **held)
    assert drawn(browser, "lift") != before
