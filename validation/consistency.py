"""Equal problems: a batch and its worlds, single and double precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, Body, Gripper, Simulator, Table, cloth, rope
from validation.bench import Bench, Row, case, vanishing

WORLDS = tuple(
    Material(E=E, nu=nu) for E, nu in ((1e5, 0.3), (3e5, 0.2), (1e6, 0.4), (2e5, 0.1), (5e4, 0.0))
)
"""Their substeps differ, so that they take turns at being the slowest."""

LIFT = 0.1
"""[m]."""

SHEET = 0.2
"""Size of a cloth, and how high its corner is lifted [m]."""

EQUAL = "equal inputs, equal operations; on CUDA sums are added in no fixed order"
ROUND_OFF = "round-off: 2^-24 a number (IEEE 754)"


@case("batch", "worlds together and alone", "mpm")
def particles_together(bench: Bench) -> list[Row]:
    """Five worlds at once and each alone: bit for bit on the CPU, to round-off on CUDA."""
    return [_together(bench, "", lambda which: _lift(bench, [WORLDS[w] for w in which]))]


@case("rod-batch", "ropes together and alone", "thin", "rope")
@case("shell-batch", "cloths together and alone", "thin", "cloth")
def together(bench: Bench, kind: str) -> list[Row]:
    """Five bodies at once and each alone: lifted off the table at an end, with self-contact."""

    def lift(which: Sequence[int]) -> NDArray[np.floating]:
        return _thin_lift(bench, kind, which).run([0.1, 0.4])

    return [_together(bench, f" {kind}s", lift)]


def _together(
    bench: Bench, kinds: str, lift: Callable[[Sequence[int]], NDArray[np.floating]]
) -> Row:
    every = range(len(WORLDS))
    alone = np.concatenate([lift([w]) for w in every], axis=1)
    apart = float(np.abs(lift(every) - alone).max())
    allowed = 0.0 if bench.device == "cpu" else bench.round_off(1e-9, 1e-4)
    name = f"largest difference of a batch of {len(WORLDS)}{kinds} from single worlds"
    return vanishing(name, apart, allowed, EQUAL, "m")


@case("precision", "single and double precision", "mpm")
def particles_precision(bench: Bench) -> list[Row]:
    """The same five worlds in float32 and float64."""
    apart = _apart(bench, lambda one: _lift(one, WORLDS))
    name = "largest difference of float32 from float64, over the lift"
    return [vanishing(name, float(np.abs(apart).max() / LIFT), 1e-5, ROUND_OFF)]


@case("rod-precision", "single and double precision", "thin")
def rods_precision(bench: Bench) -> list[Row]:
    """A lift off the table in float32 and float64."""
    worlds = [Material(E=E, damping=0.003) for E in (1e5, 1e6, 1e7)]
    body, low, high = rope(diameter=0.01, length=0.3, start=(0, 0, 0.005)), 0.005, 0.305
    hand = Gripper(time=[0, 1], position=[(0, 0, low), (0, 0, high)], radius=0.0075)
    apart = _apart(bench, lambda one: _off_table(one, body, worlds, hand, [0.5, 1.0]))
    name = "largest difference of float32 from float64, over a lift by 0.3 m"
    return [vanishing(name, float(np.abs(apart).max() / 0.3), 1e-3, ROUND_OFF)]


@case("shell-precision", "single and double precision", "thin")
def shells_precision(bench: Bench) -> list[Row]:
    """A cloth lifted by a corner, in float32 and float64.

    Limp cloths fold, and at a fold's edge round-off grows: there it may be ten times the mean.
    """
    worlds = [Material(E=E, nu=0.3, density=400.0, damping=0.01) for E in (1e6, 3e6)]
    low, high = 0.0005, 0.0005 + SHEET
    hand = Gripper(time=[0.0, 2.0], position=[(0, 0, low), (0, 0, high)], radius=0.03)
    apart = _apart(bench, lambda one: _off_table(one, _sheet(), worlds, hand, [1.0, 2.0]))
    far = np.linalg.norm(apart, axis=-1) / SHEET
    mean, name = (
        float(np.sqrt(np.mean(far**2, axis=2)).max()),
        "of float32 from float64 over the size",
    )
    return [
        vanishing(f"root mean square difference {name}", mean, 1e-5, ROUND_OFF),
        vanishing(f"largest difference {name}", float(far.max()), 1e-4, ROUND_OFF),
    ]


def _apart(
    bench: Bench, positions: Callable[[Bench], NDArray[np.floating]]
) -> NDArray[np.floating]:
    """Positions in single less those in double precision [m]."""
    single, double = (positions(replace(bench, dtype=d)) for d in ("float32", "float64"))
    return single.astype(float) - double


def _off_table(
    bench: Bench, body: Body, worlds: list[Material], hand: Gripper, times: list[float]
) -> NDArray[np.floating]:
    table = Table(height=0.0)
    s = bench.simulate(body, worlds, grippers=[hand], table=table, air_density=AIR_DENSITY)
    return s.run(times)


def _thin_lift(bench: Bench, kind: str, which: Sequence[int]) -> Simulator:
    """Worlds of ``WORLDS`` that differ in all that worlds may differ in."""
    body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005)) if kind == "rope" else _sheet()
    low = np.array([0.0, 0.0, body.thickness / 2.0])
    number = np.array(which, dtype=float)
    hands = [
        [
            Gripper(
                time=[0.0, 0.3 + 0.02 * w],
                position=[low, low + np.array([0.1 * LIFT * w, 0.0, LIFT])],
                radius=0.02 + 0.001 * w,
                hold_until=0.35,
            )
        ]
        for w in which
    ]
    return bench.simulate(
        body,
        [replace(WORLDS[w], damping=0.001 * w) for w in which],
        grippers=hands,
        table=Table(height=0.0, friction=0.1 + 0.1 * number),
        self_contact=True,
        self_friction=0.2 + 0.1 * number,
        velocity_damping=number,
        air_density=0.3 * number,
        stiffness=1.0 + 0.1 * np.outer(number, np.linspace(0.0, 1.0, len(body.points))),
    )


def _sheet() -> Body:
    size = {"width": SHEET, "height": SHEET, "thickness": 0.001}
    return cloth(dx=0.02, points=(14, 14), corner=(0.0, 0.0, 0.0005), **size)


def _lift(bench: Bench, materials: Sequence[Material]) -> NDArray[np.floating]:
    """[T, W, N, 3] a rope just above a table, one end lifted by 10 cm in 0.3 s [m].

    It starts 0.1 mm above: in which substep it first touches would otherwise be left to the last
    bit of its height, and a substep's fall (25 um in the softest world) is no round-off.
    """
    z = 0.0101
    s = bench.simulate(
        rope(diameter=0.02, length=0.2, start=(0.0, 0.0, z), cells_across=1.5),
        materials,
        grippers=[Gripper(time=[0.0, 0.3], position=[(0, 0, z), (0, 0, z + LIFT)], radius=0.02)],
        table=Table(height=0.0),
        velocity_damping=2.0,
        air_density=AIR_DENSITY,
    )
    return s.run([0.1, 0.3]).astype(float)
