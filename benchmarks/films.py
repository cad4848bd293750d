"""Films: a soft and a stiff object that a shipped policy brings to one goal, in our simulator; a
cloth let down, dropped and pulled apart; a rope that falls into a loop; one over a bar, and a cloth
over a sphere; and, in the MuJoCo test scene, a limp cloth that the arm drags open.

    python benchmarks/films.py docs/images       # rope-reaching.gif and so on, thin-cloth.gif, ...
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gendom.arrays import placed
from gendom.materials import Cloth, Item, Material, Rope, size_of
from gendom.policies import Policy
from gendom.reality.model import looking_at
from gendom.reality.objects import as_real
from gendom.reality.trials import TrialRun, lift_cameras, task_trial
from gendom.sim import (
    Capsule,
    Gripper,
    Physics,
    Simulator,
    Sphere,
    Table,
    cloth,
    rope,
)
from gendom.tasks import ClothDragging, Observed
from gendom.tasks.areas import spread_areas
from gendom.tasks.cloth_dragging import MOTIONS
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.tasks.world import Simulation
from gendom.viz import Animation, Layer, object_layer, save, write_film
from gendom.viz.layers import goal_layer, observed_layer
from gendom.viz.palette import RECORDED_COLOR

FABRIC = Material(E=4.0e5, nu=0.3, density=400.0, damping=0.01)
SIZE = 0.3
FRAMES_A_SECOND = 20

LIMP = (901, 5)
"""Draws the cloth that the arm drags open."""


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
    ("cloth-dragging", _cloth(5e5), _cloth(1.4e6)),
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
    write_film(out / "thin-cloth.gif", crumpled())
    write_film(out / "thin-rope.gif", coiled())
    over_obstacles(out)
    dragged(out / "cloth-dragging-arm.gif")


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


def crumpled() -> Animation:
    """A cloth that is dropped and pulled apart."""
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
    x = np.concatenate([heap, pulled.run(times)[:, 0]])
    return _alone(object_layer("cloth", body, x))


def coiled() -> Animation:
    """A rope that falls on its end."""
    body = rope(
        diameter=0.008, length=0.5, start=(0, 0, 0.52), direction=(0.02, 0.01, -1), points=81
    )
    soft = Material(E=1.5e5, nu=0.3, density=1000.0, damping=0.01)
    s = Simulator(
        body, [soft], table=Table(height=0.0, friction=0.5), physics=Physics(self_contact=True)
    )
    turn = 12.0 * body.points[:, 2]
    s.set_velocities(0.03 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1))
    x = s.run(np.arange(1, 1.6 * FRAMES_A_SECOND) / FRAMES_A_SECOND)[:, 0]
    return _alone(object_layer("rope", body, x))


def _alone(layer: Layer) -> Animation:
    times = np.arange(len(layer.points)) / FRAMES_A_SECOND
    return Animation(times=times, layers=(layer,), table_height=0.0)


def over_obstacles(out: Path) -> None:
    """A rope that falls over a bar, and a cloth over a sphere."""
    times, table = np.arange(1, 1.2 * FRAMES_A_SECOND) / FRAMES_A_SECOND, Table(height=0.0)
    bar = Capsule.between((0, -0.1, 0.2), (0, 0.1, 0.2), radius=0.03, friction=0.4)
    line = rope(diameter=0.008, length=0.5, start=(-0.3, 0, 0.25))
    ball = Sphere(radius=0.06, position=(0.0, 0.0, 0.08), friction=0.4)
    sheet = cloth(width=SIZE, height=SIZE, thickness=0.001, dx=0.02, corner=(-0.15, -0.15, 0.2))
    for name, body, fabric, obstacle in (
        ("rope-bar", line, Material(E=1e6, damping=0.01), bar),
        ("cloth-sphere", sheet, FABRIC, ball),
    ):
        s = Simulator(body, [fabric], table=table, obstacles=[obstacle])
        save(out / f"{name}.gif", s, s.run(times), times)


def dragged(path: Path) -> None:
    """A limp cloth of the MuJoCo test scene, which the arm drags open by the fourth motion."""
    task = ClothDragging()
    item = replace(as_real(task.draw_items([np.random.default_rng(LIMP)])[0]), colour=(40, 70, 190))
    motion = np.array(MOTIONS[3]) * task.action_units(item)
    trial = task_trial(task, item, task.nearest(item, motion))
    ends = np.array([trial.path.position.min(axis=0), trial.path.position.max(axis=0)])
    centre = np.r_[ends[:, :2].mean(axis=0), 0.1]
    width, height, focal = 400, 250, 350.0
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    pose = looking_at(centre + np.array([0.7, 0.1, 0.5]), centre)
    camera = replace(lift_cameras(item)[0], width=width, height=height, K=K, T_world_camera=pose)
    run, images = TrialRun(trial, cameras=[camera]), []
    with run.world:
        for moment in np.arange(run.closes, run.end, 0.1):
            run.step_to(float(moment))
            images.append(Image.fromarray(run.world.render(0)[1]))
    x = placed(np.linalg.inv(task.T_world_task(item)), run.world.vertices()) / size_of(item)
    share, _ = spread_areas(x, lattice_triangles(item.vertices, item.vertices))
    print(f"{path.name}: {share:.2f} lie spread")
    few = Image.fromarray(np.concatenate([np.asarray(images[k]) for k in (0, 20, -1)])).quantize(48)
    images = [image.quantize(palette=few, dither=Image.Dither.NONE) for image in images]
    lasts = [100] * (len(images) - 1) + [1500]
    images[0].save(path, save_all=True, append_images=images[1:], duration=lasts, loop=0)


if __name__ == "__main__":
    main()
