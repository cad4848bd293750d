"""Simulations as people look at them: in the viewer or a notebook, as meshes and as films."""

from __future__ import annotations

import html
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import check_numbers, check_type, require
from gendom.errors import DeviceError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.viz.palette import SIMULATED_COLOR, rgb
from gendom.viz.stage import Stage, write_film
from gendom.viz.viewer.scenes import (
    Layer,
    SliderParameter,
    ViewerModel,
    ViewerScene,
    gripper_layer,
    object_layer,
    obstacle_layer,
)

FORMS = (".glb", ".obj", ".gif", ".mp4")
"""Of files that are saved."""

FRAMES, FRAME_TIME = 250, 40
"""Most frames of a film, and how long one of them is shown at least [ms]."""


class Motion(ViewerModel):
    """A simulator, and where its points were.

    Args:
        simulator: A `gendom.sim.Simulator`.
        x: [T, N, 3] or [T, W, N, 3] positions that it returned [m]; None: as it is now.
        times: [T] when [s]; None: 25 in a second.
        world: Which of its worlds is shown.

    Raises:
        ParameterError: Shapes do not fit, numbers are not finite, times do not increase or there is
            no such world.
    """

    notes = ()
    cases = ("scene", 1)

    def __init__(
        self,
        simulator: Any,
        x: npt.ArrayLike | None = None,
        times: npt.ArrayLike | None = None,
        world: int = 0,
    ):
        from gendom.sim import Simulator  # Warp, which takes long to import

        check_type("simulator", simulator, Simulator)
        W, n, body = simulator.num_worlds, simulator.num_points, simulator.body
        require(world in range(W), f"there is no world {world}", fix=f"0 to {W - 1}")
        if x is None:
            x, times = simulator.positions()[None], [simulator.time]
        x = check_numbers("x", x, ("T", n, 3), ("T", W, n, 3))
        x = x if x.ndim == 3 else x[:, world]
        every = 1e-3 * FRAME_TIME * np.arange(len(x)) if times is None else times
        t = np.atleast_1d(check_numbers("times", every))
        grows = t.shape == (len(x),) and np.all(np.diff(t) > 0.0)
        require(len(x) and grows, f"must be {len(x)} that increase, one a frame", where="times")
        self.title, setting = f"a {body.kind}", simulator.engine.setting
        layers = [_object(simulator, x)]
        for o, of in enumerate(setting.obstacles[world]):
            layers.append(obstacle_layer(f"{of.kind.lower()} {o}", of, t))
        hands = list(setting.grippers[world])
        if hands and simulator.engine.commanded is None:
            held = np.stack([hand.position_at(t) for hand in hands], axis=1)
            layers.append(gripper_layer(held, float(np.ptp(x[0], axis=0).max())))
        table = None if setting.table is None else setting.table.height
        self.initial: ViewerScene = ViewerScene(times=t, layers=tuple(layers), table_height=table)

    def parameters(self, case: int) -> tuple[SliderParameter, ...]:
        """None."""
        return ()

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[ViewerScene]:
        """What was simulated before."""
        yield self.initial


def _object(simulator: Any, x: npt.NDArray[np.floating]) -> Layer:
    """A rod's or shell's skin; of particles dots."""
    from gendom.sim.thin.contact import edges_and_triangles

    body, model = simulator.body, getattr(simulator.engine, "model", None)
    if model is not None and body.kind == "rope":
        return object_layer("rope", body, x, None)
    made = {"name": body.kind, "color": SIMULATED_COLOR, "points": list(body.surface(x))}
    if model is None:
        return Layer(**made, radius=0.25 * body.dx)
    return Layer(**made, faces=edges_and_triangles(model)[1])


def show(
    simulator: Any,
    x: npt.ArrayLike | None = None,
    times: npt.ArrayLike | None = None,
    *,
    world: int = 0,
    port: int = 8080,
) -> Any:
    """Show a simulator as it is, or a motion that it returned.

    In a notebook this returns a page with a player, which is displayed. Elsewhere it serves the
    viewer on this machine, prints its address, and goes on until Ctrl-C.

    Args:
        simulator: As of `Motion`, with what follows; or a `gendom.Recording`, with sliders.
        x, times, world: As of `Motion`.
        port: Of the viewer.

    Raises:
        ParameterError: As of `Motion`.
        RecordingError: A recording shows too little to place its object.
        DeviceError: viser is not installed.
        GendomError: There is no such port.
    """
    from gendom.datasets import Recording

    try:
        from gendom.viz.viewer.server import Viewer, encode_html
    except ModuleNotFoundError:
        fix = how_to_install("viz")
        raise DeviceError("the viewer needs viser", where="show", fix=fix) from None
    if isinstance(simulator, Recording):
        from gendom.viz.viewer.models import RecordingModel

        model: ViewerModel = RecordingModel.of(simulator, "a recording")
    else:
        model = Motion(simulator, x, times, world)
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if hasattr(shell, "kernel"):
        return NotebookPage(encode_html(model))
    viewer = Viewer(model, port=port)
    try:
        viewer.serve(f"{model.title}: {viewer.url} (Ctrl-C ends it)")
    finally:
        viewer.close()
    return None


class NotebookPage:
    """A page that plays by itself, as notebooks display it."""

    def __init__(self, page: str):
        self.page = page

    def _repr_html_(self) -> str:
        style = "width:100%;height:480px;border:0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'


def save(
    path: str | Path,
    simulator: Any,
    x: npt.ArrayLike | None = None,
    times: npt.ArrayLike | None = None,
    *,
    world: int = 0,
) -> None:
    """Save a simulator as it is, or a motion that it returned, with its obstacles.

    The file appears whole or not at all.

    Args:
        path: .glb or .obj: the faces of the skin in the last frame (y is up in the first, z in the
            second); .gif or .mp4: a film in true time, with grippers and table.
        simulator, x, times, world: As of `Motion`.

    Raises:
        ParameterError: As of `Motion`, or the file is of another form.
        DeviceError: What it needs is not installed: trimesh for meshes, OpenCV for .mp4.
    """
    form, fix = Path(path).suffix.lower(), f"choose {', '.join(FORMS)}"
    require(form in FORMS, f"cannot save {form or 'that'}", where=str(path), fix=fix)
    scene = Motion(simulator, x, times, world).initial
    if form in (".gif", ".mp4"):
        lasts = 1e3 * float(scene.times[-1] - scene.times[0])
        step = max(FRAME_TIME, round(lasts / FRAMES))
        moments = scene.times[0] + 1e-3 * step * np.arange(int(lasts / step + 0.5) + 1)
        frames = [scene.frame_at(t + 0.5e-3 * step) for t in moments]
        write_film(path, Stage(scene), frames, step)
        return
    data = _encode_mesh(scene, form)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _encode_mesh(scene: ViewerScene, form: str) -> bytes:
    """Surfaces of a scene's last frame; a glTF turned such that y is up."""
    try:
        import trimesh
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial
    except ModuleNotFoundError:
        fix = how_to_install("viz")
        raise DeviceError("meshes need trimesh", where=form, fix=fix) from None
    made = trimesh.Scene()
    for layer in scene.layers:
        if layer.kind == "surface":
            mesh = trimesh.Trimesh(layer.at(scene.num_frames - 1), layer.faces, process=False)
            material = PBRMaterial(
                name=layer.name, baseColorFactor=[*rgb(layer.color), 255], doubleSided=True,
                metallicFactor=0.0, roughnessFactor=0.8,
            )  # fmt: skip
            mesh.visual = TextureVisuals(material=material)
            made.add_geometry(mesh, node_name=layer.name, geom_name=layer.name)
    require(len(made.geometry), "particles have no faces", where=form, fix="save a .gif or .mp4")
    if form == ".glb":
        made.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    found: Any = made.export(file_type=form[1:])
    return found.encode() if isinstance(found, str) else found
