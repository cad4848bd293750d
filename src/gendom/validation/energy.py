"""Energy of bodies on which no external force does work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import CFL, GRAVITY, Simulator, rope
from gendom.validation.check import Check, Settings
from gendom.validation.specimens import across, block, clamp_beyond, energies, spring_energy

SOURCE = (
    "first law: a clamp that stands still does no work; kinetic (with C, Jiang et al. 2015) + "
    "elastic (neo-Hookean, Bonet and Wood 2008) + gravitational energy cannot grow"
)


def energy(settings: Settings) -> list[Check]:
    """A wobbling block and a bent rope in free fall; a clamped rope that falls and swings for 1 s.

    Counted are kinetic energy, the affine velocities' share included, elastic and gravitational
    energy, and that of the springs by which a clamp holds its border. The reading is the largest
    rise above any earlier value, over the largest change of gravitational energy. The clamped rope
    has half the default substep (at that it reads 0.0015 at 2 cells across).
    """
    bound = settings.round_off(1e-3, 2e-3)
    dx = 0.01
    body = block((4 * dx, 3 * dx, 3 * dx), dx, centre=(0.003, 0.001, 0.002))
    s = settings.simulator(body, [Material(E=1.0e5)])
    out = body.x - body.x.mean(axis=0)
    s.set_velocities(np.cross([5.0, 3.0, 15.0], out) + 8.0 * out * [1.0, -0.5, 0.3] + [0.2, 0, 2])
    checks = [_never_grows("free fall of a wobbling block", s, 0.4, bound)]
    for cells in (1.0,) if settings.quick else (1.0, 2.0):
        d = 0.01
        L, dx = 15.0 * d, d / cells
        back = 3.0 * dx
        checks.append(
            _never_grows(
                f"free fall of a bent rope, {across(cells)}", bent_rope(settings, cells), 0.4, bound
            )
        )
        hung = rope(
            diameter=d,
            length=L + back,
            start=(-back, 0.0, 0.0),
            cells_across=cells,
        )
        clamp = clamp_beyond((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), d)
        s = settings.simulator(
            hung, [Material(E=1.0e5)], grippers=[clamp], air_density=0.0, cfl=CFL / 2.0
        )
        checks.append(_never_grows(f"swinging rope, {across(cells)}", s, 1.0, bound))
    return checks


def bent_rope(settings: Settings, cells: float) -> Simulator:
    """A rope that flies, turns and bends: its middle is thrown up, its ends aside."""
    body = rope(diameter=0.01, length=0.15, start=(-0.075, 0.0013, 0.0007), cells_across=cells)
    s = settings.simulator(body, [Material(E=1.0e5)], air_density=0.0)
    u = body.x[:, 0] / 0.075
    s.set_velocities(np.stack([0.0 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1))
    return s


def _never_grows(name: str, s: Simulator, time: float, bound: float) -> Check:
    readings = [(*energies(s, GRAVITY), 0.0)]
    for t in np.linspace(0.0, time, 51)[1:]:
        s.run([t])
        readings.append((*energies(s, GRAVITY), spring_energy(s)))
    parts = np.array(readings)
    return Check.within(
        f"growth of energy, {name}",
        "-",
        0.0,
        growth(parts.sum(axis=1)) / float(np.ptp(parts[:, 2])),
        bound,
        SOURCE,
    )


def growth(total: NDArray[np.floating]) -> float:
    """Largest rise of readings [T] above any earlier one."""
    return float((total - np.minimum.accumulate(total)).max())
