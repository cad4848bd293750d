"""A report in a real browser: what it logs and loads, whether it fits, whether its controls act."""

import numpy as np
import pytest

from gendom.viz import CloudSequence, write_report
from viz import made_up
from viz.browser import Browser

FRAMES = 20


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """The browser, which takes a second to start."""
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


@pytest.fixture
def browser(started):
    """Whatever a test does, nothing is logged or asked for."""
    yield started
    assert started.logged == [] and started.requested == []


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """All that a report can hold."""
    arm = np.zeros((FRAMES, 2, 2, 3))
    arm[:, 0, 1] = arm[:, 1, 0] = [0.1, 0.0, 0.4]
    arm[:, 1, 1] = made_up.lift(FRAMES)["gripper"][:, 0]
    held = {"arm": arm, "arm_radius": np.array([0.05, 0.03])}
    motion = CloudSequence(
        **made_up.lift(FRAMES, chamfer=None),
        **held,
        goal=np.array([[0.5, 0.0, 0.1]]),
        labels=("carried out", "predicted"),
    )
    content = made_up.content(
        lift=CloudSequence(**made_up.lift(FRAMES), **held),
        estimate=made_up.estimate(rms_by_frame=[0.002] * FRAMES),
        action=made_up.action(motion=motion),
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, content)
    return path


def drawn(browser, viewer):
    """What its canvas shows, as text."""
    browser.settle()
    return browser.evaluate(f"document.querySelector('#{viewer} canvas').toDataURL()")


def act(browser, element, change, event="input"):
    """Change an element and say so, as a hand would."""
    browser.evaluate(
        f"(() => {{ const e = document.querySelector('{element}'); e.{change};"
        f"e.dispatchEvent(new Event('{event}', {{bubbles: true}})); }})()"
    )
    browser.settle()


@pytest.mark.parametrize(("width", "dark"), [(390, False), (800, True), (1280, False)])
def test_it_fits_and_is_silent(browser, report, width, dark):
    browser.open(report, width=width, dark=dark)
    browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    browser.settle()
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    # tables have no scroll bars of their own either
    wide = "[...document.querySelectorAll('.scroll')].filter((t) => t.scrollWidth > t.clientWidth)"
    assert browser.evaluate(f"{wide}.length") == 0
    light = browser.evaluate("getComputedStyle(document.body).backgroundColor") == (
        "rgb(255, 255, 255)"
    )
    assert light is not dark


@pytest.mark.parametrize("viewer", ["lift", "motion"])
def test_the_slider_moves_the_view(browser, report, viewer):
    browser.open(report, width=1280)
    output = f"document.querySelector('#{viewer} output').textContent"
    seen = []
    for frame in (0, FRAMES - 1):
        act(browser, f"#{viewer} input.time", f"value = {frame}")
        assert f"frame {frame + 1} of {FRAMES}" in browser.evaluate(output)
        seen.append(drawn(browser, viewer))
    assert seen[0] != seen[1]


def test_play_goes_on_until_pause(browser, report):
    browser.open(report, width=800)
    act(browser, "#lift input.time", "value = 0")
    browser.evaluate("document.querySelector('#lift button.play').click()")
    frame = "Number(document.querySelector('#lift input.time').value)"
    playing = (
        "new Promise((done, fail) => { setTimeout(() => fail('it stands'), 20000);"
        f"const look = () => {frame} > 0 ? done(true) : requestAnimationFrame(look); look(); }})"
    )
    assert browser.evaluate(playing)
    label = "document.querySelector('#lift button.play').textContent"
    assert browser.evaluate(label) == "Pause"
    browser.evaluate("document.querySelector('#lift button.play').click()")
    assert browser.evaluate(label) == "Play"
    stood = browser.evaluate(frame)
    browser.evaluate("new Promise((done) => setTimeout(done, 300))")
    assert browser.evaluate(frame) == stood


def test_layers_go_and_come_back_and_clouds_fade(browser, report):
    browser.open(report, width=800)
    before = drawn(browser, "motion")
    for layer in ("recorded", "simulated", "arm", "goal"):
        box = f"#motion input[data-layer={layer}]"
        act(browser, box, "checked = false")
        assert drawn(browser, "motion") != before, layer
        act(browser, box, "checked = true")
        assert drawn(browser, "motion") == before
    pictures = [before]
    for fade in (-1, 1):
        act(browser, "#motion input.fade", f"value = {fade}")
        pictures.append(drawn(browser, "motion"))
    assert len(set(pictures)) == 3
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
