"""Uncertain objects: the most likely one, and a Gaussian over plausible ones.

An estimate's posterior, or flags alone, become a Gaussian in the numbers of `QUANTITIES`, in
logarithms where ratios count. Numbers that no recording determines keep the deviation `ASSUMED_SD`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError
from gendom.materials import ASSUMED_SD, QUANTITIES, Item, from_columns, to_columns
from gendom.tasks import Task

Array = NDArray[np.float64]

LIMITS: dict[str, tuple[float, float]] = {
    "E_over_rho": (1e-2, 1e9),
    "nu": (0.05, 0.45),
    "damping": (3e-4, 0.2),
    "friction": (0.02, 1.5),
}
"""Lowest and highest value of each uncertain parameter, in SI units."""

OF_POSTERIOR = {
    "E_over_rho": "E_over_rho",
    "nu": "nu",
    "damping": "damping",
    "friction": "friction",
}
"""Names in the posterior of an estimate's file."""


def _of_these_sizes(posterior: Mapping[str, Any]) -> Array:
    """[P, P] covariance where the thickness is the estimated one, as that of the item is. Of an
    uncertain thickness and E / density, what bends alike is known better than either."""
    covariance = np.array(posterior["covariance"], dtype=float)
    if "thickness" not in posterior["names"]:
        return covariance
    k = list(posterior["names"]).index("thickness")
    shared = covariance[:, k]
    return covariance - np.outer(shared, shared) / covariance[k, k]


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """A Gaussian over P parameters of an object.

    Raises:
        ParameterError: A parameter is unknown, or the covariance is none.
    """

    item: Item
    """Has the sizes, the density, and the parameters that are taken as known."""
    names: tuple[str, ...]
    """Of `LIMITS`, the uncertain parameters."""
    mean: Array
    """[P] in SI units, logarithms where `QUANTITIES` says so."""
    covariance: Array
    """[P, P]."""

    def __post_init__(self) -> None:
        count = len(self.names)
        if unknown := [name for name in self.names if name not in LIMITS]:
            raise ParameterError(
                f"{unknown[0]!r} cannot be uncertain", fix=f"choose from {', '.join(LIMITS)}"
            )
        if self.mean.shape != (count,) or self.covariance.shape != (count, count):
            raise ParameterError(
                f"has {count} names, a mean of shape {self.mean.shape} and a covariance of shape "
                f"{self.covariance.shape}",
                where="belief",
            )
        finite = np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()
        if not finite or (count and np.linalg.eigvalsh(self.covariance).min() <= 0.0):
            raise ParameterError("covariance is not positive definite", where="belief")

    @classmethod
    def of(
        cls, item: Item, posterior: Mapping[str, Any] | None = None, *, known: Sequence[str] = ()
    ) -> Belief:
        """From an object and, if there is one, the `posterior` of an estimate's file.

        Args:
            item: With the most likely values.
            posterior: Names, transformed means and covariance, as `gendom.estimation` writes them;
                where it holds a parameter it replaces the item's value.
            known: Parameters that are taken as known, by names of `QUANTITIES`.

        Raises:
            ParameterError: The posterior cannot be used.
        """
        columns = to_columns(item)
        doubtful = [n for n in ASSUMED_SD if n not in known]
        mean = {n: _transformed(n, max(columns[QUANTITIES[n].column], 1e-6)) for n in doubtful}
        blocks = {n: {n: ASSUMED_SD[n] ** 2} for n in doubtful}
        if posterior is not None:
            try:
                found = [OF_POSTERIOR.get(n) for n in posterior["names"]]
                covariance = _of_these_sizes(posterior)
                for i, name in enumerate(found):
                    if name is None or name in known:
                        continue
                    mean[name] = float(posterior["mean"][i])
                    blocks[name] = {
                        other: float(covariance[i][j])
                        for j, other in enumerate(found)
                        if other is not None and other not in known
                    }
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise ParameterError(
                    f"cannot be used ({type(error).__name__} {error})",
                    where="posterior",
                    fix="estimate again",
                ) from None
        names = tuple(n for n in LIMITS if n in mean)
        covariance = np.array([[blocks[a].get(b, 0.0) for b in names] for a in names])
        return cls(
            item=item,
            names=names,
            mean=np.array([mean[n] for n in names]),
            covariance=covariance.reshape(len(names), len(names)),
        )

    @classmethod
    def for_task(
        cls,
        task: Task,
        item: Item,
        posterior: Mapping[str, Any] | None = None,
        *,
        known: Sequence[str] = (),
    ) -> Belief:
        """As `of`, where only what the task's outcome depends on is uncertain."""
        counts = uncertain(task, item)
        certain = [n for n in QUANTITIES if n in known or n not in counts]
        return cls.of(item, posterior, known=certain)

    def with_uncertain(self, name: str, sd: float) -> Belief:
        """With one more uncertain parameter, independent of the others, around the object's value.

        Args:
            name: Of `LIMITS`.
            sd: Standard deviation, of the logarithm where that counts.
        """
        value = to_columns(self.item)[QUANTITIES[name].column]
        count = len(self.names)
        covariance = np.zeros((count + 1, count + 1))
        covariance[:count, :count] = self.covariance
        covariance[count, count] = sd**2
        return replace(
            self,
            names=(*self.names, name),
            mean=np.append(self.mean, _transformed(name, value)),
            covariance=covariance,
        )

    @classmethod
    def from_dict(cls, item: Item, saved: Mapping[str, Any]) -> Belief:
        """Inverse of `to_dict`, of the same object."""
        mean, covariance = np.array(saved["mean"]), np.array(saved["covariance"])
        return cls(item=item, names=tuple(saved["names"]), mean=mean, covariance=covariance)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "names": list(self.names),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @property
    def sd(self) -> Array:
        """[P] standard deviations, of logarithms where these count."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def most_likely(self) -> Item:
        """The object at the mean."""
        return self.at(self.mean)

    def at(self, vector: Array) -> Item:
        """The object with transformed parameters [P], kept within `LIMITS`."""
        columns = dict(to_columns(self.item))
        for name, value in zip(self.names, vector, strict=True):
            plain = math.exp(value) if QUANTITIES[name].log else float(value)
            columns[QUANTITIES[name].column] = float(np.clip(plain, *LIMITS[name]))
        columns["E"] = columns["E_over_rho"] * columns["density"]
        return from_columns(self.item.kind, columns)

    def draws(self, count: int, seed: int) -> list[Item]:
        """Objects that are plausible."""
        rng = np.random.default_rng(seed)
        drawn = rng.multivariate_normal(self.mean, self.covariance, size=count)
        return [self.at(vector) for vector in drawn]

    def interval(self, name: str, deviations: float = 1.645) -> tuple[float, float]:
        """Ends of the interval of so many standard deviations (default: 90 %), in SI units.

        Raises:
            ValueError: The parameter is not uncertain.
        """
        k = self.names.index(name)
        low, high = (self.mean[k] + sign * deviations * self.sd[k] for sign in (-1.0, 1.0))
        if QUANTITIES[name].log:
            low, high = math.exp(low), math.exp(high)
        floor, ceiling = LIMITS[name]
        return max(float(low), floor), min(float(high), ceiling)


def uncertain(task: Task, item: Item) -> tuple[str, ...]:
    """Parameters that the outcome of a task depends on for such an object."""
    names = ["E_over_rho", "damping"]
    if item.kind == "cloth":
        names.insert(1, "nu")
    if task.scene(item).table is not None or task.scene(item).self_contact:
        names.append("friction")
    return tuple(names)


def _transformed(name: str, value: float) -> float:
    return math.log(value) if QUANTITIES[name].log else value
