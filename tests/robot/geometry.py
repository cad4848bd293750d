"""Where the tool goes, whenever it is there."""

import numpy as np

from gendom.robot import XARM7, JointMotion, TcpPath


def off_the_path(path: TcpPath, motion: JointMotion) -> float:
    """Largest distance of the tool from the line of its rounded path [m]."""
    half = 0.5 * motion.blend
    line = path.position_at(np.linspace(path.start - half, path.end + half, 4001), motion.blend)
    tool = motion.tcp_at(XARM7, motion.sampled(200.0))[:, :3, 3]
    a, step = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((step * step).sum(axis=1), 1e-30)
    along = np.clip(((tool[:, None] - a) * step).sum(axis=2) / length2, 0.0, 1.0)
    nearest = a + along[..., None] * step
    return float(np.linalg.norm(tool[:, None] - nearest, axis=2).min(axis=1).max())
