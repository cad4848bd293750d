"""What is dropped onto the table lies on it, not above and not in it."""

from __future__ import annotations

import numpy as np

from gendom.materials import Material
from gendom.sim import Table, cloth, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across

SOURCE = (
    "a body at rest touches the table with its surface: its middle lies half its thickness above"
)

HEIGHT = 0.1
"""Of the table, away from the grid's nodes [m]."""


def resting(settings: Settings) -> list[Check]:
    """A rope and a cloth that fall by two cells and lie for a while."""
    d, h, dx = 0.01, 0.002, 0.01
    bodies = [
        (
            f"a rope's axis, {across(cells)}",
            rope(
                diameter=d,
                length=12.0 * d,
                start=(0.0013, 0.0007, HEIGHT + d / 2.0 + 2.0 * d / cells),
                direction=(1.0, 0.3, 0.0),
                cells_across=cells,
            ),
        )
        for cells in ((1.5,) if settings.quick else (1.0, 1.5, 2.0))
    ]
    bodies += [
        (
            f"the middle of a cloth {h / dx:g} cells thick",
            cloth(
                width=0.1,
                height=0.1,
                thickness=h,
                dx=dx,
                corner=(0.0013, 0.0007, HEIGHT + h / 2.0 + 2.0 * dx),
            ),
        )
    ]
    checks = []
    for name, body in bodies:
        material = Material(E=1.0e5, nu=0.3, density=500.0)
        s = settings.simulator(body, [material], table=Table(height=HEIGHT))
        x = s.run([1.0])[0, 0].astype(float)
        centres = x.reshape(-1, body.section, 3).mean(axis=1)[:, 2]
        off = (centres - HEIGHT - body.thickness / 2.0) / body.dx
        checks.append(
            Check.within(
                f"height of {name}, beside half its thickness, worst place",
                "cells",
                0.0,
                float(off[np.argmax(np.abs(off))]),
                0.1,
                SOURCE,
            )
        )
    return checks
