"""NumPy's files: clouds, recordings and shapes at rest; no pickles, no bombs."""

import io
import json
import os
import zipfile

import numpy as np
import pytest

from datasets.test_clouds import refusal
from gendom import reading
from gendom.datasets import Recording
from gendom.datasets.npz import read_npz, read_npz_cloud, short
from gendom.errors import RecordingError

CLOUD = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25], [4.0, 5.0, 6.0]])
NOTHING, OTHER = np.zeros((2, 3)), np.zeros((1, 3))


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"points": CLOUD, "colour": NOTHING}, CLOUD),
        ({"xyz": NOTHING, "points": CLOUD}, CLOUD),
        ({"colour": NOTHING, "xyz": CLOUD.astype(np.float32)}, CLOUD.astype(np.float32)),
        ({"anything": np.arange(6, dtype=np.int16).reshape(2, 3)}, np.arange(6.0).reshape(2, 3)),
        ({"points": np.array([*CLOUD, [np.nan] * 3])}, CLOUD),
        ({"points": np.zeros((0, 3))}, np.zeros((0, 3))),
        ({"points": np.tile(CLOUD, (2, 1, 1))}, np.tile(CLOUD, (2, 1))),  # pixel by pixel
    ],
)
def test_clouds(tmp_path, arrays, expected):
    found = read_npz_cloud(saved(tmp_path / "a.npz", **arrays))
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


def packed(shape, written):
    """A zip file of one array that says it has a shape, and has so many bytes."""
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(member := io.BytesIO(), header)
    return zipped({"points.npy": member.getvalue() + bytes(written)})


def archive(**arrays):
    np.savez(file := io.BytesIO(), allow_pickle=True, **arrays)
    return file.getvalue()


def zipped(members):
    with zipfile.ZipFile(file := io.BytesIO(), "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        for name, content in members.items():
            made.writestr(name, content)
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"PQ", "is no .npz file; write it with numpy.savez"),
        (b"QK", "is no .npz file"),
        (b"PK", "is damaged ("),
        (archive(a=OTHER, b=OTHER), "has the arrays a, b; call the cloud 'points'"),
        (archive(), "has the arrays "),
        (archive(points=np.zeros((2, 4))), "points is float64 [2, 4]; give numbers [n, 3] in met"),
        (archive(points=np.zeros(3)), "points is float64 [3]; give"),
        (archive(points=np.zeros((2, 2, 2))), "points is float64 [2, 2, 2]; give"),
        (archive(points=np.zeros((1, 3), complex)), "points is complex128 [1, 3]; give"),
        (archive(points=np.array([["a", "b", "c"]])), "points is <U1 [1, 3]; give"),
        (archive(points=np.array([[None] * 3])),
         "holds Python objects (pickles), which are never loaded; write its arrays as numbers"),
        (packed((10**6, 3), 12 * 10**6), "unpacks to 12"),
        (packed((2**33, 3), 1 << 20), "is damaged"),
        (zipped({f"{k}.npy": b"" for k in range(3000)}), "has an index of "),
    ],
)  # fmt: skip
def test_what_is_no_cloud(tmp_path, data, said, monkeypatch):
    assert reading.LARGEST_FILE == 1 << 28
    monkeypatch.setattr(reading, "LARGEST_FILE", 1 << 22)
    assert refusal(read_npz_cloud, tmp_path / "a.npz", data).startswith(said)


def test_bounds(tmp_path):
    """Of a file, which need not be written to be tried, and of the text in it."""
    path = tmp_path / "a.npz"
    path.write_bytes(b"")
    for size, said in ((1 << 31, "is no .npz file"), ((1 << 31) + 1, "most 2147483648 are read")):
        os.truncate(path, size)
        with pytest.raises(RecordingError, match=said):
            read_npz_cloud(path)
    for size, said in ((1 << 23, "meta.format: is None"), ((1 << 23) + 1, "or no JSON text")):
        with pytest.raises(RecordingError, match=said):
            read_npz(saved(path, meta=np.array("{}".ljust(size))))
    assert short(ValueError("a" * 130 + "\nb")) == "a" * 120 and short(KeyError()) == "KeyError"


# ---- shapes at rest ------------------------------------------------------------------------------

WIRE = {"kind": "wire", "length": 0.5, "mass_per_length": 0.02, "diameter": 0.01}
LOOPS = np.arange(2 * 5 * 3).reshape(2, 5, 3) ** 2.0


def at_rest(path, loops=LOOPS, **changes):
    """A file of shapes; what is None is left out."""
    told = {name: value for name, value in {**WIRE, **changes}.items() if value is not None}
    meta = {"format": "gendom-static/1", "object": told, "source": "here"}
    return saved(path, loops=loops, meta=json.dumps(meta))


def test_a_shape_at_rest_becomes_a_recording(tmp_path):
    """Held at both ends, where the repeats are in the mean, along their first and last piece."""
    arrays, meta = read_npz(at_rest(tmp_path / "a.npz"))
    ends, inner = LOOPS[:, [0, 4]].mean(axis=0), LOOPS[:, [1, 3]].mean(axis=0)
    axes = (inner - ends) / np.linalg.norm(inner - ends, axis=1)[:, None]
    wanted = {"points": LOOPS.reshape(10, 3), "offsets": [0, 5, 10], "time": [0, 1],
              "gripper_position": [ends, ends], "gripper_axis": [axes, axes]}  # fmt: skip
    assert arrays.keys() == wanted.keys() and arrays["points"].dtype == np.float32
    for name, values in wanted.items():
        np.testing.assert_allclose(arrays[name], values, rtol=1e-6)
    assert meta == {
        "table_height": None, "gripper_source": "measured", "quasi_static": True, "static": True,
        "ordered_markers": True, "format": "gendom-recording/1", "source": "here",
        "object": {**WIRE, "kind": "rope", "grasp": "both ends", "mass": 0.01},
    }  # fmt: skip
    angle = np.linspace(0.0, np.pi, 21)
    line = 0.16 * np.stack([-np.cos(angle), 0.0 * angle, -np.sin(angle)], axis=1)
    path = at_rest(tmp_path / "b.npz", np.stack([line, line + np.array([1e-3, 0.0, 0.0])]))
    found = Recording.read(path, on_warning=lambda _: None)
    assert (found.num_frames, found.num_grippers, found.quasi_static) == (2, 2, True)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        *(({"loops": of}, "loops: has shape .*, or numbers that are not finite; give .* 5 or more")
          for of in (LOOPS[:, :4], LOOPS[0], LOOPS[..., :2], LOOPS.astype(str),
                     np.where(LOOPS > 9.0, np.nan, LOOPS))),
        *(({name: value}, f"object.{name}: is {value}; give a number above 0, in SI")
          for name in ("length", "mass_per_length") for value in (0.0, -1.0)),
        ({"kind": "cloth"}, "object: kind: invalid enum value 'cloth'"),
        ({"mass_per_length": "much"}, "object: mass_per_length: expected float"),
        ({"mass_per_length": None}, "object: object missing required field mass_per_length"),
    ],
)  # fmt: skip
def test_what_is_no_shape_is_refused(tmp_path, changes, said):
    with pytest.raises(RecordingError, match=said):
        Recording.read(at_rest(tmp_path / "bad.npz", **changes))
