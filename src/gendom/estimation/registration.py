"""Registration of clouds from cameras with unknown poses to the robot's frame.

The held point lies at the gripper, which gives a first shift. Then a simulated object is placed
where the clouds are and the clouds are registered to it, in turns. What is left is a nuisance
parameter of the likelihood, with a wide prior.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation.likelihood import Comparison
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.observed import NoiseModel
from gendom.estimation.placing import with_points
from gendom.estimation.problem import EstimateSettings, Problem
from gendom.estimation.scene import LiftScene
from gendom.materials.unknowns import Theta

LIFTED = 0.3
"""Rise of the gripper from which the held point is the highest, in the object's size."""

CONVERGED = (0.002, 0.005)
"""Registration ends below this motion: [m] at the clouds' centre, and [rad]; the likelihood
linearises motions of this size."""


def register(recording: Recording, settings: EstimateSettings, known: Theta | None = None) -> Array:
    """[4, 4] the motion that brings clouds to where the robot's frame has the object [m].

    A turn about the vertical through the gripper that no sideways motion shows stays as recorded.

    Raises:
        RecordingError: It shows too little to place the object.
        SimulationError: Nothing of it can be simulated.
    """
    T, vector = first_shift(recording), None
    for _ in range(5):
        scene = LiftScene.of(recording, settings.scene, registration=T)
        problem = Problem([scene], settings, known=known)
        if vector is None:
            vector, comparison, noise = _scanned(problem.coarse)
        else:
            found = gauss_newton(problem, initial=[vector])
            vector, comparison = found.best.vector, found.best.compared.parts[0]
            noise = found.noise[0]
        change, moved = _motion(comparison, noise)
        T = change @ T
        if moved[0] < CONVERGED[0] and moved[1] < CONVERGED[1]:
            break
    return T


def first_shift(recording: Recording) -> Array:
    """[4, 4] a shift of the tops of lifted clouds to the gripper [m].

    Raises:
        RecordingError: The gripper never lifts the object.
    """
    T, size, frames = np.eye(4), recording.object.size or 0.0, with_points(recording)
    rise = recording.gripper_position[:, :, 2].min(axis=1)
    lifted = [t for t in frames if rise[t] - rise[frames[0]] > LIFTED * size]
    what = "clouds of cameras with unknown poses need a gripper that lifts the object by"
    what, one = f"{what} {LIFTED:.0%} of its size", recording.num_grippers == 1
    where, fix = "gripper_position", "calibrate the cameras (gendom calibrate), or lift higher"
    require(lifted and one, what, where=where, fix=fix, error=RecordingError)
    away = []
    for t in lifted:
        cloud = recording.frame(t).astype(float)
        top = np.argsort(cloud[:, 2])[-max(1, round(0.05 * len(cloud))) :]
        away.append(recording.gripper_position[t, 0] - cloud[top].mean(axis=0))
    T[:3, 3] = np.median(away, axis=0)
    return T


def _scanned(problem: Problem) -> tuple[Array, Comparison, NoiseModel]:
    """[P] the best registered fit of a scan over the modulus and guesses of the grip; its noise."""
    prior, part = problem.prior, problem.parts[0]
    vectors = [prior.vector(part.base.with_values(guess)) for guess in part.scene.guesses]
    if "E_over_rho" in prior.names:
        k = prior.index("E_over_rho")
        scan = np.linspace(prior.low[k], prior.high[k], 10)[1:-1]
        vectors = [np.where(np.arange(len(v)) == k, x, v) for v in vectors for x in scan]
    (noise,) = problem.first_noise(sensor=0.005, rounds=8)
    compared = problem.compare(vectors, derivatives=False)
    values = [np.inf if c is None else c.parts[0].fit(noise).value for c in compared]
    n = int(np.argmin(values))
    best = compared[n]
    if best is None:
        raise problem.nothing_runs()
    return vectors[n], best.parts[0], noise


def _motion(comparison: Comparison, noise: NoiseModel) -> tuple[Array, tuple[float, float]]:
    """[4, 4] that moves clouds onto a shape [m], and how far: at their centre [m], and [rad]."""
    shift, turn = np.split(comparison.fit(noise).a[-7:-1], 2)
    centre, T = comparison.observation.centre, np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = centre + shift - T[:3, :3] @ centre
    return T, (float(np.linalg.norm(shift)), float(np.linalg.norm(turn)))
