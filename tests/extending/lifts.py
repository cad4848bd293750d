"""A lift of a hanging rope as depth arrays, for packages that read or explain them."""

from pathlib import Path

import numpy as np

FRAMES = 4
CAMERA = """\
width = 160
height = 120
depth_unit = 0.001
K = [[200.0, 0.0, 80.0], [0.0, 200.0, 60.0], [0.0, 0.0, 1.0]]
# at (0, -0.6, 0.2), it looks along y
T_world_camera = [[1, 0, 0, 0], [0, 0, 1, -0.6], [0, -1, 0, 0.2], [0, 0, 0, 1]]
"""


def depth_pictures(*, post: bool = False) -> np.ndarray:
    """[FRAMES, 120, 160] millimetres: a rope at x = 0 before a wall, and a post at x = 0.12 m."""
    depth = np.full((FRAMES, 120, 160), 1500, np.uint16)
    for t in range(FRAMES):
        depth[t, 25 : 105 - 3 * t, 79:82] = 600
    if post:
        depth[:, 20:110, 118:123] = 600
    return depth


def write_lift(folder: Path, *, robot: str = "") -> Path:
    """Everything of a recording but the pictures; returns the folder of its camera."""
    camera = folder / "cameras" / "left"
    camera.mkdir(parents=True)
    (camera / "camera.toml").write_text(CAMERA)
    rows = [f"{t / 30},0,0,0.31" for t in range(FRAMES)]
    (folder / "gripper.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    named = f'robot = "{robot}"\n' if robot else ""
    (folder / "object.toml").write_text(
        f'{named}[object]\nkind = "rope"\nlength = 0.25\ndiameter = 0.01\n'
    )
    return camera
