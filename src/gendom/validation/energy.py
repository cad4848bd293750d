"""Energy of bodies on which no external force does work."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.materials import Material
from gendom.sim import CFL, GRAVITY, Gripper, Simulator, cloth, rope
from gendom.sim.thin.rods import Rods
from gendom.sim.thin.shells import Shells
from gendom.validation.check import Check, Settings
from gendom.validation.rods import momenta_and_energy
from gendom.validation.shells import bending_energy, membrane_energy
from gendom.validation.specimens import across, block, clamp_beyond, energies, spring_energy

SOURCE = (
    "first law: a clamp that stands still does no work; kinetic (with C, Jiang et al. 2015) + "
    "elastic (neo-Hookean, Bonet and Wood 2008) + gravitational energy cannot grow"
)

LEAPFROG = (
    "a hand that stands still does no work; a leapfrog keeps energy but for an oscillation "
    "(Hairer, Lubich, Wanner 2006), of which means over many steps are free"
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


def rod_swings(settings: Settings) -> list[Check]:
    """A rope without damping that swings in space from a gripper, 45 times to and fro."""
    body = rope(diameter=0.01, length=0.3, direction=(1, 0, -3), points=33)
    s = settings.simulator(
        body, [Material(E=1.0e6)], engine="thin", grippers=[Gripper.still((0, 0, 0), radius=0.02)],
        air_density=0.0,
    )  # fmt: skip
    return [_mean_grows("a swinging rope", s, GRAVITY, 40.0, 0.0, settings.round_off(1e-3, 1e-2))]


def sheet_swings(settings: Settings) -> list[Check]:
    """A sheet without damping that swings in space from a row of held points, by 30 degrees to both
    sides, 25 times to and fro; in the default substep of undamped sheets and in half of it."""
    body = cloth(width=0.2, height=0.1, thickness=0.002, dx=0.02, points=(15, 8))
    tilt = math.radians(60.0)
    pull = -GRAVITY[2] * np.array([math.sin(tilt), 0.0, -math.cos(tilt)])
    checks = []
    for share, allowed, name in (
        (0.5, 1e-3, "a swinging sheet, half the substep"),
        (1.0, 2e-3, "a swinging sheet, the default substep"),
    ):
        s = settings.simulator(
            body, [Material(E=1.0e5, density=500.0)], engine="thin", gravity=pull, air_density=0.0,
            grippers=[Gripper.still((-100, 0, 0), radius=100.01)],
            cfl=share * Shells.undamped_cfl,
        )  # fmt: skip
        allowed = settings.round_off(allowed, 1e-2)
        checks.append(_mean_grows(name, s, pull, 20.0, 0.0, allowed))
    return checks


def _mean_grows(
    name: str, s: Simulator, gravity: ArrayLike, time: float, expected: float, allowed: float
) -> Check:
    """How much the mean energy of an eighth of the time is above that of the first at most, over
    the largest change of gravitational energy."""
    e = s.engine
    assert isinstance(e, Rods | Shells)
    mass = e.model.mass[0] if isinstance(e, Rods) else e.mass[0]
    pull = np.asarray(gravity, dtype=float)
    readings = []
    for t in np.linspace(0.0, time, 401)[1:]:
        s.run([t])
        readings.append(
            (_own_energy(s, mass), -float(mass @ s.positions()[0].astype(float) @ pull))
        )
    parts = np.array(readings)
    means = parts.sum(axis=1).reshape(8, -1).mean(axis=1)
    return Check.within(
        f"growth of the mean energy in {time:g} s, {name}", "-", expected,
        float((means - means[0]).max() / np.ptp(parts[:, 1])), allowed, LEAPFROG,
    )  # fmt: skip


def _own_energy(s: Simulator, mass: NDArray[np.floating]) -> float:
    """Kinetic and elastic energy of a rod or shell, world 0 [J]."""
    if isinstance(s.engine, Rods):
        return sum(momenta_and_energy(s)[2])
    v = s.velocities()[0].astype(float)
    return 0.5 * float(mass @ np.sum(v**2, axis=1)) + membrane_energy(s) + bending_energy(s)


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
