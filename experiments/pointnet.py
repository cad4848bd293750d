"""PointNet++, the paper's baseline: a network that predicts parameters from the last cloud of one
kind of lift.

PointNet++ (Qi et al. 2017) with single-scale grouping, trained on simulated lifts
(`pointnet_training`). It takes a cloud in the gripper's frame, in sizes of the object, and gives
the logarithm of bending length over size and Poisson's ratio, each with its variance (Kendall and
Gal 2017). Farthest points and their neighbourhoods are chosen here, before the network, which
onnxruntime runs. Other unknowns stay at their priors. The network is for the lift of the paper's
simulation.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.evolution import only_part
from gendom.arguments import require
from gendom.errors import ParameterError
from gendom.estimation.methods.search import estimated_noise
from gendom.estimation.problem import Found, Problem, Start
from gendom.estimation.scene import LiftScene

Array = NDArray[np.floating]

ASSET = Path(__file__).parent / "assets" / "pointnet-rope.onnx"
METADATA_KEY = "gendom-pointnet"
FORMAT = "gendom-pointnet/1"

POINTS = 256
"""Of a cloud that count, farthest points."""

CENTRES = (64, 16)
"""Farthest points of each layer about which neighbours are grouped."""

RADII = (0.1, 0.3)
"""How far these lie, at most [sizes of the object]."""

NEIGHBOURS = 16
"""Of each centre, itself among them; where there are fewer, the centre stands in."""


def pointnet(problem: Problem) -> Found:
    """Predict modulus and Poisson's ratio from the last cloud.

    Raises:
        ParameterError: The network was trained on another kind of lift.
        SimulationError: Its prediction cannot be simulated.
    """
    scene, prior = only_part(problem).scene, problem.prior
    session, description = read_network(ASSET)
    lift = lift_of(scene)
    for name, value in description["lift"].items():
        if not value / 1.2 <= lift[name] <= 1.2 * value:
            raise ParameterError(
                f"the network knows lifts with {name} {value:.3g}, this one's is {lift[name]:.3g}",
                where="method pointnet",
                fix="use gauss-newton",
            )
    cloud = scene.recording.frame(scene.frames[-1]).astype(float)
    (mean,), (log_variance,) = session.run(
        ["mean", "log_variance"], grouped(normalised(scene, cloud, scene.frames[-1])[None])
    )
    initial = prior.vector(*problem.bases)
    vector, covariance = initial.copy(), np.diag(prior.sd**2)
    # the modulus goes with the bending length cubed
    modulus = math.log(scene.E_over_rho(math.exp(float(mean[0])) * scene.size))
    predicted = {"E_over_rho": (modulus, 3.0), "nu": (float(mean[1]), 1.0)}
    for n, (name, (value, share)) in enumerate(predicted.items()):
        if name in prior.names:
            k = prior.names.index(name)
            vector[k] = value
            covariance[k, k] = share**2 * math.exp(float(log_variance[n]))
    vector = prior.clipped(vector)
    comparison = problem.compare([vector])[0]
    if comparison is None:
        raise problem.nothing_runs()
    best = Start(
        initial=initial,
        vector=vector,
        comparison=comparison,
        value=comparison.rms,
        iterations=1,
        done=True,
    )
    problem.tell("network", 1, 1, best)
    return Found(
        best=best,
        starts=[best],
        noise=estimated_noise(comparison, problem.first_noise()),
        covariance=covariance,
    )


def lift_of(scene: LiftScene) -> dict[str, float]:
    """Dimensionless features that distinguish lifts.

    Raises:
        ParameterError: It is no lift of a rope by one gripper.
    """
    if scene.kind != "rope" or len(scene.held) != 1:
        raise ParameterError(
            "reads lifts of ropes by one gripper", where="method pointnet", fix="use gauss-newton"
        )
    path = scene.recording.gripper_position[:, 0]
    rise = float(path[scene.frames[-1], 2] - path[scene.begins, 2])
    return {"rise": rise / scene.size, "thickness": scene.body.thickness / scene.size}


def normalised(scene: LiftScene, points: Array, frame: int) -> Array:
    """[n, 3] points [m] seen from the gripper in a frame, in sizes of the object; x is where the
    rope lay before, z up."""
    x, y = scene.inwards[0, :2] / np.linalg.norm(scene.inwards[0, :2])
    turn = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    grip = scene.recording.gripper_position[frame, 0]
    return (points - grip) @ turn / scene.size


def farthest(points: Array, count: int) -> NDArray[np.intp]:
    """[B, count] farthest points of clouds [B, n, 3], beginning with that nearest to the origin.

    Source: Eldar et al. (1997), "The farthest point strategy for progressive image sampling".
    """
    rows = np.arange(len(points))
    chosen = np.empty((len(points), count), dtype=np.intp)
    chosen[:, 0] = (points**2).sum(axis=2).argmin(axis=1)
    gap = np.full(points.shape[:2], np.inf)
    for k in range(1, count):
        last = points[rows, chosen[:, k - 1]]
        np.minimum(gap, ((points - last[:, None]) ** 2).sum(axis=2), out=gap)
        chosen[:, k] = gap.argmax(axis=1)
    return chosen


def neighbours(points: Array, centres: Array, radius: float) -> NDArray[np.intp]:
    """[B, m, K] the nearest points [B, n, 3] within a radius of centres [B, m, 3]; the nearest of
    all where there are fewer than `NEIGHBOURS`."""
    far = ((centres[:, :, None] - points[:, None]) ** 2).sum(axis=3)
    near = np.argsort(far, axis=2, kind="stable")[:, :, :NEIGHBOURS]
    inside = np.take_along_axis(far, near, axis=2) <= radius**2
    return np.where(inside, near, near[:, :, :1])


def grouped(clouds: Array) -> dict[str, NDArray[Any]]:
    """The network's input for normalised clouds [B, n, 3].

    Returns:
        near [B, m1, K, 3] places of neighbours about the first layer's centres; which [B, m2, K]
        first centres about the second's, and about [B, m2, K, 3] their places; at [B, m2, 3] the
        second centres.
    """
    if clouds.shape[1] < POINTS:
        clouds = np.tile(clouds, (1, -(-POINTS // clouds.shape[1]), 1))
    points = _taken(clouds, farthest(clouds, POINTS))
    first = _taken(points, farthest(points, CENTRES[0]))
    near = _taken(points, neighbours(points, first, RADII[0])) - first[:, :, None]
    second = _taken(first, farthest(first, CENTRES[1]))
    which = neighbours(first, second, RADII[1])
    about = _taken(first, which) - second[:, :, None]
    return {
        "near": near.astype(np.float32),
        "which": which.astype(np.int64),
        "about": about.astype(np.float32),
        "at": second.astype(np.float32),
    }


def _taken(points: Array, index: NDArray[np.intp]) -> Array:
    """[B, ..., 3] of points [B, n, 3] at indices [B, ...]."""
    flat = index.reshape(len(index), -1, 1)
    return np.take_along_axis(points, flat, axis=1).reshape(*index.shape, 3)


def read_network(path: Path) -> tuple[Any, dict[str, Any]]:
    """A session of onnxruntime, and the metadata of a file that `train` of `pointnet_training`
    wrote.

    Raises:
        ParameterError: There is no such file, or it is no such network.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    fix = "train one with python -m experiments.pointnet_training"
    try:
        session = onnxruntime.InferenceSession(
            path.read_bytes(), sess_options=options, providers=["CPUExecutionProvider"]
        )
        metadata = session.get_modelmeta().custom_metadata_map[METADATA_KEY]
        description = json.loads(metadata)
    except Exception as error:  # onnxruntime's own exceptions share no public base class
        what = f"is no network of this method ({type(error).__name__})"
        raise ParameterError(what, where=str(path), fix=fix) from error
    what = f"has format {description.get('format')!r}, not {FORMAT!r}"
    require(description.get("format") == FORMAT, what, where=str(path), fix=fix)
    return session, description
