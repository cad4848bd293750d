"""The race at equal error: what ropes and cloths cost in simulators, alone and many at once.

    python benchmarks/race.py [SCENE ...] [--rounds 3] [--worlds 1 64] [--json] [--figure FILE]
    RACE_DEVICE=cuda python benchmarks/race.py SCENE --only '["gendom", [[16, "float64", 1024]]]'

Scenes: a cantilevered rope and strip (``cantilever.py``, beside theory); the lift of a rope and of
a cloth from a table by one end, and a cloth that stands askew on the table and falls onto itself,
each beside that simulator's own finest run. An error is the root mean square over places and times,
over the static sag, the height of the lift, or that of the cloth. Numbers of edges and steps are
first surveyed; then, for each simulator and each bound on the error, the cheapest that keeps it is
timed: CPU seconds for one simulated, medians of rounds in which the simulators take turns.
``--worlds`` then times many at once on all cores, by the clock, at 1 %. ``--only`` runs one setting
(edges, option, worlds), here on a GPU (MuJoCo by MuJoCo Warp). Peers have environments of their own
(``make -C benchmarks peers``); one that is not there is a row with its reason.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from cantilever import CANTILEVERS, CORES, DEVICE, LENGTH, NU, ROPE, SAG, STRIP, elastic_rod, theory

BOUNDS = (0.02, 0.01, 0.005)
EDGES = (6, 8, 10, 12, 16, 20, 24, 32, 40)
SIDE, RISE, SPEED, LAST, TILT, ROOM = 0.2, 0.15, 0.3, 0.8, 0.15, 0.002
"""Of cloths [m], lifts [m], [m/s] and [s], and of the fall: the sheet's angle against the vertical
[rad], and its distance from the table [m]."""
TIMES = np.linspace(0.0, LAST, 41)[1:]
SHARES = np.linspace(0.0, 1.0, 9)
DAMPING, FRICTION = 0.01, 0.3
Run = Callable[[], np.ndarray]


def material(scene: str) -> tuple[Any, Any]:
    """The specimen of a scene, and its material with damping."""
    from gendom.materials import Material

    item = ROPE if "rope" in scene else STRIP
    return item, Material(E=item.E, nu=NU, density=item.density, damping=DAMPING)


def upright(x: np.ndarray, height: float) -> np.ndarray:
    """A sheet [n, 3] that lay along x, standing on the table at ``height``, tilted."""
    s, c = np.sin(TILT), np.cos(TILT)
    return x @ np.array([[s, 0, c], [0, 1, 0], [-c, 0, s]]) + [0, 0, height]


def gendom(scene: str, edges: int, option: str, worlds: int) -> Run:
    from gendom.sim import Gripper, Physics, Simulator, Solver, Table, cloth, rope

    (item, own), falls = material(scene), scene == "fall-cloth"
    low, size = item.thickness / 2.0, LENGTH if "rope" in scene else SIDE
    h = 0.0 if falls else size / edges
    if "rope" in scene:
        body = rope(diameter=item.thickness, length=size + h, start=(-h, 0, low), points=edges + 2)
    else:
        body = cloth(
            width=size + h, height=SIDE, thickness=item.thickness, dx=0.02,
            corner=(-h, 0.0, 0.0 if falls else low), points=(edges + 2 - falls, edges + 1),
        )  # fmt: skip
    top = RISE / SPEED
    hand = Gripper(time=[0, top], position=[(-100, 0, low), (-100, 0, low + RISE)], radius=100.0)
    simulator = Simulator(
        body, [own] * worlds, grippers=() if falls else [hand],
        table=Table(height=0.0, friction=FRICTION),
        physics=Physics(air_density=0.0, self_contact=falls, self_friction=FRICTION),
        solver=Solver(engine="thin", dtype=option, device=DEVICE, threads=min(worlds, CORES)),
        positions=upright(body.points, ROOM) if falls else None,
    )  # fmt: skip
    simulator.run([1e-6])

    def run() -> np.ndarray:
        x = simulator.run(1e-6 + TIMES)[:, 0]
        x = x.reshape(len(x), -1, edges + 2 - falls, 3).transpose(0, 2, 1, 3)
        return seen(x if falls else x[:, 1:], falls)

    return run


def seen(x: np.ndarray, falls: bool) -> np.ndarray:
    """[T, ...] what is compared of points [T, along, across, 3]: places (x, z) in the middle, or
    the centre's height (points at the border count half)."""
    if not falls:
        middle = 0.5 * (x[:, :, (x.shape[2] - 1) // 2] + x[:, :, x.shape[2] // 2])[..., ::2]
        at = SHARES * (x.shape[1] - 1)
        k = np.minimum(at.astype(int), x.shape[1] - 2)
        return middle[:, k] + (at - k)[:, None] * (middle[:, k + 1] - middle[:, k])
    along, across = (np.where(np.arange(n) % (n - 1) == 0, 0.5, 1.0) for n in x.shape[1:3])
    return np.einsum("tij,i,j->t", x[..., 2], along / along.sum(), across / across.sum())


def mujoco(scene: str, edges: int, option: str, worlds: int) -> Run:
    """MuJoCo's flex as in `gendom.reality`, whose hand holds all up to 0. A rope is free from half
    an edge before the last vertex that is held, a sheet from a quarter (``cantilever.py``)."""
    from gendom.reality.model import Layout, load_mujoco
    from gendom.reality.objects import SHEET_NU, RealCloth, RealRope
    from gendom.reality.world import Reality

    (item, own), falls, rope = material(scene), scene == "fall-cloth", "rope" in scene
    lib, free = load_mujoco(), 0.5 if rope else 0.0 if falls else 0.75
    h = (LENGTH if rope else SIDE) / (edges - free)
    common: dict[str, Any] = {"name": "race", "colour": (9, 9, 9), "vertices": edges + 1}
    common |= {"material": own, "friction": FRICTION}
    if rope:
        thing = RealRope(length=edges * h, diameter=item.thickness, **common)
    else:  # as stiff in a strip as one of E
        E = item.E * (1.0 - NU**2) / (1.0 - SHEET_NU**2)
        stiff = type(own)(E=E, nu=NU, density=item.density, damping=DAMPING)
        thing = RealCloth(side=edges * h, thickness=item.thickness, **common | {"material": stiff})
    low, s, c = thing.radius, np.sin(TILT), np.cos(TILT)
    layout = Layout(origin=(-free * h, 0.0, low))
    if falls:
        layout = Layout(origin=(0.0, 0.0, ROOM), along=(s, 0.0, c), across=(0.0, 1.0, 0.0))

    def one(_: int) -> np.ndarray:
        world = Reality(thing, layout, timestep=float(option))
        model, data, frames = world.model, world.data, []
        if not falls:
            data.mocap_pos[0] = -100.0, 0.0, low
            lib.mj_forward(model, data)
            # `attach` adds half an edge: what is held ends between two vertices
            world.attach(100.0 + (1.0 - free) * h - 0.1 * h)
        for time_ in TIMES:
            while data.time < time_ - 1e-9:
                if not falls:
                    data.mocap_pos[0][2] = low + min(SPEED * (data.time + float(option)), RISE)
                lib.mj_step(model, data)
            lib.mj_kinematics(model, data)
            lib.mj_flex(model, data)
            frames.append(data.flexvert_xpos.copy())
        x = np.array(frames).reshape(len(TIMES), edges + 1, -1, 3)
        if not falls:  # the place where it is free, between the two rows that are held
            x[:, 0] += free * (x[:, 1] - x[:, 0])
        return seen(x, falls)

    def run() -> np.ndarray:
        if worlds == 1:
            return one(0)
        with ThreadPoolExecutor(CORES) as pool:
            return next(iter(list(pool.map(one, range(worlds)))))

    return run


def elastica(scene: str, edges: int, option: str, worlds: int) -> Run:
    """PyElastica's rod on a plane; ``option``: the step over an edge's length at the speed of
    sound. It has no damping of a material: this is of velocities, 1 /s. A world at a time."""
    import elastica as ea  # pyright: ignore[reportMissingImports]

    low, top = ROPE.thickness / 2.0, RISE / SPEED
    mu = np.full(3, FRICTION)

    class Scene(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Contact, ea.Damping):
        pass

    class Hand(ea.ConstraintBase):
        def constrain_values(self, system: Any, time: float) -> None:
            system.position_collection[:, 0] = -edge / 2.0, 0.0, low + SPEED * min(time, top)
            system.director_collection[..., 0] = along

        def constrain_rates(self, system: Any, time: float) -> None:
            system.velocity_collection[:, 0] = 0.0, 0.0, SPEED * (time < top)
            system.omega_collection[:, 0] = 0.0

    scene_, (rod, edge) = Scene(), elastic_rod(ROPE, edges, low)
    along = rod.director_collection[..., 0].copy()
    steps = int(np.ceil(TIMES[0] / (float(option) * edge / np.sqrt(ROPE.E / ROPE.density))))
    dt = TIMES[0] / steps
    plane = ea.Plane(plane_origin=np.zeros((3, 1)), plane_normal=np.eye(3)[:, 2:])
    scene_.append(rod)
    scene_.append(plane)
    scene_.constrain(rod).using(Hand)
    scene_.add_forcing_to(rod).using(ea.GravityForces, acc_gravity=np.array([0.0, 0.0, -9.81]))
    scene_.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=1.0, time_step=dt)
    scene_.detect_contact_between(rod, plane).using(
        ea.RodPlaneContactWithAnisotropicFriction, k=1000.0, nu=0.05,
        slip_velocity_tol=1e-3, static_mu_array=mu, kinetic_mu_array=mu,
    )  # fmt: skip
    scene_.finalize()

    def run() -> np.ndarray:
        stepper, now, frames = ea.PositionVerlet(), 0.0, []
        for _ in TIMES:
            for _ in range(steps):
                now = stepper.step(scene_, now, dt)
            frames.append(rod.position_collection.T.copy())
        x = np.array(frames)[:, :, None]
        x[:, 0] = 0.5 * (x[:, 0] + x[:, 1])
        return seen(x, False)

    return run


def own(
    edges: tuple[int, ...], finest: tuple[int, int], steps: tuple[str, ...], least: str
) -> dict[str, tuple[Callable[..., Run], tuple[str, ...], tuple[int, ...], tuple[int, str]]]:
    """Simulators, what sets their steps, numbers of edges, and the finest of all."""
    return {
        "gendom": (gendom, ("float64",), edges, (finest[0], "float64")),
        "gendom-f32": (gendom, ("float32",), edges, (finest[0], "float64")),
        "mujoco-flex": (mujoco, steps, edges, (finest[1], least)),
    }


OWN = {
    "lift-rope": own((8, 12, 16, 24, 32), (64, 40), ("0.001", "0.002", "0.004"), "0.0005")
    | {"elastica": (elastica, ("0.25", "0.0625"), (12, 16, 24, 32), (48, "0.125"))},
    "lift-cloth": own((8, 12, 16, 24), (48, 32), ("0.002", "0.004", "0.008"), "0.001"),
    "fall-cloth": own((12, 16, 24), (32, 24), ("0.001", "0.002", "0.004"), "0.001"),
}
SCENES = [*CANTILEVERS, *OWN]


def measured(scene: str, name: str, edges: int, option: str, worlds: int) -> dict[str, Any]:
    """One run: its costs, and its error or what it saw. What diverges has an infinite error."""
    theoretical = scene in CANTILEVERS
    item, prepare = ROPE if "rope" in scene else STRIP, (CANTILEVERS | OWN)[scene][name][0]
    lasts, cpus = float(item.times[-1] if theoretical else LAST), []
    # in a first run, which is left out
    compiles = DEVICE != "cpu" or (worlds == 1 and not name.startswith("mujoco"))
    for _ in range(2 if compiles else 1):
        made: Any = prepare(item if theoretical else scene, edges, option, worlds)
        run = made[0] if theoretical else made
        wall, cpu = time.perf_counter(), time.process_time()
        x = run()
        cpus.append(time.process_time() - cpu)
        wall = time.perf_counter() - wall
    found = {"edges": edges, "option": option, "cpu": min(cpus) / lasts,
             "rate": worlds * lasts / wall}  # fmt: skip
    if not theoretical:
        return found | {"seen": x.tolist()}
    return found | {"error": rms(x - theory(item, *made[1:])) / SAG}


def rms(off: np.ndarray) -> float:
    value = float(np.sqrt(np.mean(np.sum(np.atleast_2d(off.T) ** 2, axis=0))))
    return value if np.isfinite(value) else np.inf


def ask(scene: str, name: str, runs: list[tuple[int, str, int]]) -> list[dict[str, Any]] | str:
    """Runs in a process of the simulator's own, on one core unless there are many worlds; or why
    there are none."""
    peer = name.split("-")[0]
    python = Path(__file__).parent / f".envs/{peer}/bin/python"
    if not python.exists() and not find_spec(peer):
        return f"not installed: no {python}"
    python = python if python.exists() else Path(sys.executable)
    done = subprocess.run(
        [str(python), __file__, scene, "--only", json.dumps([name, runs])],
        env={**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
        capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        return (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1][:90]
    return json.loads(done.stdout.strip().splitlines()[-1])


def surveyed(scene: str, name: str) -> tuple[list[dict[str, Any]], np.ndarray | None, str]:
    """Errors of all settings from few edges on, until the least bound is kept; the finest run."""
    mine = OWN.get(scene, {}).get(name)
    options = mine[1] if mine else CANTILEVERS[scene][name][1]
    rows, finest, scale = [], None, RISE if scene.startswith("lift") else SIDE
    if mine:
        found = ask(scene, name, [(*mine[3], 1)])
        if isinstance(found, str):
            return [], None, found
        finest = np.array(found[0]["seen"])
    for edges in mine[2] if mine else EDGES:
        found = ask(scene, name, [(edges, option, 1) for option in options])
        if isinstance(found, str):
            return rows, finest, found
        for row in found:
            if finest is not None:
                row["error"] = rms(np.array(row.pop("seen")) - finest) / scale
        rows += found
        if min(r["error"] for r in rows) < min(BOUNDS):
            break
    return rows, finest, ""


def raced(scene: str, rounds: int, worlds: list[int]) -> dict[str, Any]:
    """A scene: settings and costs by bound and simulator, rates by number of worlds."""
    chosen: dict[str, dict[float, dict]] = {}
    reasons, finest = {}, {}
    for name in {**CANTILEVERS, **OWN}[scene]:
        rows, finest[name], why = surveyed(scene, name)
        if why:
            reasons[name] = why
        keeps = {b: [r for r in rows if r["error"] < b] for b in BOUNDS}
        chosen[name] = {b: min(k, key=lambda r: r["cpu"]) for b, k in keeps.items() if k}
    costs: dict[tuple[str, str, str], list[float]] = {}
    wanted = [("cpu", b, b, 1) for b in BOUNDS] + [("rate", n, 0.01, n) for n in worlds]
    for _ in range(rounds):
        for name, best in chosen.items():
            for what, key, bound, many in wanted:
                if bound not in best:
                    continue
                # PyElastica's processes share nothing: more worlds take longer in proportion
                many = min(many, 16) if name == "elastica" else many
                got = ask(scene, name, [(best[bound]["edges"], best[bound]["option"], many)])
                if isinstance(got, list):
                    costs.setdefault((what, f"{key:g}", name), []).append(got[0][what])
    found: dict[str, Any] = {"cpu": {}, "rate": {}, "reasons": reasons, "settings": {}}
    for (what, key, name), values in costs.items():
        found[what].setdefault(key, {})[name] = statistics.median(values)
    for name, best in chosen.items():
        found["settings"][name] = {f"{b:g}": (r["edges"], r["option"], r["error"])
                                   for b, r in best.items()}  # fmt: skip
    ours = finest.get("gendom")
    scale = RISE if scene.startswith("lift") else SIDE
    found["apart"] = {n: rms(x - ours) / scale for n, x in finest.items() if x is not None}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--worlds", type=int, nargs="*", default=[1, 16, 64])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--figure", type=Path, help="seconds over error, as SVG")
    parser.add_argument("--results", type=Path, nargs="*", default=[],
                        help="of --json, to draw in place of a race")  # fmt: skip
    parser.add_argument("--only", help="a simulator and its runs, as JSON")
    given = parser.parse_args()
    if given.only:
        name, runs = json.loads(given.only)
        with np.errstate(all="ignore"):
            print(json.dumps([measured(given.scenes[0], name, *run) for run in runs]))
        return
    found: dict[str, Any] = {}
    for one in given.results:
        for scene, more in json.loads(one.read_text()).items():
            found.setdefault(scene, {"cpu": {}, "settings": {}})["settings"] |= more["settings"]
            for bound, costs in more["cpu"].items():
                found[scene]["cpu"].setdefault(bound, {}).update(costs)
    for scene in () if given.results else given.scenes or SCENES:
        found[scene] = raced(scene, given.rounds, given.worlds)
        if not given.json:
            show(scene, found[scene])
    if given.json:
        print(json.dumps(found, indent=2))
    if given.figure:
        draw(found, given.figure)


def show(scene: str, found: dict[str, Any]) -> None:
    print(f"\n{scene}: CPU s a simulated one, by error; simulated s a second on {CORES} cores")
    keys = [("cpu", f"{b:g}") for b in BOUNDS] + [("rate", n) for n in found["rate"]]
    print(f"{'':16}", *[f"{k if w == 'cpu' else k + ' worlds':>10}" for w, k in keys], " apart")
    for name in {**CANTILEVERS, **OWN}[scene]:
        numbers = [found[what].get(key, {}).get(name) for what, key in keys]
        text = [f"{'-' if v is None else format(v, '.3g'):>10}" for v in numbers]
        apart = found["apart"].get(name)
        print(f"{name:16}", *text, "" if apart is None else f"{apart:6.3f}",
              found["reasons"].get(name, ""), flush=True)  # fmt: skip


def draw(found: dict[str, Any], path: Path) -> None:
    """CPU seconds over the error that is kept, a panel a scene."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(found), figsize=(3.2 * len(found), 3.9), squeeze=False)
    names = list(dict.fromkeys(name for one in found.values() for name in one["settings"]))
    lines = {}
    for axis, (scene, one) in zip(axes[0], found.items(), strict=True):
        for name, kept in one["settings"].items():
            at = [b for b in kept if name in one["cpu"].get(b, {})]
            (lines[name],) = axis.loglog(
                [100.0 * float(b) for b in at], [one["cpu"][b][name] for b in at],
                "o-" if name.startswith("gendom") else "s--", color=f"C{names.index(name)}",
            )  # fmt: skip
        bounds = [100.0 * b for b in BOUNDS]
        axis.set(title=scene, xlabel="error [%]", ylabel="CPU s a simulated s")
        axis.set_xticks(bounds, [f"{b:g}" for b in bounds])
        axis.set_xticks([], minor=True)
    labels = [f"{name} {released(name.split('-')[0])}" for name in lines]
    figure.legend(lines.values(), labels, loc="lower center", ncols=6, fontsize=8)
    figure.tight_layout(rect=(0, 0.13, 1, 1))
    figure.savefig(path)


def released(peer: str) -> str:
    """A simulator's version: of a peer, the one that is installed for it."""
    pinned = Path(__file__).parent / f"peers/{peer}.txt"
    return pinned.read_text().split("==")[-1].strip() if pinned.exists() else version(peer)


if __name__ == "__main__":
    main()
