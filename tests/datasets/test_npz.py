"""Clouds as NumPy files."""

import numpy as np
import pytest

from gendom.datasets.npz import read_npz_cloud
from gendom.errors import RecordingError

CLOUD = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25]])


@pytest.mark.parametrize(
    ("arrays", "kind"),
    [
        ({"points": CLOUD, "colour": np.zeros((2, 3))}, np.float64),
        ({"colour": np.zeros((2, 3)), "xyz": CLOUD.astype(np.float32)}, np.float32),
        ({"anything": np.arange(6).reshape(2, 3)}, np.float64),
        ({"points": np.zeros((0, 3))}, np.float64),
    ],
)
def test_a_cloud(tmp_path, arrays, kind):
    np.savez(tmp_path / "a.npz", **arrays)
    found = read_npz_cloud(tmp_path / "a.npz")
    expected = arrays.get("points", arrays.get("xyz", arrays.get("anything")))
    assert found.dtype == kind
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"a": CLOUD, "b": CLOUD}, "has the arrays a, b; call the cloud 'points'"),
        ({"points": CLOUD[:, :2]}, r"points is float64 \[2, 2\]; give numbers \[n, 3\] in metres"),
        ({"points": np.array([["a", "b", "c"]])}, r"points is <U1 \[1, 3\]"),
        ({"points": np.array([[None] * 3])}, "holds Python objects .*, which are never loaded"),
        ({}, "has the arrays "),
    ],
)
def test_no_cloud(tmp_path, arrays, said):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(RecordingError, match=said):
        read_npz_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize("kept", [0, 1, 40, 150, -1])
def test_a_cut_file(tmp_path, kept):
    path = tmp_path / "a.npz"
    np.savez(path, points=CLOUD)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(RecordingError, match=r"a\.npz: is (damaged|no \.npz file)"):
        read_npz_cloud(path)
