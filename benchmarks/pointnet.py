"""Trains the network of the method pointnet on simulated lifts, and measures it on fresh ones.

    python benchmarks/pointnet.py                            # the paper's lift: the shipped network
    python benchmarks/pointnet.py --recording LIFT.npz --out lift.onnx     # for lifts like another

The paper's baseline is trained on 998 simulated sets, with E over [500, 10500] in its units and nu
over [0.2, 0.4] (Kuroki et al. 2024). For a recording of one's own, bending lengths of 0.1 to 1.5
lengths are drawn and clouds show what its cameras see.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np

from gendom.datasets import Recording
from gendom.estimation import LiftScene, Theta
from gendom.estimation.methods.pointnet import ASSET, grouped, read_network
from gendom.estimation.methods.pointnet_network import (
    PointNetTraining,
    simulated_lifts,
    train_pointnet,
)
from gendom.estimation.sim2sim import (
    E_RANGE,
    NU_RANGE,
    paper_E,
    scene_settings,
    sim2sim_recording,
    truth_of,
)

SHIPPED = Path(__file__).resolve().parents[1] / "src" / "gendom" / "assets" / ASSET


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recording", type=Path, help="a lift that others are like")
    parser.add_argument("--out", type=Path, default=SHIPPED, help="file to write")
    parser.add_argument("--lifts", type=int, default=998)
    parser.add_argument("--held-out", type=int, default=200, help="fresh lifts to measure it on")
    parser.add_argument("--epochs", type=int, default=PointNetTraining.epochs)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, help="of the simulator (default: all cores)")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.recording is None:
        settings = scene_settings(threads=given.threads)
        scene = LiftScene.of(sim2sim_recording(5000.0, 0.3, settings=settings), settings)
    else:
        scene = LiftScene.of(Recording.read(given.recording))
    began = time.perf_counter()
    rng = np.random.default_rng(given.seed)
    cameras = given.recording is not None

    def lifts(count: int) -> tuple[np.ndarray, np.ndarray]:
        thetas = [drawn(scene, rng, paper=not cameras) for _ in range(count)]
        return simulated_lifts(scene, thetas, cameras=cameras)

    clouds, targets = lifts(given.lifts)
    simulated = time.perf_counter() - began

    def show(epoch: int, loss: float) -> None:
        if epoch % 10 == 0 and not given.json:
            print(f"epoch {epoch:4d}  loss {loss:.5f}", flush=True)

    train_pointnet(
        scene,
        clouds,
        targets,
        given.out,
        PointNetTraining(epochs=given.epochs, seed=given.seed),
        on_epoch=show,
    )
    trained = time.perf_counter() - began - simulated
    session, _ = read_network(given.out)
    fresh, truth = lifts(given.held_out)
    mean, log_variance = session.run(["mean", "log_variance"], grouped(fresh))
    E, true_E = (
        np.array([paper_E(scene.E_over_rho(math.exp(b) * scene.size)) for b in each])
        for each in (mean[:, 0].astype(float), truth[:, 0])
    )
    z = (mean - truth) / np.exp(0.5 * log_variance)
    result = {
        "lifts": len(clouds),
        "held_out": len(fresh),
        "mean_absolute_error_of_E": float(np.abs(E - true_E).mean()),
        "sd_of_that": float(np.abs(E - true_E).std()),
        "mean_absolute_error_of_ln_E": float(np.abs(np.log(E / true_E)).mean()),
        "mean_absolute_error_of_nu": float(np.abs(mean[:, 1] - truth[:, 1]).mean()),
        "nu_by_its_mean_alone": float(np.abs(truth[:, 1] - targets[:, 1].mean()).mean()),
        "errors_over_claimed_deviations": z.std(axis=0).tolist(),
        "simulation_seconds": simulated,
        "training_seconds": trained,
        "bytes": given.out.stat().st_size,
    }
    if given.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result.items():
        print(f"{name:<32} {value}")


def drawn(scene: LiftScene, rng: np.random.Generator, *, paper: bool) -> Theta:
    """Parameters of a random rope: the paper's, or any for a recorded lift."""
    if paper:
        return truth_of(rng.uniform(*E_RANGE), rng.uniform(*NU_RANGE))
    prior, base = scene.prior()
    theta = prior.theta(
        prior.clipped(prior.mean + prior.sd * rng.standard_normal(len(prior.names))), base
    )
    bending = math.exp(rng.uniform(math.log(0.1), math.log(1.5))) * scene.size
    return theta.with_values({"E_over_rho": scene.E_over_rho(bending)})


if __name__ == "__main__":
    main()
