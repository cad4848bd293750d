"""Sets on a Ray cluster of this machine."""

import os
import subprocess
import sys

import pytest

from gendom.datasets.demonstrations import generate
from gendom.errors import DeviceError, ParameterError
from throwing import Throwing

SIZE = 3 * max(16, 2 * (os.cpu_count() or 1)) + 5


@pytest.fixture(scope="module")
def ray():
    """A cluster of two processes without a GPU."""
    real = pytest.importorskip("ray", reason="needs the extra cluster")
    real.init(num_cpus=2, num_gpus=0, include_dashboard=False, log_to_driver=False)
    yield real
    real.shutdown()


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(tmp_path, ray):
    """The rows are those of one machine."""
    alone = generate(Throwing(), SIZE, tmp_path / "one", seed=3, shard_size=24)
    source = Throwing(dies_once=str(tmp_path / "died"))
    shared = generate(source, SIZE, tmp_path / "two", seed=3, shard_size=24, cluster="local")
    assert (tmp_path / "died").exists() and shared.equals(alone)
    for shard in (tmp_path / "one").glob("*.parquet"):
        assert (tmp_path / "two" / shard.name).read_bytes() == shard.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "device", "error", "says"),
    [
        (ParameterError, "cpu", ParameterError, "^the ball is flat$"),
        (ZeroDivisionError, "cpu", Exception, "the ball is flat"),
        (None, "cuda", DeviceError, "--cluster local: the cluster has no GPU"),
    ],
)
def test_faults_come_home_and_leave_nothing(tmp_path, ray, fault, device, error, says):
    with pytest.raises(error, match=says):
        source = Throwing(fault=fault)
        generate(source, 20, tmp_path / "set", seed=3, cluster="local", device=device)
    assert not (tmp_path / "set").exists()


def test_an_unreachable_cluster_is_told_in_one_line(tmp_path, monkeypatch):
    """Without what Ray's client has to say about it."""
    real = pytest.importorskip("ray", reason="needs the extra cluster")

    def init(**_):
        raise ConnectionError("ray client connection timeout\nmore")

    for name, value in (("init", init), ("is_initialized", lambda: False)):
        monkeypatch.setattr(real, name, value)
    with pytest.raises(DeviceError, match=r"^.*no cluster answers there.*$"):
        generate(Throwing(), 20, tmp_path / "set", seed=3, cluster="ray://nowhere:10001")


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
    """It listens on its own address alone, and asks for a token."""
    pytest.importorskip("ray", reason="needs the extra cluster")
    environment = {name: v for name, v in os.environ.items() if not name.startswith("RAY_")}
    words = [sys.executable, "-c", ALONE]
    run = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert run.stdout.split() == ["127.0.0.1", "token", "False"], run.stderr
