"""Cantilevers with a closed form, for ``race.py``: ropes, strips of cloth, and their simulators.

A straight rope or a flat strip, clamped at one end, is let go in weak gravity and swings about its
static sag of 1 % of its length, without damping, for 1.3 periods. Theory: the modes of a thin
plate, which for a rope are those of a beam. A run's error is the root mean square of the tip's,
over the static sag.

A wide strip is stiffer than a beam of modulus E: the clamp keeps it from curving across, within
about its width. One of 60 mm x 300 mm sags by 2.5 % less for nu 0.3, and swings 1.3 % faster; by
3.8 % and 2.0 % for MuJoCo's own Poisson's ratio of bending, -1/3 (`gendom.reality.objects`). Each
simulator is compared with the plate of its Poisson's ratio and width.
"""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial

LENGTH, NU, FRAMES = 0.3, 0.3, 100
SAG = 0.01 * LENGTH
EDGES = (6, 8, 10, 12, 16, 20, 24, 32, 40)
HINGES_NU = -1.0 / 3.0
"""Poisson's ratio of a lattice of squares whose diagonals take turns (`gendom.reality.objects`)."""
CORES = len(os.sched_getaffinity(0))
DEVICE = os.environ.get("RACE_DEVICE", "cpu")


@dataclass(frozen=True)
class Specimen:
    E: float
    """[Pa]."""
    density: float
    """[kg/m^3]."""
    thickness: float
    """[m]."""
    width: float
    """Of a strip; 0 for a rope [m]."""
    gyration: float
    """Radius of gyration of the section [m]."""

    @property
    def speed(self) -> float:
        """sqrt(E I / (rho A)) [m^2/s]."""
        return self.gyration * (self.E / self.density) ** 0.5

    @property
    def gravity(self) -> float:
        return 8.0 * SAG * self.speed**2 / LENGTH**4

    @property
    def times(self) -> np.ndarray:
        period = 2.0 * np.pi * LENGTH**2 / (1.8751040687**2 * self.speed)
        return np.linspace(0.0, 1.3 * period, FRAMES + 1)[1:]

    def pace(self, step: float) -> tuple[int, float]:
        """Steps a frame, and the step that divides one [s]."""
        steps = int(np.ceil(self.times[0] / step))
        return steps, self.times[0] / steps


ROPE = Specimen(E=1e6, density=800.0, thickness=0.006, width=0.0, gyration=0.0015)
STRIP = Specimen(E=6e5, density=400.0, thickness=0.001, width=0.06, gyration=0.001 / 12**0.5)

Prepared = tuple[Callable[[], np.ndarray], float, float]
"""Simulates all worlds and returns how far the first one's tip sinks [T] [m]; Poisson's ratio of
bending and width [m] of the plate to compare with."""


@cache
def theory(item: Specimen, nu: float, width: float) -> np.ndarray:
    """[T] how far the middle of the free side is below the clamp [m], by Ritz's method.

    Deflections are x^2 times polynomials along, and even ones across; 20 x 8 of them are within
    0.1 % of the sag. With nu = 0 the strip is a beam.
    """
    many = 8 if nu else 1
    along = [
        Polynomial([0, 0, 1]) * Legendre.basis(i, domain=[0, 1]).convert(kind=Polynomial)
        for i in range(20)
    ]
    across = [
        Legendre.basis(2 * j, domain=[-0.5, 0.5]).convert(kind=Polynomial) for j in range(many)
    ]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    area = np.outer(weights, weights) / 4.0

    def values(dx: int, dy: int) -> np.ndarray:
        x = np.array([p.deriv(dx)(0.5 + nodes / 2.0) for p in along]) / LENGTH**dx
        y = np.array([p.deriv(dy)(nodes / 2.0) for p in across]) / (width or 1.0) ** dy
        return np.einsum("ix,jy->ijxy", x, y).reshape(-1, len(nodes), len(nodes))

    def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("axy,bxy,xy->ab", a, b, area)

    w, xx, yy, xy = values(0, 0), values(2, 0), values(0, 2), values(1, 1)
    mixed = product(xx, yy)
    stiffness = product(xx, xx) + product(yy, yy) + nu * (mixed + mixed.T)
    stiffness += 2.0 * (1.0 - nu) * product(xy, xy)
    # the peers' environments lack SciPy and its eigh of two matrices
    inverse = np.linalg.inv(np.linalg.cholesky(product(w, w)))
    values_, modes = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    modes = inverse.T @ modes
    omega = item.speed * np.sqrt(values_ / (1.0 - nu**2))
    tips = np.array([p(1.0) * q(0.0) for p in along for q in across])
    loads = np.einsum("axy,xy->a", w, area)
    low = omega < 60.0 * omega[0]
    share = item.gravity * (loads @ modes) * (tips @ modes) / omega**2
    return (share * (1.0 - np.cos(np.outer(item.times, omega))))[:, low].sum(axis=1)


# ---- simulators: each prepares worlds of so many edges, with an option of its own ----------------


def gendom(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    from gendom.materials import Material
    from gendom.sim import Gripper, Physics, Simulator, Solver, cloth, rope

    dtype, soft = (*option.split(), "1")[:2]
    softness = float(soft)
    if item.width:
        h = LENGTH / edges
        body = cloth(
            width=LENGTH + h, height=item.width, thickness=item.thickness, dx=0.02,
            corner=(-h, -item.width / 2.0, 0.0), points=(edges + 2, across(edges) + 1),
        )  # fmt: skip
        hand = Gripper.still((-100.0, 0.0, 0.0), radius=100.0)  # all that is beyond 0
    else:
        held = 0.75 * item.thickness
        body = rope(
            diameter=item.thickness, length=LENGTH + held, start=(0, 0, 0), points=edges + 1
        )
        hand = Gripper.still((0.0, 0.0, 0.0), radius=held)
    material = Material(
        E=item.E, nu=NU, density=item.density, damping=0.0,
        membrane=item.E / softness if softness > 1.0 else None,
    )  # fmt: skip
    simulator = Simulator(
        body,
        [material] * worlds,
        grippers=[hand],
        physics=Physics(air_density=0.0, gravity=(0.0, 0.0, -item.gravity)),
        solver=Solver(engine="thin", dtype=dtype, device=DEVICE, threads=min(worlds, CORES)),
    )
    simulator.run([1e-6])
    end = np.flatnonzero(body.points[:, 0] > body.points[:, 0].max() - 1e-9)
    tip = end[len(end) // 2]
    return (
        lambda: -simulator.run(1e-6 + item.times)[:, 0, tip, 2],
        NU if item.width else 0.0,
        item.width,
    )


def across(edges: int) -> int:
    """Cells across a strip of so many cells along."""
    return max(2, round(edges / 5))


def flex(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    """MuJoCo's rods and sheets, without the hand, floor and contacts of our test scene. Vertices
    are pinned, not connected to the clamp, which takes less than half the time."""
    from gendom.reality.model import DIAGONAL_HINGES, SIDE_HINGES, load_mujoco
    from gendom.reality.objects import SHEET_NU, grid

    mujoco = load_mujoco()
    steps, step = item.pace(float(option))
    if item.width:
        # Free from a quarter of an edge before its last pinned row: measured. The square of the
        # first frequency is then correct to 0.7, 0.3 and 0.2 % with 10, 20 and 40 edges; from half
        # an edge, as of a rope, 11, 5 and 2 % off.
        h = LENGTH / (edges - 0.75)
        cells = across(edges)
        width = cells * h
        flat, triangles = grid(edges + 1, cells + 1, h)
        points = np.column_stack([flat, np.zeros(len(flat))])
        shares = np.bincount(triangles.ravel()) / (3.0 * len(triangles))
        section, tip = item.thickness * width, edges * (cells + 1) + cells // 2
        # A plate of MuJoCo's Poisson's ratio that is as stiff in a strip as one of E.
        E = item.E * (1.0 - NU**2) / (1.0 - SHEET_NU**2)
        shape = (
            f'dim="2" element="{row(triangles)}"',
            f'<elasticity young="{E}" poisson="{NU}" thickness="{item.thickness}"'
            f' elastic2d="both"/>',
        )
    else:
        h, width = LENGTH / (edges - 0.5), 0.0  # docs/reality.md
        points = h * np.outer(np.arange(edges + 1.0), (1.0, 0.0, 0.0))
        shares = np.full(edges + 1, 1.0 / edges)
        shares[[0, -1]] /= 2.0
        section, tip = np.pi * item.thickness**2 / 4.0, edges
        shape = (
            f'dim="1" element="{row(np.arange(edges)[:, None] + [0, 1])}"',
            f'<edge equality="true" solref="{2 * step} 1" solimp="0.99 0.999 0.001"/>'
            f'<elasticity young="{item.E}" poisson="{NU}" section="circle"/>',
        )
    mass = item.density * section * edges * h
    held = np.flatnonzero(points[:, 0] < 1.01 * h)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
  <option timestep="{step}" integrator="discrete" tolerance="1e-8" gravity="0 0 {-item.gravity}"/>
  <worldbody>
    <flexcomp name="object" type="direct" {shape[0]} point="{row(points)}" mass="{mass}"
              radius="{item.thickness / 2.0}">
      {shape[1]}
      <contact contype="0" conaffinity="0" selfcollide="none"/>
      <pin id="{row(held)}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
    )
    free = np.setdiff1d(np.arange(len(points)), held)
    model.body_mass[model.flex_vertbodyid[free]] = mass * shares[free]
    if item.width:
        long = np.linalg.norm(np.diff(points[model.flex_edge], axis=1), axis=(1, 2)) > 1.2 * h
        hinges = model.flex_bending.reshape(len(long), -1)
        hinges *= np.where(long, DIAGONAL_HINGES, SIDE_HINGES)[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))

    def height(data: Any) -> float:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        return data.flexvert_xpos[tip, 2]

    return steps_of(model, steps, worlds, height), SHEET_NU if item.width else 0.0, width


def row(values: np.ndarray) -> str:
    return " ".join(map(repr, np.ravel(values).tolist()))


def chain(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    """A rope in MuJoCo as rigid links with springs in their ball joints, as its cables were."""
    from gendom.reality.model import load_mujoco

    mujoco = load_mujoco()
    integrator, step = option.split()
    steps, step = item.pace(float(step))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
  <option timestep="{step}" integrator="{integrator}" gravity="0 0 {-item.gravity}"/>
  <worldbody>{links(item, edges, ('type="ball"',))}</worldbody>
</mujoco>"""
    )

    def height(data: Any) -> float:
        mujoco.mj_kinematics(model, data)
        return data.site_xpos[0, 2]

    return steps_of(model, steps, worlds, height), 0.0, 0.0


def links(item: Specimen, edges: int, joints: tuple[str, ...]) -> str:
    """Bodies of a chain. A joint bends for half an edge to both sides: the last link is half as
    long."""
    h, d, bodies = LENGTH / edges, item.thickness, ""
    springs = "".join(
        f'<joint {joint} stiffness="{item.E * np.pi * d**4 / 64.0 / h}"/>' for joint in joints
    )
    for i in range(edges):
        at, long = (h, h) if i else (h / 2.0, h)
        long = long if i < edges - 1 else h / 2.0
        m = item.density * np.pi * d**2 / 4.0 * long
        turning = m * (long**2 / 12.0 + d**2 / 16.0)
        bodies += f"""
<body name="link{i}" pos="{at} 0 0">{springs}
<inertial pos="{long / 2.0} 0 0" mass="{m}" diaginertia="{m * d**2 / 8.0} {turning} {turning}"/>"""
    return f'{bodies}<site name="tip" pos="{h / 2.0} 0 0"/>{"</body>" * edges}'


def genesis(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    """A rope in Genesis as rigid links with springs in two hinges a joint, by its rigid solver."""
    import genesis as gs  # pyright: ignore[reportMissingImports]

    integrator, step = option.split()
    steps, step = item.pace(float(step))
    if not getattr(gs, "_initialized", False):
        gs.init(backend=gs.cpu, precision="64", logging_level="error")
    hinges = ('type="hinge" axis="0 1 0"', 'type="hinge" axis="0 0 1"')
    with NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(f'<mujoco><worldbody><body name="hand">{links(item, edges, hinges)}</body>'
                   "</worldbody></mujoco>")  # fmt: skip
        file.flush()
        scene = gs.Scene(
            sim_options=gs.options.SimOptions(dt=step, gravity=(0.0, 0.0, -item.gravity)),
            rigid_options=gs.options.RigidOptions(
                enable_collision=False, disable_constraint=True,
                integrator=getattr(gs.integrator, integrator),
            ),
        )  # fmt: skip
        last = scene.add_entity(gs.morphs.MJCF(file=file.name)).links[-1]
        scene.build(n_envs=worlds)

    def run() -> np.ndarray:
        scene.reset()
        tip = []
        for _ in range(FRAMES):
            for _ in range(steps):
                scene.step()
            w, x, y, z = last.get_quat()[0].tolist()
            tip.append(LENGTH / edges * (w * y - x * z) - float(last.get_pos()[0, 2]))
        return np.array(tip)

    return run, 0.0, 0.0


def steps_of(
    model: Any, steps: int, worlds: int, height: Callable[[Any], float]
) -> Callable[[], np.ndarray]:
    """Many `MjData` in threads: a call of many steps releases the interpreter's lock."""
    from gendom.reality.model import load_mujoco

    mujoco = load_mujoco()
    if DEVICE != "cpu":
        return warped(model, steps, worlds, height)

    def one(_: int) -> list[float]:
        data, tip = mujoco.MjData(model), []
        for _ in range(FRAMES):
            mujoco.mj_step(model, data, steps)
            tip.append(-height(data))
        return tip

    def run() -> np.ndarray:
        if worlds == 1:
            return np.array(one(0))
        with ThreadPoolExecutor(CORES) as pool:
            first, *_ = pool.map(one, range(worlds))
        return np.array(first)

    return run


def warped(
    model: Any, steps: int, worlds: int, height: Callable[[Any], float]
) -> Callable[[], np.ndarray]:
    """The same by MuJoCo Warp, in float32."""
    import mujoco_warp  # pyright: ignore[reportMissingImports]
    import warp as wp

    from gendom.reality.model import load_mujoco

    mujoco = load_mujoco()
    shown = mujoco.MjData(model)
    mujoco.mj_forward(model, shown)
    with wp.ScopedDevice(DEVICE):
        there = mujoco_warp.put_model(model)
        data = mujoco_warp.put_data(model, shown, nworld=worlds)
        mujoco_warp.step(there, data)  # compiles
        data = mujoco_warp.put_data(model, shown, nworld=worlds)
        with wp.ScopedCapture() as capture:
            for _ in range(steps):
                mujoco_warp.step(there, data)
    graph = capture.graph
    assert graph is not None

    def run(_: Any = there) -> np.ndarray:  # the graph needs it
        tip = []
        for _ in range(FRAMES):
            wp.capture_launch(graph)
            shown.qpos[:] = data.qpos.numpy()[0]
            tip.append(-height(shown))
        return np.array(tip)

    return run


def elastica(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    """``option``: the step over an edge's length at the speed of sound."""
    if worlds == 1:
        return (lambda: one_elastica(item, edges, option)), 0.0, 0.0
    one_elastica(item, edges, option)  # compiles before the processes part
    pool = ProcessPoolExecutor(CORES, mp_context=get_context("fork"))
    list(pool.map(abs, range(CORES)))

    def run() -> np.ndarray:
        runs = [pool.submit(one_elastica, item, edges, option) for _ in range(worlds)]
        first, *_ = [run.result() for run in runs]
        return first

    return run, 0.0, 0.0


def one_elastica(item: Specimen, edges: int, option: str) -> np.ndarray:
    import elastica as ea  # pyright: ignore[reportMissingImports]

    class Scene(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
        pass

    scene, (rod, edge) = Scene(), elastic_rod(item, edges, 0.0)
    scene.append(rod)
    scene.constrain(rod).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    scene.add_forcing_to(rod).using(
        ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -item.gravity])
    )
    scene.finalize()
    steps, dt = item.pace(float(option) * edge / np.sqrt(item.E / item.density))
    stepper, now, tip = ea.PositionVerlet(), 0.0, []
    for _ in range(FRAMES):
        for _ in range(steps):
            now = stepper.step(scene, now, dt)
        tip.append(-rod.position_collection[2, -1])
    return np.array(tip)


def elastic_rod(item: Specimen, edges: int, height: float) -> tuple[Any, float]:
    """PyElastica's rod along x, free from 0 on, and the length of an edge: one whose direction is
    fixed is clamped up to its middle."""
    import elastica as ea  # pyright: ignore[reportMissingImports]

    edge = LENGTH / (edges - 0.5)
    return ea.CosseratRod.straight_rod(
        edges, np.array([-edge / 2.0, 0.0, height]), np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]), edges * edge, item.thickness / 2.0, item.density,
        youngs_modulus=item.E, shear_modulus=item.E / 2.0 / (1.0 + NU),
    ), edge  # fmt: skip


def newton(item: Specimen, edges: int, option: str, worlds: int) -> Prepared:
    """Newton's rods by VBD, and its cloths by VBD and Style3D. ``option``: the solver, its
    iterations (Style3D: and those of its linear solver), the step [s], and how much softer shear
    and stretch are made, for which its iterations would not suffice. Rods are clamped to the
    middle of the edge that is held, sheets as MuJoCo's are."""
    import newton as nt  # pyright: ignore[reportMissingImports]
    import warp as wp

    name, iterations, step, soft = option.split()
    steps, dt = item.pace(float(step))
    steps, dt = steps + steps % 2, dt * steps / (steps + steps % 2)  # graphs need an even number
    h = LENGTH / (edges - (0.75 if item.width else 0.5))
    builder = nt.ModelBuilder(gravity=wp.vec3(0.0, 0.0, -item.gravity))
    if name == "style3d":
        nt.solvers.SolverStyle3D.register_custom_attributes(builder)
    for _ in range(worlds):
        if item.width:
            tip = newton_sheet(builder, item, edges, h, name == "style3d", float(soft))
        else:
            tip = newton_rod(builder, item, edges, h, float(soft))
    if name == "vbd":
        builder.color(include_bending=bool(item.width))
    model = builder.finalize(device=DEVICE)
    if name == "vbd":
        solver = nt.solvers.SolverVBD(model, iterations=int(iterations))
    else:
        outer, inner = map(int, iterations.split(","))
        config = nt.solvers.SolverStyle3D.Config(iterations=outer, linear_iterations=inner)
        solver = nt.solvers.SolverStyle3D(model, config=config)
        solver.collision = None
    control = model.control()

    def run() -> np.ndarray:
        states, heights, graph = [model.state(), model.state()], [], None

        def frame() -> None:
            for _ in range(steps):
                states[0].clear_forces()
                solver.step(*states, control, None, dt)
                states.reverse()

        for k in range(FRAMES):
            if k == 1 and DEVICE != "cpu":
                with wp.ScopedCapture() as capture:
                    frame()
                graph = capture.graph
            if graph:
                wp.capture_launch(graph)
            else:
                frame()
            if item.width:
                heights.append(-float(states[0].particle_q[tip : tip + 1].numpy()[0, 2]))
            else:  # from segments' middles
                z = states[0].body_q[tip - 1 : tip + 1].numpy()[:, 2]
                heights.append(float(0.5 * z[0] - 1.5 * z[1]))
        return np.array(heights)

    return run, HINGES_NU if item.width else 0.0, h * even(edges) if item.width else 0.0


def even(edges: int) -> int:
    """Cells across, even in number."""
    return across(edges) + across(edges) % 2


def newton_rod(builder: Any, item: Specimen, edges: int, h: float, soft: float) -> int:
    import newton as nt  # pyright: ignore[reportMissingImports]
    import warp as wp

    area = np.pi * item.thickness**2 / 4.0
    EI, GJ = item.E * area * item.gyration**2, item.E / (1.0 + NU) * area * item.gyration**2
    nodes = [wp.vec3(float(x), 0.0, 0.0) for x in h * (np.arange(edges + 1) - 0.5)]
    rod = nt.Rod(
        nodes, radius=item.thickness / 2.0, stretch_rigidity=item.E * area / soft,
        shear_rigidity=item.E * area / soft, bend_rigidity=EI, twist_rigidity=GJ,
    )  # fmt: skip
    bodies, _ = builder.add_rod(rod=rod)
    for k, body in enumerate(bodies):
        mass = item.density * area * h if k else 0.0
        share = mass / builder.body_mass[body]
        inertia = share * np.array(builder.body_inertia[body]).reshape(3, 3)
        builder.body_mass[body] = mass
        builder.body_inv_mass[body] = 1.0 / mass if mass else 0.0
        builder.body_inertia[body] = wp.mat33(inertia)
        inverse = np.linalg.inv(inertia) if mass else np.zeros((3, 3))
        builder.body_inv_inertia[body] = wp.mat33(inverse)
    return len(bodies) - 1


def newton_sheet(
    builder: Any, item: Specimen, edges: int, h: float, style: bool, soft: float
) -> int:
    import newton as nt  # pyright: ignore[reportMissingImports]
    import warp as wp

    ends, n, m = (edges, even(edges)), edges + 1, even(edges) + 1
    ids = np.arange(n * m).reshape(n, m)
    a, b, c, d = ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]
    odd = np.add.outer(np.arange(n - 1), np.arange(m - 1))[..., None] % 2
    one, other = np.stack([a, b, c, a, c, d], -1), np.stack([a, b, d, b, c, d], -1)
    triangles = np.where(odd, other, one).ravel().tolist()
    points = np.stack([*np.meshgrid(h * np.arange(n), h * np.arange(m), indexing="ij")], -1)
    points = np.concatenate([points, np.zeros((n, m, 1))], -1).reshape(-1, 3).tolist()
    # Springs alike in all hinges, 4/3 of D, are a plate with Poisson's ratio -1/3.
    K = item.E * item.thickness**3 / 9.0 / (1.0 - HINGES_NU**2)
    G = item.E * item.thickness / 2.0 / soft
    first, density = builder.particle_count, item.density * item.thickness
    common: dict[str, Any] = {"pos": wp.vec3(), "rot": wp.quat_identity(), "vel": wp.vec3()}
    common |= {"vertices": points, "indices": triangles, "density": density}
    common |= {"tri_kd": 0.0, "edge_kd": 0.0}
    if style:  # springs of 3 L^2 over the faces' area; a 32nd of those along sides at diagonals
        nt.solvers.style3d.add_cloth_mesh(
            builder, tri_aniso_ke=wp.vec3(2.0 * G, 2.0 * G, G),
            edge_aniso_ke=wp.vec3(K / 3.0, K / 3.0, K / 6.0 - K / 96.0), **common,
        )  # fmt: skip
    else:  # springs of the edge's length
        edge = len(builder.edge_indices)
        builder.add_cloth_mesh(scale=1.0, tri_ke=G, tri_ka=G, edge_ke=K, **common)
        for k in range(edge, len(builder.edge_indices)):
            long = builder.edge_rest_length[k]
            builder.edge_bending_properties[k] = (K / long, 0.0)
    shares = np.outer(*(np.where(np.arange(e + 1) % e, 1.0, 0.5) for e in ends)).ravel()
    for k in range(n * m):
        held = k < 2 * m
        builder.particle_mass[first + k] = 0.0 if held else float(shares[k] * h**2 * density)
        if held:
            builder.particle_flags[first + k] &= ~nt.ParticleFlags.ACTIVE
    return edges * m + (m - 1) // 2


FLEX = ("0.001", "0.002", "0.004", "0.008", "0.016")
"""Steps [s]. Euler's diverge at 2 ms for a sheet; MuJoCo refuses `implicit` for a flex."""
CANTILEVERS: dict[str, dict[str, tuple[Callable[..., Prepared], tuple[str, ...]]]] = {
    "cantilever-rope": {
        "gendom": (gendom, ("float64",)),
        "gendom-f32": (gendom, ("float32",)),
        "mujoco-flex": (flex, FLEX),
        "mujoco-chain": (
            chain,
            tuple(
                f"{name} {step}"
                for name, some in (
                    ("Euler", ("0.00025", "0.0005", "0.001", "0.002", "0.004")),
                    ("RK4", ("0.0005", "0.001", "0.002", "0.004", "0.008")),
                    ("discrete", ("0.001", "0.002", "0.004")),
                )
                for step in some
            ),
        ),
        "elastica": (elastica, ("0.5", "0.25", "0.125", "0.0625")),
        "genesis": (
            genesis,
            tuple(f"approximate_implicitfast {s}" for s in ("0.001", "0.002", "0.004")),
        ),
        "newton-vbd": (
            newton,
            ("vbd 5 0.001 16",),
        ),
    },
    "cantilever-strip": {
        "gendom": (gendom, ("float64",)),
        "gendom-f32": (gendom, ("float32",)),
        "gendom-soft": (gendom, ("float64 16",)),
        "gendom-soft-f32": (gendom, ("float32 16",)),
        "mujoco-flex": (flex, FLEX),
        "newton-vbd": (newton, ("vbd 3 0.004 4096", "vbd 3 0.008 4096")),
        "newton-style3d": (newton, ("style3d 4,20 0.032 4096",)),
    },
}
"""``soft``: `Material(membrane=)` of E / 16; as far as the strip only bends, its plane does not
count."""
