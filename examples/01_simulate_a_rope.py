"""Simulate a rope that a gripper lifts and lets go, and draw what happens (about 2 s).

    python examples/01_simulate_a_rope.py --out lifted

Two ropes that differ in stiffness alone are simulated side by side, as two worlds of one batch.
"""

import tempfile
from pathlib import Path

import numpy as np
import tyro

from gendom import Material, Simulator
from gendom.sim import Gripper, Table, rope
from gendom.viz import Animation, object_layer, write_film


def main(out: Path | None = None) -> None:
    """Simulate, print where the free ends are, and write rope.gif.

    Args:
        out: Folder to write to; by default a new temporary one.
    """
    out = Path(tempfile.mkdtemp(prefix="gendom-")) if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    body = rope(diameter=0.01, length=0.3, start=(0.0, 0.0, 0.005))
    hand = Gripper(
        time=[0.0, 1.0],
        position=[(0.0, 0.0, 0.005), (0.0, 0.0, 0.25)],
        radius=0.0075,
        hold_until=1.3,
    )
    materials = [Material(E=E, nu=0.35, density=800, damping=0.004) for E in (2e5, 2e6)]
    simulator = Simulator(body, materials, grippers=[hand], table=Table(height=0.0))

    times = np.linspace(0.0, 1.8, 37)
    x = simulator.run(times)  # [T, W, N, 3] positions of the rope's points [m]
    for material, tip in zip(materials, x[26, :, -1], strict=True):
        print(f"E {material.E:.0e} Pa, held at 0.25 m: the free end is at {tip.round(3)} m")

    soft = object_layer("soft rope", body, x[:, 0])
    stiff = object_layer("stiff rope", body, x[:, 1], color="#0072B2")
    write_film(out / "rope.gif", Animation(times=times, layers=(soft, stiff), table_height=0.0))
    print(f"wrote {out / 'rope.gif'}")


if __name__ == "__main__":
    tyro.cli(main)
