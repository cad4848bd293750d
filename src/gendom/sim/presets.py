"""Named sets of simulator settings."""

import math
from dataclasses import dataclass
from typing import Any

from gendom.errors import ParameterError
from gendom.materials import AIR_DENSITY, Material
from gendom.sim.scene import GRAVITY, Table


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A consistent set of units, resolution and physical parameters.

    Use it as ``Simulator(body, [preset.material(E=..., nu=...)], **preset.settings())``.
    """

    name: str
    dx: float | None
    """Size of a grid cell [m], or None to choose it for each body."""
    density: float
    """Density of the material [kg/m^3]."""
    yield_stress: float
    """Yield stress of the material [Pa]."""
    law: str
    """Elastic law, see ``gendom.materials.laws.LAWS``."""
    gravity: tuple[float, float, float]
    """Gravity [m/s^2]."""
    air_density: float
    """Density of the air [kg/m^3]."""
    substep: float | None
    """Substep [s], or None to derive it from each world's stability limit."""
    table: Table | None

    def material(self, *, E: float, nu: float, damping: float = 0.0) -> Material:
        """Return a material with this preset's density and yield stress."""
        return Material(
            E=E, nu=nu, density=self.density, damping=damping, yield_stress=self.yield_stress
        )

    def settings(self) -> dict[str, Any]:
        """Return the preset's keyword arguments for ``Simulator``."""
        return {
            "law": self.law,
            "gravity": self.gravity,
            "air_density": self.air_density,
            "substep": self.substep,
            "table": self.table,
        }


METRIC = Preset(
    name="metric",
    dx=None,
    density=1000.0,
    yield_stress=math.inf,
    law="neo-hookean",
    gravity=GRAVITY,
    air_density=AIR_DENSITY,
    substep=None,
    table=None,
)
"""SI units; the default throughout the package."""

_CELL = 1.0 / 64.0

PAPER = Preset(
    name="paper",
    dx=_CELL,
    density=1.0,
    yield_stress=200.0,
    law="fixed-corotated",
    gravity=(0.0, 0.0, -12.0),
    air_density=0.0,
    substep=None,
    table=Table(height=2.0 * _CELL, friction=0.5),
)
"""The unit cube of the GenDOM authors' code, z up, with 64 cells, density 1 and the authors'
gravity, yield stress and floor. The authors' substep of 1e-4 exceeds the stability limit
at E above about 3,000; here each world's substep is derived from its own limit."""

_PRESETS = {p.name: p for p in (METRIC, PAPER)}


def preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        ParameterError: If there is no preset with that name.
    """
    if not isinstance(name, str) or name not in _PRESETS:
        raise ParameterError(
            f"there is no preset {name!r}", fix=f"choose one of {', '.join(_PRESETS)}"
        )
    return _PRESETS[name]
