"""A viewer in a browser: a page that this machine serves to itself.

Its player is that of reports. Sliders that move ask for another simulation (`player.js`).
"""

import contextlib
import itertools
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from gendom.arguments import require
from gendom.datasets import Recording
from gendom.errors import GendomError, printable
from gendom.estimation import UNKNOWNS, LiftScene, Theta, chamfers, replay
from gendom.estimation.replayed import of_all_frames
from gendom.materials.unknowns import Unknown
from gendom.viz.animation import Animation
from gendom.viz.layers import lift_animation
from gendom.viz.markup import escaped
from gendom.viz.player import animation_data, encode_page, facts_text
from gendom.viz.quantities import SHOWN_UNITS, length_text, quantity_text

HOST = "127.0.0.1"

OWN_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this machine by which a browser on it, or behind a tunnel to it, may ask."""

PAUSE = 0.3
"""Between a motion and its distance from the clouds [s]: a slider that is dragged asks again."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Slider:
    """One number that is changed."""

    unknown: Unknown
    ends: tuple[float, float]
    """Its usual range; there is room for the value."""
    value: float
    """At first."""

    def html(self) -> str:
        """A slider, and a box with the value in the unit that people read."""
        u, (low, high) = self.unknown, self.ends
        factor, unit = SHOWN_UNITS.get(u.unit, (1.0, u.unit))
        about = {"name": u.name, "low": min(low, self.value), "high": max(high, self.value),
                 "value": self.value, "log": u.log, "factor": factor}  # fmt: skip
        return (
            f'<label title="{escaped(u.meaning)}" data-about="{escaped(json.dumps(about))}">'
            f"<span>{escaped(f'{u.symbol} [{unit}]' if unit else u.symbol)}</span><input "
            'type="range" min="0" max="1" step="0.005"><input type="number" step="any"></label>'
        )


@dataclass(kw_only=True)
class ViewerModel:
    """Something to view."""

    title: str
    initial: Animation
    """What is known before anything is simulated."""
    notes: tuple[str, ...] = ()
    """Sentences to be read beside it."""
    sliders: tuple[Slider, ...] = ()
    simulate: Callable[[Mapping[str, float], Callable[[], None]], Iterator[Animation]] | None = None
    """From values of the sliders by name to animations, each more complete than the one before; its
    second argument is called now and then, and what that raises ends everything. It may raise a
    `GendomError`. None: there is the initial one alone."""

    def complete(self) -> Animation:
        """The most complete animation with the first values; errors as of `simulate`."""
        if self.simulate is None:
            return self.initial
        *_, last = self.simulate({s.unknown.name: s.value for s in self.sliders}, lambda: None)
        return last

    def page(self) -> str:
        """The page, with what is known before anything is simulated."""
        groups: dict[bool, list[str]] = {True: [], False: []}
        for slider in self.sliders:
            groups[slider.unknown.material].append(slider.html())
        parts = [
            f"<details{' open' * material}><summary>{name}</summary>{''.join(groups[material])}"
            "</details>"
            for material, name in ((True, "Material"), (False, "Grip and clock"))
            if groups[material]
        ]
        if parts:
            parts.append('<button type="reset">Reset parameters</button>')
        form = f'<form class="parameters">{"".join(parts)}</form>' * bool(parts)
        notes = "".join(f'<p class="soft">{escaped(note)}</p>' for note in self.notes)
        page = encode_page(self.initial, self.title, form + notes)
        return page.replace("default-src 'none'", "default-src 'none'; connect-src 'self'")


def recording_model(scene: LiftScene, theta: Theta, title: str) -> ViewerModel:
    """A recording that is replayed with the parameters of sliders.

    Args:
        scene: What was recorded, with all frames that are shown.
        theta: Parameters at first.
        title: One line.
    """

    def simulate(values: Mapping[str, float], go_on: Callable[[], None]) -> Iterator[Animation]:
        """The simulated object, then with its distance from the clouds."""
        given = theta.with_values(values)
        x = replay(scene, [given], on_frame=lambda _: go_on())[:, 0]
        bending = scene.bending_length(given.E_over_rho, given.thickness)
        facts = {"bending length": length_text(bending)}
        if scene.recording.object.mass is not None:
            facts["E"] = quantity_text("E", given.E_over_rho * scene.density_of(given))
        yield lift_animation(scene, x, given, facts=tuple(facts.items()))
        off = chamfers(scene, x, given)[0]
        facts["Chamfer distance in the mean"] = length_text(float(off.mean()))
        yield lift_animation(scene, x, given, facts=tuple(facts.items()), distance=("Chamfer", off))

    known = {"notes": scene.notes, "sliders": _sliders(scene, theta), "simulate": simulate}
    return ViewerModel(title=title, initial=lift_animation(scene), **known)


def unknown_object(recording: Recording) -> tuple[LiftScene, Theta]:
    """All of a recording, with the middle of the priors of an unknown object's parameters.

    Raises:
        RecordingError: The recording shows too little to place the object.
    """
    scene = LiftScene.of(recording)
    theta = scene.prior()[1].with_values(scene.guesses[len(scene.guesses) // 2])
    return of_all_frames(scene, recording), theta


def _sliders(scene: LiftScene, theta: Theta) -> tuple[Slider, ...]:
    """Unknowns of the object, those that are searched, and those that have other values than usual,
    within the ranges that are searched."""
    searched = scene.prior()[0].names
    names = [
        u.name
        for u in UNKNOWNS.values()
        if scene.kind in u.kinds and (u.material or u.name in searched or theta[u.name] != u.usual)
    ]
    if scene.recording.table_height is None:
        names.remove("friction")
    prior = scene.prior(tuple(names))[0]
    return tuple(
        Slider(unknown=u, ends=(u.value(low), u.value(high)), value=theta[u.name])
        for u, low, high in zip(prior.unknowns, prior.low, prior.high, strict=True)
    )


class _DroppedError(Exception):
    """Ends a simulation whose result is not needed any more."""


class Viewer(ThreadingHTTPServer):
    """A model's page, and the answers to its sliders.

    Args:
        model: What is shown.
        port: Of its address; 0: any that is free. Where it is taken one of the next is.

    Raises:
        GendomError: There is no such port, or none is free.
    """

    def __init__(self, model: ViewerModel, *, port: int = 8080):
        require(0 <= port < 65536, f"is {port}", where="port", fix="give 0 to 65535")
        self._model, self._turn = model, threading.Lock()
        self._numbers, self._latest = itertools.count(1), 0
        for at in range(port, min(port + 1000, 65536)) if port else [0]:
            with contextlib.suppress(OSError):
                super().__init__((HOST, at), _Handler)
                return
        raise GendomError("are all taken", where=f"ports from {port} on", fix="name another --port")

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{HOST}:{self.server_port}/"

    def page(self) -> bytes:
        """What a browser shows."""
        return self._model.page().encode("utf-8", "backslashreplace")

    def answers(self, values: Mapping[str, float]) -> Iterator[dict[str, Any]]:
        """What `player.js` takes for values of the sliders: scenes and what to read, or a fault.

        One is simulated at a time; a newer request ends those before it.
        """
        mine = self._latest = next(self._numbers)

        def go_on() -> None:
            if self._latest != mine:
                raise _DroppedError

        assert self._model.simulate is not None
        said, shown = "", self._model.simulate(values, go_on)
        try:
            for first in (True, False):
                time.sleep(0.0 if first else PAUSE)
                with self._turn if first else contextlib.nullcontext():
                    go_on()
                    began = time.monotonic()
                    scene = next(shown, None)
                if scene is None:
                    return
                said = said or f"simulated in {time.monotonic() - began:.2f} s"
                told = "; ".join(filter(None, (said, facts_text(scene))))
                yield {"scene": animation_data(scene), "said": told}
        except _DroppedError:
            return
        except GendomError as error:
            yield {"fault": str(error)}
        except Exception as error:  # the page must not stop following its sliders
            _log.exception("cannot simulate")
            yield {"fault": f"internal error: {type(error).__name__}: {error}"}

    def serve(self) -> None:
        """Print the address, and go on until Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            print(f"{printable(self._model.title)}: {self.url} (Ctrl-C ends it)", flush=True)
            self.serve_forever()

    def close(self) -> None:
        """Stop serving, and what is being simulated."""
        self._latest = -1
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    """Answers the page, and nobody else's."""

    server: Viewer

    def parse_request(self) -> bool:
        parsed = super().parse_request()
        if parsed and not from_own_page(self.headers):
            self.send_error(403, "only its own page is served")
            return False
        return parsed

    def do_GET(self) -> None:
        if urlsplit(self.path).path != "/":
            self.send_error(404)
            return
        self._begin("text/html; charset=utf-8")
        self.wfile.write(self.server.page())

    def do_POST(self) -> None:
        try:
            size = min(int(self.headers.get("Content-Length", 0)), 1 << 16)
            values = {str(n): float(v) for n, v in json.loads(self.rfile.read(size)).items()}
        except (ValueError, AttributeError, TypeError):
            self.send_error(400)
            return
        self._begin("application/x-ndjson")
        with contextlib.suppress(ConnectionError):  # the page does not wait any more
            for answer in self.server.answers(values):
                self.wfile.write(json.dumps(answer).encode() + b"\n")

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: what is printed belongs to the command."""


def from_own_page(headers: Any) -> bool:
    """Whether a request comes from a page of the server that it asks, or from no page.

    Args:
        headers: Of the request. ``Host`` must name this machine: a page elsewhere whose name was
            made to lead here keeps its name there. ``Origin``, which browsers send with every POST,
            must be the same host and port; programs that are no browsers have none.
    """
    hosts, origins = headers.get_all("Host", []), headers.get_all("Origin", [])
    try:
        named = len(hosts) == 1 and urlsplit(f"//{hosts[0]}").hostname in OWN_NAMES
    except ValueError:
        return False
    return named and origins in ([], [f"http://{hosts[0]}"])
