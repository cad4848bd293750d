"""What a report is given of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gendom.errors import GendomError
from gendom.viz.report.quantities import finite

ESTIMATE_FORMAT = "gendom-estimate/1"


@dataclass(frozen=True, kw_only=True)
class EstimateSummary:
    """What was estimated, and what is known besides.

    Raises:
        GendomError: `values` has another format, or no Young's modulus or Poisson's ratio; or
            an interval or a range that was searched is not a pair of numbers.
    """

    values: Mapping[str, Any]
    """The estimate's JSON object (gendom-estimate/1), SI units; other keys may be missing."""
    truth: Mapping[str, float] | None = None
    """True values under the keys of `values`, as far as known."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of the unknowns of the estimate's posterior, by name."""

    def __post_init__(self):
        found = self.values.get("format", ESTIMATE_FORMAT)
        if found != ESTIMATE_FORMAT:
            raise GendomError(
                f"is {found!r}", where="estimate.format", fix=f"give {ESTIMATE_FORMAT!r}"
            )
        for key in ("E", "nu"):
            if finite(self.values.get(key)) is None:
                raise GendomError("is no number", where=f"estimate.{key}", fix="estimate again")
        for name in ("intervals", "bounds"):
            for key, ends in (self.values.get(name) or {}).items():
                if key != "level" and ends is not None and len(np.atleast_1d(ends)) != 2:
                    raise GendomError(
                        f"is {ends!r}", where=f"estimate.{name}.{key}", fix="give [low, high]"
                    )

    def value(self, key: str) -> float | None:
        """What was estimated, in the unit of `values`."""
        return finite(self.values.get(key))

    def true(self, key: str) -> float | None:
        """The true value, where it is known."""
        return finite((self.truth or {}).get(key))

    def interval(self, key: str) -> tuple[float, float] | None:
        """Lowest and highest plausible value."""
        return self._ends("intervals", key)

    def searched(self, key: str) -> tuple[float, float] | None:
        """Lowest and highest value that was looked at; None: the file does not say."""
        return self._ends("bounds", key)

    def _ends(self, name: str, key: str) -> tuple[float, float] | None:
        ends = (self.values.get(name) or {}).get(key)
        if ends is None:
            return None
        low, high = (finite(end) for end in ends)
        return None if low is None or high is None else (low, high)

    @property
    def level(self) -> float | None:
        """How probable the intervals are, from 0 to 1."""
        return finite((self.values.get("intervals") or {}).get("level"))

    @property
    def level_text(self) -> str:
        """How probable the intervals are: "90 %"."""
        return "" if self.level is None else f"{100.0 * self.level:g} %"

    @property
    def usable(self) -> bool | None:
        """Whether the estimate is of any use; None: not said."""
        return (self.values.get("verdict") or {}).get("usable")

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not."""
        return tuple((self.values.get("verdict") or {}).get("reasons") or ())

    def determined(self, key: str) -> bool | None:
        """Whether the lift determines a parameter; None: not said."""
        return (self.values.get("identifiable") or {}).get(key)
