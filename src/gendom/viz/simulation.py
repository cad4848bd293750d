"""Simulations as people look at them: in the viewer or a notebook, as meshes and as films."""

import contextlib
import html
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL.ImageColor import getrgb

from gendom.arguments import check_numbers, check_type, require
from gendom.datasets import Recording
from gendom.errors import DeviceError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.viz.animation import Animation
from gendom.viz.films import FRAME_TIME, write_film
from gendom.viz.layers import gripper_layer, object_layer, obstacle_layer
from gendom.viz.player import encode_page

FORMS = (".glb", ".obj", ".gif", ".mp4")
"""Of files that are saved."""


def motion_of(
    simulator: Any,
    x: npt.ArrayLike | None = None,
    times: npt.ArrayLike | None = None,
    world: int = 0,
) -> Animation:
    """A simulator's object with its obstacles, table and grippers, where its points were.

    Args:
        simulator: A `gendom.sim.Simulator`.
        x: [T, N, 3] or [T, W, N, 3] positions that it returned [m]; None: as it is now.
        times: [T] when [s]; None: 25 in a second.
        world: Which of its worlds is shown.

    Raises:
        ParameterError: Shapes do not fit, numbers are not finite, times do not increase or there is
            no such world.
    """
    from gendom.sim import Simulator  # Warp, which takes long to import

    check_type("simulator", simulator, Simulator)
    W, n, body = simulator.num_worlds, simulator.num_points, simulator.body
    require(world in range(W), f"there is no world {world}", fix=f"0 to {W - 1}")
    if x is None:
        x, times = simulator.positions()[None], [simulator.time]
    x = check_numbers("x", x, ("T", n, 3), ("T", W, n, 3))
    x = x if x.ndim == 3 else x[:, world]
    every = 1e-3 * FRAME_TIME * np.arange(len(x)) if times is None else times
    t, setting = np.atleast_1d(check_numbers("times", every)), simulator.engine.setting
    grows = t.shape == (len(x),) and np.all(np.diff(t) > 0.0)
    require(grows, f"must be {len(x)} that increase, one a frame", where="times")
    layers = [object_layer(body.kind, body, x)]
    for k, of in enumerate(setting.obstacles[world]):
        layers.append(obstacle_layer(f"{of.kind.lower()} {k}", of, t))
    path = setting.grippers.arrays
    hands = list(zip(path["time"][world], path["position"][world], strict=True))
    if hands and simulator.engine.steps is None:
        held = np.array([[np.interp(t, at, axis) for axis in p.T] for at, p in hands])
        held = np.moveaxis(held, 2, 0)
        layers.append(gripper_layer(held, float(np.ptp(x[0], axis=0).max())))
    table = None if setting.table is None else setting.table.height
    return Animation(times=t, layers=tuple(layers), table_height=table)


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
        simulator: As of `motion_of`, with what follows; or a `gendom.Recording` or what
            `gendom.estimate` found, with sliders.
        x, times, world: As of `motion_of`.
        port: Of the viewer.

    Raises:
        ParameterError: As of `motion_of`.
        RecordingError: A recording shows too little to place its object.
        GendomError: There is no such port.
    """
    from gendom.estimation import FittedEstimate
    from gendom.viz.viewer import Viewer, ViewerModel, recording_model, unknown_object

    if isinstance(simulator, Recording):
        model = recording_model(*unknown_object(simulator), "a recording")
    elif isinstance(simulator, FittedEstimate):
        fit = simulator.fits[0]
        model = recording_model(fit.scene, fit.theta, "an estimate")
    else:
        shown = motion_of(simulator, x, times, world)
        model = ViewerModel(title=f"a {simulator.body.kind}", initial=shown)
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if hasattr(shell, "kernel"):
        return NotebookPage(encode_page(model.complete(), model.title))
    with contextlib.closing(Viewer(model, port=port)) as viewer:
        viewer.serve()
    return None


class NotebookPage:
    """A page that plays by itself, as notebooks display it."""

    def __init__(self, page: str):
        self.page = page

    def _repr_html_(self) -> str:
        style = "width:100%;height:640px;border:0"
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
        simulator, x, times, world: As of `motion_of`.

    Raises:
        ParameterError: As of `motion_of`, or the file is of another form.
        DeviceError: What it needs is not installed: trimesh for meshes, OpenCV for .mp4.
    """
    form, fix = Path(path).suffix.lower(), f"choose {', '.join(FORMS)}"
    require(form in FORMS, f"cannot save {form or 'that'}", where=str(path), fix=fix)
    shown = motion_of(simulator, x, times, world)
    if form in (".gif", ".mp4"):
        write_film(path, shown)
        return
    data = _encode_mesh(shown, form)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _encode_mesh(shown: Animation, form: str) -> bytes:
    """Surfaces of the last frame; a glTF turned such that y is up."""
    try:
        import trimesh
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial
    except ModuleNotFoundError:
        fix = how_to_install("viz")
        raise DeviceError("meshes need trimesh", where=form, fix=fix) from None
    made = trimesh.Scene()
    for layer in shown.layers:
        if layer.kind == "surface":
            mesh = trimesh.Trimesh(layer.at(shown.num_frames - 1), layer.faces, process=False)
            material = PBRMaterial(
                name=layer.name, baseColorFactor=[*getrgb(layer.color), 255], doubleSided=True,
                metallicFactor=0.0, roughnessFactor=0.8,
            )  # fmt: skip
            mesh.visual = TextureVisuals(material=material)
            made.add_geometry(mesh, node_name=layer.name, geom_name=layer.name)
    require(len(made.geometry), "particles have no faces", where=form, fix="save a .gif or .mp4")
    if form == ".glb":
        made.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    found: Any = made.export(file_type=form[1:])
    return found.encode() if isinstance(found, str) else found
