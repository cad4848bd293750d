"""A viewer in a browser, on viser: this machine's own address, and nothing from elsewhere.

A `Viewer` has a page with sliders and a `Painter` that draws the scene; it simulates in a thread of
its own as sliders move, and the last request wins.
"""

from __future__ import annotations

import contextlib
import html
import io
import logging
import math
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
import websockets.asyncio.server as websocket_server

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import GendomError, printable
from gendom.viz.animation import Animation, Layer, axes_of
from gendom.viz.palette import RECORDED_COLOR, TABLE_FILL, TABLE_LINE, rgb
from gendom.viz.viewer.sliders import SliderParameter, ViewerModel

HOST = "127.0.0.1"

OWN_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this machine by which a browser on it, or behind a tunnel to it, may ask."""

SPEEDS = {"1/8": 0.125, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
"""Times faster than life, as people write it."""

PATIENCE = 1.0
"""Time after which a simulation is given up for a newer request [s]. Shorter ones are shown, so
that the object follows a slider that is dragged."""

_RATE = 25.0
"""Frames that are played in a second, at most."""

FIELD_OF_VIEW = math.radians(35.0)
"""The camera's, upwards."""

_SOFT, _BAD = "#6e6e6e", "#b00020"

_log = logging.getLogger(__name__)


class _Server(viser.ViserServer):
    """Viser's, which does not leave this machine, and answers no page but its own.

    Viser has no setting for that, so the check is put before its own answers while it starts.
    """

    def __init__(self, port: int, **settings: Any):
        serve, guarded = websocket_server.serve, []

        def serve_guarded(*args: Any, process_request: Any, **others: Any) -> Any:
            def answer(connection: Any, request: Any) -> Any:
                if not from_own_page(request.headers):
                    return connection.respond(HTTPStatus.FORBIDDEN, "only its own page is served")
                return process_request(connection, request)

            guarded.append(True)
            return serve(*args, process_request=answer, **others)

        setattr(websocket_server, "serve", serve_guarded)  # noqa: B010
        try:
            with _silent():
                super().__init__(HOST, port, verbose=False, **settings)
        finally:
            setattr(websocket_server, "serve", serve)  # noqa: B010
        if not guarded:
            self.stop()
            fix = "install the version of viser in constraints.txt"
            raise GendomError("cannot be kept from pages of others", where="viser", fix=fix)


class _DroppedError(Exception):
    """Ends a simulation whose result is not needed any more."""


class Painter:
    """Draws one scene after another, at one frame after another."""

    def __init__(self, canvas: viser.SceneApi):
        self._canvas = canvas
        self._handles: dict[str, Any] = {}
        self._drawn: dict[str, Layer] = {}
        self._table = False

    def paint(self, scene: Animation, frame: int) -> None:
        """Show a frame of a scene; what another scene had and this one lacks goes."""
        layers = {layer.name: layer for layer in scene.layers}
        for name, before in list(self._drawn.items()):
            now = layers.get(name, before)
            alike = now.kind == before.kind and np.array_equal(now.faces, before.faces)
            if name not in layers or not alike:
                self._handles.pop(name).remove()
                del self._drawn[name]
        for name, layer in layers.items():
            points = layer.at(frame).astype(np.float32)
            if name not in self._handles:
                self._handles[name] = self._added(layer, points)
            elif len(layer.points) > 1 or self._drawn[name] is not layer:
                kind = "vertices" if layer.kind == "surface" else "points"
                setattr(self._handles[name], kind, points)
        self._drawn = layers
        self._lay_table(scene)

    def _added(self, layer: Layer, points: Array) -> Any:
        name, color, width = f"/{layer.name}", rgb(layer.color), 2.0 * float(np.max(layer.radius))
        if layer.kind == "lines":
            return self._canvas.add_line_segments(
                name, points, color, thickness=width, thickness_units="world"
            )
        if layer.kind == "dots":
            return self._canvas.add_point_cloud(
                name, points, color, point_size=width, precision="float32",
                point_shape="circle", point_shading="flat",
            )  # fmt: skip
        opacity = None if layer.opacity == 1.0 else layer.opacity
        return self._canvas.add_mesh_simple(
            name, points, layer.faces, color=color, opacity=opacity, side="double"
        )

    def _lay_table(self, scene: Animation) -> None:
        """A table as large as what was shown first, in squares of a round size."""
        z = scene.table_height
        if z is None or self._table:
            return
        self._table = True
        step, (low, high) = scene.square, scene.table_ends
        (width, depth), (x, y) = (high - low).tolist(), (0.5 * (low + high)).tolist()
        self._canvas.add_grid(
            "/table", width=width, height=depth, position=(x, y, z),
            cell_size=step, cell_color=(214, 214, 214),
            section_size=5.0 * step, section_color=TABLE_LINE,
            plane_color=TABLE_FILL, plane_opacity=0.7,
        )  # fmt: skip


class Viewer:
    """A model in a browser, with sliders for time and parameters.

    Args:
        model: What is shown.
        port: Of its address; 0: any that is free. Where it is taken one of the next is.

    Raises:
        GendomError: There is no such port.
    """

    def __init__(self, model: ViewerModel, *, port: int = 8080):
        require(0 <= port < 65536, f"is {port}", where="port", fix="give 0 to 65535")
        self._model = model
        self._lock = threading.RLock()
        self._scene = model.initial
        self._parameters = {p.name: p for p in model.parameters}
        self._setting = False
        self._request: dict[str, float] | None = None
        self._closed = threading.Event()
        self._server = _Server(port, label=model.title)
        self._painter = Painter(self._server.scene)
        camera = self._server.initial_camera
        camera.fov, (camera.position, camera.look_at) = FIELD_OF_VIEW, camera_of(self._scene)
        self._build()
        self._take(self._scene, self._scene.num_frames // 2)
        self._pool = ThreadPoolExecutor(1, "simulation")
        self._last = self._pool.submit(lambda: None)
        self._ask()
        self._player = threading.Thread(target=self._play, name="player", daemon=True)
        self._player.start()

    # ---- what its owner does with it -------------------------------------------------------------

    @property
    def port(self) -> int:
        """The address's port."""
        return self._server.get_port()

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{HOST}:{self.port}"

    def play(self, playing: bool) -> None:
        """Let time run, or stop it."""
        self._playing = playing
        self._button.label = "Pause" if playing else "Play"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def reset(self) -> None:
        """Go back to the first values."""
        with self._lock:
            self._setting = True
            for name, p in self._parameters.items():
                self._sliders[name].value = p.start
                self._label(p, p.value)
            self._setting = False
        self._ask()

    def wait(self, timeout: float | None = None) -> bool:
        """Until everything that was asked for is simulated, or for a time [s]; whether it is."""
        return self._last in wait([self._last], timeout).done

    def serve(self) -> None:
        """Print the address, and go on until Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            title = printable(self._model.title)
            print(f"{title}: {self.url} (Ctrl-C ends it)", flush=True)
            while not self._closed.wait(3600.0):
                pass

    def close(self) -> None:
        """End everything."""
        self._closed.set()
        self._player.join(5.0)
        self._pool.shutdown(cancel_futures=True)
        with _silent():
            self._server.stop()

    # ---- what the page holds ---------------------------------------------------------------------

    def _build(self) -> None:
        gui = self._server.gui
        gui.configure_theme(
            control_width="large",
            show_logo=False,
            show_share_button=False,
            brand_color=rgb(RECORDED_COLOR),
        )
        gui.main_panel.dock_right()
        self._status_text, self._fault = "", False
        self._readout = gui.add_html("")
        with gui.add_folder("Time"):
            self._time = gui.add_slider("frame", 0, 1, 1, 0)
            self._time.on_update(lambda _: self._paint())
            self._playing = False
            self._button = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
            self._button.on_click(lambda _: self.play(not self._playing))
            self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
        self._sliders: dict[str, viser.GuiSliderHandle] = {}
        self._boxes: dict[str, Any] = {}
        every = self._parameters.values()
        for k, group in enumerate(dict.fromkeys(p.group for p in every)):
            with gui.add_folder(group, expand_by_default=k == 0):
                for p in (p for p in every if p.group == group):
                    self._sliders[p.name] = self._add_slider(p)
        if self._sliders:
            gui.add_button("Reset parameters").on_click(lambda _: self.reset())

    def _add_slider(self, p: SliderParameter) -> viser.GuiSliderHandle:
        text, gui = p.text(p.value), self._server.gui
        slider = gui.add_slider(text, *p.range, p.start, hint=p.meaning)

        def moved(_: Any) -> None:
            if not self._setting:
                self._label(p, self._value(p.name))
                self._ask()

        slider.on_update(moved)
        if p.log:
            self._add_box(p, slider)
        return slider

    def _add_box(self, p: SliderParameter, slider: viser.GuiSliderHandle) -> None:
        """A box with a logarithmic parameter's value, in place of its slider's own."""
        gui, (factor, unit) = self._server.gui, p.shown
        gui.add_html(f'<style>[id="{slider._impl.uuid}"] + div {{display: none}}</style>')
        box = gui.add_number(f"= [{unit}]" if unit else "=", float(f"{factor * p.value:.4g}"))

        def typed(_: Any) -> None:
            if not self._setting and box.value > 0.0:
                low, high, _step = p.range
                slider.value = min(max(p.position(box.value / factor), low), high)

        box.on_update(typed)
        self._boxes[p.name] = box

    def _label(self, p: SliderParameter, value: float) -> None:
        """Write a parameter's value to its label and box."""
        self._sliders[p.name].label = p.text(value)
        if p.name in self._boxes:
            was, self._setting = self._setting, True
            self._boxes[p.name].value = float(f"{p.shown[0] * value:.4g}")
            self._setting = was

    def _value(self, name: str) -> float:
        return self._parameters[name].at(self._sliders[name].value)

    # ---- simulating ------------------------------------------------------------------------------

    def _ask(self) -> None:
        """Simulate with the values of the sliders, as soon as possible."""
        with self._lock:
            self._request = {name: self._value(name) for name in self._sliders}
        self._last = self._pool.submit(self._simulate)

    def _simulate(self) -> None:
        with self._lock:
            request, self._request = self._request, None
        if request is None:
            return
        began = time.monotonic()

        def go_on() -> None:
            late = time.monotonic() - began > PATIENCE
            if self._closed.is_set() or (late and self._request is not None):
                raise _DroppedError

        self._say("simulating …")
        try:
            for scene in self._model.animations(request, go_on):
                if self._closed.is_set():
                    return
                self._take(scene, scene.frame_at(self._scene.times[self._frame_of(self._scene)]))
                done = self._status_text.startswith("simulated")
                said = f"{self._status_text}, the rest after" if done else "simulated in"
                self._say(f"{said} {time.monotonic() - began:.2f} s")
                if self._request is not None:
                    return
        except _DroppedError:
            return
        except GendomError as error:
            self._say(str(error), fault=True)
        except Exception as error:  # the page must not stop following its sliders
            _log.exception("cannot simulate")
            self._say(f"internal error: {type(error).__name__}: {error}", fault=True)

    def _take(self, scene: Animation, frame: int) -> None:
        """Show a frame of a scene in place of another one."""
        with self._lock:
            self._scene = scene
            with self._server.atomic():
                self._setting = True
                self._time.max = max(scene.num_frames - 1, 1)
                self._time.value = frame
                self._setting = False
                self._paint()

    def _say(self, text: str, *, fault: bool = False) -> None:
        self._status_text, self._fault = text, fault
        self._read()

    def _read(self) -> None:
        """Write what is to be read."""
        with self._lock:
            lines = [(layer.color, f"● {layer.name}") for layer in self._scene.layers]
            lines += [(_SOFT, f"{name}: {value}") for name, value in self._rows(self._scene)]
            lines.append((_BAD if self._fault else _SOFT, self._status_text))
            lines += [(_SOFT, note) for note in self._model.notes]
            shown = "".join(
                f'<div style="color:{color}">{html.escape(text)}</div>' for color, text in lines
            )
            style = "font-size:0.8em;line-height:1.45;padding:0.3em 0.8em"
            self._readout.content = f'<div style="{style}">{shown}</div>'

    def _rows(self, scene: Animation) -> list[tuple[str, str]]:
        t = self._frame_of(scene)
        rows = [("time", f"{scene.times[t]:.2f} s of {scene.times[-1]:.2f} s")]
        if scene.distance is not None:
            name, mm = scene.distance[0], 1e3 * scene.distance[1]
            rows.append((f"{name} [mm]", f"{mm[t]:.1f} now, {mm.mean():.1f} mean"))
        table = scene.table_height is not None
        squares = [("squares of table", f"{1e3 * scene.square:g} mm")] if table else []
        return [*rows, *scene.facts, *squares]

    # ---- time ------------------------------------------------------------------------------------

    def _frame_of(self, scene: Animation) -> int:
        return min(self._time.value, scene.num_frames - 1)

    def _paint(self) -> None:
        if self._setting:
            return
        with self._lock, self._server.atomic():
            self._painter.paint(self._scene, self._frame_of(self._scene))
            self._read()

    def _play(self) -> None:
        """Move the slider of time while it runs, from the end to the beginning."""
        last, clock = time.monotonic(), 0.0
        while not self._closed.wait(1.0 / _RATE):
            now = time.monotonic()
            passed, last = now - last, now
            scene = self._scene
            if not self._playing:
                continue
            if scene.frame_at(clock) != self._frame_of(scene):  # the user moved the slider
                clock = float(scene.times[self._frame_of(scene)])
            clock += passed * SPEEDS[self._speed.value]
            if clock > scene.times[-1] + 0.5 * SPEEDS[self._speed.value]:
                clock = float(scene.times[0])
            with self._lock:
                self._time.value = scene.frame_at(clock)


def camera_of(shown: Animation) -> tuple[Array, Array]:
    """Where the camera stands and what it looks at, [3] each [m], so that a window as wide as high
    shows all."""
    low, high = shown.box
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + 1e-3
    away = 1.05 * radius / math.sin(0.5 * FIELD_OF_VIEW)
    return middle - away * axes_of(*shown.view)[2], middle


def from_own_page(headers: Any) -> bool:
    """Whether a request comes from a page of the server that it asks, or from no page.

    Args:
        headers: Of the request. ``Host`` must name this machine: a page elsewhere whose name was
            made to lead here keeps its name there. ``Origin``, which browsers send with every
            WebSocket, must be the same host and port; programs that are no browsers have none.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    try:
        named = len(hosts) == 1 and urlsplit(f"//{hosts[0]}").hostname in OWN_NAMES
    except ValueError:
        return False
    return named and origins in ([], [f"http://{hosts[0]}"])


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Viser announces itself on stdout, which belongs to the command."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
