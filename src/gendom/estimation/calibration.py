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

    def posterior(
        self,
        prior: Prior,
        mean: Array,
        covariance: Array,
        bases: Sequence[Theta],
        added: Array | float = 0.0,
    ) -> Posterior:
        """A likelihood's Gaussian with calibrated deviations, and further ones [P] added in
        squares; they are at most those of the prior.

        What is added to an unknown's deviation is an error of the likelihood alone: the less it
        says, the nearer to the prior's mean the posterior's is.
        """
        own = np.sqrt(np.diag(covariance))
        factor, more = (
            np.array([by.get(name, usual) for name in prior.names])
            for by, usual in ((self.factor, 1.0), (self.added, 0.0))
        )
        wide = prior.sd**2
        both = np.minimum((factor * own) ** 2, (1.0 - 1e-9) * wide)
        alone = both * wide / (wide - both)  # the likelihood's variance without the prior
        weight = (wide + alone) / (wide + alone + more**2)
        mean = prior.mean + weight * (mean - prior.mean)
        sd = np.hypot(np.sqrt(weight * both * (1.0 + more**2 / alone)), added)
        share = np.minimum(sd, np.maximum(prior.sd, own)) / own
        return Posterior(
            prior=prior,
            mean=mean,
            covariance=covariance * share[:, None] * share,
            bases=tuple(bases),
        )
