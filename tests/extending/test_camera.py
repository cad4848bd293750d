"""A new camera is one class, in a package with an entry point."""

import json

import numpy as np

from extending.lifts import FRAMES, depth_pictures, write_lift
from gendom.datasets import Recording

CODE = '''"""Cameras whose depth is one array: depth.npy [T, height, width] and times.npy [T]."""

from functools import partial

import numpy as np

from gendom.errors import RecordingError
from gendom.perception import Frame, Pictures, read_camera


class NpyCamera:
    def __init__(self, folder, *, on_warning):
        path = self.find(folder)
        self.camera = read_camera(folder / "camera.toml")
        self.times, self.depth = np.load(folder / "times.npy"), np.load(path, mmap_mode="r")
        if self.depth.shape != (len(self.times), self.camera.height, self.camera.width):
            what = f"has the shape {self.depth.shape}"
            raise RecordingError(what, where=str(path), fix="give one picture for each time")

    @staticmethod
    def find(folder):
        path = folder / "depth.npy"
        return path if path.exists() else None

    def __iter__(self):
        for t, time in enumerate(self.times):
            where = f"{self.camera.name}: picture {t}"
            yield Frame(float(time), where, partial(self.pictures, t))

    def pictures(self, t):
        return Pictures(np.array(self.depth[t]))
'''


def test_a_package_adds_a_camera(outside, tmp_path):
    outside.add("npy_camera", CODE, cameras="NpyCamera")
    lift = tmp_path / "lift"
    camera = write_lift(lift)
    np.save(camera / "times.npy", np.arange(FRAMES) / 30)
    np.save(camera / "depth.npy", depth_pictures())
    out = tmp_path / "lift.npz"
    made = outside.gendom("perceive", lift, "--no-table", "--out", out, "--json")
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["frames"] == FRAMES
    points = Recording.read(out).frame(0)
    assert len(points) > 20 and np.abs(points[:, :2]).max() < 0.01

    np.save(camera / "depth.npy", depth_pictures()[1:])
    refused = outside.gendom("perceive", lift, "--no-table", "--out", out)
    assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1
    assert "depth.npy: has the shape (3, 120, 160)" in refused.stderr
