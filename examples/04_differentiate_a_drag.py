"""Differentiate a simulation through PyTorch: find where to drag one end of a rope so that its free
end comes to a goal (about 6 s; needs the extra `train`).

    python examples/04_differentiate_a_drag.py

The end of the gripper's path is a tensor. Derivatives of the free end's position come from the
reverse mode of the simulator; Gauss-Newton steps with them find the drag.
"""

import torch

from gendom.sim import Gripper, Table, rope
from gendom.sim.autograd import simulate

GOAL = torch.tensor([0.21, 0.03], dtype=torch.float64)  # of the free end [m]
RADIUS = 0.006
START = (0.0, 0.0, RADIUS)

body = rope(diameter=2 * RADIUS, length=0.3, start=START)
hand = Gripper(time=[0.0, 1.0], position=[START, START], radius=0.01)


def free_end(end: torch.Tensor) -> torch.Tensor:
    """[2] where the free end comes to rest [m] when the other one is dragged to `end` [2]."""
    knots = torch.stack([torch.tensor(START), torch.cat([end, torch.tensor([RADIUS])])])
    x = simulate(
        body,
        [1.5],
        grippers=[hand],
        gripper_positions=knots[None],  # [G, K, 3]
        table=Table(height=0.0),
        E=8e5,
        nu=0.35,
        density=800.0,
        damping=0.004,
        friction=0.4,
    )
    return x[-1, 0, -1, :2]  # the last time, the only world, the last point


def main() -> None:
    """Print each step of the search."""
    end = torch.tensor([-0.05, 0.15], dtype=torch.float64)
    for _ in range(8):
        J = torch.autograd.functional.jacobian(free_end, end)
        miss = GOAL - free_end(end)
        print(f"drag to {end.numpy().round(4)} m: missed by {1e3 * miss.norm():.2f} mm")
        if miss.norm() < 1e-4:
            break
        step = torch.linalg.solve(J.T @ J + 1e-3 * torch.eye(2), J.T @ miss)
        end = end + step * torch.clamp(0.08 / step.norm(), max=1.0)


if __name__ == "__main__":
    main()
