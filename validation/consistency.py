"""Equal problems: a batch and its worlds, single and double precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, Gripper, Table, cloth, rope
from validation.bench import Bench, Row, case, vanishing

MODULI = ((1e5, 0.3), (3e5, 0.2), (1e6, 0.4), (2e5, 0.1), (5e4, 0.0))
WORLDS = [Material(E=E, nu=nu) for E, nu in MODULI]
"""Their substeps differ, so that they take turns at being the slowest."""

LIFT, SHEET = 0.1, 0.2
"""How high an end is lifted; size of a cloth, and how high its corner is lifted [m]."""

LYING = {
    "rope": rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005)),
    "cloth": cloth(
        width=SHEET, height=SHEET, thickness=0.001, dx=0.02, points=(14, 14),
        corner=(0.0, 0.0, 0.0005),
    ),
}  # fmt: skip

EQUAL = "equal inputs, equal operations; on CUDA sums are added in no fixed order"
ROUND_OFF = "round-off: 2^-24 a number (IEEE 754)"


@case("batch", "worlds together and alone", "mpm", "")
@case("rod-batch", "ropes together and alone", "thin", "rope")
@case("shell-batch", "cloths together and alone", "thin", "cloth")
def batch(bench: Bench, kind: str) -> list[Row]:
    """Five worlds at once and each alone: bit for bit on the CPU, to round-off on CUDA."""
    lift, every = _varied_lift if kind else _particle_lift, range(len(WORLDS))
    alone = np.concatenate([lift(bench, kind, [w]) for w in every], axis=1)
    apart = np.abs(lift(bench, kind, every) - alone).max()
    allowed = 0.0 if bench.device == "cpu" else bench.round_off(1e-9, 1e-4)
    name = f"largest difference of a batch of 5{f' {kind}s' * bool(kind)} from single worlds"
    return [vanishing(name, apart, allowed, EQUAL, "m")]


@case("precision", "single and double precision", "mpm", "")
@case("rod-precision", "single and double precision", "thin", "rope")
@case("shell-precision", "single and double precision", "thin", "cloth")
def precision(bench: Bench, kind: str) -> list[Row]:
    """A lift off the table in float32 and float64.

    Limp cloths fold, and at a fold's edge round-off grows: there it may be ten times the mean.
    """
    ropes = [Material(E=E, damping=0.003) for E in (1e5, 1e6, 1e7)]
    cloths = [Material(E=E, nu=0.3, density=400.0, damping=0.01) for E in (1e6, 3e6)]

    def lifted(dtype: str) -> NDArray[np.float64]:
        one = replace(bench, dtype=dtype)
        if not kind:
            return _particle_lift(one, kind, range(len(WORLDS)))
        worlds, radius, end, high = {
            "rope": (ropes, 0.0075, 1.0, 0.3), "cloth": (cloths, 0.03, 2.0, SHEET)
        }[kind]  # fmt: skip
        low = np.array([0.0, 0.0, LYING[kind].thickness / 2.0])
        hand = Gripper(time=[0.0, end], position=[low, low + np.array([0, 0, high])], radius=radius)
        options = {"grippers": [hand], "table": Table(height=0.0), "air_density": AIR_DENSITY}
        return one.simulate(LYING[kind], worlds, **options).run([end / 2.0, end]).astype(float)

    apart = lifted("float32") - lifted("float64")
    name = "difference of float32 from float64"
    if kind == "cloth":
        far, name = np.linalg.norm(apart, axis=-1) / SHEET, f"{name} over the size"
        mean = np.sqrt(np.mean(far**2, axis=2)).max()
        return [
            vanishing(f"root mean square {name}", mean, 1e-5, ROUND_OFF),
            vanishing(f"largest {name}", far.max(), 1e-4, ROUND_OFF),
        ]
    way, over, allowed = (0.3, "a lift by 0.3 m", 1e-3) if kind else (LIFT, "the lift", 1e-5)
    return [
        vanishing(f"largest {name}, over {over}", np.abs(apart).max() / way, allowed, ROUND_OFF)
    ]


def _varied_lift(bench: Bench, kind: str, which: Sequence[int]) -> NDArray[np.float64]:
    """[T, W, N, 3] positions of worlds that differ in all that worlds may differ in [m]."""
    body, number = LYING[kind], np.array(which, dtype=float)
    low = np.array([0.0, 0.0, body.thickness / 2.0])
    hands = [
        [
            Gripper(
                time=[0.0, 0.3 + 0.02 * w], radius=0.02 + 0.001 * w, hold_until=0.35,
                position=[low, low + np.array([0.1 * LIFT * w, 0.0, LIFT])],
            )
        ]
        for w in which
    ]  # fmt: skip
    s = bench.simulate(
        body, [replace(WORLDS[w], damping=0.001 * w) for w in which], grippers=hands,
        table=Table(height=0.0, friction=0.1 + 0.1 * number), self_contact=True,
        self_friction=0.2 + 0.1 * number, velocity_damping=number, air_density=0.3 * number,
        stiffness=1.0 + 0.1 * np.outer(number, np.linspace(0.0, 1.0, len(body.points))),
    )  # fmt: skip
    return s.run([0.1, 0.4]).astype(float)


def _particle_lift(bench: Bench, _: str, which: Sequence[int]) -> NDArray[np.float64]:
    """[T, W, N, 3] a rope just above a table, one end lifted by 10 cm in 0.3 s [m].

    It starts 0.1 mm above: in which substep it first touches would otherwise be left to the last
    bit of its height, and a substep's fall (25 um in the softest world) is no round-off.
    """
    z = 0.0101
    s = bench.simulate(
        rope(diameter=0.02, length=0.2, start=(0.0, 0.0, z), cells_across=1.5),
        [WORLDS[w] for w in which], table=Table(height=0.0), velocity_damping=2.0,
        grippers=[Gripper(time=[0.0, 0.3], position=[(0, 0, z), (0, 0, z + LIFT)], radius=0.02)],
        air_density=AIR_DENSITY,
    )  # fmt: skip
    return s.run([0.1, 0.3]).astype(float)
