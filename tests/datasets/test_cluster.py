"""Sets on a Ray cluster: what our code does with a stub of it, and, slowly, a real one."""

import os
import subprocess
import sys
import warnings
from types import SimpleNamespace

import pytest

from gendom.datasets.demonstrations import generate
from gendom.errors import DeviceError, ParameterError
from throwing import Throwing

SIZE = 3 * max(16, 2 * (os.cpu_count() or 1)) + 5


class TaskError(Exception):
    """As Ray's: what a job raised, in another process."""

    cause: Exception


class ClusterError(Exception):
    """As Ray's: of the cluster itself."""


class Ray(SimpleNamespace):
    """A cluster of no processes, whose jobs finish in reverse order."""

    exceptions = SimpleNamespace(RayTaskError=TaskError, RayError=ClusterError)

    def __init__(self):
        by_value = SimpleNamespace(register_pickle_by_value=lambda m: self.log.append(m.__name__))
        super().__init__(log=[], cloudpickle=by_value, fault=None, asked={}, at_start={})

    def is_initialized(self):
        return False

    def init(self, **asked):
        self.asked, self.at_start = asked, dict(os.environ)
        if self.fault is not None:
            warnings.warn("Ray Client connection timed out.", stacklevel=2)
            raise self.fault

    def cluster_resources(self):
        return {"CPU": 2.0}

    def put(self, value):
        return value

    def remote(self, **needs):
        self.log.append(needs)
        return lambda work: SimpleNamespace(remote=lambda *words: (work, words))

    def wait(self, waiting):
        return waiting[-1:], waiting[:-1]

    def get(self, task):
        work, words = task
        try:
            return work(*words)
        except ClusterError:
            raise
        except Exception as cause:
            error = TaskError("Traceback")
            error.cause = cause
            raise error from None

    def cancel(self, task, force):
        self.log.append("cancelled")

    def shutdown(self):
        self.log.append("ended")


@pytest.fixture
def ray(monkeypatch):
    stub = Ray()
    monkeypatch.setitem(sys.modules, "ray", stub)
    return stub


def test_a_cluster_gives_the_rows_of_one_machine(tmp_path, ray):
    """One of this machine is started where nobody else reaches it, and ended."""
    alone = generate(Throwing(), SIZE, tmp_path / "one", seed=3, shard_size=24)
    shared = generate(Throwing(), SIZE, tmp_path / "two", seed=3, shard_size=24, cluster="local")
    assert shared.equals(alone)
    for shard in (tmp_path / "one").glob("*.parquet"):
        assert (tmp_path / "two" / shard.name).read_bytes() == shard.read_bytes()
    assert ray.log == [Throwing.__module__, {"max_retries": 5, "num_cpus": 1}, "ended"]
    assert "address" not in ray.asked
    assert ray.at_start["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] == "0"
    assert ray.at_start["RAY_AUTH_MODE"] == "token" and len(ray.at_start["RAY_AUTH_TOKEN"]) == 64
    assert not {"RAY_AUTH_MODE", "RAY_AUTH_TOKEN"} & set(os.environ)
    generate(Throwing(), 3, tmp_path / "three", seed=3, cluster="auto")
    assert ray.asked["address"] == "auto" and "RAY_AUTH_TOKEN" not in ray.at_start


@pytest.mark.parametrize(
    ("fault", "device", "error", "says"),
    [
        (ParameterError, "cpu", ParameterError, "^the ball is flat$"),
        (ClusterError, "cpu", DeviceError, r"a job was lost 6 times \(the ball is flat\); look at"),
        (ZeroDivisionError, "cpu", TaskError, "Traceback"),
        (None, "cuda", DeviceError, "--cluster local: the cluster has no GPU"),
    ],
)
def test_faults_end_all_jobs(tmp_path, ray, fault, device, error, says):
    options = {"seed": 3, "shard_size": 24, "cluster": "local", "device": device}
    with pytest.raises(error, match=says):
        generate(Throwing(fault=fault), SIZE, tmp_path / "set", **options)
    assert ray.log.count("cancelled") >= 3 * (device == "cpu") and ray.log[-1] == "ended"
    assert not (tmp_path / "set").exists()


def test_an_unreachable_cluster_is_told_in_one_line(tmp_path, ray, recwarn):
    """Without what Ray's client has to say about it."""
    ray.fault = ConnectionError("ray client connection timeout\nmore")
    with pytest.raises(DeviceError, match="no cluster answers there") as told:
        generate(Throwing(), 20, tmp_path / "set", seed=3, cluster="ray://nowhere:10001")
    assert "\n" not in str(told.value) and len(recwarn) == 0


# ---- a real one ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_faults_come_home(tmp_path):
    real = pytest.importorskip("ray", reason="needs the extra cluster")
    real.init(num_cpus=2, num_gpus=0, include_dashboard=False, log_to_driver=False)
    try:
        alone = generate(Throwing(), SIZE, tmp_path / "one", seed=3)
        source = Throwing(dies_once=str(tmp_path / "died"))
        shared = generate(source, SIZE, tmp_path / "two", seed=3, cluster="local")
        assert (tmp_path / "died").exists() and shared.equals(alone)
        with pytest.raises(ParameterError, match=r"^the ball is flat$"):
            flat = Throwing(fault=ParameterError)
            generate(flat, 20, tmp_path / "set", seed=3, cluster="local")
    finally:
        real.shutdown()


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
    pytest.importorskip("ray", reason="needs the extra cluster")
    environment = {name: v for name, v in os.environ.items() if not name.startswith("RAY_")}
    words = [sys.executable, "-c", ALONE]
    run = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert run.stdout.split() == ["127.0.0.1", "token", "False"], run.stderr
