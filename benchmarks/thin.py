"""How long rods and shells take for the jobs that they are made for, beside the MPM's particles.

    python benchmarks/thin.py                          # one or two cores
    python benchmarks/thin.py --device cuda --worlds 40000 --sheets 9600

Times are medians of ``--runs`` after a first run that compiles; making the scene is counted, too.
Derivatives of lifts are those of an estimate: a world for the parameters as they are, and one
beside it for each unknown, which differs by the step that an estimate takes.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.materials.unknowns import UNKNOWNS
from gendom.sim import (
    Body,
    Gripper,
    Physics,
    Rollout,
    Simulator,
    Solver,
    Table,
    Variation,
    cloth,
    rope,
)
from gendom.sim.thin.run import Run
from gendom.tasks import RopeReaching
from gendom.tasks.world import POINTS, Simulation

ROPE = Material(E=1.0e6, nu=0.3, density=1000.0, damping=0.004)
CLOTH = Material(E=6.0e5, nu=0.3, density=400.0, damping=0.005)

OF_ROPE = (
    "E_over_rho", "nu", "damping", "friction", "stiffness_slope", "delay", "grip_height",
    "grip_along",
)  # fmt: skip
OF_CLOTH = (
    "E_over_rho", "nu", "damping", "friction", "thickness", "delay", "grip_height",
    "grip_along", "grip_aside", "grip_tilt", "grip_reach", "yaw",
)  # fmt: skip
"""Unknowns of an estimate, see ``gendom.materials.unknowns.UNKNOWNS``."""

FRICTION, TILT = 0.3, 0.8
"""On the table; how far a held corner turns [rad]."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--dtype", choices=("float32", "float64"), help="of the thin engine")
    parser.add_argument("--worlds", type=int, default=200, help="ropes that are released")
    parser.add_argument("--sheets", type=int, default=4, help="cloths that are spread")
    parser.add_argument("--threads", type=int, help="of the CPU, for many worlds (default: all)")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--cpu-time", action="store_true", help="of all threads, not the clock's")
    parser.add_argument("--mpm", action="store_true", help="also time the MPM, one world each")
    parser.add_argument("--jobs", nargs="+", choices=list(JOBS), default=list(JOBS))
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = {}
    for name in given.jobs:
        seconds, note = JOBS[name](given)
        found[name] = {"seconds": seconds, "what": note}
        if not given.json:
            print(f"{name:<18} {seconds:9.4f} s   {note}", flush=True)
    if given.json:
        print(json.dumps(found, indent=2))


def timed(given: argparse.Namespace, job: Callable[[], object]) -> float:
    clock = time.process_time if given.cpu_time else time.perf_counter
    times = []
    for _ in range(given.runs + 1):
        began = clock()
        job()
        times.append(clock() - began)
    return statistics.median(times[1:])


def release(
    given: argparse.Namespace, worlds: int, threads: int | None, engine: str,
    clock: Callable[..., float] = timed,
) -> float:  # fmt: skip
    """Rope reaching with random releases and materials."""
    task = RopeReaching().of_one_size()
    rng = np.random.default_rng(0)
    items = [task.draw_items([rng])[0] for _ in range(worlds)]
    actions = task.sample_actions(task.item, rng, worlds)
    dtype = given.dtype if engine == "thin" else "float32"
    world = Simulation(engine=engine, device=given.device, dtype=dtype, threads=threads)
    return clock(given, lambda: world.carry_out(task, items, actions))


def one_release(given: argparse.Namespace) -> tuple[float, str]:
    thin = release(given, 1, 1, "thin")
    beside = f", MPM {release(given, 1, 1, 'mpm'):.3f} s" if given.mpm else ""
    return thin, "one rope-reaching rollout, 25 points, one core" + beside


def releases(given: argparse.Namespace) -> tuple[float, str]:
    seconds = release(given, given.worlds, given.threads, "thin")
    return seconds, (
        f"{given.worlds} rope-reaching rollouts: 40,000 would take "
        f"{seconds * 4e4 / given.worlds:.1f} s"
    )


def kernels(given: argparse.Namespace) -> tuple[float, str]:
    """The same ropes: steps of points a second in kernels alone, one thread on the CPU."""
    launch, taken = Run.launch, {}

    def timed_launch(run: Run, group: slice) -> None:
        wp.synchronize()
        began = time.perf_counter()
        launch(run, group)
        wp.synchronize()
        taken[run] = taken.get(run, 0.0) + time.perf_counter() - began

    def alone(given: argparse.Namespace, job: Callable[[], object]) -> float:
        timed(given, job)
        taken.clear()
        job()
        return sum(taken.values())

    with patch.object(Run, "launch", timed_launch):
        seconds = release(given, given.worlds, 1, "thin", alone)
    rate = POINTS * sum(int(run.plan.steps.sum()) for run in taken) / seconds
    return seconds, f"kernels of {given.worlds} rollouts: {rate / 1e9:.3g} G point-steps/s"


@dataclass(frozen=True)
class Lift:
    """An object that lies on a table and is lifted by a sphere of a radius [m]."""

    body: Body
    material: Material
    rise: float
    """[m]."""
    radius: float
    inwards: NDArray[np.float64]
    """[3] direction from the held end or corner into the object."""

    def differing(
        self, names: tuple[str, ...], given: argparse.Namespace, threads: int | None
    ) -> Simulator:
        """The object as it is, and beside it one for each unknown, which differs in that."""
        base = dict.fromkeys(UNKNOWNS, 0.0) | {
            "E_over_rho": self.material.E_over_rho,
            "nu": self.material.nu,
            "damping": self.material.damping,
            "friction": FRICTION,
            "thickness": 1.0,
            "grip_tilt": TILT if "grip_tilt" in names else 0.0,
        }
        worlds = [base]
        for name in names:
            unknown = UNKNOWNS[name]
            worlds.append(
                base | {name: unknown.value(unknown.transformed(base[name]) + unknown.step)}
            )
        slope = np.array([of["stiffness_slope"] for of in worlds])[:, None]
        return Simulator(
            self.body,
            [self._material(of) for of in worlds],
            grippers=[[self._hand(of)] for of in worlds],
            table=Table(height=0.0, friction=[of["friction"] for of in worlds]),
            variation=Variation(
                stiffness=np.exp(slope * np.linspace(-0.5, 0.5, len(self.body.points)))
            ),
            positions=np.stack([self._laid(of) for of in worlds]),
            solver=Solver(engine="thin", device=given.device, dtype=given.dtype, threads=threads),
        )

    def _material(self, of: dict[str, float]) -> Material:
        E = of["E_over_rho"] * of["thickness"] ** 2 * self.material.density
        return replace(self.material, E=E, nu=of["nu"], damping=of["damping"])

    def _laid(self, of: dict[str, float]) -> NDArray[np.float64]:
        left = np.array([-self.inwards[1], self.inwards[0], 0.0])
        x = self.body.points - of["grip_along"] * self.inwards - of["grip_aside"] * left
        held = self.body.points[0]
        return held + Rotation.from_euler("z", of["yaw"]).apply(x - held)

    def _hand(self, of: dict[str, float]) -> Gripper:
        radius = self.radius + of["grip_reach"]
        rise = np.array([0.0, 2.0 * radius, self.rise])
        at = self.body.points[0] + rise[:, None] * np.array([0.0, 0.0, 1.0])
        at[1:, 2] += of["grip_height"]
        inwards = Rotation.from_euler("z", of["yaw"]).apply(self.inwards)
        angle = of["grip_tilt"] * np.clip(rise / (2.0 * radius), 0.0, 1.0)
        turned = Rotation.from_rotvec(angle[:, None] * np.cross(inwards, [0.0, 0.0, -1.0]))
        return Gripper(
            time=of["delay"] + 2.5 * rise / self.rise,
            position=at,
            quat_xyzw=turned.as_quat() if of["grip_tilt"] else None,
            radius=radius,
        )


def rope_lift(given: argparse.Namespace) -> tuple[float, str]:
    """A rope lies on a table and is lifted by 0.3 m in 2.5 s; nine worlds."""
    body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005))
    lift = Lift(body, ROPE, 0.3, 0.0075, np.array([1.0, 0.0, 0.0]))

    def run() -> None:
        lift.differing(OF_ROPE, given, 1).run(np.linspace(0.1, 2.5, 25))

    return timed(given, run), "a rope's lift of 2.5 s with derivatives by 8 unknowns, one core"


def rope_gradient(given: argparse.Namespace) -> tuple[float, str]:
    """The same lift once, and the derivative of one loss by everything."""
    body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005))
    hand = Gripper(time=[0.0, 2.5], position=[(0, 0, 0.005), (0, 0, 0.305)], radius=0.0075)

    def lift() -> None:
        rollout = Rollout(
            Simulator(
                body,
                [ROPE],
                grippers=[hand],
                table=Table(height=0.0),
                solver=Solver(engine="thin", device=given.device, dtype=given.dtype, threads=1),
            )
        )
        rollout.backward(np.ones_like(rollout.forward(np.linspace(0.1, 2.5, 25))))

    return timed(given, lift), "a rope's lift of 2.5 s and its reverse, one core"


def sheet_lift(given: argparse.Namespace) -> tuple[float, str]:
    """A cloth lies on a table and is lifted by a corner by 0.4 m in 2.5 s; thirteen worlds."""
    body = cloth(width=0.3, height=0.3, thickness=0.001, dx=0.02, corner=(0.0, 0.0, 0.0005))
    lift = Lift(body, CLOTH, 0.4, 0.015, np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0))

    def run() -> None:
        lift.differing(OF_CLOTH, given, given.threads).run(np.linspace(0.1, 2.5, 25))

    return timed(given, run), "a cloth's lift of 2.5 s, 28 x 28 points, derivatives by 12 unknowns"


def spreading(given: argparse.Namespace) -> tuple[float, str]:
    """Cloths held at their centre are lowered and dragged by 16 cm; they meet themselves."""
    body = cloth(width=0.2, height=0.2, thickness=0.001, dx=0.02, corner=(-0.1, -0.1, 0.2))
    hand = Gripper(
        time=[0.0, 0.5, 1.0, 2.6],
        position=[(0, 0, 0.2), (0, 0, 0.2), (0, 0, 0.05), (0.16, 0, 0.05)],
        radius=0.01,
    )
    rng = np.random.default_rng(0)
    materials = [replace(CLOTH, E=float(np.exp(rng.uniform(11, 14)))) for _ in range(given.sheets)]

    def spread() -> None:
        Simulator(
            body,
            materials,
            grippers=[hand],
            table=Table(height=0.0),
            physics=Physics(self_contact=True),
            solver=Solver(
                engine="thin", device=given.device, dtype=given.dtype, threads=given.threads
            ),
        ).run([2.6], keep_going=True)

    seconds = timed(given, spread)
    return seconds, (
        f"{given.sheets} cloth spreadings of 2.6 s: 9,600 would take "
        f"{seconds * 9600 / given.sheets:.0f} s"
    )


JOBS = {
    "release": one_release,
    "releases": releases,
    "kernels": kernels,
    "rope-lift": rope_lift,
    "rope-gradient": rope_gradient,
    "sheet-lift": sheet_lift,
    "spreading": spreading,
}

if __name__ == "__main__":
    main()
