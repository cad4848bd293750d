"""The posterior of a recording: a Gaussian in transformed parameters, with calibrated deviations.

The likelihood's own deviations are wrong, because the simulator is not exact. The calibration comes
from lifts whose true parameters are known: `python -m experiments coverage` records random objects
in the second reality, estimates them and writes, for each unknown, the factor of its deviations or
the deviation to add in squares, in the form of `assets/calibration.json`.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gendom.estimation.theta import UNKNOWNS, Prior, Theta, owners_of

Array = NDArray[np.floating]

IDENTIFIABLE = 0.5
"""A parameter counts as determined where its posterior deviation is at most this share of the
prior's."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration of intervals for one kind of object: factors of standard deviations, and what is
    added to them in squares."""

    factor: Mapping[str, float]
    added: Mapping[str, float]
    displaced: float = math.inf
    """Up to which displacement of the model, over the object's size, it holds."""

    @classmethod
    @functools.cache
    def of(cls, kind: str, frames: str = "all") -> Calibration:
        """The shipped one of ropes or cloths, of all frames or, of ropes, of the last one alone."""
        place = resources.files("gendom") / "assets" / "calibration.json"
        every = json.loads(place.read_text(encoding="utf-8"))
        read = every.get(f"{kind}-{frames}", every[kind])
        return cls(factor=read["factor"], added=read["added"], displaced=read["displaced"])

    @classmethod
    def none(cls) -> Calibration:
        return cls(factor={}, added={})

    def sd(self, name: str, own: float) -> float:
        """Standard deviation of a transformed unknown, from the likelihood's own."""
        return math.hypot(self.factor.get(name, 1.0) * own, self.added.get(name, 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """P unknowns, Gaussian where `UNKNOWNS` transforms them to."""

    prior: Prior
    mean: Array
    """[P] transformed."""
    covariance: Array
    """[P, P]."""
    bases: tuple[Theta, ...]
    """For each recording the values of everything that was not estimated."""

    @classmethod
    def calibrated(
        cls,
        prior: Prior,
        mean: Array,
        covariance: Array,
        bases: Sequence[Theta],
        calibration: Calibration,
        added: Array | float = 0.0,
    ) -> Posterior:
        """With calibrated deviations, and further ones [P] added in squares; they are at most those
        of the prior."""
        own = np.sqrt(np.diag(covariance))
        sd = np.array([calibration.sd(n, s) for n, s in zip(prior.names, own, strict=True)])
        sd = np.hypot(sd, added)
        share = np.minimum(sd, np.maximum(prior.sd, own)) / own
        return cls(
            prior=prior,
            mean=mean,
            covariance=covariance * share[:, None] * share,
            bases=tuple(bases),
        )

    def of_prior(self) -> Posterior:
        """With the deviations of the prior: recordings that are not usable tell nothing."""
        return replace(self, covariance=np.diag(self.prior.sd**2))

    def with_assumed(self, assumed: Prior) -> Posterior:
        """With an unknown of the object that was assumed, not estimated, and is as uncertain as its
        prior. What the recordings determine is the combination that `Unknown.steps_with` keeps:
        others vary with it.

        Args:
            assumed: Its prior.
        """
        (u,), sd = assumed.unknowns, float(assumed.sd[0])
        along = np.append(np.zeros(len(self.names)), 1.0)
        for other, share in u.steps_with:
            if other in self.names:
                along[self.prior.index(other)] = share
        return replace(
            self,
            prior=self.prior.followed_by(assumed),
            mean=np.append(self.mean, u.transformed(getattr(self.theta, u.name))),
            covariance=np.pad(self.covariance, (0, 1)) + sd**2 * np.outer(along, along),
        )

    @property
    def names(self) -> tuple[str, ...]:
        return self.prior.names

    @property
    def theta(self) -> Theta:
        """The most likely values, of the first recording where each has its own."""
        return self.thetas[0]

    @property
    def thetas(self) -> tuple[Theta, ...]:
        """The most likely values of each recording."""
        return tuple(self.prior.theta(self.mean, b, k) for k, b in enumerate(self.bases))

    def sd(self, name: str, recording: int = 0) -> float:
        """Standard deviation of a transformed unknown."""
        k = self.prior.index(name, recording)
        return math.sqrt(float(self.covariance[k, k]))

    def determined(self, name: str) -> bool:
        """Whether the recordings determine an unknown of the object, or the first its own."""
        if name not in self.names:
            return False
        return self.sd(name) < IDENTIFIABLE * float(self.prior.sd[self.prior.index(name)])

    def interval(self, name: str, level: float, recording: int = 0) -> tuple[float, float]:
        """Ends of the central interval of an unknown, within the range that was searched."""
        k, u = self.prior.index(name, recording), UNKNOWNS[name]
        half = float(norm.ppf(0.5 + level / 2.0)) * self.sd(name, recording)
        low, high = (
            float(np.clip(self.mean[k] + sign * half, self.prior.low[k], self.prior.high[k]))
            for sign in (-1.0, 1.0)
        )
        return u.value(low), u.value(high)

    def product(
        self, powers: Mapping[str, float], level: float, other_sd: float = 0.0
    ) -> tuple[float, float]:
        """Ends of the interval of a product of powers of positive unknowns of the object, with
        their joint uncertainty; unknowns that were not estimated are taken as exact.

        Args:
            powers: By name.
            level: Probability of the interval.
            other_sd: Standard deviation of the logarithm of a factor that is none of them.
        """
        centre, low, high = 0.0, 0.0, 0.0
        slope = np.zeros(len(self.names))
        for name, power in powers.items():
            if name not in self.names:
                centre += power * math.log(getattr(self.bases[0], name))
                continue
            k = self.prior.index(name)
            slope[k] = power
            ends = sorted((power * self.prior.low[k], power * self.prior.high[k]))
            low, high = low + ends[0], high + ends[1]
        z = float(norm.ppf(0.5 + level / 2.0))
        half = z * math.sqrt(max(float(slope @ self.covariance @ slope), 0.0) + other_sd**2)
        at, low, high = float(slope @ self.mean), low - z * other_sd, high + z * other_sd
        return (
            math.exp(centre + float(np.clip(at - half, low, high))),
            math.exp(centre + float(np.clip(at + half, low, high))),
        )

    def draws(self, count: int, seed: int, recording: int = 0) -> Sequence[Theta]:
        """A recording's estimates drawn from it, within the ranges that were searched."""
        rng = np.random.default_rng(seed)
        drawn = rng.multivariate_normal(self.mean, self.covariance, size=count)
        base = self.bases[recording]
        return [self.prior.theta(self.prior.clipped(v), base, recording) for v in drawn]

    def to_dict(self) -> dict[str, Any]:
        """For JSON: names, whose they are, transformed means and covariance."""
        return {
            "names": list(self.names),
            "recordings": list(self.prior.owners),
            "log": [UNKNOWNS[n].log for n in self.names],
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "prior_mean": self.prior.mean.tolist(),
            "prior_sd": self.prior.sd.tolist(),
            "low": self.prior.low.tolist(),
            "high": self.prior.high.tolist(),
        }

    @classmethod
    def from_dict(cls, read: Mapping[str, Any], bases: Sequence[Theta]) -> Posterior:
        """Inverse of `to_dict`; files of older versions are of one recording.

        Raises:
            KeyError, TypeError, ValueError: It is none.
        """
        names = tuple(str(n) for n in read["names"])
        numbers = {k: np.array(read[k], dtype=float) for k in ("mean", "low", "high")}
        prior = Prior(
            names=names,
            owners=tuple(
                None if owner is None else int(owner)
                for owner in read.get("recordings", owners_of(names))
            ),
            low=numbers["low"],
            high=numbers["high"],
            mean=np.array(read["prior_mean"], dtype=float),
            sd=np.array(read["prior_sd"], dtype=float),
            step=np.array([UNKNOWNS[n].step for n in names]),
            widest=np.array([UNKNOWNS[n].widest for n in names]),
        )
        covariance = np.array(read["covariance"], dtype=float).reshape(len(names), len(names))
        return cls(prior=prior, mean=numbers["mean"], covariance=covariance, bases=tuple(bases))
