"""Write a recording of your own from arrays, check it and read it back (about 2 s).

    python examples/02_your_own_recording.py --out mine

The clouds come from a simulation here. Put those of your cameras in their place: one array
[n, 3] in metres for each frame, in the world frame with z up; n may differ between frames.
"""

import tempfile
from pathlib import Path

import numpy as np
import tyro

from gendom import Material, ObjectDescription, Recording, Simulator
from gendom.cli import main as gendom
from gendom.sim import Gripper, Table, rope


def main(out: Path | None = None) -> None:
    """Write lift.npz, check it, and show what a fault looks like.

    Args:
        out: Folder to write to; by default a new temporary one.
    """
    out = Path(tempfile.mkdtemp(prefix="gendom-")) if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    time = np.linspace(0.0, 2.0, 31)  # [T] seconds
    gripper = np.zeros((31, 3))  # [T, 3] metres
    gripper[:, 2] = 0.006 + 0.1 * time
    body = rope(diameter=0.012, length=0.3, start=(0.0, 0.0, 0.006))
    hand = Gripper(time=time, position=gripper, radius=0.0125)
    material = Material(E=8e5, nu=0.35, density=800, damping=0.004)
    x = Simulator(body, [material], grippers=[hand], table=Table(height=0.0)).run(time)[:, 0]
    rng = np.random.default_rng(0)
    clouds = [rng.choice(skin, 300) + rng.normal(0.0, 1e-3, (300, 3)) for skin in body.surface(x)]

    recording = Recording.from_frames(
        clouds,
        time=time,
        gripper_position=gripper,
        object=ObjectDescription(kind="rope", length=0.3, diameter=0.012, mass=0.027),
        table_height=0.0,
        gripper_source="measured",
        quasi_static=True,
    )
    recording.write(out / "lift.npz")
    gendom(["check", str(out / "lift.npz")])  # as `gendom check` on the command line

    in_millimetres = Recording.from_frames(
        [1000.0 * cloud for cloud in clouds],
        time=time,
        gripper_position=gripper,
        object=recording.object,
    )
    print("\nThe same with clouds in millimetres:")
    for fault in in_millimetres.validate():
        print(f"  {fault.severity}: {fault}")


if __name__ == "__main__":
    tyro.cli(main)
