"""Put a rope of your own into the MuJoCo test scene (about 5 s; needs the extra `reality`).

    python examples/07_your_own_object.py --out mine

A TOML file describes it. `gendom record --reality mine/rope.toml --out mine/lift` records its lift
before two depth cameras (that needs OpenGL, so this example does not).
"""

import tempfile
from pathlib import Path

import numpy as np
import tyro

from gendom import RopeReaching
from gendom.reality import RealWorld, find_object
from gendom.tasks import Simulation

ROPE = """
kind = "rope"
length = 0.28              # [m]
diameter = 0.012           # [m]
mass = 0.03                # [kg]
E = 1.2e6                  # [Pa], of bending
nu = 0.35
damping = 0.004            # [s]
friction = 0.4
colour = [200, 60, 60]     # sRGB
"""


def main(out: Path | None = None) -> None:
    """Write rope.toml, and carry a task out with it.

    Args:
        out: Folder to write to; by default a new temporary one.
    """
    out = Path(tempfile.mkdtemp(prefix="gendom-")) if out is None else out
    out.mkdir(parents=True, exist_ok=True)
    (out / "rope.toml").write_text(ROPE)
    rope = find_object(str(out / "rope.toml"))
    print(f"{rope.name}: {rope.mass:.3f} kg, E {rope.material.E:.2e} Pa")

    task = RopeReaching()
    action = task.limits(rope).mean(axis=1)  # the middle of what the task allows: x, z [m]
    for name, world in (("simulator", Simulation()), ("MuJoCo, free hand", RealWorld(robot=False))):
        (outcome,) = world.carry_out(task, [rope], [action])
        print(f"{name}: release at {np.round(action, 3)} m, farthest x of the tip:", end=" ")
        print(outcome.fault or f"{outcome.values['x']:.4f} m")


if __name__ == "__main__":
    tyro.cli(main)
