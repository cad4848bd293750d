"""An `Estimate`: what is known of an object, from the search to the policy, and its file.

The file (``estimate.json``, format ``gendom-estimate/1``) holds SI units;
`gendom.materials.estimate_file` reads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.files import write_json
from gendom.materials.estimate_file import (
    CHECKSUM,
    FORMAT,
    HIDDEN,
    LEVEL,
    NOTHING_ESTIMATED,
    SIZES,
    USABLE,
    Derived,
    Verdict,
    check_record,
    checksum,
    derived,
    fields_of,
    read_record,
)
from gendom.materials.objects import (
    ASSUMED,
    KINDS,
    STANDARD_GRAVITY,
    Cloth,
    Item,
    Rope,
    from_columns,
    to_columns,
)
from gendom.materials.parameters import bending_length
from gendom.materials.posterior import Posterior, Prior, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.shown import Shown

T = TypeVar("T", Rope, Cloth)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimate(Shown):
    """What is known of a rope or a cloth.

    Raises:
        ParameterError: The posterior's covariance is not positive definite.
    """

    kind: str
    """``rope`` or ``cloth``."""
    known: Mapping[str, float]
    """Numbers that are not in the posterior, in SI units: sizes as stated, mass or density, and
    parameters, which replace those of the posterior for the most likely object."""
    posterior: Posterior = NOTHING_ESTIMATED
    verdict: Verdict = USABLE
    level: float = LEVEL
    """Probability of the intervals."""
    density_sd: float = 0.0
    """Standard deviation of the logarithm of a density that is assumed."""
    given: frozenset[str] = frozenset()
    """Names of parameters that are taken as exact, whatever a task depends on."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """The file's further entries: fit and search, executions."""

    def __post_init__(self) -> None:
        mean, covariance = self.mean, self.covariance
        finite = bool(np.isfinite(mean).all() and np.isfinite(covariance).all())
        definite = finite and (not len(mean) or np.linalg.eigvalsh(covariance).min() > 0.0)
        require(definite, "covariance is not positive definite", where="posterior")

    @classmethod
    def of(cls, item: Item, posterior: Mapping[str, Any] | None = None) -> Estimate:
        """The most likely object, of which everything is known but for, perhaps, a Gaussian as
        `Posterior.to_dict` writes it.

        Raises:
            ParameterError: The posterior cannot be used.
        """
        known = {n: v for n, v in to_columns(item).items() if n != "E"}
        own = NOTHING_ESTIMATED if posterior is None else Posterior.from_dict(posterior, ())
        return Estimate(kind=item.kind, known=known, posterior=own)

    # ---- values ----------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Of the P unknowns of the posterior."""
        return self.posterior.names

    @property
    def mean(self) -> Array:
        """[P] transformed: logarithms where `UNKNOWNS` says so."""
        return np.asarray(self.posterior.mean, dtype=float)

    @property
    def covariance(self) -> Array:
        """[P, P] of that."""
        return np.asarray(self.posterior.covariance, dtype=float)

    @property
    def sd(self) -> Array:
        """[P] standard deviations of that."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def theta(self) -> Theta:
        """The most likely value of every unknown, of the first recording where each has its own."""
        return self.posterior.theta

    @property
    def usable(self) -> bool:
        return self.verdict.usable

    def value(self, name: str) -> float | None:
        """The most likely value of a number of the material or of a size, None: not known."""
        if name in self.known:
            found = self.known[name]
            if name == self._small and "thickness" in self.names:
                found *= self._estimated("thickness")
            elif name == "density" and "mass" in self.known and "thickness" in self.names:
                found /= self._estimated("thickness") ** KINDS[self.kind].thickness_power
            return found
        return self._estimated(name) if name in self.names else None

    def _estimated(self, name: str) -> float:
        return UNKNOWNS[name].value(float(self.mean[self.posterior.prior.index(name)]))

    def _need(self, name: str) -> float:
        value = self.value(name)
        if value is None:
            raise ParameterError(f"{name} is not known", where="estimate", fix="estimate it")
        return value

    @property
    def E(self) -> float:
        """Young's modulus [Pa]."""
        return self.E_over_rho * self.density

    @property
    def E_over_rho(self) -> float:
        """Young's modulus over density [m^2/s^2]."""
        return self._need("E_over_rho")

    @property
    def nu(self) -> float:
        """Poisson's ratio [-]."""
        return self._need("nu")

    @property
    def density(self) -> float:
        """Mass density [kg/m^3]."""
        return self._need("density")

    @property
    def bending_length(self) -> float:
        """Length over which gravity bends the object [m]."""
        k = self._need(self._small) / (4.0 if self.kind == "rope" else math.sqrt(12.0))
        return bending_length(self.E_over_rho, k, STANDARD_GRAVITY)

    @property
    def bending_stiffness(self) -> float:
        """E I of a rope's section [N m^2], D of a cloth per width [N m]."""
        h = self._need(self._small)
        if self.kind == "rope":
            return self.E * math.pi * h**4 / 64.0
        return self.E * h**3 / (12.0 * (1.0 - self.nu**2))

    @property
    def _small(self) -> str:
        """Name of the smaller size."""
        return KINDS[self.kind].sizes[1]

    def interval(self, name: str) -> tuple[float, float] | None:
        """Ends of the interval of a value of the file, None where there is none."""
        ends = (self.record["intervals"] or {}).get(name)
        return None if ends is None else (float(ends[0]), float(ends[1]))

    # ---- the object ------------------------------------------------------------------------------

    @property
    def assumed(self) -> dict[str, float]:
        """Numbers of the object that neither the estimate nor a flag says."""
        return {name: value for name, value in ASSUMED.items() if not self._says(name)}

    def _says(self, name: str) -> bool:
        hidden = name in HIDDEN and name not in self.known and not self.posterior.determined(name)
        return self.value(name) is not None and not hidden

    @cached_property
    def item(self) -> Item:
        """The object with the estimated material; what is not known is assumed.

        Raises:
            ParameterError: E over density or a size is not known.
        """
        made = self._usual
        for name in self.names:
            applied = UNKNOWNS[name].on_object
            if applied is not None and name not in ("E_over_rho", *ASSUMED):
                made = applied(made, self._estimated(name))
        return made

    @cached_property
    def _usual(self) -> Item:
        """The object without effects of unknowns that other packages have registered."""
        numbers = {n: self._need(n) if self._says(n) else value for n, value in ASSUMED.items()}
        square = self.kind == "cloth" and "side" not in self.known
        for name in KINDS[self.kind].sizes:
            numbers[name] = self._need("width" if square and name == "side" else name)
        return from_columns(self.kind, {**numbers, "E": self.E_over_rho * numbers["density"]})

    def rope(self) -> Rope:
        """The rope with the estimated material.

        Raises:
            ParameterError: It is a cloth.
        """
        return self._made(Rope)

    def cloth(self) -> Cloth:
        """The cloth with the estimated material, square as wide as stated; errors as of `rope`."""
        return self._made(Cloth)

    def _made(self, made: type[T]) -> T:
        item = self.item
        if not isinstance(item, made):
            what, fix = f"is of a {item.kind}", f"take its {item.kind}()"
            raise ParameterError(what, where="estimate", fix=fix)
        return item

    def at(self, vector: Array) -> Item:
        """The object with transformed unknowns [P], kept within their ranges."""
        item = self._usual
        for name, x in zip(self.names, vector, strict=True):
            u = UNKNOWNS[name]
            if u.on_object is not None:
                item = u.on_object(item, float(np.clip(u.value(float(x)), u.low, u.high)))
        return item

    @property
    def most_likely(self) -> Item:
        """The object at the posterior's mean, also in what the recording does not determine."""
        return self.at(self.mean)

    def draws(self, count: int, seed: int) -> list[Item]:
        """Plausible objects, all of one size."""
        own = self.of_object(self.names)
        rng, drawn = np.random.default_rng(seed), np.empty((count, 0))
        if len(own.mean):  # NumPy has none of no numbers
            drawn = rng.multivariate_normal(own.mean, own.covariance, size=count)
        return [own.at(vector) for vector in drawn]

    # ---- what is uncertain -----------------------------------------------------------------------

    def of_object(self, names: Sequence[str]) -> Self:
        """What it says of an object of exactly the estimated size, in some of the unknowns, without
        those that have no `Unknown.on_object`.

        Where the posterior has none of the names that are usually assumed, the prior's deviation
        counts, about what is assumed. Numbers that are `given` are not uncertain."""
        chosen = [
            u
            for name, u in UNKNOWNS.items()
            if name in names and u.on_object is not None and name not in self.given
            if name in self.names or name in ASSUMED
        ]
        assumed = {u.name: self.known.get(u.name, ASSUMED.get(u.name, 0.0)) for u in chosen}
        mean = np.array([u.transformed(max(assumed[u.name], 1e-6)) for u in chosen])
        covariance = np.diag([u.sd**2 for u in chosen])
        own = [i for i, u in enumerate(chosen) if u.name in self.names]
        at = [self.posterior.prior.index(chosen[i].name) for i in own]
        mean[own] = self.mean[at]
        covariance[own] = covariance[:, own] = 0.0
        covariance[np.ix_(own, own)] = self._of_this_size()[np.ix_(at, at)]
        # what is not uncertain any more stays as it most likely is
        known = {n: v for n, v in to_columns(self._usual).items() if n != "E"}
        prior = prior_of(u.name for u in chosen)
        return replace(self, known=known).with_gaussian(mean, covariance, prior)

    def _of_this_size(self) -> Array:
        """[P, P] covariance with the thickness at its most likely value. Of an uncertain thickness
        and E over density, what bends alike is known better than either."""
        if "thickness" not in self.names:
            return self.covariance
        k = self.posterior.prior.index("thickness")
        shared = self.covariance[:, k]
        return self.covariance - np.outer(shared, shared) / self.covariance[k, k]

    def with_gaussian(self, mean: Array, covariance: Array, prior: Prior | None = None) -> Self:
        """With another mean [P] and covariance [P, P], perhaps of other unknowns."""
        prior = prior or self.posterior.prior
        posterior = replace(self.posterior, prior=prior, mean=mean, covariance=covariance)
        return replace(self, posterior=posterior)

    def with_uncertain(self, name: str, sd: float) -> Self:
        """With one more uncertain unknown, independent of the others, around the object's value;
        the deviation is that of the logarithm where that counts."""
        value = self.value(name)
        mean = UNKNOWNS[name].transformed(ASSUMED[name] if value is None else value)
        covariance = np.pad(self.covariance, (0, 1))
        covariance[-1, -1] = sd**2
        prior = self.posterior.prior.followed_by(prior_of([name]))
        return self.with_gaussian(np.append(self.mean, mean), covariance, prior)

    def with_known(self, values: Mapping[str, float]) -> Self:
        """With numbers that are given: sizes and parameters in SI units, E among them. With another
        E or density nothing is left of the posterior, which was of other numbers."""
        known = {**self.known, **values}
        given = set(values)
        posterior = self.posterior
        if given & {"E", "density"}:
            for name in (*ASSUMED, self._small):
                value = self.value(name)
                if name not in values and value is not None and self._says(name):
                    known[name] = value
            E = known.pop("E", None)
            if E is None and self.value("E_over_rho") is not None and "density" in self.known:
                E = self.E
            known.pop("E_over_rho", None)
            posterior = NOTHING_ESTIMATED
            if E is not None and "density" in known:
                known["E_over_rho"] = E / known["density"]
                given.add("E_over_rho")
            elif E is not None:
                known["E"] = E
        return replace(self, known=known, given=self.given | given, posterior=posterior)

    def updated(self, learned: Estimate, entries: Mapping[str, Any]) -> Self:
        """With the unknowns of another estimate of the same object, which knows more, and further
        entries of the file. What is not among them is independent of them, but for the thickness:
        what bends alike stays so."""
        old, mine, P = self.posterior, learned.names, len(learned.names)
        owned = enumerate(zip(old.names, old.prior.owners, strict=True))
        kept = [k for k, (name, owner) in owned if owner is not None or name not in mine]
        at = {n: old.prior.index(n) for n in mine if n in old.names}
        means = {n: UNKNOWNS[n].value(float(old.prior.mean[k])) for n, k in at.items()}
        changes = {n: {"mean": means[n], "sd": float(old.prior.sd[k])} for n, k in at.items()}
        covariance = np.pad(learned.covariance, (0, len(kept)))
        covariance[P:, P:] = old.covariance[np.ix_(kept, kept)]
        if "thickness" in old.names:
            k = old.prior.index("thickness")
            t, variance = P + kept.index(k), old.covariance[k, k]
            shared = np.array([old.covariance[at[n], k] if n in at else 0.0 for n in mine])
            covariance[:P, :P] += np.outer(shared, shared) / variance
            covariance[:P, t] = covariance[t, :P] = shared
        prior = prior_of(mine, changes).followed_by(old.prior.taken(kept))
        mean = np.concatenate([learned.mean, old.mean[kept]])
        known = {n: v for n, v in self.known.items() if n not in mine}
        about = {**self.about, **entries}
        return replace(self, known=known, about=about).with_gaussian(mean, covariance, prior)

    # ---- the file --------------------------------------------------------------------------------

    @cached_property
    def record(self) -> dict[str, Any]:
        """The JSON document. ``intervals`` and ``bounds``, the range that was searched, hold
        [low, high] by the names of the values; ``intervals`` is null where the verdict is not
        usable; ``recordings`` has the entries of each recording, those of the first are at the top
        level, too."""
        values = self._values()
        intervals, bounds, known = self._ranges(values)
        object_ = {n: self.value(n) for n in (*SIZES[:-1], "mass")}
        side = {"side": self.known["side"]} if "side" in self.known else {}
        entries: dict[str, Any] = {**self.about, "format": FORMAT}
        if self.posterior.bases:
            entries["theta"] = dict(self.theta)
            if self.theta.offsets:
                entries["marker_offsets"] = list(self.theta.offsets)
        record = {
            **entries,
            **values,
            "density_assumed": "mass" not in self.known,
            "density_sd": self.density_sd,
            "verdict": {"usable": self.usable, "reasons": list(self.verdict.reasons)},
            "intervals": {"level": self.level, **intervals} if self.usable else None,
            "bounds": bounds,
            "identifiable": known,
            "posterior": self.posterior.to_dict(),
            "object": {"kind": self.kind, **object_, **side},
        }
        return {**record, CHECKSUM: checksum(record)}

    @cached_property
    def _derived(self) -> dict[str, Derived]:
        return derived(self.kind, weighed="mass" in self.known)

    def _values(self) -> dict[str, float | None]:
        """The file's values: those that every object has, and what follows from them."""
        values = {n: self.value(n) for n, u in UNKNOWNS.items() if u.material}
        values["thickness"] = self.value(self._small) if "thickness" in self.names else None
        values["density"] = self.value("density")
        for name, number in self._derived.items():
            known = all(self.value(other) is not None for other in ("E_over_rho", *number.needs))
            values[name] = getattr(self, name) if known else None
        return values

    def _ranges(
        self, values: Mapping[str, float | None]
    ) -> tuple[dict[str, list[float]], dict[str, list[float]], dict[str, bool]]:
        """Intervals, searched ranges, and whether each of the file's values is determined."""
        posterior = self.posterior
        intervals: dict[str, list[float]] = {}
        bounds: dict[str, list[float]] = {}
        known: dict[str, bool] = dict.fromkeys(("E_over_rho", "nu", "friction", "damping"), False)
        for k, name in enumerate(posterior.names):
            u = UNKNOWNS[name]
            if not u.material:
                continue
            unit = self.known.get(self._small, 1.0) if name == "thickness" else 1.0
            intervals[name] = [unit * end for end in posterior.interval(name, self.level)]
            ends = posterior.prior.low[k], posterior.prior.high[k]
            bounds[name] = [unit * u.value(float(end)) for end in ends]
            known[name] = posterior.determined(name)
        known["E"] = known["E_over_rho"]
        for name, number in self._derived.items():
            value, power = values[name], number.power
            if "E_over_rho" not in posterior.names or value is None:
                continue
            powers = {"E_over_rho": power, "thickness": power * number.thicker}
            ends = posterior.factors(powers, self.level, number.heavier * self.density_sd)
            intervals[name] = [value * end for end in ends]
            middle = self._estimated("E_over_rho")
            bounds[name] = [value * (end / middle) ** power for end in bounds["E_over_rho"]]
        return intervals, bounds, known

    def save(self, path: str | Path) -> None:
        """Write ``estimate.json``, atomically.

        Raises:
            GendomError: The place cannot be written.
        """
        write_json(path, self.record)

    @classmethod
    def load(cls, path: str | Path, *, even_unusable: bool = True) -> Estimate:
        """Read what `save`, ``gendom estimate`` or ``gendom adapt`` wrote.

        Args:
            path: The file.
            even_unusable: Take one whose verdict is not usable, too.

        Raises:
            ParameterError: It is no estimate, or that of a recording that gave none, or it was
                changed after it was written.
            GendomError: It cannot be read.
        """
        return Estimate.from_dict(read_record(path, even_unusable=even_unusable), str(path))

    @classmethod
    def from_dict(cls, read: Mapping[str, Any], where: str = "estimate") -> Estimate:
        """Inverse of `record`; errors as of `load`."""
        check_record(read, where)
        try:
            found = cls(**fields_of(read))
            found.rows()  # all that follows from its numbers can be said
            return found
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            what, fix = f"cannot be used: {type(error).__name__} {error}", "estimate again"
            raise ParameterError(what, where=where, fix=fix) from None

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and interval of what was found, with units, for tables."""
        record, ours = self.record, self._derived
        every = ["E", "E_over_rho", *ours, *(n for n, u in UNKNOWNS.items() if u.material)]
        if {"E_over_rho", "thickness"} <= set(self.names):
            k = self.posterior.prior.index("E_over_rho")
            if self._of_this_size()[k, k] < 0.5 * self.covariance[k, k]:
                # most of the uncertainty is that of the thickness, on which this does not depend
                every = list(dict.fromkeys(["bending_length", *every]))
        shown = {name: ours.get(name) or UNKNOWNS[name] for name in every}
        titles = {n: (q.title, "" if q.unit == "1" else q.unit, q.form) for n, q in shown.items()}
        titles["thickness"] = (self._small, "m", ".4g")
        titles["density"] = ("density", "kg/m^3", ".4g")
        rows = []
        for name, (title, unit, form) in titles.items():
            if record.get(name) is None:
                continue
            remarks = []
            ends = self.interval(name)
            if ends is not None:
                remarks.append(f"{self.level:.0%} in [{ends[0]:{form}}, {ends[1]:{form}}]")
            if name == "thickness" and record["object"].get(self._small) is not None:
                remarks.append("as stated")
            elif record["identifiable"].get(name) is False:
                remarks.append("not determined: mostly the prior")
            if name == "density" and record["density_assumed"]:
                remarks.append("assumed: the mass is unknown")
            rows.append((title, f"{record[name]:{form}} {unit}".strip(), ", ".join(remarks)))
        return rows

    def _shown(self) -> tuple[str, list[tuple[str, str, str]]]:
        return f"Estimate ({self.kind}, {self.verdict.text})", self.rows()
