"""How a cloth lies before its corner is lifted: flat, or as the first clouds show it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.datasets import Recording
from gendom.estimation.hold import Hold
from gendom.estimation.priors import HOLD_MEAN
from gendom.estimation.shapes import Sheet, best_sheet, shaped
from gendom.sim import Body

RAISED = 0.015
"""Height over the table's crop at which a cloth at rest shows that it does not lie flat [m]."""

FEWEST_RAISED = 100
"""Points that must show it."""

REST_FRAMES = 3
"""First frames, in which the cloth still lies."""


@dataclass(kw_only=True)
class Lying:
    """A cloth on its table, held by a corner."""

    recording: Recording
    frames: Sequence[int]
    """Those with points."""
    flat: Body
    """The cloth, flat and held at its very tip."""
    grip: NDArray[np.floating]
    """[3] where it is held then [m]."""
    size: float
    """Its diagonal [m]."""
    floor: float | None
    """Height below which the recording shows nothing, or None [m]."""
    sheet: Sheet | None = None
    """How it lies crumpled, or None until that is needed."""

    def laid(self, hold: Hold) -> Body:
        """The cloth held like this, on the stated table."""
        inwards = self.inwards()
        left = np.array([-inwards[1], inwards[0], 0.0])
        turn = Rotation.from_euler("z", hold.turn).as_matrix()
        if not hold.shaped:
            x = self.flat.x - self.grip - hold.inset * inwards - hold.aside * left
            return replace(self.flat, x=self.grip + x @ turn.T)
        x, curvature = self._shape(hold)
        axes = np.stack([inwards, left, [0.0, 0.0, 1.0]])
        x = self.grip + x @ axes @ turn.T
        # nothing lies under the table
        x[:, 2] = np.maximum(x[:, 2], self.grip[2] - self.flat.thickness)
        return replace(self.flat, x=x, curvature=curvature)

    def _shape(self, hold: Hold) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """What ``shaped`` says of this cloth."""
        if hold.crumple and self.sheet is None:
            self.register()
        described = self.recording.object
        assert described.width is not None and described.height is not None
        return shaped(
            self.flat.material_coordinates,
            hold,
            self.sheet,
            width=described.width,
            height=described.height,
        )

    def inwards(self) -> NDArray[np.floating]:
        """[3] horizontal unit vector from the held corner along the diagonal, before any turn."""
        towards = self.flat.x.mean(axis=0) - self.grip
        towards[2] = 0.0
        return towards / np.linalg.norm(towards)

    def _resting_points(self) -> NDArray[np.floating]:
        """[n, 3] points of the first frames that lie within the cloth's reach of the grip [m]."""
        points = np.concatenate([self.recording.frame(t) for t in self.frames[:REST_FRAMES]])
        away = np.linalg.norm(points[:, :2] - self.grip[:2], axis=1)
        return points[away < 1.15 * self.size].astype(float)

    @property
    def lies_raised(self) -> bool:
        """Whether the first frames show that a square cloth does not lie flat."""
        described = self.recording.object
        if self.floor is None or described.width != described.height:
            return False
        raised = self._resting_points()[:, 2] > self.floor + RAISED
        return int(raised.sum()) >= FEWEST_RAISED

    def register(self) -> None:
        """Find how the crumpled cloth lies."""
        assert self.floor is not None and self.recording.table_height is not None
        described = self.recording.object
        assert described.width is not None
        inwards = self.inwards()
        self.sheet = best_sheet(
            self._resting_points(),
            self.grip[:2],
            yaw=math.atan2(inwards[1], inwards[0]),
            size=described.width,
            floor=self.floor,
            table=self.recording.table_height - HOLD_MEAN.sink,
            inset=HOLD_MEAN.inset,
            aside=HOLD_MEAN.aside,
        )
