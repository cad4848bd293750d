"""A camera whose pictures are one array: depth.npy [T, height, width] and times.npy [T]
(`gendom.cameras`)."""

from functools import partial

import numpy as np

from gendom.perception import Frame, Pictures, read_camera


class NpyCamera:
    """A folder of it; its geometry stands in camera.toml."""

    def __init__(self, folder, *, on_warning):
        self.camera = read_camera(folder / "camera.toml")
        self.times, self.depth = (
            np.load(folder / "times.npy"),
            np.load(folder / "depth.npy", mmap_mode="r"),
        )

    @staticmethod
    def find(folder):
        """The file by which such a folder is known; None: it is another camera's."""
        path = folder / "depth.npy"
        return path if path.exists() else None

    def __iter__(self):
        for t, time in enumerate(self.times):
            where = f"{self.camera.name}: picture {t}"
            yield Frame(float(time), where, partial(self.pictures, t))

    def pictures(self, t):
        """Read when a frame is."""
        return Pictures(np.array(self.depth[t]))
