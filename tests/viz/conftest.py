"""A headless Chromium that is spoken to by its DevTools protocol."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
"""Of the program, as found on the path."""

FLAGS = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--no-first-run", "--disable-gpu"]
FLAGS += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
FLAGS += ["--remote-debugging-port=0"]


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A browser, which takes a second to start."""
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


class Browser:
    """One page at a time, in a profile folder; collects what it logs and asks the network for.
    Skips the test where there is no browser."""

    def __init__(self, profile: Path):
        connect = pytest.importorskip("websockets.sync.client", reason="the extra dev").connect
        program = next((found for name in NAMES if (found := shutil.which(name))), None)
        if program is None:
            pytest.skip(f"needs a browser: {', '.join(NAMES)}")
        words, nowhere = [program, *FLAGS, f"--user-data-dir={profile}"], subprocess.DEVNULL
        self._process = subprocess.Popen([*words, "about:blank"], stdout=nowhere, stderr=nowhere)
        port, until = profile / "DevToolsActivePort", time.monotonic() + 60.0
        while not (port.is_file() and port.read_text().count("\n")):
            assert time.monotonic() < until, "the browser does not start"
            time.sleep(0.02)
        with urlopen(f"http://127.0.0.1:{port.read_text().split()[0]}/json/list") as answer:
            pages = [of for of in json.load(answer) if of["type"] == "page"]
        self._socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=None)
        self._last_id = 0
        self.logged: list[str] = []
        """Errors and warnings of the console, and uncaught exceptions."""
        self.requested: list[str] = []
        """Addresses other than the page's own file and what is inside it."""
        self._loaded = False
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait(10.0)

    def open(self, page: Path | str, *, width: int, dark: bool = False) -> None:
        """Load a file, or an address, in a window of a width [CSS pixels]."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1.0, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)
        self._address = page if isinstance(page, str) else page.resolve().as_uri()
        for address in ("about:blank", self._address):  # what the page before still says is gone
            self.logged.clear()
            self.requested.clear()
            self._loaded = False
            self.call("Page.navigate", url=address)
            while not self._loaded:
                self._receive()
        self.settle()

    def act(self, element: str, change: str, event: str = "input") -> None:
        """Change the element of a selector and say so, as a hand would."""
        self.evaluate(
            f"(() => {{ const e = document.querySelector(`{element}`); e.{change};"
            f"e.dispatchEvent(new Event('{event}', {{bubbles: true}})); }})()"
        )
        self.settle()

    def settle(self) -> None:
        """Wait until what was changed is drawn."""
        frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.evaluate(frame)

    def until(self, expression: str, seconds: float = 20.0) -> None:
        """Wait until an expression is true."""
        ends = time.monotonic() + seconds
        while not self.evaluate(expression):
            assert time.monotonic() < ends, expression
            time.sleep(0.02)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression; of a promise, what it gives."""
        options = {"awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", expression=expression, **options)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol, and its answer."""
        self._last_id += 1
        self._socket.send(json.dumps({"id": self._last_id, "method": method, "params": params}))
        while (answer := self._receive()).get("id") != self._last_id:
            pass
        assert "error" not in answer, (method, answer["error"])
        return answer["result"]

    def _receive(self) -> dict[str, Any]:
        message = json.loads(self._socket.recv(timeout=60.0))
        event, params = message.get("method", ""), message.get("params", {})
        if event == "Page.loadEventFired":
            self._loaded = True
        elif event == "Network.requestWillBeSent":
            address = params["request"]["url"]
            if address != self._address and not address.startswith("data:"):
                self.requested.append(address)
        entry = params.get("entry", params)  # of the console, of the browser's own log
        if event == "Runtime.exceptionThrown" or (
            event in ("Runtime.consoleAPICalled", "Log.entryAdded")
            and entry.get("type", entry.get("level")) in ("error", "warning")
        ):
            self.logged.append(json.dumps(params)[:500])
        return message
