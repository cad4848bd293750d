"""A simulation as a function of PyTorch tensors (needs the extra ``train``)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from torch import Tensor

from gendom.arguments import check_list, check_numbers, check_type, require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.materials.parameters import FIELDS, OF_THIN
from gendom.sim.bodies import Body
from gendom.sim.gripper import Gripper
from gendom.sim.obstacles import Obstacle, Table
from gendom.sim.rollout import Rollout
from gendom.sim.setting import Physics, Solver, Variation
from gendom.sim.simulator import Simulator, engine_of
from gendom.sim.thin.rotation import left_jacobian

_OF_PHYSICS = ("velocity_damping", "air_density", "self_friction", "gravity")


def _shapes(
    body: Body, solver: Solver, grippers: Sequence[Gripper], obstacles: int, given: set[str]
) -> dict[str, tuple[int, ...]]:
    """Inputs that may be tensors, and their shapes in one world; refuses others that are given."""
    thin = engine_of(body, solver) == "thin"
    N = len(body.points) if thin else body.num_particles
    path = (len(grippers), max((len(np.asarray(g.time)) for g in grippers), default=0), 3)
    scalars = ("velocity_damping", "air_density", "friction", "self_friction", "thickness")
    shapes = dict.fromkeys((*FIELDS, *scalars), ()) | {
        "gravity": (3,), "obstacle_friction": (obstacles,),
        "stiffness": (N,), "positions": (N, 3), "velocities": (N, 3),
        "gripper_positions": path, "gripper_rotations": path, "gripper_radius": path[:1],
    }  # fmt: skip
    unknown, names = sorted(given - set(shapes)), ", ".join(shapes)
    require(not unknown, f"simulate takes {names}; unknown: {unknown}")
    only_thin = sorted({"thickness", "obstacle_friction", *OF_THIN} & given)
    what = f"the MPM has no derivative by {', '.join(only_thin)}"
    require(thin or not only_thin, what, fix='solver=Solver(engine="thin")')
    return shapes


def simulate(
    body: Body,
    times: ArrayLike,
    *,
    materials: Sequence[Material] = (Material(),),
    grippers: Sequence[Gripper] = (),
    table: Table | None = None,
    obstacles: Sequence[Obstacle] = (),
    physics: Physics = Physics(),
    solver: Solver = Solver(),
    variation: Variation = Variation(),
    start_time: float = 0.0,
    **given: Tensor | float,
) -> Tensor:
    """Simulate positions at given times, differentiable with respect to every input tensor.

    Keywords and their defaults are those of ``Simulator``.

    Args:
        body: The body to simulate.
        times: [T] not decreasing [s].
        materials: One for each world, or one for all; inputs of the names of its fields replace
            them.
        grippers: Shared by all worlds; ``gripper_positions``, ``gripper_rotations`` and
            ``gripper_radius`` change them.
        table: Table; ``friction``, if given, replaces its coefficient.
        obstacles: Shared by all worlds; ``obstacle_friction``, if given, replaces their
            coefficients.
        physics, variation: Inputs of the names of their fields replace them.
        solver, start_time: As of ``Simulator``.
        given: ``E`` [Pa], ``nu``, ``density`` [kg/m^3], ``damping`` [s], of shells ``membrane``
            [Pa], ``warp``, ``weft`` and ``shear``, ``velocity_damping`` [1/s], ``air_density``
            [kg/m^3], ``friction``, ``self_friction``: numbers or [W]; ``gravity`` [3] or [W, 3];
            ``obstacle_friction`` [O] or [W, O]; ``stiffness`` [N] or [W, N]; ``positions`` and
            ``velocities`` [N, 3] or [W, N, 3]; of grippers, with K the knots of each one's own
            path, ``gripper_positions`` [G, K, 3] or [W, G, K, 3], ``gripper_rotations`` of the same
            shape, rotation vectors that turn them further, in world axes [rad], and
            ``gripper_radius`` [G] or [W, G]. For rods and shells also what all worlds share of the
            body: ``thickness`` (or diameter) [m]. Tensors that require a gradient get one.

    Returns:
        [T, W, N, 3] positions [m], in the dtype of the simulation.

    Raises:
        ParameterError: If a name is unknown, or an argument is of another type, shape or range.
        SimulationError: If a world diverges, or a derivative does in the backward pass.
    """
    check_type("body", body, Body)
    check_list("materials", materials, Material)
    check_list("grippers", grippers, Gripper)
    check_list("obstacles", obstacles, Obstacle)
    shapes = _shapes(body, solver, grippers, len(obstacles), set(given))
    scene = {
        "body": body, "materials": materials, "grippers": grippers, "table": table,
        "obstacles": obstacles, "physics": physics, "solver": solver, "variation": variation,
        "start_time": start_time,
    }  # fmt: skip
    names, tensors = _spread(given, shapes, len(materials))
    return _Simulation.apply(scene, times, names, *tensors)  # pyright: ignore[reportReturnType]


def _spread(
    given: dict[str, Any], shapes: dict[str, tuple[int, ...]], worlds: int
) -> tuple[list[str], list[Tensor]]:
    """Names of what is given, and tensors that are expanded to one leading axis of worlds; torch
    sums the derivatives over it."""
    tensors = {}
    for n in [n for n in shapes if n in given]:
        a = given[n] if isinstance(given[n], Tensor) else check_numbers(n, given[n], finite=False)
        tensors[n] = torch.as_tensor(a, dtype=torch.float64)
    extra = {n: t.dim() - len(shapes[n]) for n, t in tensors.items()}
    wrong = [n for n, e in extra.items() if e not in ((0,) if n == "thickness" else (0, 1))]
    if wrong:
        raise ParameterError(f"too many or too few axes: {', '.join(wrong)}")
    counts = {worlds} | {t.shape[0] for n, t in tensors.items() if extra[n] == 1}
    if len(counts - {1}) > 1:
        raise ParameterError(f"arguments are for different numbers of worlds: {sorted(counts)}")
    W, spread = max(counts), []
    for n, t in tensors.items():
        shape = (W, *shapes[n])
        try:
            spread.append(t.expand(shape))
        except RuntimeError:
            raise ParameterError(f"{n} has shape {tuple(t.shape)}, expected {shape}") from None
    return list(tensors), spread


class _Simulation(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, scene: dict[str, Any], times: ArrayLike, names: list[str], *tensors: Tensor
    ) -> Tensor:
        v = {n: t.detach().cpu().numpy() for n, t in zip(names, tensors, strict=True)}
        made, body, materials = dict(scene), scene["body"], scene["materials"]
        worlds = range(max([len(materials), *(len(values) for values in v.values())]))
        given = [n for n in FIELDS if n in v]
        made["materials"] = [
            replace(materials[w % len(materials)], **{n: float(v[n][w]) for n in given})
            for w in worlds
        ]
        hands = list(enumerate(scene["grippers"]))
        made["grippers"] = [[_changed(g, i, w, v) for i, g in hands] for w in worlds]
        made["physics"] = replace(scene["physics"], **{n: v[n] for n in _OF_PHYSICS if n in v})
        if "thickness" in v:
            h = float(v["thickness"][0])
            radius = body.contact_radius * h / body.thickness
            made["body"] = replace(body, thickness=h, contact_radius=radius)
        if "friction" in v:
            if scene["table"] is None:
                raise ParameterError("friction without a table: pass table=Table(height=...)")
            made["table"] = replace(scene["table"], friction=v["friction"])
        if "obstacle_friction" in v:
            made["obstacles"] = [
                [replace(of, friction=mu) for of, mu in zip(scene["obstacles"], rubs, strict=True)]
                for rubs in v["obstacle_friction"].tolist()
            ]
        if "stiffness" in v:
            made["variation"] = replace(scene["variation"], stiffness=v["stiffness"])
        simulator = Simulator(**made, positions=v.get("positions"))
        if "velocities" in v:
            simulator.set_velocities(v["velocities"])
        ctx.rollout = Rollout(simulator)
        ctx.names, ctx.turned = names, v.get("gripper_rotations")
        return torch.from_numpy(ctx.rollout.forward(times))

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        gradients = ctx.rollout.backward(bars[0].detach().cpu().numpy())
        found = {n: getattr(gradients, n) for n in ctx.names}
        if ctx.turned is not None:  # by rotation vectors, not by a further rotation
            by_turn = found["gripper_rotations"][..., None, :] @ left_jacobian(ctx.turned)
            found["gripper_rotations"] = by_turn[..., 0, :]
        return None, None, None, *(torch.as_tensor(a, dtype=torch.float64) for a in found.values())


def _changed(gripper: Gripper, i: int, w: int, v: dict[str, Array]) -> Gripper:
    """Gripper i as it is in world w."""
    K, change = len(np.atleast_1d(np.asarray(gripper.time))), {}
    if "gripper_positions" in v:
        change["position"] = v["gripper_positions"][w, i, :K]
    if "gripper_rotations" in v:
        quat = [[0.0, 0.0, 0.0, 1.0]] * K if gripper.quat_xyzw is None else gripper.quat_xyzw
        by = Rotation.from_rotvec(v["gripper_rotations"][w, i, :K])
        change["quat_xyzw"] = (by * Rotation.from_quat(quat)).as_quat()
    if "gripper_radius" in v:
        change["radius"] = float(v["gripper_radius"][w, i])
    return replace(gripper, **change) if change else gripper
