"""The viewer without a recording: what it shows, when it simulates, whom it answers."""

import contextlib
import http.client
import json
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.materials.unknowns import UNKNOWNS
from gendom.viz import Animation, Layer
from gendom.viz.viewer import Slider, Viewer, ViewerModel

TIMES = np.array([0.0, 0.1, 0.3, 0.6])

STICK = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]])
CORNERS = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.2, 0.0], [0.0, 0.2, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def square(height=0.0):
    """Two triangles that rise from a height on [m]."""
    rise = (height + 0.1 * TIMES)[:, None, None] * [0.0, 0.0, 1.0]
    return Layer(name="simulated", color="#E69F00", points=list(CORNERS + rise), faces=FACES)


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
        height = replace(UNKNOWNS["grip_height"], name="height", symbol="height", material=True)
        E = replace(UNKNOWNS["E_over_rho"], name="E", symbol="E", unit="Pa")
        self.sliders = (
            Slider(unknown=height, ends=(0.0, 0.1), value=0.0),
            Slider(unknown=E, ends=(1.0, 1e4), value=123.0),
        )

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


# ---- simulating again ----------------------------------------------------------------------------


@pytest.fixture
def viewer():
    """Of the square, on any port."""
    with contextlib.closing(Viewer(Square(), port=0)) as made:
        threading.Thread(target=made.serve_forever, args=(0.02,), daemon=True).start()
        yield made
        made.shutdown()


def answer(viewer, method, path, body=None, head=None):
    asked = http.client.HTTPConnection("127.0.0.1", viewer.port, timeout=20.0)
    asked.request(method, path, body, head or {})
    return asked.getresponse()


def ask(viewer, height):
    """What a page gets that asks for values."""
    found = answer(viewer, "POST", "/simulate", json.dumps({"height": height, "E": 123.0}))
    return [json.loads(line) for line in found.read().splitlines()]


def test_a_wish_gets_the_motion_and_then_its_distance(viewer):
    first, second = ask(viewer, 0.04)
    assert first["scene"]["distance"] is None and first["said"].startswith("simulated in 0.0")
    assert second["scene"]["distance"] == ["Chamfer", pytest.approx(0.04 + 1e-3 * TIMES)]
    assert [of["name"] for of in second["scene"]["layers"]] == ["recorded", "simulated", "stick"]
    assert viewer._model.simulated == [{"height": 0.04, "E": 123.0}]


def test_the_last_wish_wins(viewer):
    """A simulation is given up for a newer one, and when the viewer ends."""
    model = viewer._model
    for ends in (lambda: ask(viewer, 0.02), viewer.close):
        model.seconds, left = 30.0, []
        long = threading.Thread(target=lambda: left.append(ask(viewer, 0.01)), daemon=True)  # noqa: B023
        long.start()
        time.sleep(0.2)
        model.seconds = 0.0
        ends()
        long.join(5.0)
        assert left == [[]]
    assert [of["height"] for of in model.simulated] == [0.02]


def test_faults_are_told_and_the_next_wish_is_served(viewer, caplog):
    for height, fault, said in (
        (0.095, None, "height: is too high"),
        (0.01, KeyError("height"), "internal error: KeyError: 'height'"),  # of the program
    ):
        viewer._model.fault = fault
        assert ask(viewer, height) == [{"fault": said}]
    viewer._model.fault = None
    assert len(ask(viewer, 0.05)) == 2


def test_only_this_machine_reaches_it(viewer, capfd):
    """On the next port where one is taken. Nothing is printed."""
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.2", viewer.port), timeout=1.0)
    with contextlib.closing(Viewer(Square(), port=viewer.port)) as second:
        assert second.port > viewer.port
    with pytest.raises(GendomError, match="port: is 70000"):
        Viewer(Square(), port=70000)
    assert capfd.readouterr() == ("", "")


ASKED = [
    (None, None, True),  # no browser: those always say where a page is from
    ("http://{own}", None, True),
    ("http://localhost:9000", "localhost:9000", True),  # behind a tunnel
    ("http://evil.example", None, False),
    ("http://127.0.0.1:1", None, False),  # another server of this machine
    ("null", None, False),
    ("http://{own}.evil.example", None, False),
    ("http://evil.example", "evil.example", False),  # a name that was made to lead here
    (None, "evil.example", False),
    (None, "[", False),
]
"""Origin and host of requests, and whether they are served."""


@pytest.mark.parametrize(("origin", "host", "served"), ASKED)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_only_its_own_page_is_answered(viewer, method, origin, host, served):
    own = f"127.0.0.1:{viewer.port}"
    head = {"Host": host or own} | ({"Origin": origin.format(own=own)} if origin else {})
    values = '{"height": 0.0, "E": 1.0}' if method == "POST" else None
    assert answer(viewer, method, "/", values, head).status == (200 if served else 403)


def test_what_is_no_wish_is_refused(viewer):
    for method, path, body, status in (
        ("POST", "/simulate", "{", 400),
        ("POST", "/simulate", "[1]", 400),
        ("POST", "/simulate", '{"E": "much"}', 400),
        ("GET", "/etc/passwd", None, 404),
    ):
        assert answer(viewer, method, path, body).status == status
    assert viewer._model.simulated == []


# ---- in a browser --------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_shows_and_obeys(viewer, browser, width):
    """It is drawn without errors, asks for nothing from elsewhere, and its sliders act."""
    simulated = viewer._model.simulated
    browser.open(viewer.url, width=width)
    for said in ("a square", "It is flat.", "Chamfer", "stick", "Reset parameters"):
        browser.until(f"document.body.textContent.includes({said!r})")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert simulated == [{"height": 0.0, "E": 123.0}]  # all its digits

    values = "[...document.querySelectorAll('[type=number]')].map(of => Number(of.value))"
    for which, kind, value, heard, found in (
        (1, "range", 0.5, "input", {"height": 0.05, "E": 123.0}),
        (2, "range", 0.75, "input", {"height": 0.05, "E": 1e3}),  # its slider is logarithmic
        (1, "number", 20.0, "change", {"height": 0.02, "E": 1e3}),  # in mm
        (2, "number", 9e9, "change", {"height": 0.02, "E": 1e4}),
    ):
        browser.act(f"label:nth-of-type({which}) [type={kind}]", f"value = {value}", heard)
        ends = time.monotonic() + 10.0
        while simulated[-1] != pytest.approx(found):
            assert time.monotonic() < ends, simulated[-1]
            time.sleep(0.02)
        assert browser.evaluate(values) == pytest.approx([1e3 * found["height"], found["E"]])
    browser.act("label:nth-of-type(1) [type=number]", "value = 95", "change")
    browser.until("document.querySelector('.said.warning')?.textContent === 'height: is too high'")
    browser.evaluate("document.querySelector('[type=reset]').click()")
    browser.until("document.querySelector('.said').textContent.startsWith('simulated in')")
    assert simulated[-1] == {"height": 0.0, "E": 123.0}
    assert browser.logged == []
    assert [a for a in browser.requested if not a.startswith(viewer.url)] == []
