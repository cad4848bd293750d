"""Ropes between two hands, drawn at random in the MuJoCo scene: are they found?

Both hands hold an end, as arms do, and move and turn at random; nothing else is touched. Either a
motion capture sees markers on the rope, or depth cameras see clouds of its skin. The estimate is
compared with the rope that was drawn, and predicts a second motion of it.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from experiments.lifts import LEVEL, estimate_settings
from experiments.runs import Result, Runs, Table
from gendom.datasets import ObjectDescription, Recording
from gendom.errors import GendomError
from gendom.estimation import LiftScene, SceneSettings, estimate, replay
from gendom.installation import load_mujoco
from gendom.materials import Material
from gendom.materials.parameters import E_over_rho_of, bending_length
from gendom.reality import Air, Layout, RealRope
from gendom.reality.model import compiled, scene_xml
from gendom.reality.twist import Twist

Array = NDArray[Any]

STEP, RATE = 2.5e-4, 100.0
"""Time step [s], and frames [1/s]."""

BRING, REST, MOVE = 2.0, 1.5, 5.0
"""Time in which the hands bring a straight rope's ends together, wait, and move [s]."""

HEIGHT = 1.5
"""Of the hands, far above the table [m]."""

NOISE = {"markers": 0.0003, "clouds": 0.002}
"""Of what is seen [m]."""

AXIS = 0.03
"""How well the rope's direction in a hand is known [rad]."""

CLOUD = 160
"""Points of a frame."""

HANDS = "".join(f'<body name="{name}" mocap="true" pos="0 0 9"/>' for name in ("hand", "other"))


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Of both hands: places [T, 2, 3] [m] and turns [T, 2, 3] (rotation vectors) from the straight
    rope on, at times [T] [s]."""

    time: Array
    position: Array
    turn: Array


def drawn_rope(rng: np.random.Generator) -> RealRope:
    """A rope of any size and stiffness."""
    length, slender = rng.uniform(0.4, 1.2), rng.uniform(60.0, 150.0)
    diameter = float(np.clip(length / slender, 0.004, 0.012))
    bends = length * math.exp(rng.uniform(math.log(0.06), math.log(0.35)))
    density = rng.uniform(500.0, 1500.0)
    E = density * E_over_rho_of(bends, diameter / 4.0, 9.80665)
    damping = math.exp(rng.uniform(math.log(0.002), math.log(0.03)))
    return RealRope(
        name="drawn",
        colour=(128, 128, 128),
        length=length,
        diameter=diameter,
        material=Material(E=E, nu=0.3, density=density, damping=damping),
        friction=0.4,
        vertices=1 + min(60, int(length / (1.05 * diameter))),
    )


def drawn_motion(rope: RealRope, rng: np.random.Generator) -> Motion:
    """Ends are brought together from the side or above, then move as smooth noise does."""
    time = np.arange(0.0, BRING + REST + MOVE + 1e-9, 0.01)
    near = np.clip(time / BRING, 0.0, 1.0)
    near = near**2 * (3.0 - 2.0 * near)
    moving = np.clip((time - BRING - REST) / 0.5, 0.0, 1.0)[:, None]
    span, L = rng.uniform(0.35, 0.7), rope.length
    down = rng.uniform(0.2, 1.3, 2)
    position, turn = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2, 3))
    away, yaw = 0.5 * L * (1.0 - (1.0 - span) * near), rng.uniform(-math.pi, math.pi)
    both = noise(time, rng, 0.25 * L, 0.6)
    for g, side in enumerate((-1.0, 1.0)):
        own = moving * (both + noise(time, rng, 0.15 * L, 1.2))
        position[:, g, 0] = side * away
        position[:, g] += own
        turn[:, g, 1] = -side * down[g] * near  # ends point downwards
        turn[:, g] += moving * noise(time, rng, 0.3, 0.8)
    level = Rotation.from_euler("z", yaw)
    shape = position.shape
    position = level.apply(position.reshape(-1, 3)).reshape(shape)
    position[..., 2] += HEIGHT
    turn = level.apply(turn.reshape(-1, 3)).reshape(shape)
    return Motion(time=time, position=position, turn=turn)


def noise(time: Array, rng: np.random.Generator, size: float, fastest: float) -> Array:
    """[T, 3] smooth noise of about this size."""
    found = np.zeros((len(time), 3))
    for _ in range(4):
        frequency, phase = rng.uniform(0.15, fastest), rng.uniform(0.0, 2.0 * math.pi, 3)
        weight = size * rng.normal(size=3) / math.hypot(1.0, frequency / 0.5) / 2.0
        found += weight * np.sin(2.0 * math.pi * frequency * time[:, None] + phase)
    return found


def simulated(rope: RealRope, motion: Motion) -> tuple[Array, Array, Array]:
    """The rope's vertices [T, V, 3], where the clamps end [T, 2, 3] [m] and the rope's direction in
    them [T, 2, 3], in frames of `MOVE`."""
    mujoco = load_mujoco()
    start = motion.position[0]
    ahead = (start[1] - start[0]) / np.linalg.norm(start[1] - start[0])
    across = np.cross([0.0, 0.0, 1.0], ahead)
    layout = Layout(origin=tuple(start[0]), along=tuple(ahead), across=tuple(across))
    xml = scene_xml(rope, layout, bodies=[HANDS], ties=(), tied=False, step=STEP)
    last = rope.vertices - 1
    held = ((0, "hand"), (1, "hand"), (last - 1, "other"), (last, "other"))
    tie = '<connect name="tie_{0}" body1="object_{0}" body2="{1}" anchor="0 0 0" solref="{2} 1"'
    tie += ' solimp="0.9999 0.9999 0.001"/>'
    ties = "".join(tie.format(v, name, 2 * STEP) for v, name in held)
    model = compiled(rope, xml.replace("</equality>", f"{ties}</equality>"))
    data = mujoco.MjData(model)
    bodies = np.array(model.flex_vertbodyid)
    dofs = model.body_dofadr[bodies][:, None] + np.arange(3)
    mujoco.mj_forward(model, data)
    x = data.xpos[bodies].copy()
    for v, name in held:
        e = model.equality(f"tie_{v}").id
        model.eq_data[e, :3], model.eq_data[e, 3:6] = 0.0, x[v] - start[int(name == "other")]
        data.eq_active[e] = 1
    which = [int(model.body(name).mocapid[0]) for name in ("hand", "other")]
    place = CubicSpline(motion.time, motion.position)
    turns = CubicSpline(motion.time, motion.turn)
    air, twist = Air(rope), Twist(rope, x, first=0, last=last - 1, rotation=np.eye(3))
    shapes, ends, axes = [], [], []
    frames = BRING + REST + np.arange(0.0, MOVE, 1.0 / RATE)
    for k in range(round((frames[-1] + 1.5 * STEP) / STEP)):
        t = k * STEP
        if len(shapes) < len(frames) and t > frames[len(shapes)] - 0.5 * STEP:
            own = Rotation.from_rotvec(turns(t))
            shapes.append(data.xpos[bodies].copy())
            axes.append(own.apply(ahead))
            # clamped from half an edge before the last pinned vertex on
            half = 0.5 * rope.spacing * np.array([[1.0], [-1.0]])
            ends.append(place(t) + half * axes[-1])
        x, R = data.xpos[bodies], Rotation.from_rotvec(turns(t)).as_matrix()
        forces = air.forces(x, data.qvel[dofs])
        # seen from the first hand, which turns, too
        more, _ = twist.load((x - x[0]) @ R[0], R[0].T @ R[1], STEP)
        data.qfrc_applied[dofs] = forces + more @ R[0].T
        after, quats = place(t + STEP), Rotation.from_rotvec(turns(t + STEP))
        for g, m in enumerate(which):
            data.mocap_pos[m] = after[g]
            data.mocap_quat[m] = quats[g].as_quat(scalar_first=True)
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
    return np.array(shapes), np.array(ends), np.array(axes)


def recorded(
    rope: RealRope, motion: Motion, seen_as: str, rng: np.random.Generator
) -> tuple[Recording, Array]:
    """The recording of a motion, and where the rope's vertices are [T, V, 3] [m]."""
    shapes, ends, axes = simulated(rope, motion)
    markers = 10 + rope.vertices % 5
    s, places = np.linspace(0.0, 1.0, rope.vertices), np.linspace(0.0, 1.0, 400)
    # from where one hand's hold ends to where the other's begins
    free = 0.5 / (rope.vertices - 1)
    places = free + (1.0 - 2.0 * free) * places
    line = CubicSpline(s, shapes, axis=1)(places)
    if seen_as == "markers":
        own = np.r_[0.0, 0.04, np.linspace(0.04, 0.96, markers - 2)[1:-1], 0.96, 1.0]
        frames = CubicSpline(np.linspace(0.0, 1.0, 400), line, axis=1)(own)
    else:
        which = rng.integers(0, 400, (len(line), CLOUD))
        centre = np.take_along_axis(line, which[..., None], axis=1)
        ahead = np.take_along_axis(np.gradient(line, axis=1), which[..., None], axis=1)
        out = np.cross(ahead, rng.standard_normal(centre.shape))
        frames = centre + 0.5 * rope.diameter * out / np.linalg.norm(out, axis=2, keepdims=True)
    frames = frames + NOISE[seen_as] * rng.standard_normal(frames.shape)
    axes = axes + AXIS * rng.standard_normal((2, 3))
    length = (1.0 - 2.0 * free) * rope.length
    recording = Recording.from_frames(
        list(frames.astype(np.float32)),
        time=np.arange(len(frames)) / RATE,
        gripper_position=ends,
        gripper_axis=axes / np.linalg.norm(axes, axis=2, keepdims=True),
        object=ObjectDescription(
            kind="rope",
            length=length,
            diameter=rope.diameter,
            mass=rope.mass * length / rope.length,
            grasp="both ends",
            grasp_radius=0.001,  # what is held ends at the stated place
        ),
        gripper_source="measured",
        source="experiments.two_hands",
        extra={"ordered_markers": True} if seen_as == "markers" else {},
    )
    return recording, line


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each rope and way of seeing it."""
    seeds = range(flags.seed, flags.seed + flags.lifts)
    work = [(name, seed) for seed in seeds for name in NOISE]
    rows = list(runs.each(partial(_row, runs), work, "moving"))
    texts = {f"{r['seed']}, {r['seen_as']}": _shown(r) for r in rows}
    head = ("bends / length", "bending length", "inside", "damping", "inside", "other motion, mm")
    title = "Ropes between two hands: found over true, and the error of another motion"
    table = Table(title=title, head=head, rows=texts)
    faults = [f"{r['seed']}, {r['seen_as']}: {r['fault']}" for r in rows if "fault" in r]
    return Result(name="two-hands", figures={"rows": rows}, shown=[table], notes=faults)


def _shown(row: dict[str, Any]) -> tuple[str, ...]:
    if "fault" in row:
        return ("refused", *[""] * 5)
    found = [f"{row['bends'] / row['length']:.2f}"]
    for name in ("bending_length", "damping"):
        low, high = row["intervals"][name] or (math.nan, math.nan)
        true = row["truth"][name]
        found += [f"{row['found'][name] / true:.3f}", "yes" if low <= true <= high else "no"]
    return (*found, f"{1e3 * row['error']:.1f}")


def _row(runs: Runs, which: tuple[str, int]) -> dict[str, Any]:
    seen_as, seed = which
    return runs.kept(f"two-hands-{seen_as}-{seed:04d}", partial(_estimated, seen_as, seed))


def _estimated(seen_as: str, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([94, seed])
    rope = drawn_rope(rng)
    (first, _), (other, line) = (
        recorded(rope, drawn_motion(rope, rng), seen_as, rng) for _ in range(2)
    )
    bends = bending_length(rope.material.E / rope.material.density, 0.25 * rope.diameter, 9.80665)
    truth = {"bending_length": bends, "damping": rope.material.damping}
    row: dict[str, Any] = {"seed": seed, "seen_as": seen_as, "truth": truth, "bends": bends}
    row["length"] = rope.length
    try:
        found = estimate(first, estimate_settings(seed))
        scene = LiftScene.of(other, SceneSettings(fast_frames=500, slow_frames=500, threads=1))
        x = replay(scene, [found.theta])[:, 0]
    except GendomError as error:
        return {**row, "fault": str(error)}
    if not found.usable:
        row["fault"] = ", ".join(found.verdict.reasons)
    own = CubicSpline(np.linspace(0.0, 1.0, x.shape[1]), x, axis=1)(np.linspace(0.0, 1.0, 400))
    values = {"bending_length": found.record["bending_length"], "damping": found.theta.damping}
    return {
        **row,
        "found": values,
        "intervals": {name: found.interval(name) for name in truth},
        "error": float(np.abs(own - line[list(scene.frames)]).mean()),
        "posterior": found.posterior.to_dict(),
        "seconds": found.record["seconds"],
        "level": LEVEL,
    }
