"""Clouds as NumPy files."""

import zipfile

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


def test_pixels_that_saw_nothing_are_left_out(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.array([[1.0, 2.0, 3.0], [np.nan] * 3]))
    assert read_npz_cloud(tmp_path / "a.npz").tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize("shape", [(10**8, 3), (2**33, 3)], ids=["gigabyte", "huge"])
def test_a_file_that_unpacks_to_gigabytes(tmp_path, shape):
    """Members that are, and members that say they are."""
    path = tmp_path / "a.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("points.npy", "w", force_zip64=True) as member,
    ):
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(300 if shape[0] == 10**8 else 1):
            member.write(bytes(1 << 20))
    with pytest.raises(RecordingError, match=r"unpacks to|is damaged"):
        read_npz_cloud(path)


def test_an_index_without_end(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for k in range(3000):
            archive.writestr(f"{k}.npy", b"")
    with pytest.raises(RecordingError, match="has an index of"):
        read_npz_cloud(tmp_path / "a.npz")
