"""`gendom calibrate`: where a camera stands."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from scipy.spatial.transform import Rotation

from gendom.cli.arguments import Json
from gendom.cli.outputs import check_places, print_result, tell_written
from gendom.datasets import Fault
from gendom.errors import GendomError
from gendom.perception.calibration import Calibration, calibrate, read_views
from gendom.perception.camera_file import read_camera, write_camera
from gendom.perception.realsense import RealSenseRecording, is_recording


@dataclass(frozen=True, kw_only=True)
class Command:
    """Find a camera's pose from pictures of a ChArUco board that the robot holds.

    The folder has board.toml, poses.csv and the pictures; see docs/perception.md. Refuses when
    the poses do not determine the camera's pose.

    For example: gendom calibrate board --camera camera.toml --out camera.toml
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder with board.toml, poses.csv and pictures."""
    camera: Path
    """camera.toml, or a RealSense recording, with the intrinsics of the stream that took the
    pictures."""
    out: Path | None = None
    """Where to write camera.toml with T_world_camera; may be the same file."""
    json: Json = False

    def run(self) -> int:
        warnings: list[Fault] = []
        check_places((self.out, ".toml"))
        recorded = is_recording(self.camera)
        camera = RealSenseRecording(self.camera).camera if recorded else read_camera(self.camera)
        views = read_views(self.folder, camera, on_warning=warnings.append)
        try:
            found = calibrate(camera, views)
        except GendomError as error:
            lost = f" ({len(warnings)} left out, first {warnings[0]})" if warnings else ""
            where = error.where or str(self.folder)
            raise GendomError(error.what + lost, where=where, fix=error.fix) from None
        for name in found.outliers:
            what = f"is {found.rms_by_picture[name]:.3g} pixels off: its pose is not the picture's"
            warnings.append(Fault(what, name, "take it again or leave it out", "warning"))
        poses = {n: getattr(found, n) for n in ("T_world_camera", "T_gripper_board")}
        rms = {"reprojection_rms": found.rms, "reprojection_rms_by_picture": found.rms_by_picture}
        errors = {n: getattr(found, n) for n in ("error_position", "error_angle", "refit")}
        summary = {"out": self.out, **poses, **rms, **errors}
        print_result(summary, _text(found), warnings, json=self.json)
        if self.out is not None:
            write_camera(self.out, camera.at(found.T_world_camera))
            tell_written(self.out, json=self.json)
        return 0


def _text(found: Calibration) -> str:
    """For people."""
    x, y, z = found.T_world_camera[:3, 3]
    worst = max(found.rms_by_picture, key=lambda name: found.rms_by_picture[name])
    quaternion = Rotation.from_matrix(found.T_world_camera[:3, :3]).as_quat()
    turned = ", ".join(f"{q:.5f}" for q in quaternion)
    refit = ", ".join(f"{name} {v:.5g} +- {sd:.2g}" for name, (v, sd) in found.refit.items())
    most, below = found.rms_by_picture[worst], 1e3 * found.error_position
    rows = {
        "position": f"{x:.4f}, {y:.4f}, {z:.4f} m (error below {below:.2f} mm)",
        "quaternion": f"{turned} (x, y, z, w; error below {found.error_angle:.3f} degrees)",
        "reprojection": f"{found.rms:.3f} pixels RMS, most in {worst} ({most:.3f})",
        "where free": refit,
    }
    lines = [f"  {name:<14} {text}" for name, text in rows.items()]
    return "\n".join([f"T_world_camera from {len(found.rms_by_picture)} pictures", *lines])
