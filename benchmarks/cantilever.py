"""Rods beside PyElastica and MuJoCo: a cantilever that begins to sag, with a closed form.

    python benchmarks/cantilever.py [--elastica PYTHON] [--rounds 5]

A straight rope, clamped at one end, is let go in weak gravity and swings about its static sag of
1 % of its length, without damping. Theory: the modes of an Euler-Bernoulli beam. The table: for
each simulator and number of edges the root mean square of the tip's error over one period and a
bit, over the static sag, and the seconds that a simulated second takes on one core (median; the
simulators take turns). ``--elastica`` is an interpreter that has PyElastica
(``make -C benchmarks peers``).
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

LENGTH, DIAMETER, E, NU, DENSITY = 0.3, 0.006, 1e6, 0.3, 800.0
SECONDS, FRAMES = 3.0, 100
AREA, INERTIA = np.pi * DIAMETER**2 / 4.0, np.pi * DIAMETER**4 / 64.0
SAG = 0.01 * LENGTH
GRAVITY = SAG * 8.0 * E * INERTIA / (DENSITY * AREA * LENGTH**4)
TIMES = np.linspace(0.0, SECONDS, FRAMES + 1)[1:]
EDGES = (10, 20, 40)


def theory() -> np.ndarray:
    """[T] how far the tip is below the clamp [m]: six modes of a beam that is let go."""
    roots = (1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349, 14.1371683910, 17.2787595321)
    x = np.linspace(0.0, 1.0, 4001)
    sag = np.zeros(FRAMES)
    for b in roots:
        ratio = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
        shape = np.cosh(b * x) - np.cos(b * x) - ratio * (np.sinh(b * x) - np.sin(b * x))
        omega = b**2 * np.sqrt(E * INERTIA / (DENSITY * AREA * LENGTH**4))
        part = np.trapezoid(shape, x) / np.trapezoid(shape**2, x)
        sag += GRAVITY / omega**2 * part * shape[-1] * (1.0 - np.cos(omega * TIMES))
    return sag


def gendom(edges: int) -> tuple[np.ndarray, float]:
    from gendom.materials import Material
    from gendom.sim import Gripper, Simulator, rope

    held = 0.75 * DIAMETER
    body = rope(diameter=DIAMETER, length=LENGTH + held, start=(0.0, 0.0, 0.0), points=edges + 1)
    hand = Gripper(time=[0.0], position=[(0.0, 0.0, 0.0)], radius=held)
    simulator = Simulator(
        body, [Material(E=E, nu=NU, density=DENSITY, damping=0.0)], engine="thin",
        grippers=[hand], gravity=(0.0, 0.0, -GRAVITY), air_density=0.0, threads=1,
    )  # fmt: skip
    simulator.run([1e-6])
    began = time.perf_counter()
    x = simulator.run(1e-6 + TIMES)
    return -x[:, 0, -1, 2], time.perf_counter() - began


def mujoco(edges: int, timestep: float = 0.001) -> tuple[np.ndarray, float]:
    from gendom.materials import Material
    from gendom.reality import Layout, Reality, RealRope

    # it is free from half an edge before its last pinned vertex (docs/reality.md)
    edge = LENGTH / (edges - 0.5)
    item = RealRope(
        name="cantilever", length=edges * edge, diameter=DIAMETER, friction=0.3, vertices=edges + 1,
        material=Material(E=E, nu=NU, density=DENSITY, damping=0.0), colour=(0, 0, 0),
    )  # fmt: skip
    layout = Layout(origin=(0.0, 0.0, 0.5), clamped=1e-6)
    world = Reality(
        item, layout, table=False, timestep=timestep, gravity=(0.0, 0.0, -GRAVITY), air_density=0.0
    )
    began, tip = time.perf_counter(), []
    for t in TIMES:
        world.step_to(float(t))
        tip.append(0.5 - world.vertices()[-1, 2])
    return np.array(tip), time.perf_counter() - began


def elastica(edges: int) -> tuple[np.ndarray, float]:
    import elastica as ea  # pyright: ignore[reportMissingImports]

    # an edge whose direction is fixed is clamped up to its middle
    edge = LENGTH / (edges - 0.5)

    class Scene(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
        pass

    for halvings in range(12):
        scene = Scene()
        rod = ea.CosseratRod.straight_rod(
            edges, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]),
            edges * edge, DIAMETER / 2.0, DENSITY,
            youngs_modulus=E, shear_modulus=E / 2.0 / (1.0 + NU),
        )  # fmt: skip
        scene.append(rod)
        scene.constrain(rod).using(
            ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        scene.add_forcing_to(rod).using(
            ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY])
        )
        scene.finalize()
        # the largest stable step: an edge's length over the speed of sound, halved until it is
        longest = edge / np.sqrt(E / DENSITY) / 2**halvings
        steps = int(np.ceil(SECONDS / FRAMES / longest))
        dt, stepper, now, tip = SECONDS / FRAMES / steps, ea.PositionVerlet(), 0.0, []
        began = time.perf_counter()
        for _ in TIMES:
            for _ in range(steps):
                now = stepper.step(scene, now, dt)
            tip.append(-rod.position_collection[2, -1])
        took = time.perf_counter() - began
        if np.isfinite(tip).all() and np.abs(tip).max() < 4.0 * SAG:
            return np.array(tip), took
    raise RuntimeError("no step is stable")


SIMULATORS = {"gendom": gendom, "mujoco": mujoco, "elastica": elastica}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    peer = Path(__file__).parent / ".envs/elastica/bin/python"
    parser.add_argument("--elastica", type=Path, default=peer)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=SIMULATORS, help="one simulator, as JSON")
    given = parser.parse_args()
    if given.only:
        rows = []
        for edges in EDGES:
            SIMULATORS[given.only](edges)  # compiles
            tip, seconds = SIMULATORS[given.only](edges)
            error = float(np.sqrt(np.mean((tip - theory()) ** 2)) / SAG)
            rows.append({"edges": edges, "error": error, "seconds": seconds / SECONDS})
        print(json.dumps(rows))
        return
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    found: dict[str, list[list[dict[str, float]]]] = {name: [] for name in SIMULATORS}
    for _ in range(given.rounds):
        for name in SIMULATORS:
            python = given.elastica if name == "elastica" else sys.executable
            done = subprocess.run(
                [str(python), __file__, "--only", name],
                env=environment, capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode:
                print(f"{name}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
                continue
            found[name].append(json.loads(done.stdout.strip().splitlines()[-1]))
    print("simulator   edges   error    seconds for one simulated")
    for name, rounds in found.items():
        for rows in zip(*rounds, strict=True):
            seconds = statistics.median(row["seconds"] for row in rows)
            print(f"{name:10} {rows[0]['edges']:6} {rows[0]['error']:8.4f} {seconds:12.4f}")


if __name__ == "__main__":
    main()
