"""Our simulator beside the second reality (MuJoCo): the same motions of the same three ropes.

Each rope is let go at five points of rope reaching and cast three times, by a free hand, with the
parameters that the object has there: E, nu, density, damping, and the air. Reaching is compared by
the tip's farthest x, casting by where the tip is highest in its first swing forward: from when it
is ahead of the hand, which has stopped, until it is behind. A cast is marked `back` where the tip
gets still higher behind the hand later on, within 1.5 s. No rope comes near the table.

Both ropes hang straight and at rest at first. A grip holds a length of the rope, rigid with the
gripper: in MuJoCo up to the last vertex that is pinned, in ours up to where the gripper's sphere
cuts the centre line, which is chosen to be there. MuJoCo's rods bend at their vertices, each for
half an edge on either side, the last pinned one too: as a beam, its rope is free from half an edge
before it on: a cantilever sags by 0.998 of theory if its length is counted from there, by 1.13 or
0.89 if from the last pinned vertex or from the one before (`gendom.reality.benches`). MuJoCo pins a
rope's first two vertices here, so our grips end half an edge from its end: `--border 0.5`.

    python benchmarks/two_realities.py [--ropes rope-cotton] [--no-damping] [--no-air] [--json]
    python benchmarks/two_realities.py --reality mujoco.json --skip-ours     # MuJoCo's part alone
    python benchmarks/two_realities.py --reality mujoco.json --skip-mujoco   # ours, beside that
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.files import write_json
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.reality import (
    AIR_DENSITY,
    OBJECTS,
    Performance,
    RealRope,
    Trial,
    carry_out_reaching,
    casting,
    find_object,
    reaching,
    reaching_task,
)
from gendom.reality.scene import ROPE_STEP, clamped_vertices
from gendom.reality.trials import CAST_AFTER, CAST_PLACE, CAST_SPEED
from gendom.sim import ENGINES, Body, Gripper, Simulator, rope

RELEASES = ((0.196, 0.097), (0.153, 0.125), (0.109, 0.147), (0.22, 0.14), (0.25, 0.1))
"""Release points (x, z) of rope reaching, in its own frame [m]."""

CASTS = (0.12, 0.20, 0.25)
"""How far the hand goes [m]."""

AHEAD, UP = np.eye(3)[[0, 2]]
"""Where our rope is cast, and up."""

RATE = 500.0
"""At which the tip is watched [1/s]."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [name for name, item in OBJECTS.items() if isinstance(item, RealRope)]
    parser.add_argument("--ropes", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--engine", choices=ENGINES, default="mpm", help="of our simulator")
    parser.add_argument("--cells-across", type=float, default=1.5, help="of the MPM's grid")
    parser.add_argument("--points", type=int, help="of the rod")
    parser.add_argument("--border", type=float, default=0.5, help="of our grips [MuJoCo's edges]")
    parser.add_argument("--device", default="cpu", help="of our simulator")
    parser.add_argument("--no-damping", action="store_true", help="in ours")
    parser.add_argument("--no-air", action="store_true", help="in whatever is simulated now")
    parser.add_argument("--step", type=float, help="MuJoCo's [s]; by default that of its ropes")
    parser.add_argument("--reality", type=Path, help="MuJoCo's results: written here")
    parser.add_argument("--skip-mujoco", action="store_true", help="read --reality instead")
    parser.add_argument("--skip-ours", action="store_true")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.skip_mujoco and (given.reality is None or not given.reality.is_file()):
        parser.error("--skip-mujoco needs --reality FILE, written by an earlier run")
    air = 0.0 if given.no_air else AIR_DENSITY
    ropes = [item for item in map(find_object, given.ropes) if isinstance(item, RealRope)]
    if given.skip_mujoco:
        found: dict[str, Any] = json.loads(given.reality.read_text())
        if missing := [item.name for item in ropes if item.name not in found["ropes"]]:
            parser.error(f"{given.reality} lacks {', '.join(missing)}")
    else:
        found = {
            "air_density": air,
            "step": given.step or ROPE_STEP,
            "ropes": {item.name: in_mujoco(item, air, given.step) for item in ropes},
        }
        if given.reality:
            write_json(given.reality, found)
    result = {"mujoco": found}
    if not given.skip_ours:
        result["ours"] = {
            "air_density": air,
            "damping": not given.no_damping,
            "ropes": {item.name: in_ours(item, air, given) for item in ropes},
        }
    if given.json:
        print(json.dumps(result, indent=2))
    else:
        show(result, ropes)


# ---- MuJoCo --------------------------------------------------------------------------------------


def in_mujoco(item: RealRope, air: float, step: float | None) -> dict[str, Any]:
    """What the second reality's rope does."""
    began = time.perf_counter()
    edge = item.length / (item.vertices - 1)
    releases, casts, free = [], [], []
    for action in RELEASES:
        performance = free_hand(reaching(item, action), air, step)
        performance.step_to(performance.closes)
        stand = clamped_vertices(item, performance.trial.layout)
        free.append(item.length - edge * (len(stand) + len(performance.world.held) - 2))
        reached = carry_out_reaching(performance, frame_rate=RATE).reached
        releases.append({"release": list(action), "reached": reached})
    for way in CASTS:
        performance = free_hand(casting(item, way), air, step)
        performance.step_to(performance.closes)
        free.append(item.length - edge * (len(performance.world.held) - 1))
        times, tip, hand = [], [], []
        for t in np.arange(performance.closes, performance.end, 1.0 / RATE):
            performance.step_to(t)
            times.append(t)
            tip.append(performance.world.vertices()[-1])
            hand.append(performance.world.hand[1])
        start = performance.trial.path.position[0, 1]
        stops = performance.trial.path.time[2]
        y, z = np.array(tip)[:, 1] - start, np.array(tip)[:, 2]
        swing = first_swing(np.array(times) > stops, y, z, np.array(hand) - start)
        casts.append({"way": way, **swing})
    return {
        "free_lengths": [free[0], free[-1]],
        "releases": releases,
        "casts": casts,
        "seconds": time.perf_counter() - began,
    }


def free_hand(trial: Trial, air: float, step: float | None) -> Performance:
    return Performance(trial, robot=False, air_density=air, timestep=step)


# ---- ours ----------------------------------------------------------------------------------------


def in_ours(item: RealRope, air: float, given: argparse.Namespace) -> dict[str, Any]:
    """What our simulator's rope does: the releases side by side, then the casts."""
    began = time.perf_counter()
    edge = item.length / (item.vertices - 1)
    task = reaching_task(item)
    border = given.border * edge
    material = Material(
        E=item.material.E,
        nu=item.material.nu,
        density=item.material.density,
        damping=0.0 if given.no_damping else item.material.damping,
    )

    def sag(along: Any) -> Any:
        """How far a rope that hangs from its first `border` metres is stretched there [m]."""
        s = np.maximum(along, border)
        weight = STANDARD_GRAVITY * material.density / material.E
        return weight * (item.length * (s - border) - 0.5 * (s**2 - border**2))

    def tips(
        top: NDArray[np.float64], grippers: list[list[Gripper]], times: NDArray[np.float64]
    ) -> tuple[Body, NDArray[np.float64]]:
        """The rope, hanging from its top [3] at first, and its tip [T, W, 3] at some times."""
        body = rope(
            diameter=item.diameter,
            length=item.length,
            start=top,
            direction=(0.0, 0.0, -1.0),
            cells_across=given.cells_across,
            points=given.points,
        )
        thin = given.engine == "thin"
        along = top[2] - body.points[:, 2] if thin else body.material_coordinates[:, 0]
        simulator = Simulator(
            body,
            [material] * len(grippers),
            engine=given.engine,
            grippers=grippers,
            table=None,
            gravity=(0.0, 0.0, -STANDARD_GRAVITY),
            positions=(body.points if thin else body.x) - np.outer(sag(along), UP),
            air_density=air,
            device=given.device,
        )
        return body, tip_of(body, item.length, simulator, times)

    pairs = [task.grippers(action)[1] for action in RELEASES]
    grippers = [
        [
            Gripper(time=[0.0], position=[task.top], radius=border),
            Gripper(
                time=tip.time,
                position=tip.position,
                radius=border - sag(item.length - border),
                hold_until=task.release_time,
            ),
        ]
        for tip in pairs
    ]
    times = np.arange(task.release_time, task.end_time + 0.5 / RATE, 1.0 / RATE)
    body, tip = tips(task.top, grippers, times)
    releases = [
        {"release": list(action), "reached": float(tip[:, w, 0].max())}
        for w, action in enumerate(RELEASES)
    ]

    top = np.array([0.0, 0.0, CAST_PLACE[1] + item.length])
    stops = np.array(CASTS) / CAST_SPEED
    grippers = [
        [Gripper(time=[0.0, stop], position=[top, top + way * AHEAD], radius=border)]
        for way, stop in zip(CASTS, stops, strict=True)
    ]
    times = np.arange(0.0, stops.max() + CAST_AFTER, 1.0 / RATE)
    _, tip = tips(top, grippers, times)
    casts = []
    for w, (way, stop) in enumerate(zip(CASTS, stops, strict=True)):
        seen = times <= stop + CAST_AFTER
        hand = np.minimum(CAST_SPEED * times, way)
        x, z = tip[seen, w, 0], tip[seen, w, 2]
        casts.append({"way": way, **first_swing(times[seen] > stop, x, z, hand[seen])})
    return {
        "cells_across": given.cells_across,
        "points": len(body.points) if given.engine == "thin" else body.num_particles,
        "engine": given.engine,
        "free_lengths": [item.length - 2.0 * border, item.length - border],
        "releases": releases,
        "casts": casts,
        "seconds": time.perf_counter() - began,
    }


def tip_of(
    body: Body, length: float, simulator: Simulator, times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[T, W, 3] the rope's very end [m]: of a rod its last point, of particles half a spacing
    beyond the last section."""
    if simulator.num_points == len(body.points):
        return simulator.run(times, particles=[-1])[:, :, 0].astype(float)
    along = body.material_coordinates[:, 0]
    before, last = np.unique(along)[-2:]
    ends = [np.flatnonzero(along == s) for s in (before, last)]
    x = simulator.run(times, particles=np.concatenate(ends)).astype(float)
    first, second = x[:, :, : len(ends[0])].mean(axis=2), x[:, :, len(ends[0]) :].mean(axis=2)
    return second + (length - last) / (last - before) * (second - first)


# ---- both ----------------------------------------------------------------------------------------


def first_swing(
    stopped: NDArray[np.bool_],
    along: NDArray[np.float64],
    height: NDArray[np.float64],
    hand: NDArray[np.float64],
) -> dict[str, Any]:
    """Where the tip is highest in its first swing forward, and whether it is never higher behind.

    Args:
        stopped: [T] whether the hand stands still again.
        along: [T] the tip, along the cast from where it hung [m].
        height: [T] the tip, above the table [m].
        hand: [T] the hand, along the cast [m].
    """
    ahead = stopped & (along > hand)
    begin = int(np.argmax(ahead))
    behind = np.flatnonzero(~ahead[begin:])
    end = begin + int(behind[0]) if len(behind) else len(ahead)
    top = begin + int(np.argmax(height[begin:end]))
    highest = int(np.argmax(height))
    return {
        "highest": [float(along[top]), float(height[top])],
        "forward": bool(along[highest] > hand[-1]),
    }


def show(result: dict[str, Any], ropes: list[RealRope]) -> None:
    """Both realities' reaches and casts, and what is between them."""
    mujoco, ours = result["mujoco"], result.get("ours")
    print(f"MuJoCo: air {mujoco['air_density']:g} kg/m^3, steps of {1e3 * mujoco['step']:g} ms")
    if ours:
        damped = "as MuJoCo's" if ours["damping"] else "none"
        print(f"ours:   air {ours['air_density']:g} kg/m^3, damping {damped}")
    gaps: list[float] = []
    cast_gaps: list[float] = []
    for item in ropes:
        there = mujoco["ropes"][item.name]
        here = ours["ropes"][item.name] if ours else None
        print(f"\n{item.name}, damping {1e3 * item.material.damping:g} ms")
        print(
            f"  MuJoCo {item.vertices} vertices, "
            f"free length {lengths(there)}, {there['seconds']:.0f} s"
        )
        if here:
            print(
                f"  ours   {here['engine']}, {here['points']} points, "
                f"free length {lengths(here)}, {here['seconds']:.0f} s"
            )
        print("  released at (x, z) [m]   reached [m]: MuJoCo     ours  difference [mm]")
        of_rope = []
        for k, row in enumerate(there["releases"]):
            x, z = row["release"]
            line = f"  ({x:.3f}, {z:.3f}) {row['reached']:28.4f}"
            if here:
                reached = here["releases"][k]["reached"]
                of_rope.append(1e3 * (reached - row["reached"]))
                line += f" {reached:8.4f} {of_rope[-1]:16.1f}"
            print(line)
        if here:
            print(f"  difference: {summary(of_rope)}")
            gaps += of_rope
        print("  cast [m]  tip's highest (along, height) [m]: MuJoCo     ours  distance [mm]")
        for k, row in enumerate(there["casts"]):
            line = f"  {row['way']:<8.2f} {cast_text(row):>44}"
            if here:
                other = here["casts"][k]
                gap = 1e3 * float(np.linalg.norm(np.subtract(other["highest"], row["highest"])))
                cast_gaps.append(gap)
                line += f"  {cast_text(other)} {gap:6.1f}"
            print(line)
    if ours:
        print(f"\nall releases: {summary(gaps)}\nall casts:    {summary(cast_gaps)}")


def lengths(row: dict[str, Any]) -> str:
    """Between both grips, and below the one of a cast."""
    released, cast = row["free_lengths"]
    return f"{1e3 * released:.1f} mm (cast {1e3 * cast:.1f})"


def cast_text(row: dict[str, Any]) -> str:
    x, z = row["highest"]
    return f"({x:.3f}, {z:.3f}){'     ' if row['forward'] else ' back'}"


def summary(gaps: list[float]) -> str:
    size = np.abs(gaps)
    return f"mean {size.mean():.1f} mm, worst {size.max():.1f} mm, bias {np.mean(gaps):+.1f} mm"


if __name__ == "__main__":
    main()
