"""The viewer without a recording: what it shows, when it simulates, its server and its files."""

import contextlib
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.viz import Animation, Layer
from gendom.viz.player import encode_page
from gendom.viz.viewer.sliders import MATERIAL, SliderParameter, ViewerModel
from viz.browser import Browser

ARROW = {"key": "ArrowRight", "code": "ArrowRight", "windowsVirtualKeyCode": 39}
"""A key, as the browser's protocol describes it."""

TIMES = np.array([0.0, 0.1, 0.3, 0.6])

STICK = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]])


def square(height=0.0):
    """Two triangles that rise from a height on [m]."""
    corners = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.2, 0.0], [0.0, 0.2, 0.0]])
    rise = (height + 0.1 * TIMES)[:, None, None] * [0.0, 0.0, 1.0]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Layer(name="simulated", color="#E69F00", points=list(corners + rise), faces=faces)


def cloud():
    """Points around the square, and a stray one."""
    rng = np.random.default_rng(0)
    points = [rng.uniform(size=(500, 3)) * [0.4, 0.2, 0.1] for _ in TIMES]
    points[0][0] = [9.0, 9.0, 9.0]
    return Layer(name="recorded", color="#0072B2", points=points, radius=0.002)


class Square(ViewerModel):
    """A model whose square lies as high as its slider says."""

    title = "a square"
    notes = ("It is flat.",)
    initial: Animation = Animation(times=TIMES, layers=(cloud(),), table_height=0.0)

    def __init__(self, seconds=0.0):
        self.seconds, self.fault = seconds, None
        self.simulated = []
        height = SliderParameter(
            name="height", label="height", unit="m", meaning="of the square", group=MATERIAL,
            ends=(0.0, 0.1), value=0.0,
        )  # fmt: skip
        E = replace(height, name="E", label="E", ends=(1.0, 1e4), value=123.0, log=True)
        self.parameters = height, E

    def simulate(self, values, go_on):
        if self.fault:
            raise self.fault
        if values["height"] > 0.09:
            raise GendomError("is too high", where="height")
        until = time.monotonic() + self.seconds
        while time.monotonic() < until:
            go_on()
            time.sleep(0.005)
        self.simulated.append(values)
        stick = Layer(name="stick", color="#000000", points=[STICK], radius=0.003)
        layers = (cloud(), square(values["height"]), stick)
        shown = {"times": TIMES, "layers": layers, "table_height": 0.0}
        yield Animation(**shown)
        yield Animation(**shown, distance=("Chamfer", values["height"] + 1e-3 * TIMES))


def test_scenes_know_their_frames_and_their_box():
    """A frame lasts until the next; stray points do not count."""
    scene = Animation(times=TIMES, layers=(cloud(), square(0.2)))
    assert [scene.frame_at(t) for t in (-1.0, 0.0, 0.09, 0.1, 0.59, 5.0)] == [0, 0, 0, 1, 2, 3]
    np.testing.assert_allclose(scene.box, [[0.0, 0.0, 0.0], [0.4, 0.2, 0.26]], atol=0.005)
    with pytest.raises(GendomError, match="no points at all"):
        _ = Animation(times=TIMES, layers=()).box
    # logarithmic parameters have logarithmic sliders
    height, E = Square().parameters
    assert E.position(100.0) == pytest.approx(2.0) and E.at(2.0) == pytest.approx(100.0)
    assert E.range == (0.0, 4.0, 0.02) and E.at(E.start) == 123.0
    assert height.text(0.02) == "height 20 mm" and height.range[:2] == (0.0, 0.1)


# ---- simulating again ----------------------------------------------------------------------------


@pytest.fixture
def viewer():
    """Of the square, on any port."""
    pytest.importorskip("viser", reason="needs viser (the extra viz)")
    from gendom.viz.viewer.server import Viewer

    with contextlib.closing(Viewer(Square(), port=0)) as made:
        assert made.wait(10.0)
        yield made


def move(viewer, name, value):
    """Move a parameter's slider, as a hand would."""
    viewer._sliders[name].value = viewer._parameters[name].position(value)


def test_the_last_wish_wins(viewer):
    """Those in between are never simulated; long simulations are given up, and not waited for."""
    model = viewer._model
    model.seconds = 0.1
    for height in (0.01, 0.02, 0.03, 0.04):
        move(viewer, "height", height)
    assert viewer.wait(10.0)
    assert model.simulated[-1]["height"] == pytest.approx(0.04) and len(model.simulated) <= 3
    assert viewer._scene.distance[1][0] == pytest.approx(0.04)
    model.simulated.clear()
    model.seconds = 30.0
    move(viewer, "height", 0.01)
    time.sleep(0.05)
    model.seconds = 0.0
    move(viewer, "height", 0.02)
    assert viewer.wait(6.0)
    assert model.simulated == [{"height": 0.02, "E": 123.0}]
    assert viewer._status_text.startswith("simulated in ")
    model.seconds = 30.0
    move(viewer, "height", 0.01)
    assert not viewer.wait(0.2)
    began = time.monotonic()
    viewer.close()
    assert time.monotonic() - began < 2.0


def test_faults_are_told_and_the_next_wish_is_served(viewer, caplog):
    """The last scene stays until there is another."""
    before = viewer._scene
    for height, fault, said in (
        (0.095, None, "height: is too high"),
        (0.01, KeyError("height"), "internal error: KeyError: 'height'"),  # of the program
    ):
        viewer._model.fault = fault
        move(viewer, "height", height)
        assert viewer.wait(5.0)
        assert viewer._status_text == said and viewer._scene is before
    viewer._model.fault = None
    move(viewer, "height", 0.05)
    assert viewer.wait(5.0) and viewer._status_text.startswith("simulated in ")
    assert viewer._scene.distance[1][0] == pytest.approx(0.05)


def test_parameters_are_reset(viewer):
    """What nobody moved keeps all its digits."""
    move(viewer, "height", 0.04)
    assert viewer.wait(10.0)
    assert viewer._model.simulated[-1] == {"height": 0.04, "E": 123.0}
    move(viewer, "E", 1000.0)
    assert viewer.wait(10.0)
    assert viewer._model.simulated[-1]["E"] == pytest.approx(1000.0)
    viewer.reset()
    assert viewer.wait(10.0)
    assert viewer._model.simulated[-1] == {"height": 0.0, "E": 123.0}


def test_only_this_machine_reaches_it(viewer, capfd):
    """On the next port where one is taken. Nothing is printed, and no thread stays."""
    from gendom.viz.viewer.server import Viewer

    socket.create_connection(("127.0.0.1", viewer.port), timeout=5.0).close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", viewer.port), timeout=1.0)
    with contextlib.closing(Viewer(Square(), port=viewer.port)) as second:
        assert second.port > viewer.port
    with pytest.raises(GendomError, match="port: is 70000"):
        Viewer(Square(), port=70000)
    viewer.close()
    assert capfd.readouterr().out == ""
    assert not [t for t in threading.enumerate() if t.name.startswith(("player", "simulation"))]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """One that draws with WebGL, in software."""
    opened = Browser(tmp_path_factory.mktemp("profile"), webgl=True)
    yield opened
    opened.close()


def until(browser, expression, seconds=60.0):
    """The value of an expression once it is something."""
    ends = time.monotonic() + seconds
    while not (value := browser.evaluate(expression)):
        assert time.monotonic() < ends, expression
        time.sleep(0.1)
    return value


def test_a_page_plays_by_itself(browser, tmp_path):
    path = tmp_path / "square.html"
    path.write_text(encode_page(Square().complete(), "a square"), encoding="utf-8")
    browser.open(path, width=500, height=700)
    for name in ("recorded", "simulated", "stick", "Chamfer"):
        assert browser.evaluate(f"document.body.textContent.includes({name!r})")
    assert browser.errors == []
    assert [a for a in browser.requested if not a.startswith("file:")] == []


@pytest.mark.slow
def test_the_page_shows_and_obeys(viewer, browser, capfd):
    """It is drawn without errors, asks for nothing from elsewhere, and its sliders act."""
    browser.open(viewer.url + "/", width=600, height=300, scale=0.1)
    text = "document.body.textContent"
    for said in ("a square", "It is flat.", "Chamfer", "recorded", "Reset parameters"):
        until(browser, f"{text}.includes({said!r})")
    until(browser, "document.querySelector('canvas') !== null")
    assert browser.evaluate("document.documentElement.scrollWidth") <= 600
    viewer._time.value = 0
    for slider, moved in (
        (0, lambda: viewer._time.value == 1),
        (1, lambda: viewer._model.simulated[1:]),
    ):
        thumb = f"document.querySelectorAll('[role=slider]')[{slider}]"
        until(browser, f"{thumb}.getAttribute('aria-valuenow') === '0'")
        browser.evaluate(f"{thumb}.focus()")
        for kind in ("rawKeyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, **ARROW)
        ends = time.monotonic() + 20.0
        while not moved():
            assert time.monotonic() < ends, slider
            browser.settle()
    # the box beside a logarithmic slider has the value itself, in both directions
    boxes = "[...document.querySelectorAll('input')].filter(i => i.offsetParent !== null)"
    values = f"{boxes}.map(i => i.value)"
    until(browser, f"{values}.includes('123000')")
    assert browser.evaluate(f"!{values}.some(v => v.startsWith('2.08'))")
    viewer._boxes["E"].value = 456e3  # in mm
    until(browser, f"{values}.includes('456000')")
    assert viewer._value("E") == pytest.approx(456.0)
    assert browser.errors == []
    assert [a for a in browser.requested if not a.startswith((viewer.url, "blob:"))] == []
    assert capfd.readouterr().out == ""


ASKED = [
    (None, None, True),  # no browser: those always say where a page is from
    ("http://{own}", None, True),
    ("http://localhost:9000", "localhost:9000", True),  # behind a tunnel
    ("http://evil.example", None, False),
    ("http://127.0.0.1:1", None, False),  # another server of this machine
    ("https://{own}", None, False),
    ("null", None, False),
    ("http://{own}.evil.example", None, False),
    ("http://evil.example", "evil.example", False),  # a name that was made to lead here
    (None, "evil.example", False),
    (None, "127.0.0.1.evil.example:80", False),
    (None, "[", False),
]
"""Origin and host of requests, and whether they are served."""


def test_only_its_own_page_opens_a_socket(viewer):
    own = f"127.0.0.1:{viewer.port}"
    for origin, host, served in ASKED:
        lines = [
            "GET / HTTP/1.1", f"Host: {host or own}", "Upgrade: websocket", "Connection: Upgrade",
            "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Protocol: viser-v0",
        ]  # fmt: skip
        lines += [f"Origin: {origin.format(own=own)}"] if origin else []
        with socket.create_connection(("127.0.0.1", viewer.port), timeout=5.0) as asked:
            asked.sendall("\r\n".join([*lines, "", ""]).encode())
            answer = asked.recv(12).decode()
        assert answer.endswith("101" if served else "403"), (origin, host)
