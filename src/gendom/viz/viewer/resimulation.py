"""A thread that simulates what was asked for last."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping

from gendom.errors import GendomError
from gendom.viz.viewer.model import Model
from gendom.viz.viewer.scene import ViewerScene

PATIENCE = 1.0
"""Time after which a simulation is given up for a newer wish [s]: a shorter one is shown, so that
the object follows a slider that is dragged."""

_log = logging.getLogger(__name__)


class _DroppedError(Exception):
    """Ends a simulation whose result is not needed any more."""


class Resimulation:
    """Simulates a model in a thread of its own; the last wish wins, older ones are dropped.

    Args:
        model: What is simulated.
        on_begin: Called when a wish is taken up.
        on_scene: Called with every scene that a wish gives, and the time since it was taken up [s].
        on_fault: Called with one line if it cannot be simulated.
    """

    def __init__(
        self,
        model: Model,
        *,
        on_begin: Callable[[], None],
        on_scene: Callable[[ViewerScene, float], None],
        on_fault: Callable[[str], None],
    ):
        self._model = model
        self._on_begin, self._on_scene, self._on_fault = on_begin, on_scene, on_fault
        self._changed = threading.Condition()
        self._wish: tuple[int, Mapping[str, float]] | None = None
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, name="resimulation", daemon=True)
        self._thread.start()

    def ask(self, case: int, values: Mapping[str, float]) -> None:
        """Simulate a case with parameters by name, as soon as possible."""
        with self._changed:
            self._wish = (case, dict(values))
            self._changed.notify_all()

    def wait(self, timeout: float) -> bool:
        """Whether all that was asked for is done within a time [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: self._wish is None and not self._busy, timeout)

    def close(self) -> None:
        """Drop everything, and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._wish is not None or self._closed)
                if self._closed or self._wish is None:
                    return
                case, values = self._wish
                self._wish, self._busy = None, True
            self._simulate(case, values)

    def _simulate(self, case: int, values: Mapping[str, float]) -> None:
        began = time.monotonic()

        def go_on() -> None:
            late = time.monotonic() - began > PATIENCE
            if self._closed or (late and self._wish is not None):
                raise _DroppedError

        self._on_begin()
        try:
            for scene in self._model.simulate(case, values, go_on):
                if self._closed:
                    return
                self._on_scene(scene, time.monotonic() - began)
                if self._wish is not None:
                    return
        except _DroppedError:
            return
        except GendomError as error:
            self._on_fault(str(error))
        except Exception as error:  # the page must not stop following its sliders
            _log.exception("cannot simulate")
            self._on_fault(f"internal error: {type(error).__name__}: {error}")
