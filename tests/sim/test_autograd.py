"""The simulation as a PyTorch function."""

import math

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Capsule, Gripper, Simulator, Solver, Table, Variation, cloth, rope

torch = pytest.importorskip("torch", reason="needs the extra train")

from gendom.sim.autograd import simulate  # noqa: E402

BODY = rope(diameter=0.014, length=0.06, start=(0.0, 0.0, 0.0075), cells_across=2.0)
PATH = [[0.0001, 0, 0.0076], [0.0101, 0, 0.0301]]
SCENE = {
    "grippers": [Gripper(time=[0.0, 0.03], position=PATH, radius=0.006)],
    "table": Table(height=0.0),
    "solver": Solver(engine="mpm", substep=2e-4, dtype="float64"),
}


def loss_of(log_E, path, *, worlds=1):
    given = {"E": torch.exp(log_E).expand(worlds), "nu": 0.3, "density": 1000.0, "friction": 0.4}
    x = simulate(BODY, [0.01, 0.03], gripper_positions=path, **given, **SCENE)
    return torch.sqrt(((x[-1] - x[0]) ** 2).sum(-1) + 1e-8).sum()


def test_a_torch_loss_reaches_its_tensors_through_the_simulation():
    log_E = torch.tensor(math.log(2e5), dtype=torch.float64, requires_grad=True)
    start = torch.tensor([PATH], dtype=torch.float64)
    path = start.clone().requires_grad_()
    loss_of(log_E, path, worlds=3).backward()
    # what worlds share gets the sum of their derivatives
    up, down = (loss_of(log_E.detach() + h, start) for h in (1e-5, -1e-5))
    assert float(log_E.grad) == pytest.approx(3.0 * float(up - down) / 2e-5, rel=1e-5)
    step = torch.zeros_like(start)
    step[0, 1, 2] = 1e-9  # small: nodes that enter or leave the grip jump
    up, down = loss_of(log_E.detach(), start + step), loss_of(log_E.detach(), start - step)
    assert float(path.grad[0, 1, 2]) == pytest.approx(3.0 * float(up - down) / 2e-9, rel=1e-5)


def test_every_input_gets_its_derivative():
    """Shells have all of them."""
    body = cloth(width=0.1, height=0.08, thickness=0.002, dx=0.02, points=(6, 5))
    ends = torch.tensor(body.points[[0, -1]])
    turn = torch.tensor([[[0.1, 0.2, -0.1], [0.3, -0.1, 0.2]], [[0.0, 0.0, 0.0], [0.2, 0.4, 0.1]]])
    given = {
        "E": torch.tensor(3e5), "nu": torch.tensor(0.3), "density": torch.tensor(900.0),
        "damping": torch.tensor(0.002), "velocity_damping": torch.tensor(3.0),
        "air_density": torch.tensor(30.0), "positions": torch.tensor(body.points),
        "thickness": torch.tensor(body.thickness), "gravity": torch.tensor([0.5, 0.2, -20.0]),
        "gripper_positions": torch.stack([ends, ends + torch.tensor([0.0, 0.004, 0.008])], dim=1),
        "obstacle_friction": torch.tensor([0.3]), "gripper_rotations": turn,
        "gripper_radius": torch.tensor([0.0231, 0.0213]), "membrane": torch.tensor(2e5),
        "warp": torch.tensor(1.2), "weft": torch.tensor(0.9), "shear": torch.tensor(0.7),
    }  # fmt: skip
    given = {name: a.to(torch.float64).requires_grad_() for name, a in given.items()}
    hands = [Gripper(time=[0.0, 0.03], position=[(0, 0, 0)] * 2, radius=0.01)] * 2
    n, low = len(body.points), body.points[:, 2].min() - body.thickness / 2.0
    bar = Capsule.between((0.05, -0.1, low - 0.0201), (0.06, 0.2, low - 0.0203), radius=0.02)

    def loss(values):
        more = {"grippers": hands, "obstacles": [bar], "solver": Solver(substep=1e-4)}
        x = simulate(body, [0.015, 0.03], **values, **more)
        return (x[:, 0] * torch.arange(6 * n, dtype=torch.float64).reshape(2, n, 3).sin()).sum()

    loss(given).backward()
    with torch.no_grad():
        for name, value in given.items():
            way = torch.cos(1.7 * torch.arange(value.numel()) + 0.5).reshape(value.shape)
            moves = name in ("thickness", "positions") or name.startswith("gripper")
            h = (3e-7 if moves else 1e-5) * max(float(value.abs().max()), 1e-3)
            h /= float(value.abs().max()) if "rotations" in name else 1.0
            up, down = (loss(given | {name: value + k * h * way}) for k in (1, -1))
            expected = float(up - down) / (2.0 * h)
            assert value.grad is not None, name
            assert float((value.grad * way).sum()) == pytest.approx(expected, rel=3e-5), name


def test_keywords_and_defaults_are_those_of_the_simulator():
    body = rope(diameter=0.004, length=0.1, start=(0, 0, 0.05), points=11)
    more = {"table": Table(height=0.0), "start_time": 0.1,
            "variation": Variation(mass=np.linspace(1.0, 2.0, 11))}  # fmt: skip
    soft = [Material(E=1e4, damping=0.01), Material(E=1e5)]
    hand = [Gripper.still(body.points[0], radius=0.012)]
    y = Simulator(body, soft, grippers=hand, **more).run([0.2])
    x = simulate(body, [0.2], materials=soft, grippers=hand, **more)
    np.testing.assert_array_equal(x.numpy(), y)
    x = simulate(body, [0.2], E=torch.tensor([1e4, 1e5]), grippers=hand, **more)
    np.testing.assert_array_equal(x[:, 1].numpy(), y[:, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"youngs": 1.0}, "unknown"),
        ({"thickness": 0.01}, "the MPM has no derivative by thickness"),
        ({"nu": torch.zeros(2, 2)}, "axes"),
        ({"E": torch.ones(2) * 1e5, "nu": torch.ones(3) * 0.3}, "different numbers"),
        ({"positions": torch.zeros(5, 3)}, "positions has shape"),
        ({"E": "soft"}, "E must be numbers, got 'soft'"),
        ({"obstacles": [3]}, r"obstacles\[0\] must be a Obstacle"),
        ({"table": None, "friction": np.float64(0.2)}, "without a table"),
    ],
)
def test_arguments_that_do_not_fit_are_named(change, message):
    given = {"body": BODY, "times": [0.01], **SCENE, "E": 1e5, "nu": 0.3, "density": 1e3, **change}
    with pytest.raises(ParameterError, match=message):
        simulate(**given)
