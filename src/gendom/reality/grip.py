"""Slip between the fingers: beyond a largest pull, held vertices slide.

This is isotropic dry friction: a vertex is fixed while it pulls by no more than the grip's force,
else it slides against that force until it has come to rest or has left the fingers. Friction is a
damping of the vertices that is the force over their speed, which MuJoCo's integrator takes
implicitly; it stops below `CREEP`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.errors import ParameterError

CREEP = 1e-4
"""Speed below which a sliding vertex that decelerates is at rest [m/s]."""


class Slip:
    """The vertices that slide between a hand's fingers.

    Args:
        force: That the fingers hold at most [N]; infinite: all.
        masses: [V] of the vertices [kg].
        dofs: [V, 3] their slides.

    Raises:
        ParameterError: The force is not above 0.
    """

    def __init__(self, force: float, masses: npt.NDArray[np.float64], dofs: npt.NDArray[np.intp]):
        if not force > 0.0:
            raise ParameterError(f"is {force:g}", where="grip_force", fix="give newtons above 0")
        self.force = force
        self._masses = masses
        self._dofs = dofs
        self._speed = 0.0
        self.vertices = np.empty(0, dtype=np.intp)
        """Vertices between the fingers that are not fixed."""

    @property
    def possible(self) -> bool:
        return math.isfinite(self.force)

    def begin(self, vertices: npt.NDArray[np.intp]) -> None:
        self.vertices, self._speed = vertices, 0.0

    def end(self, model: Any) -> npt.NDArray[np.intp]:
        """Free all of them; returns which."""
        vertices, self.vertices = self.vertices, self.vertices[:0]
        model.dof_damping[self._dofs[vertices]] = 0.0
        return vertices

    def leave(self, model: Any, away: npt.NDArray[np.bool_]) -> None:
        """Free those of them that have left the fingers."""
        model.dof_damping[self._dofs[self.vertices[away]]] = 0.0
        self.vertices = self.vertices[~away]

    def rub(
        self, model: Any, data: Any, hand: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        """Set friction for the next step.

        Args:
            model, data: MuJoCo's.
            hand: [3] velocity of the fingers [m/s].

        Returns:
            [k, 3] forces on what slides that belong to the damping [N], and whether it has come to
            rest.
        """
        dofs = self._dofs[self.vertices]
        share = self._masses[self.vertices] / self._masses[self.vertices].sum()
        before = self._speed
        self._speed = float(np.linalg.norm(share @ (data.qvel[dofs] - hand)))
        damping = self.force / max(2.0 * self._speed - before, CREEP) * share[:, None]
        model.dof_damping[dofs] = damping
        return damping * hand, self._speed < CREEP and self._speed <= before


def pull(mujoco: Any, data: Any, connections: npt.NDArray[np.intp]) -> float:
    """By how much connections to a hand were pulled in the last step [N]."""
    equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    rows = np.flatnonzero(equality & np.isin(data.efc_id, connections))
    # three rows each, along the world's axes
    return float(np.linalg.norm(data.efc_force[rows].reshape(-1, 3).sum(axis=0)))
