"""What is known of unknowns before and after a recording: Gaussians in transformed parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import check_numbers, require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.materials.unknowns import UNKNOWNS, Theta, Unknown
from gendom.reading import record_of

IDENTIFIABLE = 0.5
"""A parameter counts as determined where its posterior deviation is at most this share of the
prior's."""

NUMBERS = ("low", "high", "mean", "sd", "step", "widest")
"""Fields of `Prior` that are arrays."""


def half_width(level: float) -> float:
    """Of a Gaussian's central interval with this probability, in deviations."""
    return NormalDist().inv_cdf(0.5 + level / 2.0)


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Gaussian prior of P unknowns of an object and its recordings, in transformed coordinates."""

    names: tuple[str, ...]
    """A recording's own unknowns are named once for each recording."""
    owners: tuple[int | None, ...]
    """Which recording has each; None: the object, so that all recordings share it."""
    low: Array
    high: Array
    mean: Array
    sd: Array
    step: Array
    widest: Array

    @property
    def unknowns(self) -> list[Unknown]:
        return [UNKNOWNS[name] for name in self.names]

    def of(self, recording: int) -> list[int]:
        """Indices of the unknowns that a recording shares or has."""
        return [k for k, owner in enumerate(self.owners) if owner in (None, recording)]

    def taken(self, which: Sequence[int] | NDArray[np.intp]) -> Prior:
        """Prior of unknowns with these indices."""
        numbers = {name: getattr(self, name)[list(which)] for name in NUMBERS}
        owners = tuple(self.owners[k] for k in which)
        return Prior(names=tuple(self.names[k] for k in which), owners=owners, **numbers)

    def alone(self, which: Sequence[int] | NDArray[np.intp]) -> Prior:
        """Prior of those with these indices, of one recording, as if there were no other."""
        found = self.taken(which)
        return replace(found, owners=owners_of(found.names))

    def followed_by(self, other: Prior) -> Prior:
        """Prior of these unknowns and then those, none of them twice."""
        numbers = {n: np.append(getattr(self, n), getattr(other, n)) for n in NUMBERS}
        return Prior(names=self.names + other.names, owners=self.owners + other.owners, **numbers)

    def index(self, name: str, recording: int = 0) -> int:
        """Of an unknown, of this recording if each has its own.

        Raises:
            ValueError: It is not among them.
        """
        own = self.of(recording)
        return own[[self.names[k] for k in own].index(name)]

    def vector(self, *thetas: Theta) -> Array:
        """[P] transformed values of an estimate, one for each recording."""
        own = [thetas[owner or 0] for owner in self.owners]
        return np.array([u.transformed(t[u.name]) for u, t in zip(self.unknowns, own, strict=True)])

    def theta(self, vector: Sequence[float] | Array, base: Theta, recording: int = 0) -> Theta:
        """A recording's estimate with these transformed values [P], others as in ``base``."""
        own = self.of(recording)
        values = ((UNKNOWNS[self.names[k]], float(vector[k])) for k in own)
        return base.with_values({u.name: u.value(x) for u, x in values})

    def within(self, reach: float) -> tuple[Array, Array]:
        """[P] and [P] ends of the ranges, no farther than so many deviations from the means."""
        low, high = self.mean - reach * self.sd, self.mean + reach * self.sd
        return np.maximum(self.low, low), np.minimum(self.high, high)

    def clipped(self, vector: Array) -> Array:
        return np.clip(vector, self.low, self.high)


def prior_of(names: Iterable[str], changes: Mapping[str, Mapping[str, float]] = {}) -> Prior:
    """Prior of some unknowns, with changes of a scene to what `UNKNOWNS` says: by name, other
    values of low, high, mean, sd, step or widest.

    Raises:
        ParameterError: There is no such unknown, or one is named twice.
    """
    names = tuple(names)
    for name in names:
        what, fix = f"{name} is named twice", "name each unknown once"
        require(names.count(name) == 1, what, where="unknowns", fix=fix)
        known = f"choose from {', '.join(UNKNOWNS)}"
        require(name in UNKNOWNS, f"there is no unknown {name!r}", fix=known)
    chosen = [replace(UNKNOWNS[name], **changes.get(name, {})) for name in names]
    ends = {n: [u.transformed(getattr(u, n)) for u in chosen] for n in ("low", "high", "mean")}
    widths = {n: [getattr(u, n) for u in chosen] for n in ("sd", "step", "widest")}
    numbers = {n: np.array(values) for n, values in (ends | widths).items()}
    return Prior(names=names, owners=owners_of(names), **numbers)


def owners_of(names: Iterable[str]) -> tuple[int | None, ...]:
    """`Prior.owners` of the unknowns of one recording."""
    return tuple(None if UNKNOWNS[name].material else 0 for name in names)


def joint_prior(priors: Sequence[Prior]) -> Prior:
    """Joint prior of several recordings of one object: the material's unknowns once, from the first
    recording that has them, and the unknowns of each recording."""
    joint = priors[0]
    for recording, prior in enumerate(priors[1:], start=1):
        own = [k for k, name in enumerate(prior.names) if not UNKNOWNS[name].material]
        new = [k for k, name in enumerate(prior.names) if k in own or name not in joint.names]
        owners = tuple(recording if k in own else None for k in new)
        joint = joint.followed_by(replace(prior.taken(new), owners=owners))
    return joint


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

    def with_assumed(self, assumed: Prior) -> Posterior:
        """With an unknown of the object that was assumed, not estimated, and is as uncertain as its
        prior. What the recordings determine is the combination that `Unknown.steps_with` keeps:
        others vary with it."""
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
        half = half_width(level) * self.sd(name, recording)
        ends = np.clip(self.mean[k] + [-half, half], self.prior.low[k], self.prior.high[k])
        return u.value(float(ends[0])), u.value(float(ends[1]))

    def factors(
        self, powers: Mapping[str, float], level: float, other_sd: float = 0.0
    ) -> tuple[float, float]:
        """Ends of the interval of a product of powers (by name) of positive unknowns of the object,
        over its most likely value, with their joint uncertainty; unknowns that were not estimated
        are taken as exact. `other_sd` is the standard deviation of the logarithm of a factor that
        is none of them."""
        weights, z = np.zeros(len(self.names)), half_width(level)
        for name in set(powers) & set(self.names):
            weights[self.prior.index(name)] = powers[name]
        searched = np.sort([weights * self.prior.low, weights * self.prior.high], axis=0)
        half = z * math.sqrt(max(float(weights @ self.covariance @ weights), 0.0) + other_sd**2)
        at, other = float(weights @ self.mean), z * other_sd
        low, high = searched.sum(axis=1) - at + [-other, other]
        return math.exp(np.clip(-half, low, high)), math.exp(np.clip(half, low, high))

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
        """Inverse of `to_dict`; what is not told of the prior is as usual.

        Raises:
            ParameterError: It is none.
        """
        fix = "estimate again"
        stored = record_of(_StoredPosterior, read, where="posterior", fix=fix, error=ParameterError)
        names, P = stored.names, len(stored.names)
        usual = prior_of(dict.fromkeys(names))
        told = {"low": stored.low, "high": stored.high, "mean": stored.prior_mean,
                "sd": stored.prior_sd}  # fmt: skip
        told = {n: check_numbers(n, v, (P,)) for n, v in told.items() if v is not None}
        own = {} if stored.recordings is None else {"owners": stored.recordings}
        prior = replace(usual.taken([usual.names.index(n) for n in names]), **told, **own)
        mean = check_numbers("mean", stored.mean, (P,))
        covariance = np.array(stored.covariance).reshape(-1, P) if P else np.zeros((0, 0))
        check_numbers("covariance", covariance, (P, P))
        return cls(prior=prior, mean=mean, covariance=covariance, bases=tuple(bases))


@dataclass(frozen=True, kw_only=True)
class _StoredPosterior:
    """A `Posterior` in JSON."""

    names: tuple[str, ...]
    recordings: tuple[int | None, ...] | None = None
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    prior_mean: tuple[float, ...] | None = None
    prior_sd: tuple[float, ...] | None = None
    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None
