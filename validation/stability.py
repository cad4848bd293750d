"""Random worlds at the default substep, and at longer ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gendom.materials import Material, Rope, thickness_of
from gendom.robot import TcpPaths
from gendom.sim import AIR_DENSITY, CFL, Body, Gripper, Table, cloth
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers
from validation.bench import Bench, Row, case, vanishing

SOURCE = "Courant, Friedrichs and Lewy (1928): the substep is a share of dx / wave speed"

Motion = Callable[[np.random.Generator], list[Gripper]]


@case("stability", "random worlds", "mpm")
def stability(bench: Bench) -> list[Row]:
    """Ropes that are carried, held and released; ropes pulled away sideways; cloths lifted by
    their centre and dropped faster and faster: random E, nu, damping and motions, none may diverge.

    3,334 worlds of each kind on a GPU, 12 on a CPU, 3 where quick. Longer substeps are run with
    fewer, to show where the limit is.
    """
    count = 3334 if bench.device.startswith("cuda") else 3 if bench.quick else 12
    cells, dx = (1.0, 0.04) if bench.quick else (1.5, 0.02)
    task = RopeReaching(item=Rope(length=0.5, diameter=0.028))
    rope, _ = Simulation(engine="mpm", cells_across=cells).body(task, task.item)
    end = float(task.times(task.item)[-1])
    square = cloth(width=0.4, height=0.4, thickness=0.01, dx=dx, corner=(-0.2, -0.2, 0.0101))
    kinds: list[tuple[str, Body, Motion, Table | None, float]] = [
        ("rope carried, held, released", rope, lambda rng: _reach(task, rng), None, end),
        ("rope pulled sideways", rope, lambda rng: _jerk(task, rng), None, 0.7),
        ("cloth lifted and dropped", square, _lift_and_drop, Table(height=0.0), 1.2),
    ]
    rows = []
    for name, body, motion, table, until in kinds:
        for share in [1.0] if bench.quick else [1.0, 1.5, 2.0, 2.5]:
            default = share == 1.0
            worlds = count if default else max(1, count // 4)
            rng = np.random.default_rng(0)
            materials = [_material(rng) for _ in range(worlds)]
            hands = [motion(rng) for _ in range(worlds)]
            failed = diverged(bench, body, materials, hands, table, until, share)
            label = "default substep" if default else f"{share:g} x that (for information)"
            name_ = f"diverged of {worlds}, {name}, {label}"
            rows.append(vanishing(name_, failed / worlds, 0.0 if default else 1.0, SOURCE))
    return rows


def diverged(
    bench: Bench,
    body: Body,
    materials: Sequence[Material],
    hands: Sequence[Sequence[Gripper]],
    table: Table | None,
    until: float,
    share: float,
) -> int:
    """Number of worlds that do not reach the end; worlds of like stiffness run together."""
    failed = 0
    order = np.argsort([m.E for m in materials])
    for group in np.split(order, range(1024, len(order), 1024)):
        s = bench.simulate(
            body, [materials[w] for w in group], grippers=[list(hands[w]) for w in group],
            table=table, gravity=(0.0, 0.0, -12.0), cfl=share * CFL, air_density=AIR_DENSITY,
        )  # fmt: skip
        s.run(np.linspace(0.0, until, 11)[1:], particles=[0], keep_going=True)
        failed += len(s.failures)
    return failed


def _material(rng: np.random.Generator) -> Material:
    """In the paper's ranges, for a 0.5 m rope under gravity 12; every other one, on average, has
    damping."""
    return Material(
        E=1000.0 * rng.uniform(500.0, 10500.0), nu=rng.uniform(0.2, 0.4), density=1000.0,
        damping=rng.choice([0.0, 1.0]) * rng.uniform(0.001, 0.02),
    )  # fmt: skip


def _reach(task: RopeReaching, rng: np.random.Generator) -> list[Gripper]:
    path = task.tool_path(task.item, task.sample_actions(task.item, rng, 1)[0])
    return grippers(task.scene(task.item), TcpPaths([path]), 0.0)[0]


def _jerk(task: RopeReaching, rng: np.random.Generator) -> list[Gripper]:
    """The held top moves away at once, at 1 to 2 m/s for 50 ms, and stops."""
    top = task.top(task.item)
    away = np.array([rng.uniform(1.0, 2.0) * 0.05, 0.0, 0.0])
    path = [top, top + away]
    return [Gripper(time=[0.0, 0.05], position=path, radius=thickness_of(task.item))]


def _lift_and_drop(rng: np.random.Generator) -> list[Gripper]:
    """A cloth's centre goes up by 0.32 m at constant speed, then down faster and faster."""
    start = np.array([0.0, 0.0, 0.015])
    high = rng.uniform(0.2, 0.32)
    u = np.linspace(0.0, 1.0, 17)
    slope = rng.uniform(0.1, 0.65)
    fallen = (1.0 - slope) * u + slope * u**2
    time = np.concatenate([[0.0], 0.6 + 0.5 * u])
    height = np.concatenate([[0.0], high * (1.0 - fallen)])
    path = start + height[:, None] * [0.0, 0.0, 1.0]
    return [Gripper(time=time, position=path, radius=0.03)]
