"""Films: a soft and a stiff object that a shipped policy brings to one goal, in our simulator; a
cloth let down, dropped and pulled apart; and a rope that falls into a loop.

    python benchmarks/films.py docs/images       # rope-reaching.gif and so on, thin-cloth.gif, ...
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from numpy.typing import NDArray

from gendom.materials import Cloth, Item, Material, Rope
from gendom.policies import Policy
from gendom.sim import Gripper, Physics, Simulator, Table, cloth, rope
from gendom.tasks import Observed
from gendom.tasks.world import Simulation
from gendom.viz import Animation, write_film
from gendom.viz.layers import goal_layer, observed_layer
from gendom.viz.palette import RECORDED_COLOR

FABRIC = Material(E=4.0e5, nu=0.3, density=400.0, damping=0.01)
SIZE = 0.3
FRAMES_A_SECOND = 20


def _rope(E: float) -> Rope:
    material = Material(E=E, nu=0.35, density=900.0, damping=0.004)
    return Rope(length=0.3, diameter=0.016, material=material)


def _cloth(E: float) -> Cloth:
    material = Material(E=E, nu=0.3, density=400.0, damping=0.004)
    return Cloth(side=0.2, thickness=0.001, material=material, friction=0.4)


TASKS = (
    ("rope-reaching", _rope(7e5), _rope(3e6)),
    ("rope-casting", _rope(7e5), _rope(3e6)),
    ("cloth-spreading", _cloth(5e5), _cloth(1.4e6)),
)
"""Names, a soft and a stiff object."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name, soft, stiff in TASKS:
        write_film(out / f"{name}.gif", one_goal(name, soft, stiff))
    sheet, shape = crumpled()
    film(out / "thin-cloth.gif", sheet, lambda axes, x: draw_sheet(axes, x.reshape(*shape, 3)))
    film(out / "thin-rope.gif", coiled(), draw_rope)


def one_goal(name: str, soft: Item, stiff: Item) -> Animation:
    """The motions of two objects, each by the policy's action for it; the goal is one that both
    reach, between what each can."""
    policy = Policy.pretrained(name)
    task, items = policy.task(), (soft, stiff)
    ends = [policy.goal_range(item) for item in items] if task.goals else []
    goal = np.mean([np.max([e[:, 0] for e in ends], 0), np.min([e[:, 1] for e in ends], 0)], 0) \
        if task.goals else np.zeros(0)  # fmt: skip
    actions = [np.array(policy.act(goal, item, force=True).values) for item in items]
    world = Simulation(everything=True)
    soft_seen, stiff_seen = (
        world.carry_out(task, [item], [action], keep=True)[0].seen
        for item, action in zip(items, actions, strict=True)
    )
    assert soft_seen is not None and stiff_seen is not None
    begins = max(soft_seen.times[0], stiff_seen.times[0])
    ends_at = min(soft_seen.times[-1], stiff_seen.times[-1])
    times = np.arange(begins, ends_at, 1.0 / FRAMES_A_SECOND)

    def at(seen: Observed) -> Observed:
        nearest = [int(np.argmin(np.abs(seen.times - t))) for t in times]
        return replace(seen, points=seen.points[nearest])

    layers = [
        observed_layer("stiff", stiff, at(stiff_seen), RECORDED_COLOR),
        observed_layer("soft", soft, at(soft_seen)),
    ]
    if task.goals:
        layers.append(goal_layer(goal, soft_seen, soft))
    table = -float(task.T_world_task(soft)[2, 3])
    return Animation(times=times - times[0], layers=tuple(layers), table_height=table)


def crumpled() -> tuple[NDArray[np.floating], tuple[int, ...]]:
    """[T, n, 3] points of a cloth, and its rows and columns."""
    body = cloth(
        width=SIZE, height=SIZE, thickness=0.001, dx=0.02, corner=(-SIZE / 2, -SIZE / 2, 0.25)
    )
    top = np.array([0.001, 0.002, 0.25])
    hand = Gripper(
        time=[0.0, 0.6, 1.2], position=[top, top, top * [1, 1, 0.12]], radius=0.012, hold_until=1.25
    )
    table, physics = Table(height=0.0, friction=0.4), Physics(self_contact=True)
    times = np.arange(1, 2.0 * FRAMES_A_SECOND) / FRAMES_A_SECOND
    heap = Simulator(body, [FABRIC], grippers=[hand], table=table, physics=physics).run(times)[:, 0]
    corners = heap[-1][[0, -1]]
    up, apart = np.array([0.0, 0.0, 0.35]), 0.48 * SIZE * np.array([[-1, -1, 0], [1, 1, 0]])
    hands = [
        Gripper(time=[0.0, 1.0, 2.0], position=[at, at + up, to + up], radius=0.0004)
        for at, to in zip(corners, apart, strict=True)
    ]
    pulled = Simulator(
        body, [FABRIC], grippers=hands, positions=heap[-1], table=table, physics=physics
    )
    times = np.arange(1, 2.5 * FRAMES_A_SECOND) / FRAMES_A_SECOND
    return np.concatenate([heap, pulled.run(times)[:, 0]]), body.shape


def coiled() -> NDArray[np.floating]:
    """[T, n, 3] points of a rope that falls on its end."""
    body = rope(
        diameter=0.008, length=0.5, start=(0, 0, 0.52), direction=(0.02, 0.01, -1), points=81
    )
    soft = Material(E=1.5e5, nu=0.3, density=1000.0, damping=0.01)
    s = Simulator(
        body, [soft], table=Table(height=0.0, friction=0.5), physics=Physics(self_contact=True)
    )
    turn = 12.0 * body.points[:, 2]
    s.set_velocities(0.03 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1))
    return s.run(np.arange(1, 1.6 * FRAMES_A_SECOND) / FRAMES_A_SECOND)[:, 0]


def draw_sheet(axes: Any, x: NDArray[np.floating]) -> None:
    axes.plot_surface(*np.moveaxis(x, -1, 0), rstride=1, cstride=1, color="#c8743c", shade=True)


def draw_rope(axes: Any, x: NDArray[np.floating]) -> None:
    axes.plot(*x.T, color="#2c5f8a", linewidth=5, solid_capstyle="round")


def film(path: Path, frames: NDArray[np.floating], draw: Callable[[Any, Any], None]) -> None:
    """Write an animated GIF of frames [T, n, 3] [m]."""
    figure = plt.figure(figsize=(3.6, 3.2), dpi=80)
    axes: Any = figure.add_axes((0, 0, 1, 1), projection="3d")
    low, high = frames.min(axis=(0, 1)), frames.max(axis=(0, 1))
    half = 0.5 * float((high - low).max())
    middle = 0.5 * (low + high)

    def show(k: int) -> None:
        axes.clear()
        draw(axes, frames[k])
        axes.set_xlim(middle[0] - half, middle[0] + half)
        axes.set_ylim(middle[1] - half, middle[1] + half)
        axes.set_zlim(0.0, 2.0 * half)
        axes.set_box_aspect((1, 1, 1), zoom=1.3)
        axes.set_axis_off()
        axes.view_init(elev=20, azim=-60)

    FuncAnimation(figure, show, frames=len(frames)).save(  # pyright: ignore[reportArgumentType]
        path, writer=PillowWriter(fps=FRAMES_A_SECOND)
    )
    plt.close(figure)


if __name__ == "__main__":
    main()
