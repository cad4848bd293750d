"""Sets on a real Ray cluster of this machine's cores."""

import os
import signal
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ray", reason="needs the extra cluster")

from gendom.datasets.demonstrations import Outcomes, generate
from gendom.errors import DeviceError, ParameterError


@dataclass(frozen=True, kw_only=True)
class Throwing:
    """Throw a ball: it lands at speed^2 / gravity."""

    cost: float = 1.0
    dies_once: str | None = None
    """The first worker to make this file dies in it."""
    breaks: bool = False

    def about(self):
        return {"task": {"name": "throwing"}}

    def draw(self, rngs):
        return {"speed": np.array([rng.uniform(0.0, 10.0) for rng in rngs])}

    def demonstrate(self, draws, *, device, on_frame=None):
        if self.breaks:
            raise ParameterError("the ball is flat", fix="pump it up")
        if self.dies_once is not None:
            try:
                Path(self.dies_once).touch(exist_ok=False)
            except FileExistsError:
                pass
            else:
                os.kill(os.getpid(), signal.SIGKILL)
        speed = draws["speed"]
        return Outcomes(columns={"goal_x": speed**2 / 9.81}, faults=(None,) * len(speed))


@pytest.fixture(scope="module")
def cluster():
    ray = pytest.importorskip("ray")
    quiet = {"include_dashboard": False, "log_to_driver": False, "logging_level": "ERROR"}
    ray.init(num_cpus=2, num_gpus=0, **quiet)
    yield "local"
    ray.shutdown()


def test_rows_are_those_of_one_machine(tmp_path, cluster):
    size = 3 * max(16, 2 * (os.cpu_count() or 1)) + 5
    alone = generate(Throwing(), size, tmp_path / "one", seed=3, shard_size=24)
    shared = generate(Throwing(), size, tmp_path / "two", seed=3, shard_size=24, cluster=cluster)
    assert shared.equals(alone)
    for shard in (tmp_path / "one").glob("*.parquet"):
        assert (tmp_path / "two" / shard.name).read_bytes() == shard.read_bytes()


def test_a_killed_worker_loses_nothing(tmp_path, cluster):
    alone = generate(Throwing(), 60, tmp_path / "one", seed=3)
    source = Throwing(dies_once=str(tmp_path / "died"))
    shared = generate(source, 60, tmp_path / "two", seed=3, cluster=cluster)
    assert (tmp_path / "died").exists() and shared.equals(alone)


def test_faults_are_told_as_on_one_machine(tmp_path, cluster):
    with pytest.raises(ParameterError, match="the ball is flat; pump it up"):
        generate(Throwing(breaks=True), 20, tmp_path / "set", seed=3, cluster=cluster)
    with pytest.raises(DeviceError, match="the cluster has no GPU"):
        generate(Throwing(), 20, tmp_path / "set", seed=3, cluster=cluster, device="cuda")
    assert not (tmp_path / "set").exists()


def test_an_unreachable_cluster_is_told_in_one_line(tmp_path, monkeypatch, recwarn):
    """Without what Ray's client has to say about it."""
    import ray

    def no_answer(**_):
        warnings.warn("Ray Client connection timed out.", stacklevel=2)
        raise ConnectionError("ray client connection timeout\nmore")

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", no_answer)
    with pytest.raises(DeviceError, match="no cluster answers there") as error:
        generate(Throwing(), 20, tmp_path / "set", seed=3, cluster="ray://nowhere:10001")
    assert "\n" not in str(error.value) and len(recwarn) == 0


ALONE = """
import os
from gendom.datasets.cluster import on_cluster

def told(job, device):
    import ray  # not before on_cluster does

    return ray.get_runtime_context().gcs_address, os.environ["RAY_AUTH_MODE"]

for _, (address, mode) in on_cluster(told, [range(1)], "local", "cpu"):
    print(address.partition(":")[0], mode)
print("RAY_AUTH_MODE" in os.environ)
"""


@pytest.mark.slow
def test_a_cluster_of_this_machine_is_reached_from_nowhere_else():
    environment = {name: v for name, v in os.environ.items() if not name.startswith("RAY_")}
    words = [sys.executable, "-c", ALONE]
    run = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert run.stdout.split() == ["127.0.0.1", "token", "False"], run.stderr
