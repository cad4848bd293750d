"""What is read from a set of demonstrations."""

from dataclasses import dataclass

import numpy as np
import pytest

from gendom.datasets.demonstrations import generate
from gendom.errors import DatasetError
from gendom.files import read_json, write_json
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import Outcomes, RopeReaching


@dataclass(frozen=True, kw_only=True)
class Quick(RopeReaching):
    """Reaches as far as the release is away from 2 L; every fifth fails."""

    def demonstrate(self, draws, *, device="cpu", dtype="float32", on_frame=None):
        goal = np.array([2.0 * self.length - d["release_x"] for d in draws])
        goal[::5] = np.nan
        faults = tuple("it burst" if bad else None for bad in np.isnan(goal))
        return Outcomes(columns={"goal_x": goal}, faults=faults)


@pytest.fixture
def folder(tmp_path):
    generate(Quick(length=0.5, diameter=0.02), 50, tmp_path / "set", seed=2, shard_size=10)
    return tmp_path / "set"


def test_read_gives_rope_lengths_and_leaves_failures_out(folder):
    data = Demonstrations.read(folder)
    assert len(data) == 40
    assert data.action.shape == (40, 2)
    assert data.goal == pytest.approx(2.0 - data.action[:, 0])
    assert data.action_names == ("release_x", "release_z")
    assert data.task["length"] == 0.5
    assert data.task["name"] == "rope-reaching"
    low, high = Quick(length=0.5, diameter=0.02).parameter_ranges["specific_modulus"]
    assert low <= data.specific_modulus.min() < data.specific_modulus.max() <= high


def test_missing_set_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="no such folder"):
        Demonstrations.read(tmp_path / "none")


def test_goals_of_two_numbers_are_refused(folder):
    path = folder / "dataset.json"
    about = read_json(path)
    write_json(path, about | {"goal_names": ["x", "z"]})
    with pytest.raises(DatasetError):
        Demonstrations.read(folder)
