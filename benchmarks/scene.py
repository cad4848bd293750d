"""The rope that every simulator is given: one file of numbers, so that nothing is said twice."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A straight rope in the air, held at one end by a gripper that rises at constant speed."""

    x: Any
    """[N, 3] positions at rest, inside the domain [m]."""
    volume: float
    """Of one particle [m^3]."""
    dx: float
    """Size of a grid cell [m]."""
    cells: int
    """Of the cubic domain along each axis, for simulators that need one; its corner is 0."""
    substep: float
    """[s]."""
    substeps: int
    frames: int
    """Equal parts of the substeps, at whose ends positions are recorded where that is asked."""
    E: float
    """Young's modulus [Pa]."""
    nu: float
    density: float
    """[kg/m^3]."""
    gravity: Any
    """[3] [m/s^2]."""
    grip_centre: Any
    """[3] where the gripper starts [m]."""
    grip_radius: float
    """Nodes up to this plus one cell from the centre take the gripper's velocity [m]."""
    grip_velocity: Any
    """[3] [m/s]."""

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters mu and lam [Pa]."""
        mu = self.E / (2.0 * (1.0 + self.nu))
        return mu, 2.0 * mu * self.nu / (1.0 - 2.0 * self.nu)

    def tip(self, x: Any) -> float:
        """How far the free end has risen, from positions [N, 3] [m]."""
        end = self.x[:, 0] > self.x[:, 0].max() - 0.1 * self.dx
        return float(np.mean(np.asarray(x, dtype=float)[end, 2] - self.x[end, 2]))

    def save(self, path: Path) -> None:
        np.savez(path, **asdict(self))

    @classmethod
    def load(cls, path: Path) -> "Scene":
        with np.load(path) as file:
            return cls(**{k: v if v.ndim else v.item() for k, v in file.items()})
