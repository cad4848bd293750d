"""A simulation as a function of PyTorch tensors (needs the extra ``train``)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from gendom.arguments import check_list, check_numbers, check_type
from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim.bodies import Body
from gendom.sim.gripper import Gripper
from gendom.sim.rollout import Rollout
from gendom.sim.scene import Table
from gendom.sim.simulator import Simulator

_NAMES = (
    "E",
    "nu",
    "density",
    "yield_stress",
    "stiffness",
    "damping",
    "velocity_damping",
    "friction",
    "self_friction",
    "gravity",
    "positions",
    "velocities",
    "gripper_positions",
)
_OF_MATERIAL = ("E", "nu", "density", "yield_stress", "damping")


def simulate(
    body: Body,
    times: ArrayLike,
    *,
    grippers: Sequence[Gripper] = (),
    table: Table | None = None,
    memory: float | None = None,
    options: dict[str, Any] | None = None,
    **given: Tensor | float,
) -> Tensor:
    """Simulate positions at given times, differentiable with respect to every input tensor.

    Args:
        body: The body to simulate.
        times: [T] not decreasing [s].
        grippers: Shared by all worlds; ``gripper_positions`` moves their knots.
        table: Table; ``friction``, if given, replaces its coefficient.
        memory: Limit on memory for the backward pass [bytes] (default: as ``Rollout``).
        options: Further arguments of ``Simulator`` (``engine``, by default ``mpm``; ``law``,
            ``self_contact``, ``substep``, ``dtype``, ``threads``).
        given: ``E`` [Pa], ``nu``, ``density`` [kg/m^3] and optionally ``yield_stress`` [Pa],
            ``damping`` [s] (``Material.damping``), ``velocity_damping`` [1/s], ``friction``,
            ``self_friction``: numbers or [W]; ``gravity`` [3] or [W, 3]; ``stiffness`` [N] or
            [W, N]; ``positions`` and ``velocities`` [N, 3] or [W, N, 3]; ``gripper_positions``
            [G, K, 3] or [W, G, K, 3], K the knots of each gripper's own path. Tensors that require
            a gradient get one.

    Returns:
        [T, W, N, 3] positions [m], in the dtype of the simulation.

    Raises:
        ParameterError: If a name is unknown, E, nu or density is missing, or an argument is of
            another type, shape or range.
        SimulationError: If a world diverges, or a derivative does in the backward pass.
    """
    unknown = sorted(set(given) - set(_NAMES))
    missing = sorted({"E", "nu", "density"} - set(given))
    if unknown or missing:
        raise ParameterError(
            f"simulate takes {', '.join(_NAMES)}; unknown: {unknown}, missing: {missing}"
        )
    check_type("body", body, Body)
    check_list("grippers", grippers, Gripper)
    names = [n for n in _NAMES if n in given]
    tensors = [_tensor(n, given[n]) for n in names]
    scene = (body, times, tuple(grippers), table, memory, options or {})
    N = len(body.points) if (options or {}).get("engine") == "thin" else body.num_particles
    return _Simulation.apply(scene, names, *_spread(names, tensors, N, grippers))  # pyright: ignore[reportReturnType]


def _tensor(name: str, value: Any) -> Tensor:
    given = value if isinstance(value, Tensor) else check_numbers(name, value, finite=False)
    return torch.as_tensor(given, dtype=torch.float64)


def _spread(
    names: list[str], tensors: list[Tensor], N: int, grippers: Sequence[Gripper]
) -> list[Tensor]:
    """Expand the tensors to one leading axis of worlds; torch sums the derivatives over it."""
    own = {"gravity": 1, "stiffness": 1, "positions": 2, "velocities": 2, "gripper_positions": 3}
    extra = {n: t.dim() - own.get(n, 0) for n, t in zip(names, tensors, strict=True)}
    wrong = [n for n, e in extra.items() if e not in (0, 1)]
    if wrong:
        raise ParameterError(f"too many or too few axes: {', '.join(wrong)}")
    counts = {t.shape[0] for n, t in zip(names, tensors, strict=True) if extra[n] == 1}
    if len(counts - {1}) > 1:
        raise ParameterError(f"arguments are for different numbers of worlds: {sorted(counts)}")
    W = max(counts, default=1)
    shapes = {
        "gravity": (3,),
        "stiffness": (N,),
        "positions": (N, 3),
        "velocities": (N, 3),
        "gripper_positions": (len(grippers), *_knots(grippers), 3),
    }
    spread = []
    for n, t in zip(names, tensors, strict=True):
        shape = (W, *shapes.get(n, ()))
        try:
            spread.append(t.expand(shape))
        except RuntimeError:
            raise ParameterError(f"{n} has shape {tuple(t.shape)}, expected {shape}") from None
    return spread


def _knots(grippers: Sequence[Gripper]) -> tuple[int]:
    counts = {len(np.asarray(g.time)) for g in grippers}
    return (max(counts, default=0),)


class _Simulation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, scene: tuple, names: list[str], *tensors: Tensor) -> Tensor:
        body, times, grippers, table, memory, options = scene
        v = {n: t.detach().cpu().numpy() for n, t in zip(names, tensors, strict=True)}
        W = len(v["E"])
        given = [n for n in _OF_MATERIAL if n in v]
        materials = [Material(**{n: float(v[n][w]) for n in given}) for w in range(W)]
        every: Any = grippers
        if "gripper_positions" in v:
            every = [
                [
                    replace(g, position=v["gripper_positions"][w, i, : len(np.asarray(g.time))])
                    for i, g in enumerate(grippers)
                ]
                for w in range(W)
            ]
        if "friction" in v:
            if table is None:
                raise ParameterError("friction without a table: pass table=Table(height=...)")
            table = replace(table, friction=v["friction"])
        direct = ("stiffness", "velocity_damping", "self_friction", "gravity", "positions")
        more = {n: v[n] for n in direct if n in v}
        simulator = Simulator(
            body,
            materials,
            grippers=every,
            table=table,
            **{"dtype": "float64", "engine": "mpm", **more, **options},
        )
        if "velocities" in v:
            simulator.set_velocities(v["velocities"])
        ctx.rollout = Rollout(simulator, memory=memory)
        ctx.names = names
        return torch.from_numpy(ctx.rollout.forward(times))

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        gradients = ctx.rollout.backward(bars[0].detach().cpu().numpy())
        found = [torch.as_tensor(getattr(gradients, n), dtype=torch.float64) for n in ctx.names]
        return None, None, *found
