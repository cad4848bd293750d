"""`gendom view`: an interactive viewer of recordings."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gendom.arguments import require
from gendom.cli.arguments import iterations_shown
from gendom.cli.outputs import check_places, tell_written
from gendom.datasets import Recording
from gendom.files import atomic_path

if TYPE_CHECKING:
    from gendom.viz.viewer import ViewerModel


@dataclass(frozen=True, kw_only=True)
class Command:
    """Look at a recording in a browser, and simulate it again as sliders change parameters.

    The address is printed; it is reached from this machine alone. Ctrl-C ends it. With --html a
    file is written instead.

    For example: gendom view lift.npz --params lift/estimate.json
    """

    shown: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A recording, or an estimate.json beside its recording or one folder below it."""
    params: Path | None = None
    """Parameters at first: an estimate.json. By default the middle of the priors of an
    unknown object."""
    port: int = 8080
    """Of the address; where it is taken one of the next is."""
    html: Path | None = None
    """Page that plays the motion by itself, without sliders for parameters."""
    force: bool = False
    """Take parameters whose verdict is not usable, too."""

    def run(self) -> int:
        check_places((self.html, ".html"))
        model = self._model()
        if self.html is not None:
            from gendom.viz.player import encode_page

            page = encode_page(model.complete(), model.title)
            with atomic_path(self.html) as temporary:
                temporary.write_text(page, encoding="utf-8", errors="backslashreplace")
            tell_written(self.html)
            return 0
        from gendom.viz.viewer import Viewer

        with contextlib.closing(Viewer(model, port=self.port)) as viewer:
            viewer.serve()
        return 0

    def _model(self) -> ViewerModel:
        from gendom.estimation.replayed import find_recording, replay_setup
        from gendom.materials.estimate_file import read_record
        from gendom.viz.viewer import recording_model, unknown_object

        shown, params = self.shown, self.params
        if shown.suffix == ".json":
            fix = "give a recording and one estimate"
            require(params is None, "are given twice", where="--params", fix=fix)
            params = shown
        if params is None:
            return recording_model(*unknown_object(Recording.read(shown)), shown.name)
        values = read_record(params, even_unusable=self.force)
        shown = find_recording(values, params) if shown == params else shown
        recording = Recording.read(shown)
        with iterations_shown() as show:
            scene, theta = replay_setup(recording, values, str(params), on_progress=show)
        return recording_model(scene, theta, shown.name)
