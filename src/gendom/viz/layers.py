"""Layers of what is shown (clouds, objects, grippers, arms, goals, obstacles), and of a lift."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from gendom.arrays import Array, outwards, placed
from gendom.materials import Item, Rope, size_of, thickness_of
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.viz.animation import Animation, Layer
from gendom.viz.palette import (
    ARM_COLOR,
    GOAL_COLOR,
    GRIPPER_COLOR,
    OBSTACLE_COLOR,
    RECORDED_COLOR,
    RECORDED_OPACITY,
    SIMULATED_COLOR,
    SIMULATED_OPACITY,
)

if TYPE_CHECKING:
    from gendom.estimation import LiftScene, Theta
    from gendom.reality.trials import TrialRun
    from gendom.sim import Body, Obstacle
    from gendom.tasks import Observed


def lift_animation(
    scene: LiftScene, x: Array | None = None, theta: Theta | None = None, **more: Any
) -> Animation:
    """A recorded lift, and what is simulated of it.

    Args:
        scene: What was recorded.
        x: [T, N, 3] simulated positions at its frames [m]; None: the recording alone.
        theta: With which these were simulated.
        more: Further fields of the animation.
    """
    recording, frames = scene.recording, list(scene.frames)
    clouds = recording.frames(frames)
    # small, or a dense cloud would hide the object
    dot = scene.size * (0.003 if np.median([len(cloud) for cloud in clouds]) < 400 else 0.002)
    layers = [Layer(name="recorded", color=RECORDED_COLOR, points=clouds, radius=dot,
                    opacity=RECORDED_OPACITY)]  # fmt: skip
    if x is not None and theta is not None:
        body = scene.body_of(theta)
        layers.append(object_layer("simulated", body, x, opacity=SIMULATED_OPACITY))
    axis = None if recording.gripper_axis is None else recording.gripper_axis[frames]
    layers.append(gripper_layer(recording.gripper_position[frames], scene.size, axis))
    more = {"times": recording.time[frames], "table_height": recording.table_height, **more}
    return Animation(layers=tuple(layers), **more)


def object_layer(
    name: str, body: Body, x: Array, *, color: str = SIMULATED_COLOR, opacity: float = 1.0
) -> Layer:
    """The skin of a simulated rope or cloth; of particles dots.

    Args:
        name: Of the layer.
        body: The object.
        x: [T, N, 3] its points or particles [m].
        color: As "#rrggbb".
        opacity: Below 1 where something else is to be seen through it.
    """
    points, n = body.surface(x), x.shape[1]
    about: dict[str, Any] = {"name": name, "color": color, "opacity": opacity}
    if n != len(body.points):
        return Layer(points=points, radius=0.25 * body.dx, **about)
    closed = body.kind == "rope"
    if closed:  # one ring of the skin for each edge is enough
        rings = points.reshape(len(x), -1, 8, 3)
        rings = rings[:, np.linspace(0, rings.shape[1] - 1, n).round().astype(int)]
        points, faces = rings.reshape(len(x), -1, 3), tube_faces(n, 8)
    else:
        faces = lattice_triangles(*body.shape)
    return Layer(points=points, faces=faces, closed=closed, **about)


def observed_layer(name: str, item: Item, seen: Observed, color: str = SIMULATED_COLOR) -> Layer:
    """The skin of what a world observed of an object."""
    if isinstance(item, Rope):
        from gendom.sim import rope  # takes long to import

        n = seen.points.shape[1]
        body = rope(diameter=item.diameter, length=item.length, points=n)
        return object_layer(name, body, seen.points, color=color)
    return Layer(name=name, color=color, points=seen.points, faces=lattice_triangles(*seen.lattice))


def gripper_layer(position: Array, size: float, axis: Array | None = None) -> Layer:
    """Grippers as sticks that stand on what they hold, and a bar along the object at the clamp.

    Args:
        position: [T, G, 3] where they hold it [m].
        size: Of the object [m].
        axis: [T, G, 3] unit vectors along the object at the clamps; None: unknown.
    """
    up = np.array([0.0, 0.0, 0.15 * size])
    ends = [np.stack([position, position + up], axis=-2)]
    if axis is not None:
        half = 0.04 * size * axis
        ends.append(np.stack([position - half, position + half], axis=-2))
    lines = np.concatenate(ends, axis=1)
    return Layer(name="gripper", color=GRIPPER_COLOR, points=lines, radius=0.012 * size)


def arm_layer(run: TrialRun, times: Array, T_world_frame: Array) -> Layer:
    """The arm of a run of the MuJoCo scene at its times [T] [s], in a frame [4, 4]."""
    from gendom.robot import XARM7, arm_shape

    assert run.motion is not None
    shape = arm_shape(XARM7, run.motion.at(times), thickness_of(run.trial.item))
    ends = placed(np.linalg.inv(T_world_frame), np.stack([shape.start, shape.end], axis=-2))
    return Layer(name="arm", color=ARM_COLOR, points=ends, radius=shape.radius)


def goal_layer(goal: Array, seen: Observed, item: Item) -> Layer:
    """A goal in its task's frame [m]: a dot at a goal (x, z) beside where the tip hung, or an
    upright line at a distance x, as high as the rope comes."""
    if len(goal) == 1:
        ends = float(seen.points[..., 2].min()), float(seen.points[..., 2].max())
        thick, mark = 0.006, np.array([[[goal[0], 0.0, z] for z in ends]])
    else:
        x, y, z = seen.tip[0]
        thick, mark = 0.02, np.array([[x + goal[0], y, z + goal[1]]])
    return Layer(name="goal", color=GOAL_COLOR, points=[mark], radius=thick * size_of(item))


def obstacle_layer(name: str, obstacle: Obstacle, times: Array) -> Layer:
    """A rigid obstacle at times [T] [s]: the hull of spheres at the corners of its core."""
    half, reach = obstacle.core
    tilt, turn = np.meshgrid(np.linspace(0.0, math.pi, 13), np.linspace(0.0, 2.0 * math.pi, 25))
    ball = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1)
    corners = np.stack(np.meshgrid(*[(-h, h) for h in half]), axis=-1).reshape(-1, 1, 3)
    hull = ConvexHull((corners + reach * ball.reshape(-1, 3)).reshape(-1, 3))
    x, faces = hull.points[hull.vertices], np.searchsorted(hull.vertices, outwards(hull))
    moves = len(np.atleast_1d(obstacle.time)) > 1
    poses = [obstacle.pose_at(float(t)) for t in (times if moves else times[:1])]
    shown = [centre + turned.apply(x) for centre, turned in poses]
    return Layer(name=name, color=OBSTACLE_COLOR, points=shown, faces=faces, closed=True)


def tube_faces(rings: int, sides: int) -> NDArray[np.integer]:
    """[F, 3] triangles of a closed tube: rings of vertices one after another, and its two ends.

    They are counter-clockwise from outside where rings are so, seen from the last one.
    """
    at = np.arange(rings * sides).reshape(rings, sides)
    around = lattice_triangles(rings, sides + 1)
    around = at[around // (sides + 1), around % (sides + 1) % sides]
    fan = [[0, k, k + 1] for k in range(1, sides - 1)]
    return np.concatenate([around, at[0][fan][:, ::-1], at[-1][fan]])
