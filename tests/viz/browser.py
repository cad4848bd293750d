"""A headless Chromium that is spoken to by its DevTools protocol, over a pipe."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
"""Of the program, as found on the path."""

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-pipe",
)


WEBGL_FLAGS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    # whatever is elsewhere cannot be found
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
"""For pages that draw with WebGL, in place of `--disable-gpu`."""


def find_browser() -> str | None:
    """Path of a browser, or None."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Browser:
    """One page at a time; collects what it logs and asks the network for.

    The protocol goes over file descriptors 3 (in) and 4 (out): no port, no packages.

    Args:
        program: The browser.
        profile: Folder for its files.
        webgl: Whether pages can draw with WebGL, in software.
    """

    def __init__(self, program: str, profile: Path, *, webgl: bool = False):
        to_browser, self._commands = os.pipe()
        self._answers, from_browser = os.pipe()
        flags = [*FLAGS, f"--user-data-dir={profile}"]
        if webgl:
            flags = [flag for flag in flags if flag != "--disable-gpu"] + [*WEBGL_FLAGS]
        # a shell moves the pipes to the descriptors that the browser expects
        redirect = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", redirect, program, *flags, "about:blank"],
            pass_fds=(to_browser, from_browser),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._last_id = 0
        self._session: str | None = None
        self.logged: list[str] = []
        """Errors and warnings of the console, and uncaught exceptions."""
        self.errors: list[str] = []
        """Those of them that are no warnings."""
        self.requested: list[str] = []
        """Addresses other than the page's own file and what is inside it."""
        self._loaded = False
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        os.close(self._commands)  # the browser ends when its pipe does
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._answers)

    def open(self, page: Path | str, *, width: int, height: int = 900, dark: bool = False) -> None:
        """Load a file, or an address, in a window of a size [CSS pixels]."""
        self.resize(width, height)
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)
        self._address = page if isinstance(page, str) else page.resolve().as_uri()
        self._loaded = False
        self.logged.clear()
        self.errors.clear()
        self.requested.clear()
        self.call("Page.navigate", url=self._address)
        until = time.monotonic() + 60.0
        while not self._loaded:
            self._receive(until)
        self.settle()

    def resize(self, width: int, height: int = 900) -> None:
        """Another size of the window [CSS pixels]."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def settle(self) -> None:
        """Wait until what was changed is drawn."""
        frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.evaluate(frame)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression; of a promise, what it gives."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """A PNG of the page, or of what the window shows."""
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol, and its answer."""
        self._last_id += 1
        message: dict[str, Any] = {"id": self._last_id, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._commands, data) :]
        until = time.monotonic() + 60.0
        while True:
            answer = self._receive(until)
            if answer.get("id") == self._last_id:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def _receive(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                raise TimeoutError("the browser does not answer")
            data = os.read(self._answers, 1 << 20)
            if not data:
                raise ConnectionError("the browser has ended")
            self._buffer += data
        line, self._buffer = self._buffer.split(b"\0", 1)
        message = json.loads(line)
        self._note(message.get("method", ""), message.get("params", {}))
        return message

    def _note(self, event: str, params: dict[str, Any]) -> None:
        if event == "Page.loadEventFired":
            self._loaded = True
        elif event == "Runtime.exceptionThrown":
            self._log("error", json.dumps(params["exceptionDetails"])[:500])
        elif event == "Runtime.consoleAPICalled":
            self._log(params["type"], json.dumps(params["args"])[:500])
        elif event == "Log.entryAdded":
            self._log(params["entry"]["level"], params["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            address = params["request"]["url"]
            if address != self._address and not address.startswith("data:"):
                self.requested.append(address)

    def _log(self, level: str, text: str) -> None:
        if level in ("error", "warning"):
            self.logged.append(text)
        if level == "error":
            self.errors.append(text)
