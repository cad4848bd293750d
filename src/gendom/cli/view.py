"""`gendom view`: an interactive viewer of recordings and demonstrations."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gendom.cli.arguments import read_params
from gendom.cli.outputs import tell_written
from gendom.datasets import Recording
from gendom.errors import GendomError, ParameterError
from gendom.files import atomic_path, check_file

if TYPE_CHECKING:
    from gendom.viz.viewer import Model, ViewerScene

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Look at a recording or at demonstrations in a browser, and simulate them again as sliders
    change parameters.

    The address is printed; it is reached from this machine alone. Ctrl-C ends it. With --html a
    file is written instead.

    For example: gendom view lift.npz --params lift/estimate.json
    """

    shown: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A recording, an estimate.json beside its recording or one folder below it, or a folder that
    gendom dataset wrote."""
    params: Path | None = None
    """Parameters at first: an estimate.json. By default the middle of the priors of an
    unknown object."""
    demonstration: int = 0
    """Number of the demonstration that is shown first."""
    port: int = 8080
    """Of the address; where it is taken one of the next is."""
    html: Path | None = None
    """Page that plays the motion by itself, without sliders for parameters."""
    force: bool = False
    """Take parameters whose verdict is not usable, too."""

    def run(self) -> int:
        if self.html is None:
            return self._serve()
        check_file(self.html, ".html")
        from gendom.viz.viewer.server import encode_html  # viser: whether it is there shows at once

        model = self._model()
        page = encode_html(final_scene(model, self._case(model)))
        with atomic_path(self.html) as temporary:
            temporary.write_text(page, encoding="utf-8")
        tell_written(self.html, json=False)
        return 0

    def _serve(self) -> int:
        from gendom.viz.viewer.server import Viewer  # viser: whether it is there shows at once

        model = self._model()
        viewer = Viewer(model, case=self._case(model), port=self.port)
        try:
            if self.port not in (0, viewer.port):
                _log.warning("port %d is taken", self.port)
            viewer.serve(f"{model.title}: {viewer.url} (Ctrl-C ends it)")
        finally:
            viewer.close()
        return 0

    def _model(self) -> Model:
        if (self.shown / "dataset.json").is_file():
            from gendom.cli.view_dataset import DatasetModel

            if self.params is not None:
                raise ParameterError(
                    "goes with a recording, not with demonstrations",
                    where="--params",
                    fix="leave it out; sliders change the parameters",
                )
            return DatasetModel(self.shown)
        from gendom.cli.view_recording import RecordingModel, find_recording

        shown, params = self.shown, self.params
        if shown.suffix == ".json":
            if params is not None:
                raise ParameterError(
                    "are given twice", where="--params", fix="give a recording and one estimate"
                )
            params = shown
            shown = find_recording(read_params(params, force=self.force), params)
        recording = Recording.read(shown)
        if params is None:
            return RecordingModel.of(recording, shown.name)
        values = read_params(params, force=self.force)
        return RecordingModel.with_params(recording, values, str(params), shown.name)

    def _case(self, model: Model) -> int:
        noun, count = model.cases
        if not 0 <= self.demonstration < count:
            raise ParameterError(
                f"is {self.demonstration}, and there is no such {noun}",
                where="--demonstration",
                fix=f"give 0 to {count - 1}",
            )
        return self.demonstration


def final_scene(model: Model, case: int) -> ViewerScene:
    """The most complete scene of a case, with its own parameters.

    Raises:
        GendomError: It cannot be simulated.
    """
    values = {p.name: p.value for p in model.parameters(case)}
    scene = None
    for scene in model.simulate(case, values, lambda: None):  # noqa: B007
        pass
    if scene is None:
        raise GendomError("nothing is shown", where=model.title)
    return scene
