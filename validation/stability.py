"""Random worlds at the default substep, and at longer ones."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, CFL, Body, Gripper, Table, cloth, rope
from validation.bench import Bench, Row, case, vanishing


@case("stability", "random worlds", "mpm")
def stability(bench: Bench) -> Iterator[Row]:
    """Hanging ropes pulled away sideways, and cloths lifted by their centre and dropped faster and
    faster: random E, nu, damping and motions, none may diverge.

    3,334 worlds of each kind on a GPU, 12 on a CPU, 2 where quick.
    """
    count = 3334 if bench.device.startswith("cuda") else 2 if bench.quick else 12
    cells, dx = (1.0, 0.04) if bench.quick else (1.5, 0.02)
    hanging = {"start": (0.0, 0.0, 1.0), "direction": (0.0, 0.0, -1.0), "cells_across": cells}
    square = cloth(width=0.4, height=0.4, thickness=0.01, dx=dx, corner=(-0.2, -0.2, 0.0101))
    source = "Courant, Friedrichs and Lewy (1928): the substep is a share of dx / wave speed"
    for name, body, motion, until, options in (
        ("rope pulled sideways", rope(diameter=0.028, length=0.5, **hanging), _jerk, 0.7, {}),
        ("cloth lifted and dropped", square, _lift_and_drop, 1.2, {"table": Table(height=0.0)}),
    ):
        rng = np.random.default_rng(0)
        # in the paper's ranges, for a 0.5 m rope under gravity 12; half of them with damping
        materials = [
            Material(
                E=1000.0 * rng.uniform(500.0, 10500.0), nu=rng.uniform(0.2, 0.4),
                density=1000.0, damping=rng.choice([0.0, 1.0]) * rng.uniform(0.001, 0.02),
            )
            for _ in range(count)
        ]  # fmt: skip
        hands = [motion(rng) for _ in range(count)]
        failed = diverged(bench, body, materials, hands, until, 1.0, **options)
        yield vanishing(f"diverged of {count}, {name}", failed / count, 0.0, source)


def diverged(
    bench: Bench, body: Body, materials: Sequence[Material], hands: Sequence[Gripper],
    until: float, share: float, **options: Any,
) -> int:  # fmt: skip
    """Number of worlds that do not reach the end; worlds of like stiffness run together."""
    failed = 0
    order = np.argsort([m.E for m in materials])
    for group in np.split(order, range(1024, len(order), 1024)):
        s = bench.simulate(
            body, [materials[w] for w in group], grippers=[[hands[w]] for w in group],
            gravity=(0.0, 0.0, -12.0), cfl=share * CFL, air_density=AIR_DENSITY, **options,
        )  # fmt: skip
        s.run(np.linspace(0.0, until, 11)[1:], particles=[0], keep_going=True)
        failed += len(s.failures)
    return failed


def _jerk(rng: np.random.Generator) -> Gripper:
    """The held top moves away at once, at 1 to 2 m/s for 50 ms, and stops."""
    top = np.array([0.0, 0.0, 1.0])
    path = [top, top + np.array([rng.uniform(1.0, 2.0) * 0.05, 0.0, 0.0])]
    return Gripper(time=[0.0, 0.05], position=path, radius=0.028)


def _lift_and_drop(rng: np.random.Generator) -> Gripper:
    """A cloth's centre goes up by 0.32 m at constant speed, then down faster and faster."""
    high, slope, u = rng.uniform(0.2, 0.32), rng.uniform(0.1, 0.65), np.linspace(0.0, 1.0, 17)
    time = np.append(0.0, 0.6 + 0.5 * u)
    height = np.append(0.0, high * (1.0 - (1.0 - slope) * u - slope * u**2))
    path = np.array([0.0, 0.0, 0.015]) + np.outer(height, (0.0, 0.0, 1.0))
    return Gripper(time=time, position=path, radius=0.03)
