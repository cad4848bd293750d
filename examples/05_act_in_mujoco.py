"""Let the robot arm of the MuJoCo test scene act, as a shipped policy says (about 5 s; needs the
extra `reality`).

    python examples/05_act_in_mujoco.py

The policy never saw this scene: it was trained in GenDOM's own simulator. MuJoCo solves other
equations, and the arm follows its limits.
"""

import numpy as np

from gendom import Policy, RopeCasting
from gendom.reality import RealWorld, find_object
from gendom.tasks import Simulation

GOAL = (0.389, 0.091)  # the tip's highest point: along the cast, height [m]


def main() -> None:
    """Act with and without the rope's parameters, in the simulator and in MuJoCo."""
    rope = find_object("rope-cotton")
    task = RopeCasting()
    for parameters in (True, False):
        policy = Policy.pretrained("rope-casting", parameters=parameters)
        action = policy.act(GOAL, rope)
        print(f"policy that sees {', '.join(policy.description.conditioned_on) or 'nothing'}:")
        print(f"  hand moves by {action.values[0]:.3f} m")
        for name, world in (("simulator", Simulation()), ("MuJoCo, arm", RealWorld())):
            (outcome,) = world.carry_out(task, [rope], [action.values])
            if outcome.fault is not None:
                print(f"  {name}: {outcome.fault}")
                continue
            reached = np.array([outcome.values["x"], outcome.values["z"]])
            miss = 1e3 * np.linalg.norm(reached - GOAL)
            print(f"  {name}: the tip reaches {reached.round(3)} m, {miss:.1f} mm from the goal")


if __name__ == "__main__":
    main()
