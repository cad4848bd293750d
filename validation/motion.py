"""Free fall, free flight, answers that turn with the problem, and energy without work."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import CFL, GRAVITY, Gripper, Simulator, cloth, rope
from gendom.sim.thin.shells import Shells
from validation.bench import WEIGHTLESS, Bench, Row, case, relative, vanishing
from validation.readings import growth, mechanics, spring_energy
from validation.references import LEAPFROG
from validation.specimens import across, block, particle_rope

SUBSTEPS = 1000

G = np.array(GRAVITY)

EULER = "symplectic Euler: x = x0 + v0 n h + g h^2 n (n + 1) / 2 (Hairer, Lubich, Wanner 2006)"
NEWTON = "momentum balance: P = P0 + M g t, L about the centre of mass constant"
OBJECTIVITY = "objectivity: Q x(problem) = x(Q problem) (Truesdell and Noll 1965, section 19)"
FIRST_LAW = (
    "first law: a clamp that stands still does no work; kinetic (with C, Jiang et al. 2015) + "
    "elastic (neo-Hookean, Bonet and Wood 2008) + gravitational energy cannot grow"
)
MEANS = (
    "a hand that stands still does no work; a leapfrog keeps energy but for an oscillation "
    "(Hairer, Lubich, Wanner 2006), of which means over many steps are free"
)


@case("free-fall", "a thrown block", "mpm")
def free_fall(bench: Bench) -> list[Row]:
    """A thrown block of 4 x 3 x 2 cells, 1,000 substeps: all particles on one parabola."""
    dx = 0.01
    body = block((4 * dx, 3 * dx, 2 * dx), dx, centre=(0.003, 0.001, 0.002))
    s = bench.simulate(body, [Material(E=1.0e5)])
    v = np.array([0.3, -0.2, 1.0])
    s.set_velocities(v)
    h = float(s.substep[0])
    time = SUBSTEPS * h
    s.run([time])
    path = v * time + G * h**2 * SUBSTEPS * (SUBSTEPS + 1) / 2.0
    # particles must also keep their distances, so the worst one is compared
    off = np.linalg.norm(s.positions()[0].astype(float) - body.x - path, axis=1).max()
    speed = np.linalg.norm(s.velocities()[0].astype(float) - v - G * time, axis=1).max()
    exact = bench.round_off(1e-10, 1e-4)
    name = "worst particle's distance from its path, over the path"
    beside = "worst particle's velocity beside v0 + g t, over |g| t"
    return [
        vanishing(name, float(off / np.linalg.norm(path)), exact, EULER),
        vanishing(beside, float(speed / (np.linalg.norm(G) * time)), exact, NEWTON),
    ]


@case("free-flight", "a spinning block", "mpm")
def spinning_block(bench: Bench) -> list[Row]:
    """A block set spinning at 20 rad/s by a gripper that lets go; then 1,000 substeps alone."""
    dx, rate, held = 0.01, 20.0, 0.02
    body = block((4 * dx, 3 * dx, 2 * dx), dx, centre=(0.003, 0.001, 0.002))
    axis = np.array([0.0, 0.0, 1.0])
    centre = body.x.mean(axis=0)
    hand = Gripper(
        time=[0.0, held], position=[centre, centre + held * np.array([0.5, 0.0, 0.3])],
        quat_xyzw=Rotation.from_rotvec([0.0 * axis, rate * held * axis]).as_quat(), radius=0.2,
        hold_until=held,
    )  # fmt: skip
    s = bench.simulate(body, [Material(E=1.0e6)], grippers=[hand])
    s.run([held])
    x0, before = s.positions()[0].astype(float), mechanics(s)
    h = float(s.substep[0])
    time = SUBSTEPS * h
    s.run([held + time])
    x1, after = s.positions()[0].astype(float), mechanics(s)
    path = before.P / before.mass * time + G * h**2 * SUBSTEPS * (SUBSTEPS + 1) / 2.0
    off = np.linalg.norm(after.centre - before.centre - path) / np.linalg.norm(path)
    P = before.P + before.mass * G * time
    turned = Rotation.align_vectors(x1 - after.centre, x0 - before.centre)[0].as_rotvec() @ axis
    # the fit knows the angle up to whole turns
    turned += 2.0 * np.pi * np.round((rate * time - turned) / (2.0 * np.pi))
    exact = bench.round_off(1e-10, 1e-4)
    moment = NEWTON + "; a particle's moment of C included (Jiang et al. 2015)"
    axis_stays = "Euler's equations: about a principal axis the rate of turn is constant"

    def apart(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
        return float(np.linalg.norm(a - b) / np.linalg.norm(b))

    return [
        vanishing("centre's distance from its path, over the path", float(off), exact, EULER),
        vanishing("linear momentum beside P0 + M g t, relative", apart(after.P, P), exact, NEWTON),
        vanishing("change of angular momentum, relative", apart(after.L, before.L), exact, moment),
        relative(
            "angle turned about a principal axis", "rad", rate * time, turned, 0.01, axis_stays
        ),
    ]


@case("rod-free-flight", "a rope in space", "thin", "rope")
@case("shell-free-flight", "a sheet in space", "thin", "sheet")
def free_flight(bench: Bench, kind: str) -> list[Row]:
    """A bent or crumpling body that spins in space: momentum, angular momentum and energy."""
    if kind == "rope":
        body = rope(diameter=0.01, length=0.2, start=(-0.1, 0, 0))
        u = body.points[:, 0] / 0.1
        v = np.stack([0.1 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1)
        material, until, options = Material(E=1.0e5), 1.0, {}
    else:
        body = cloth(
            width=0.2, height=0.15, thickness=0.001, dx=0.02, corner=(-0.1, -0.075, 0),
            points=(15, 11),
        )  # fmt: skip
        u, w = body.points[:, 0] / 0.1, body.points[:, 1] / 0.075
        v = np.stack([-0.3 * w, 0.4 * u, 1.0 - 2.0 * u**2 + u * w], axis=1)
        material, until, options = Material(E=1.0e5, density=500.0), 0.5, {"cfl": 0.2}
    s = bench.simulate(body, [material], gravity=WEIGHTLESS, **options)
    s.set_velocities(v)
    readings = []
    for t in np.linspace(0.0, until, round(100 * until) + 1):
        s.run([t])
        readings.append(mechanics(s))
    energy = np.array([m.kinetic + m.elastic for m in readings])

    def drift(of: NDArray[np.floating]) -> float:
        return float(np.abs(of - of[0]).max() / np.abs(of[0]).max())

    P, L = (np.array(of) for of in zip(*((m.P, m.L) for m in readings), strict=True))
    about = "angular momentum" + " about the centre" * (kind == "rope")
    pushed, turned = (bench.round_off(1e-10, single) for single in (1e-4, 1e-3))
    return [
        vanishing("drift of momentum", drift(P), pushed, "nothing pushes it"),
        vanishing(f"drift of {about}", drift(L), turned, "nothing turns it"),
        vanishing(
            "largest change of energy over the kinetic energy at first",
            float(np.ptp(energy) / readings[0].kinetic), 0.02, LEAPFROG,
        ),
    ]  # fmt: skip


@case("objectivity", "a turned problem", "mpm")
def objectivity(bench: Bench) -> list[Row]:
    """A rope lifted by one end under oblique gravity, as is and turned."""
    cells = 1.5 if bench.quick else 2.0
    body = rope(diameter=0.02, length=0.2, start=(-0.05, 0.0, 0.0), cells_across=cells)
    path = np.array([(-0.05, 0.0, 0.0), (-0.05, 0.02, 0.03)])
    pull = np.array([2.0, 1.0, -9.0])

    def answer(Q: NDArray[np.floating]) -> NDArray[np.floating]:
        grip = Gripper(time=[0.0, 0.2], position=path @ Q.T, radius=0.04)
        turned = replace(body, x=body.x @ Q.T)
        s = bench.simulate(turned, [Material(E=3.0e5)], grippers=[grip], gravity=Q @ pull)
        return s.run([0.2])[0, 0].astype(float) @ Q

    plain = answer(np.eye(3))
    moved = np.linalg.norm(plain - body.x, axis=1).max()

    def difference(degrees: ArrayLike) -> float:
        Q = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        if not np.any(np.asarray(degrees) % 90.0):
            Q = np.round(Q)
        return float(np.linalg.norm(answer(Q) - plain, axis=1).max() / moved)

    exact = bench.round_off(1e-10, 1e-3)
    rows = []
    for name, degrees in (("x", (90, 0, 0)), ("y", (0, 90, 0)), ("z", (0, 0, 90))):
        name = f"largest difference after 90 degrees about {name}, over the largest displacement"
        rows.append(vanishing(name, difference(degrees), exact, OBJECTIVITY))
    # the grid stays where it is: away from its own symmetries the error is one of resolution
    allowed = 0.10 if bench.quick else 0.05
    for name, degrees in (
        ("30 degrees about y", (0, 30, 0)),
        ("45 degrees about z", (0, 0, 45)),
        ("20, 30 and 40 degrees about x, y and z", (20, 30, 40)),
    ):
        name = f"largest difference after {name}, {across(cells)}"
        rows.append(vanishing(name, difference(degrees), allowed, OBJECTIVITY))
    return rows


@case("energy", "energy without work", "mpm")
def energy(bench: Bench) -> list[Row]:
    """A wobbling block and a bent rope in free fall; a clamped rope that falls and swings for 1 s.

    Counted are kinetic energy, the affine velocities' share included, elastic and gravitational
    energy, and that of the springs by which a clamp holds its border. The reading is the largest
    rise above any earlier value, over the largest change of gravitational energy. The clamped rope
    has half the default substep (at that it reads 0.0015 at 2 cells across).
    """
    dx, soft = 0.01, Material(E=1.0e5)
    body = block((4 * dx, 3 * dx, 3 * dx), dx, centre=(0.003, 0.001, 0.002))
    s = bench.simulate(body, [soft])
    out = body.x - body.x.mean(axis=0)
    s.set_velocities(np.cross([5.0, 3.0, 15.0], out) + 8.0 * out * [1.0, -0.5, 0.3] + [0.2, 0, 2])
    rows = [_never_grows(bench, "free fall of a wobbling block", s, 0.4)]
    for cells in (1.0,) if bench.quick else (1.0, 2.0):
        # thrown up in its middle, and aside at its ends
        flying = rope(
            diameter=0.01, length=0.15, start=(-0.075, 0.0013, 0.0007), cells_across=cells
        )
        s = bench.simulate(flying, [soft])
        u = flying.x[:, 0] / 0.075
        s.set_velocities(np.stack([0.0 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1))
        rows.append(_never_grows(bench, f"free fall of a bent rope, {across(cells)}", s, 0.4))
        hung, clamp = particle_rope(0.15, 0.01, cells)
        s = bench.simulate(hung, [soft], grippers=[clamp], cfl=CFL / 2.0)
        rows.append(_never_grows(bench, f"swinging rope, {across(cells)}", s, 1.0))
    return rows


def _never_grows(bench: Bench, name: str, s: Simulator, time: float) -> Row:
    readings = []
    for t in np.linspace(0.0, time, 51):
        if t > 0.0:
            s.run([t])
        m = mechanics(s)
        # before the first substep nothing is held yet
        springs = spring_energy(s) if t > 0.0 else 0.0
        readings.append((m.kinetic + m.elastic + springs, -m.mass * (m.centre @ GRAVITY)))
    parts = np.array(readings)
    share = growth(parts.sum(axis=1)) / float(np.ptp(parts[:, 1]))
    return vanishing(f"growth of energy, {name}", share, bench.round_off(1e-3, 2e-3), FIRST_LAW)


@case("rod-swing", "a swing's energy", "thin", "rope")
@case("shell-swing", "a swing's energy", "thin", "sheet")
def swings(bench: Bench, kind: str) -> list[Row]:
    """A rope without damping that swings in space from a gripper, 45 times to and fro; a sheet from
    a row of held points, by 30 degrees to both sides, 25 times; it in the default substep of
    undamped sheets and in half of it.

    Read is how much the mean energy of an eighth of the time is above that of the first at most,
    over the largest change of gravitational energy.
    """
    if kind == "rope":
        body, time, pull = rope(diameter=0.01, length=0.3, direction=(1, 0, -3), points=33), 40.0, G
        material, hand = Material(E=1.0e6), Gripper.still((0, 0, 0), radius=0.02)
        steps: dict[str, tuple[float, dict[str, float]]] = {"a swinging rope": (1e-3, {})}
    else:
        body, time = cloth(width=0.2, height=0.1, thickness=0.002, dx=0.02, points=(15, 8)), 20.0
        material, hand = Material(E=1e5, density=500.0), Gripper.still((-100, 0, 0), radius=100.01)
        pull = -GRAVITY[2] * np.array([math.sin(math.pi / 3.0), 0.0, -math.cos(math.pi / 3.0)])
        name, cfl = "a swinging sheet, {} substep", Shells.undamped_cfl
        steps = {
            name.format("half the"): (1e-3, {"cfl": 0.5 * cfl}),
            name.format("the default"): (2e-3, {"cfl": cfl}),
        }
    rows = []
    for name, (allowed, options) in steps.items():
        s = bench.simulate(body, [material], grippers=[hand], gravity=pull, **options)
        readings = []
        for t in np.linspace(0.0, time, 401)[1:]:
            s.run([t])
            m = mechanics(s)
            readings.append((m.kinetic + m.elastic, -m.mass * (m.centre @ pull)))
        parts = np.array(readings)
        means = parts.sum(axis=1).reshape(8, -1).mean(axis=1)
        grown, name = (means - means[0]).max(), f"growth of the mean energy in {time:g} s, {name}"
        share = grown / np.ptp(parts[:, 1])
        rows.append(vanishing(name, share, bench.round_off(allowed, 1e-2), MEANS))
    return rows
