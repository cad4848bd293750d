"""Free flight, answers that turn with the problem, energy without work, and equal problems."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.materials import Material
from gendom.sim import AIR_DENSITY, GRAVITY, Gripper, Table, cloth, rope
from gendom.sim.thin.shells import ShellModel
from validation.bench import Bench, Row, case, vanishing
from validation.readings import energies, mechanics
from validation.specimens import across, block

G = np.array(GRAVITY)


@case("free-flight", "a spinning block", "mpm", "block")
@case("rod-free-flight", "a rope in space", "thin", "rope")
def free_flight(bench: Bench, kind: str) -> Iterator[Row]:
    """A block that spins at 20 rad/s and falls, for 1,000 substeps; a rope that bends as it spins
    in space."""
    C, pull = None, np.zeros(3)
    if kind == "block":
        dx, pull, material = 0.01, G, Material(E=1.0e6)
        body = block((4 * dx, 3 * dx, 2 * dx), dx, centre=(0.003, 0.001, 0.002))
        C = 20.0 * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        v = [0.5, 0.0, 0.3] + (body.x - body.x.mean(axis=0)) @ C.T
        C = np.broadcast_to(C, (len(v), 3, 3))
    else:
        body, material = rope(diameter=0.01, length=0.2, start=(-0.1, 0, 0)), Material(E=1.0e5)
        u = body.points[:, 0] / 0.1
        v = np.stack([0.1 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1)
    s = bench.simulate(body, [material], gravity=pull)
    s.set_velocities(v) if C is None else s.set_velocities(v, C)
    h = float(s.substep[0])
    times = np.linspace(0.0, 1000.0 * h if kind == "block" else 1.0, 51)
    readings = [mechanics(s)]
    for t in times[1:]:
        s.run([t])
        readings.append(mechanics(s))
    P = np.array([m.P - m.mass * t * pull for m, t in zip(readings, times, strict=True)])
    L, first, last, t = np.array([m.L for m in readings]), readings[0], readings[-1], times[-1]
    path = first.P / first.mass * t + 0.5 * pull * t * (t + h)
    euler = "symplectic Euler: x = x0 + v0 n h + g h^2 n (n + 1) / 2 (Hairer, Lubich, Wanner 2006)"
    newton = "momentum balance: P = P0 + M g t, L about the centre of mass constant"
    moment = newton + "; a particle's moment of C included (Jiang et al. 2015)"
    off = np.linalg.norm(last.centre - first.centre - path) / np.linalg.norm(path)
    for name, found, source in (
        ("centre's distance from its path, over the path", float(off), euler),
        ("drift of momentum", np.abs(P - P[0]).max() / np.abs(P[0]).max(), newton),
        ("drift of angular momentum", np.abs(L - L[0]).max() / np.abs(L[0]).max(), moment),
    ):
        yield vanishing(name, found, bench.round_off(1e-10, 1e-4), source)


@case("objectivity", "a turned problem", "mpm")
def objectivity(bench: Bench) -> Iterator[Row]:
    """A rope lifted by one end under oblique gravity, as is and turned."""
    cells = 1.5 if bench.quick else 2.0
    body = rope(diameter=0.02, length=0.2, start=(-0.05, 0.0, 0.0), cells_across=cells)
    path = np.array([(-0.05, 0.0, 0.0), (-0.05, 0.02, 0.03)])
    pull = np.array([2.0, 1.0, -9.0])

    def answer(Q: Array) -> Array:
        grip = Gripper(time=[0.0, 0.2], position=path @ Q.T, radius=0.04)
        turned = replace(body, x=body.x @ Q.T)
        s = bench.simulate(turned, [Material(E=3.0e5)], grippers=[grip], gravity=Q @ pull)
        return s.run([0.2])[0, 0].astype(float) @ Q

    plain = answer(np.eye(3))
    moved = np.linalg.norm(plain - body.x, axis=1).max()
    source = "objectivity: Q x(problem) = x(Q problem) (Truesdell and Noll 1965, section 19)"
    over, resolved = ", over the largest displacement", f", {across(cells)}"
    for name, degrees in (
        ("90 degrees about x" + over, (90, 0, 0)),
        ("90 degrees about y" + over, (0, 90, 0)),
        ("90 degrees about z" + over, (0, 0, 90)),
        ("30 degrees about y" + resolved, (0, 30, 0)),
        ("45 degrees about z" + resolved, (0, 0, 45)),
        ("20, 30 and 40 degrees about x, y and z" + resolved, (20, 30, 40)),
    ):
        Q = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        # the grid stays where it is: away from its own symmetries the error is one of resolution
        allowed = 0.10 if bench.quick else 0.05
        if 90 in degrees:
            Q, allowed = np.round(Q), bench.round_off(1e-10, 1e-3)
        off = np.linalg.norm(answer(Q) - plain, axis=1).max() / moved
        yield vanishing(f"largest difference after {name}", off, allowed, source)


# ---- energy --------------------------------------------------------------------------------------


@case("energy", "energy without work", "mpm")
def energy(bench: Bench) -> Iterator[Row]:
    """A wobbling block and a bent rope in free fall.

    The reading is the largest rise of energy above any earlier value, over the largest change of
    gravitational energy.
    """
    dx, soft, simulators = 0.01, Material(E=1.0e5), {}
    body = block((4 * dx, 3 * dx, 3 * dx), dx, centre=(0.003, 0.001, 0.002))
    s = simulators["free fall of a wobbling block"] = bench.simulate(body, [soft])
    out = body.x - body.x.mean(axis=0)
    s.set_velocities(np.cross([5.0, 3.0, 15.0], out) + 8.0 * out * [1.0, -0.5, 0.3] + [0.2, 0, 2])
    for cells in (1.0,) if bench.quick else (1.0, 2.0):
        # thrown up in its middle, and aside at its ends
        start = (-0.075, 0.0013, 0.0007)
        body = rope(diameter=0.01, length=0.15, start=start, cells_across=cells)
        name = f"free fall of a bent rope, {across(cells)}"
        s = simulators[name] = bench.simulate(body, [soft])
        u = body.x[:, 0] / 0.075
        s.set_velocities(np.stack([0.0 * u, 0.8 * u, 1.5 - 2.0 * u**2], axis=1))
    source = (
        "first law: kinetic (with C, Jiang et al. 2015) + elastic (neo-Hookean, Bonet and Wood "
        "2008) + gravitational energy cannot grow"
    )
    for name, s in simulators.items():
        total, high = energies(s, np.linspace(0.0, 0.4, 51), G)
        share = (total - np.minimum.accumulate(total)).max() / np.ptp(high)
        yield vanishing(f"growth of energy, {name}", share, bench.round_off(1e-3, 2e-3), source)


@case("rod-swing", "a swing's energy", "thin", "rope")
@case("shell-swing", "a swing's energy", "thin", "sheet")
def swings(bench: Bench, kind: str) -> Iterator[Row]:
    """A rope without damping that swings in space from a gripper, 45 times to and fro; a sheet from
    a row of held points, by 30 degrees to both sides, 25 times; it in the default substep of
    undamped sheets and in half of it.

    Read is how much the mean energy of an eighth of the time is above that of the first at most,
    over the largest change of gravitational energy.
    """
    if kind == "rope":
        body, pull = rope(diameter=0.01, length=0.3, direction=(1, 0, -3), points=33), G
        material, hand = Material(E=1.0e6), Gripper.still((0, 0, 0), radius=0.02)
        steps: dict[str, tuple[float, dict[str, float]]] = {"a swinging rope": (1e-3, {})}
    else:
        body = cloth(width=0.2, height=0.1, thickness=0.002, dx=0.02, points=(15, 8))
        material, hand = Material(E=1e5, density=500.0), Gripper.still((-100, 0, 0), radius=100.01)
        pull = -G[2] * np.array([math.sin(math.pi / 3.0), 0.0, -math.cos(math.pi / 3.0)])
        cfl = ShellModel.undamped_cfl
        steps = {
            "a swinging sheet, half the substep": (1e-3, {"cfl": 0.5 * cfl}),
            "a swinging sheet, the default substep": (2e-3, {"cfl": cfl}),
        }
    time, count = (40.0 if kind == "rope" else 20.0), 400
    if bench.quick:
        time, count = time / 4.0, count // 2
    for name, (allowed, options) in steps.items():
        s = bench.simulate(body, [material], grippers=[hand], gravity=pull, **options)
        total, high = energies(s, np.linspace(0.0, time, count + 1)[1:], pull)
        means = total.reshape(8, -1).mean(axis=1)
        name = f"growth of the mean energy in {time:g} s, {name}"
        source = (
            "a hand that stands still does no work; a leapfrog keeps energy but for an oscillation "
            "(Hairer, Lubich, Wanner 2006), of which means over many steps are free"
        )
        share = (means - means[0]).max() / np.ptp(high)
        yield vanishing(name, share, bench.round_off(allowed, 1e-2), source)


@case("precision", "single and double precision", "mpm")
def precision(bench: Bench) -> Iterator[Row]:
    """A lift off the table in float32 and float64.

    The rope starts 0.1 mm above: in which substep it first touches would otherwise be left to the
    last bit of its height, and a substep's fall (25 um in the softest world) is no round-off.
    """
    low, up = np.array([0.0, 0.0, 0.0101]), np.array([0.0, 0.0, 0.1])
    body = rope(diameter=0.02, length=0.2, start=low, cells_across=1.5)
    moduli = ((1e5, 0.3), (1e6, 0.4), (2e5, 0.1), (5e4, 0.0))
    hand = Gripper(time=[0, 0.3], position=[low, low + up], radius=0.02)

    def lifted(dtype: str) -> Array:
        s = replace(bench, dtype=dtype).simulate(
            body, [Material(E=E, nu=nu) for E, nu in moduli], grippers=[hand],
            table=Table(height=0.0), air_density=AIR_DENSITY, velocity_damping=2.0,
        )  # fmt: skip
        return s.run([0.15, 0.3]).astype(float)

    far = np.abs(lifted("float32") - lifted("float64")).max() / up[2]
    name = "largest difference of float32 from float64, over the lift"
    yield vanishing(name, far, 1e-5, "round-off: 2^-24 a number (IEEE 754)")
