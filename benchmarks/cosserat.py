"""GenDOM as a solver of cosseratbench: a rope over a cylinder (capstan), one that heaps up (pile).

    benchmarks/.envs/cosseratbench/bin/python benchmarks/cosserat.py [capstan pile] [--elements 100]

``make -C benchmarks peers`` makes that environment. cosseratbench's other experiments hold an end
that is free to turn (catenary, pendulum, crossing), pull at one with a force (cantilever, twist),
or have several rods: GenDOM has none of these, and says so.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))

from cosseratbench import registry  # pyright: ignore[reportMissingImports]
from cosseratbench.experiment import run  # pyright: ignore[reportMissingImports]
from cosseratbench.runs import describe  # pyright: ignore[reportMissingImports]
from cosseratbench.scenario import (  # pyright: ignore[reportMissingImports]
    End,
    EndCondition,
    Plane,
    parallel_transport,
)
from cosseratbench.solver import Capability, Diverged  # pyright: ignore[reportMissingImports]
from cosseratbench.trajectory import Trajectory  # pyright: ignore[reportMissingImports]

import gendom
from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import Capsule, Gripper, Physics, Simulator, Solver, Table, rope


class GenDOM:
    name = "gendom"
    backend_version = gendom.__version__
    capabilities = frozenset(Capability)

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Trajectory:
        rod, *more = scenario.rods
        if more or rod.loads or EndCondition.PINNED in (rod.start, rod.end):
            raise NotImplementedError("one rod, without forces or ends that are free to turn")
        x, m = rod.nodes(n_elements), rod.material
        times = np.linspace(0.0, scenario.duration, n_frames)
        hands = [
            hand(x, end, rod.motion(end), times)
            for end in End
            if rod.condition(end) is EndCondition.CLAMPED
        ]
        planes = [o for o in scenario.obstacles if isinstance(o, Plane)]
        bars = [o for o in scenario.obstacles if not isinstance(o, Plane)]
        if any(p.normal != (0.0, 0.0, 1.0) for p in planes) or len(planes) > 1:
            raise NotImplementedError("one plane, with its normal up")
        calm = 2.0 * scenario.slowest_frequency() if scenario.quasi_static else 0.0
        nu = min(m.youngs_modulus / (2.0 * m.shear_modulus) - 1.0, 0.499)
        simulator = Simulator(
            rope(diameter=2.0 * rod.radius, length=rod.length, start=(0, 0, 0),
                 points=n_elements + 1),
            [Material(E=m.youngs_modulus, nu=nu, density=m.density, damping=0.0)],
            grippers=hands,
            table=Table(height=planes[0].point[2], friction=planes[0].friction) if planes else None,
            obstacles=[
                Capsule.between(
                    *(np.array(o.center) + s * o.length * o.unit_axis for s in (-0.5, 0.5)),
                    radius=o.radius, friction=max(o.friction, rod.friction),
                )
                for o in bars
            ],
            physics=Physics(
                gravity=scenario.gravity, air_density=0.0, velocity_damping=calm,
                self_contact=scenario.self_contact, self_friction=rod.friction,
            ),
            solver=Solver(threads=1),
            positions=x,
        )  # fmt: skip
        try:
            x = simulator.run(times)[:, 0]
        except SimulationError as error:
            raise Diverged(str(error)) from error
        # No metric of these scenarios asks for the twist: directions without any.
        turned = np.stack([parallel_transport(p, np.array(rod.normal)) for p in x])
        return Trajectory(times, (x,), (turned,))


def hand(x: np.ndarray, end: End, motion: Any, times: np.ndarray) -> Gripper:
    """A clamp of the element at an end."""
    first, second = (x[0], x[1]) if end is End.START else (x[-1], x[-2])
    radius = 1.01 * float(np.linalg.norm(second - first))
    if motion is None:
        return Gripper.still(first, radius=radius)
    if np.any(motion.rotation) or motion.slides_along:
        raise NotImplementedError("a driven end that turns or slides")
    times = np.union1d(times, np.clip(motion.times, 0.0, times[-1]))
    return Gripper(
        time=times, position=[first + motion.pose(t)[0] for t in times], radius=radius
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("experiments", nargs="*", default=["capstan", "pile"])
    parser.add_argument("--elements", type=int, default=100)
    parser.add_argument("--solvers", nargs="*", default=["gendom", "mujoco", "pyelastica"])
    given = parser.parse_args()
    for name in given.experiments:
        experiment = registry.load_experiment(name)
        for solver in given.solvers:
            try:
                made = GenDOM() if solver == "gendom" else registry.load_solver(solver)
                found = describe(run(experiment, made, n_elements=given.elements).summary())
            except ImportError as error:
                found = f"not installed ({error.name})"
            print(f"{name:10} {solver:12} {found}", flush=True)


if __name__ == "__main__":
    main()
