"""Recordings made by the simulator itself, seen by two simulated depth cameras.

They stand in for a real lift in demonstrations and tests. The simulator that estimates from them
is the one that made them, at another resolution: this tests the estimator, not the physics.
"""

import math

import numpy as np
from numpy.typing import NDArray

from gendom.datasets import ObjectDescription, Recording
from gendom.materials import Material
from gendom.observation import visible
from gendom.sim import Gripper, Simulator, Table, rope

CELLS_ACROSS = 2.5
"""Resolution of the recorded world; estimates use 1.5 by default."""

LIFT_SPEED = 0.12
"""Speed at which the recorded world is simulated [m/s]."""

DAMPING = 4.0
"""[1/s]."""

FRICTION = 0.3
"""Coefficient of friction of the table."""

NOISE_FACTOR = 0.08 / (424.0 * 0.05)
"""Depth noise s / (f B) of a D435-like stereo camera [1/m]; its RMS is z^2 times this."""


def synthetic_rope_lift(
    material: Material,
    *,
    length: float,
    diameter: float,
    rise: float,
    frames: int,
    points: int,
    seed: int,
    frame_interval: float = 0.2,
    noise: bool = True,
) -> Recording:
    """A rope lifted by one end from a table, as two opposite depth cameras would record it.

    Args:
        material: The rope's material.
        length, diameter: Its sizes [m].
        rise: How far the gripper lifts [m].
        frames: Recorded frames.
        points: Points a frame, at most.
        seed: Seed of the cameras' noise and of the choice of points.
        frame_interval: Time between frames [s]; the motion is quasi-static.
        noise: Whether the cameras are noisy.

    Returns:
        The recording. ``extra["truth"]`` holds the parameters, for evaluation only.
    """
    start = np.array([0.35, 0.0, diameter / 2.0])
    body = rope(length=length, diameter=diameter, start=start, cells_across=CELLS_ACROSS)
    grip = start + np.array([diameter / 2.0, 0.0, 0.0])
    share = np.linspace(0.0, 1.0, frames)
    path = grip + share[:, None] * np.array([0.0, 0.0, rise])
    seconds = rise / LIFT_SPEED
    gripper = Gripper(time=share * seconds, position=path, radius=0.75 * diameter)
    simulator = Simulator(
        body,
        [material],
        grippers=[gripper],
        table=Table(height=0.0, friction=FRICTION),
        damping=DAMPING,
    )
    x = simulator.run(share * seconds)[:, 0].astype(float)
    middle = np.array([grip[0] + length / 2.0, 0.0, 0.0])
    cameras = middle + np.array([[0.0, -0.7, 0.4], [0.0, 0.7, 0.4]])
    rng = np.random.default_rng(seed)
    clouds = [_seen(cloud, cameras, points, rng, noise) for cloud in body.surface(x)]
    volume = math.pi / 4.0 * diameter**2 * length
    return Recording.from_frames(
        clouds,
        time=np.arange(frames) * frame_interval,
        gripper_position=path[:, None],
        object=ObjectDescription(
            kind="rope",
            length=length,
            diameter=diameter,
            mass=material.density * volume,
            grasp="end",
        ),
        table_height=0.0,
        gripper_source="measured",
        quasi_static=True,
        camera_positions=cameras,
        source="gendom's own simulator at another resolution, seen by two simulated depth cameras",
        notes=f"Noise seed {seed}. Not an independent reality.",
        extra={
            "truth": {
                "youngs_modulus": material.E,
                "poissons_ratio": material.nu,
                "density": material.density,
            }
        },
    )


def _seen(
    cloud: NDArray, cameras: NDArray, points: int, rng: np.random.Generator, noise: bool
) -> NDArray:
    """What the cameras make of one frame, fused and thinned out."""
    views = []
    for camera in cameras:
        view = cloud[visible(cloud, camera_positions=camera)]
        ray = view - camera
        distance = np.linalg.norm(ray, axis=1, keepdims=True)
        if noise:
            error = NOISE_FACTOR * distance**2 * rng.normal(size=distance.shape)
            view = view + error * ray / distance
        views.append(view)
    fused = np.concatenate(views)
    return fused[rng.permutation(len(fused))[:points]]
