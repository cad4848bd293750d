"""Calibration of intervals.

The likelihood's own deviations are wrong, because the simulator is not exact. The calibration comes
from lifts whose true parameters are known: `python -m experiments coverage --calibrate` records
random objects in the second reality, estimates them and writes, for each unknown, the factor of its
deviations or the deviation to add in squares, in the form of `assets/calibration.json`.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from gendom.materials.posterior import Posterior, Prior
from gendom.materials.unknowns import Theta

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class IntervalCalibration:
    """Calibration of intervals for one kind of object: factors of standard deviations, and what is
    added to them in squares."""

    factor: Mapping[str, float]
    added: Mapping[str, float]
    displaced: float = math.inf
    """Up to which displacement of the model, over the object's size, it holds."""

    @classmethod
    @functools.cache
    def of(cls, kind: str, frames: str = "all") -> IntervalCalibration:
        """The shipped one of ropes or cloths, of all frames or, of ropes, of the last one alone."""
        place = resources.files("gendom") / "assets" / "calibration.json"
        every = json.loads(place.read_text(encoding="utf-8"))
        read = every.get(f"{kind}-{frames}", every[kind])
        return cls(factor=read["factor"], added=read["added"], displaced=read["displaced"])

    @classmethod
    def none(cls) -> IntervalCalibration:
        return cls(factor={}, added={})

    def sd(self, name: str, own: float) -> float:
        """Standard deviation of a transformed unknown, from the likelihood's own."""
        return math.hypot(self.factor.get(name, 1.0) * own, self.added.get(name, 0.0))

    def posterior(
        self,
        prior: Prior,
        mean: Array,
        covariance: Array,
        bases: Sequence[Theta],
        added: Array | float = 0.0,
    ) -> Posterior:
        """A likelihood's Gaussian with calibrated deviations, and further ones [P] added in
        squares; they are at most those of the prior."""
        own = np.sqrt(np.diag(covariance))
        sd = np.array([self.sd(n, s) for n, s in zip(prior.names, own, strict=True)])
        sd = np.hypot(sd, added)
        share = np.minimum(sd, np.maximum(prior.sd, own)) / own
        return Posterior(
            prior=prior,
            mean=mean,
            covariance=covariance * share[:, None] * share,
            bases=tuple(bases),
        )
