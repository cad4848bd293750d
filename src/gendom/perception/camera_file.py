"""A depth camera's file, camera.toml (docs/perception.md, Input).

T_world_camera may also name a file beside it that another calibration wrote
(`gendom.perception.poses`). Beside a recording that holds the intrinsics only it is needed.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from gendom.arrays import Array
from gendom.errors import RecordingError
from gendom.files import atomic_path
from gendom.perception.camera import Camera, expect
from gendom.perception.poses import camera_pose
from gendom.reading import inside, read_toml

_KEYS = ("width", "height", "depth_unit", "K", "distortion", "T_world_camera")


def read_camera(path: str | os.PathLike, *, recorded: Camera | None = None) -> Camera:
    """The camera of a file camera.toml; see the top of this module.

    Args:
        path: The file, whose folder names the camera.
        recorded: The camera as a recording beside the file describes it. The file then gives the
            pose, and the depth unit where the recording's is wrong; other keys in it must equal
            those of the recording. None: it gives all.

    Raises:
        RecordingError: The file is missing, no TOML, or lacks or has a wrong value.
    """
    path = Path(path)
    table = read_toml(
        path,
        missing="no such file, so the intrinsics are unknown",
        fix="write one with width, height, K, depth_unit, distortion and T_world_camera",
        error=RecordingError,
    )
    if isinstance(stated := table.get("T_world_camera"), str):
        table["T_world_camera"] = camera_pose(inside(path.parent, stated, where=str(path)))
    # A default depth unit would be wrong by a factor of ten for many cameras.
    needed = () if recorded else ("width", "height", "K", "depth_unit")
    missing = [key for key in needed if key not in table]
    fix = "copy it from the camera's own settings; depth is useless without"
    expect(not missing, f"lacks {', '.join(missing)}", where=str(path), fix=fix)
    for key in table:
        what, fix = f"has the unknown key {key!r}", f"known are {', '.join(_KEYS)}"
        expect(key in _KEYS, what, where=str(path), fix=fix)
    name = {"name": path.resolve().parent.name, "T_world_camera": None}
    try:
        given = replace(recorded, **table) if recorded else Camera(**{**name, **table})
    except RecordingError as error:  # messages name the file in place of the camera
        where = f"{path}: {str(error.where).rpartition(': ')[2]}"
        raise RecordingError(error.what, where=where, fix=error.fix) from None
    tolerances = {"width": 0.0, "height": 0.0, "K": 0.5, "distortion": 1e-3} if recorded else {}
    for key, tolerance in tolerances.items():
        own, stated = (np.atleast_1d(getattr(c, key)) for c in (recorded, given))
        if key == "distortion":  # what is left out is zero
            own, stated = (np.pad(a, (0, 8 - len(a))) for a in (own, stated))
        what, fix = "is not that of the recording beside it", "leave it out: its own is taken"
        expect(np.abs(stated - own).max() <= tolerance, what, where=f"{path}: {key}", fix=fix)
    if recorded:
        return replace(recorded, depth_unit=given.depth_unit, T_world_camera=given.T_world_camera)
    return given


def write_camera(path: str | os.PathLike, camera: Camera) -> None:
    """Write a camera as camera.toml, atomically; reading it gives the same numbers.

    Raises:
        GendomError: The place cannot be written.
    """
    lines = (
        f"width = {camera.width}",
        f"height = {camera.height}",
        f"depth_unit = {camera.depth_unit!r}  # metres a count",
        f"K = {_rows(camera.K)}  # pixels",
        f"distortion = {list(camera.distortion)}  # OpenCV's k1, k2, p1, p2, k3, ...",
    )
    write_pose(path, camera.T_world_camera, *lines)


def write_pose(path: str | os.PathLike, T: Array | None, *before: str) -> None:
    """Write a camera's pose [4, 4] [m] as camera.toml, atomically, behind other lines.

    Raises:
        GendomError: The place cannot be written.
    """
    pose = "# not calibrated" if T is None else f"T_world_camera = {_rows(T)}  # metres"
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*before, pose, ""]), encoding="utf-8")


def _rows(matrix: np.ndarray) -> str:
    rows = ",\n".join(f"  {[float(x) for x in row]}" for row in matrix)
    return f"[\n{rows},\n]"
