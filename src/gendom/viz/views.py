"""From where a picture of clouds looks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gendom.errors import GendomError
from gendom.viz.clouds import CloudSequence

VIEWS = ("auto", "xz", "yz", "xy", "oblique")

OBLIQUE_TILT = 25.0
"""How far the view "oblique" looks downwards [degrees]."""


@dataclass(frozen=True, kw_only=True)
class View:
    """An orthographic projection."""

    turn: float
    """Angle about z from x to the direction that points right in the picture [rad]."""
    tilt: float
    """Angle by which the picture looks downwards [rad]: 0 from the side, pi / 2 from above."""
    names: tuple[str, str] | None
    """Names of the two axes; None: the picture shows all three."""

    @property
    def axes(self) -> np.ndarray:
        """[2, 3] unit vectors in the world that point right and up in the picture."""
        (c, s), (cos_tilt, sin_tilt) = ((math.cos(a), math.sin(a)) for a in (self.turn, self.tilt))
        return np.array([[c, s, 0.0], [-s * sin_tilt, c * sin_tilt, cos_tilt]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] right and up [m] of points [..., 3] [m]."""
        return points @ self.axes.T


def choose_view(sequence: CloudSequence, view: str = "auto") -> View:
    """A view by name, or the side view that shows most.

    "auto" has z upwards and the longer of x and y to the right; if the object hardly rises it
    looks from above. "oblique" shows all three axes, from 25 degrees above.

    Raises:
        GendomError: There is no view of this name.
    """
    if view not in VIEWS:
        raise GendomError(f"is {view!r}", where="view", fix=f"choose from {', '.join(VIEWS)}")
    if view == "auto":
        low, high = sequence.box()
        x, y, z = (high - low).tolist()
        view = "xy" if z < 0.25 * min(x, y) else "xz" if x >= y else "yz"
    turn, tilt = {
        "xz": (0.0, 0.0),
        "yz": (90.0, 0.0),
        "xy": (0.0, 90.0),
        "oblique": (30.0, OBLIQUE_TILT),
    }[view]
    names = None if view == "oblique" else (view[0], view[1])
    return View(turn=math.radians(turn), tilt=math.radians(tilt), names=names)
