"""Sampling, grouping, the network's file, and what the shipped one says."""

import math
import os

import numpy as np
import pytest

from experiments.pointnet import (
    grouped,
    pointnet,
    read_network,
)
from experiments.sim2sim import (
    paper_E,
    scene_settings,
    sim2sim_problem,
    sim2sim_recording,
    truth_of,
)
from gendom.errors import ParameterError
from gendom.estimation.scene import LiftScene


@pytest.fixture(scope="module")
def paper_lift():
    return sim2sim_recording(4000.0, 0.3, markers=False, shows="last")


def test_the_file_gives_what_torch_gives(tmp_path):
    torch = pytest.importorskip("torch", reason="training needs torch")
    from experiments.pointnet_training import INPUTS, Training, simulated_lifts, train

    settings = scene_settings()
    scene = LiftScene.of(sim2sim_recording(4000.0, 0.3, frames=10), settings)
    thetas = [truth_of(E, nu) for E, nu in ((600.0, 0.2), (2000.0, 0.4), (9000.0, 0.3))]
    clouds, targets = simulated_lifts(scene, thetas)
    assert targets[0, 0] == pytest.approx(
        math.log(scene.bending_length(thetas[0].E_over_rho) / 0.5)
    )
    path, training = tmp_path / "net.onnx", Training(epochs=3)
    network = train(scene, clouds, targets, path, training)
    session, said = read_network(path)
    assert said["lift"] == pytest.approx({"rise": 0.9, "thickness": 0.056})
    made = grouped(clouds)
    with torch.no_grad():
        expected = network(*(torch.from_numpy(made[name]) for name in INPUTS))
    for a, b in zip(session.run(None, made), expected, strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=1e-5)


def test_the_shipped_network_reads_a_lift(paper_lift, tmp_path):
    problem = sim2sim_problem(paper_lift)
    found = pointnet(problem)
    E = paper_E(problem.theta(found.best.vector).E_over_rho)
    assert E == pytest.approx(4000.0, rel=0.1)
    assert found.covariance is not None
    sd = math.sqrt(found.covariance[0, 0])
    assert 0.0 < sd < 0.3
    assert abs(math.log(E / 4000.0)) < 4.0 * sd
    # a file that is no network is refused
    path = tmp_path / "net.onnx"
    path.write_bytes(os.urandom(100))
    with pytest.raises(ParameterError, match="is no network of this method"):
        read_network(path)
    with pytest.raises(ParameterError, match="is no network of this method"):
        read_network(tmp_path / "missing.onnx")
