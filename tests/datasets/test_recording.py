"""gendom-recording/1: nothing is lost, and every fault is told in one line."""

import json
import re
import zipfile
from dataclasses import fields, replace
from importlib import resources

import numpy as np
import pytest

from datasets.test_clouds import archive
from gendom.datasets import Recording
from gendom.datasets.recording_form import ARRAYS
from gendom.errors import RecordingError


def stored(recording, tmp_path):
    """The recording's file as a dict of arrays and its meta as a dict."""
    recording.write(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        arrays = {name: file[name] for name in file.files}
    return arrays, json.loads(arrays.pop("meta").item())


def save(path, arrays, meta):
    np.savez(path, meta=np.array(json.dumps(meta)), **arrays)
    return path


def changed(lift, tmp_path, **changes):
    """The path of a recording whose arrays are passed through functions, and of which others and
    entries of its meta (object__length of its object) are replaced; ... leaves one out."""
    arrays, meta = stored(lift, tmp_path)
    arrays |= changes.pop("arrays", {})
    for name, value in changes.items():
        *outer, name = name.split("__")
        table = arrays if name in ARRAYS and name != "camera_positions" else meta
        table = table["object"] if outer else table
        was = table.pop(name, None)
        if value is not ...:
            table[name] = value(was) if callable(value) else value
    return save(tmp_path / "changed.npz", arrays, meta)


def refusal(path):
    """The lines with which reading is refused, without the path."""
    with pytest.raises(RecordingError) as caught:
        Recording.read(path)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


def equal(a, b):
    """Whether two recordings are alike in everything."""
    for f in fields(Recording):
        own, other = getattr(a, f.name), getattr(b, f.name)
        assert getattr(own, "dtype", None) == getattr(other, "dtype", None)
        np.testing.assert_equal(own, other, err_msg=f.name)
    return True


def test_the_file_keeps_everything_in_the_documented_types(lift, tmp_path):
    arrays, meta = stored(lift, tmp_path)
    assert {name: f"{array.dtype} {array.ndim}" for name, array in arrays.items()} == {
        "points": "float32 2", "offsets": "int64 1", "time": "float64 1",
        "gripper_position": "float64 3", "gripper_axis": "float64 3",
    }  # fmt: skip
    assert meta["format"] == "gendom-recording/1"
    sizes = {"length": 0.4, "diameter": None, "mass": 0.02}
    assert meta["object"] == {"kind": "rope", **sizes, "grasp": "end", "colour": "red"}
    assert equal(lift, Recording.read(tmp_path / "good.npz"))
    # a file keeps which cameras saw a point, and when the gripper was closed: always by default
    assert lift.gripper_closed is None and lift.holds.shape == (5, 1) and lift.holds.all()
    closed = np.array([[True], [True], [True], [False], [False]])
    by = np.where(np.arange(len(lift.points)) % 2, 1, 2).astype(np.uint8)
    seen = replace(lift, seen_by=by, gripper_closed=closed)
    arrays, _ = stored(seen, tmp_path)
    assert arrays["gripper_closed"].dtype == np.bool_ and arrays["seen_by"].dtype == np.uint8
    again = Recording.read(tmp_path / "good.npz", on_warning=lambda _: None)
    assert equal(again, seen) and again.holds.tolist() == closed.tolist()
    few = again.head(4)
    assert len(np.asarray(few.seen_by)) == seen.offsets[4]
    assert few.holds.tolist() == closed[:4].tolist()
    with pytest.raises(RecordingError, match=r"seen_by: has shape \[5\]"):
        replace(seen, seen_by=np.ones(5, dtype=np.uint8))


def test_a_write_that_fails_leaves_the_old_file(lift, tmp_path, monkeypatch):
    def half(file, **_):
        file.write(b"PK")
        raise KeyboardInterrupt

    path = tmp_path / "lift.npz"
    lift.write(path)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"meta\.gain: is nan, which JSON cannot hold"):
        replace(lift, extra={"gain": float("nan")}).write(path)
    with pytest.raises(RecordingError, match=r"name the file \.npz"):
        lift.write(tmp_path / "lift.npy")
    monkeypatch.setattr(np, "savez_compressed", half)
    with pytest.raises(KeyboardInterrupt):
        lift.write(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_frames_and_head(lift):
    np.testing.assert_array_equal(lift.frame(-1), lift.points[-24:])
    with pytest.raises(ValueError, match="read-only"):
        lift.points[0] = 1.0
    head = lift.head(2)
    assert [len(cloud) for cloud in head.frames()] == [20, 21]
    assert head.gripper_position.shape == head.gripper_axis.shape == (2, 1, 3)
    for n in (0, 6):
        with pytest.raises(RecordingError, match="choose 1 to 5"):
            lift.head(n)
    # from frames says which cloud is wrong
    with pytest.raises(RecordingError, match=r"frame 1: has shape \[4, 2\]; give \[n, 3\]"):
        clouds, taken = [np.zeros((4, 3)), np.zeros((4, 2))], {"gripper_position": np.zeros((2, 3))}
        Recording.from_frames(clouds, time=np.arange(2.0), object=lift.object, **taken)


def test_the_digest_tells_recordings_apart(lift, tmp_path):
    """Everything that an estimate depends on counts; the file and notes do not."""
    lift.write(tmp_path / "lift.npz")
    assert Recording.read(tmp_path / "lift.npz").digest == lift.digest
    assert replace(lift, notes="another", source="x", extra={"robot": "y"}).digest == lift.digest
    changed = [
        lift.head(4),
        replace(lift, points=lift.points + np.float32(1e-3)),
        replace(lift, time=2.0 * lift.time),
        replace(lift, gripper_position=lift.gripper_position + 1e-6),
        replace(lift, gripper_axis=None),
        replace(lift, gripper_closed=lift.holds),
        replace(lift, object=replace(lift.object, mass=0.123)),
        replace(lift, table_height=-0.5),
        replace(lift, quasi_static=not lift.quasi_static),
        replace(lift, camera_positions=np.array([[0.0, 1.0, 2.0]])),
    ]
    assert len({recording.digest for recording in [lift, *changed]}) == 11


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "is a bag") for name in ("lift.mcap", "lift.db3", "lift.bag", "a/metadata.yaml")),
        ("a/cameras/left/camera.toml", "holds depth pictures"),
        *((name, "is no recording") for name in ("a.ply", "gripper.csv")),
    ],
)
def test_what_makes_a_recording_is_sent_to_the_command_that_tells(tmp_path, name, kind):
    (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
    (tmp_path / name).write_bytes(b"x")
    path = tmp_path / name.split("/")[0]
    assert refusal(path)[0].startswith(f"{kind}; gendom doctor {path} says what is in it and what")


def test_several_faults_are_several_lines(lift, tmp_path):
    changes = {"object__length": None, "gripper_source": "guessed", "time": lambda a: a[::-1]}
    assert refusal(changed(lift, tmp_path, **changes)) == [
        "object.length: is missing for a rope; measure it and give metres",
        "gripper_source: is 'guessed'; give 'commanded' or 'measured'",
        f"time, frame 1: goes from 0.4 s to 0.3 s; {ORDER}",
    ]


def nan_at(*index):
    def spoil(array):
        array = array.copy()
        array[index] = np.nan
        return array

    return spoil


ORDER = "sort the frames and drop repeated ones; each must be later than the one before"
EMPTY = {"points": lambda a: a[63:], "offsets": lambda _: np.array([0, 0, 0, 0, 23, 47])}
NO_GRIPPER = dict.fromkeys(("gripper_position", "gripper_axis"), lambda a: a[:, :0])
MM, CM = "it looks like millimetres; divide by 1000", "it looks like centimetres; divide by 100"
EITHER = "it looks like centimetres or millimetres; divide by 100 or 1000"
FAR = "points: a frame spans 4.01e+19 m, the object"
FAULTS = [
    ({"points": ...}, "points: is missing; add it: float32 [S, 3]"),
    ({"points": lambda a: a[:, :2]}, "points: has shape [110, 2]; give float32 [S, 3]"),
    ({"points": lambda a: a.astype("U")}, "points: has the type <U32; give float32 [S, 3]"),
    ({"offsets": lambda a: np.maximum(a, 1)}, "offsets: runs from 1 to 110, but there are"),
    ({"offsets": lambda a: a[:-1]}, "offsets: has shape [5]; give [T + 1], which is [6] here"),
    ({"offsets": lambda _: np.array([0, 50, 41, 63, 86, 110])},
     "offsets, frame 1: falls from 50 to 41; let it never decrease"),
    ({"gripper_axis": lambda a: a[:3]}, "gripper_axis: has shape [3, 1, 3]; give [T, G, 3],"),
    (NO_GRIPPER, "gripper_position: has no gripper; give at least one"),
    ({"gripper_closed": np.ones((5, 2), bool)}, "gripper_closed: has shape [5, 2]"),
    ({"gripper_closed": np.zeros((5, 1), bool)}, "gripper_closed, gripper 0: is never closed"),
    ({"points": nan_at(slice(42, 44), 1)}, "points, frame 2: 2 of 22 points are not finite"),
    ({"gripper_position": nan_at(3, 0, 2)}, "gripper_position, frame 3: is not finite in 1 of"),
    ({"time": lambda a: (1.7e9 + a).astype(np.float32)}, "time, frame 1: goes from 1700000000 s "
     "to 1700000000 s; they look like float32, which tells times since 1970 to 2 minutes only"),
    ({"gripper_axis": lambda a: 0.5 * a}, "gripper_axis, frame 0: has length 0.5, not 1"),
    ({"time": lambda a: a[[0, 1, 1, 3, 4]]}, f"time, frame 2: goes from 0.1 s to 0.1 s; {ORDER}"),
    ({"gripper_position": lambda a: a + np.eye(3)[0]}, "gripper_position, gripper 0: never"),
    ({"points": lambda a: 1e3 * a}, f"points: a frame spans 401 m, the object 0.4 m; {MM}"),
    ({"points": lambda a: 100.0 * a}, f"points: a frame spans 40.1 m, the object 0.4 m; {CM}"),
    ({"points": lambda a: 1e20 * a}, f"{FAR} 0.4 m; it is as large in no unit; look for numbers"),
    ({"time": lambda a: 1e3 * a},
     "time: frames are 100 s apart; it looks like milliseconds; divide by 1000"),
    ({"time": lambda a: 1e6 * a},
     "time: frames are 1e+05 s apart; it looks like microseconds; divide by 1e+06"),
    ({"time": lambda a: 1e9 * a},
     "time: frames are 1e+08 s apart; it looks like nanoseconds; divide by 1e+09"),
    ({"gripper_position": lambda a: 1e3 * a}, f"gripper_position: moves by 40 m; {EITHER}"),
    ({"points": lambda a: a[:0], "offsets": lambda a: 0 * a},
     "points: all frames are empty; check the cropping and the depth range"),
    (EMPTY, "points, frame 0: the first 3 frames are empty, so the start is not seen; cut them "
     "off, or record from before the lift"),
    ({"points": lambda a: np.where(np.arange(110)[:, None] < 20, 1e3, 1) * a},
     "points, frame 0: spans 3"),
    ({"ordered_markers": True}, "points, frame 1: has 21 ordered markers, the first frame 20"),
    # what is said beside them
    ({"format": "gendom-recording/9"}, "meta.format: is 'gendom-recording/9'; only 'gendom-reco"),
    ({"object": ...}, "object: object missing required field kind; give kind, sizes"),
    ({"table_height": ...}, "meta.table_height: is missing"),
    ({"quasi_static": ...}, "meta.quasi_static: is missing; give true or false"),
    ({"quasi_static": "yes"}, "quasi_static: expected bool, got str; give true or false"),
    ({"table_height": "low"}, "table_height: expected float | null, got str; give z of"),
    ({"object__kind": "sponge"}, "object.kind: is 'sponge'; give 'rope' or 'cloth'"),
    ({"object__grasp": "middle"}, "object.grasp: is 'middle'"),
    ({"object__kind": "cloth", "object__width": 0.3}, "object.height: is missing for a cloth"),
    ({"object__outline": [[0, 0], [1, 0], [0, 1]]}, "object.outline: is not supported:"),
    ({"object__diameter": -0.01}, "object.diameter: is -0.01"),
    ({"object__grasp_radius": 0.0}, "object.grasp_radius: is 0.0"),
    ({"object__diameter": 0.012, "object__diameter_sd": 0.5},
     "object.diameter_sd: is 0.5, more than the diameter, 0.012"),
    ({"camera_positions": [[0.0, 0.0, 1.0]], "seen_by": np.full(110, 2, dtype=np.uint8)},
     "seen_by: names camera 1; camera_positions has 1 rows"),
    ({"object__mass": "20 g"}, "object.mass: expected float | null, got str; give kind"),
    ({"object__length": 400.0}, f"object.length: the object spans 400 m, a frame 0.401 m; {MM}"),
    ({"object__length": 4e-4}, "points: a frame spans 0.401 m, the object 0.0004 m"),
    ({"object__diameter": 1.0}, f"object.diameter: is 1 m, the object spans 0.4 m; {EITHER}"),
    ({"object__mass": 31.0, "object__diameter": 0.01}, "object.mass: is 31 kg, a density of "
     "9.9e+05 kg/m^3; it looks like grams; divide by 1000"),
    ({"table_height": -10.0}, f"table_height: is -10 m, the lowest point at -0.001308 m; {EITHER}"),
    ({"camera_positions": [[100.0, -800.0, 600.0]]},
     f"camera_positions: a camera is 1005 m away; {MM}"),
    ({"camera_positions": [1.0, 2.0]}, "camera_positions: has shape [2]; give float64"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "line"), FAULTS, ids=[line for _, line in FAULTS])
def test_a_fault_is_one_line(lift, tmp_path, changes, line):
    (told,) = refusal(changed(lift, tmp_path, **changes))
    assert told.startswith(line) and "; " in told


def test_misspelt_keys_are_named(lift, tmp_path):
    """Others that nothing reads are kept."""
    changes = {"object__length": ..., "object__lenght": 0.4, "object__colour": "red", "batch": 1}
    lines = refusal(changed(lift, tmp_path, table_height=..., table_hight=0.0, **changes))
    for where, right in (("object.lenght", "length"), ("table_hight", "table_height")):
        assert f"{where}: is read by nothing; did you mean '{right}'?" in lines
    assert not [line for line in lines if "colour" in line or "batch" in line]


AWAY = {"gripper_position": lambda a: a + 0.8 * (np.arange(5) == 4)[:, None, None] * np.eye(3)[0]}
FAR = {"points": lambda a: a + 2.0 * np.eye(3, dtype=np.float32)[0]}
FIRST = {name: lambda a: a[:1] for name in ("time", "gripper_position", "gripper_axis")}
FIRST |= {"points": lambda a: a[:20], "offsets": lambda a: a[:2]}
NINE_MS = {"time": lambda a: 90.0 * a, "gripper_position": lambda a: a * [1.0, 1.0, 0.3]}


def closed(*states):
    return {"gripper_closed": np.array(states, dtype=bool)[:, None]}


WARNED = [
    ({"arrays": {"colour": np.zeros(2)}}, ["colour: is read by nothing; docs/recordings.md says"]),
    ({"arrays": {"griper_closed": np.ones((5, 1)), "of_mine": np.zeros(2)}},
     ["griper_closed, of_mine: are read by nothing; did you mean 'gripper_closed'[?]$"]),
    (FIRST, ["frames: 1 with points; record a whole lift", ""]),
    ({"object__length": 4.0}, ["object.length: .*is it 0.4 m?"]),
    (NINE_MS, ["time: .*times look like milliseconds"]),
    ({"time": lambda a: a + 9.0 * (a > 0.25)}, ["time, frame 2: 9.1 s pass"]),
    ({"object__diameter": 0.08}, ["object.mass: .*sizes in metres"]),
    ({**FAR, "cameras_calibrated": False}, []),
    (AWAY, ["gripper_position, gripper 0: is farther than 0.15 m from the object in 1 of 5 frames, "
            "first in frame 4; check that the object did not slip out"]),
    (AWAY | closed(1, 1, 1, 1, 0), []),
    (closed(0, 0, 1, 1, 0), ["gripper_closed, gripper 0: is open until frame 2; "]),
    ({"gripper_position": lambda a: a[[0] * 5]}, ["gripper_position: moves by 0 m in all; record"]),
    ({"points": lambda a: a * np.array([2, 1, 1], np.float32), "offsets": lambda a: a * (a > 20)},
     ["points: 1 of 5 frames are empty .0.; nothing need be done: they are skipped",
      "points: a frame spans 0.80. m, the object only 0.4 m; check the sizes, and that robot an"]),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), WARNED, ids=[" ".join(said) for _, said in WARNED])
def test_warnings_do_not_prevent_reading(lift, tmp_path, caplog, changes, said):
    """They are logged if nobody takes them."""
    path, faults = changed(lift, tmp_path, **changes), []
    recording = Recording.read(path, on_warning=faults.append)
    assert len(faults) == len(said) and all(map(re.match, said, map(str, faults))), faults
    empty = np.diff(recording.offsets) == 0
    assert recording.frame_valid.tolist() == (~empty).tolist()
    Recording.read(path)
    assert len(caplog.records) == len(faults)


UPS = {"z": "xyz", "y": "xzY", "-y": "xZy", "x": "zxy", "-x": "Zyx"}
"""Axes of a recording whose other axis is up, as those of ours; capitals: the other way."""


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("height", [None, 0.0])
def test_another_axis_that_points_up_is_named(up, height):
    """Of the shipped lift, and the cure is right. On a table it may have been dragged there."""

    turn = np.stack([np.eye(3)["xyz".index(a.lower())] * (-1) ** a.isupper() for a in UPS[up]], 1)
    lift = Recording.read(str(resources.files("gendom") / "assets/demo-rope-lift.npz"))
    of = {n: getattr(lift, n) @ turn for n in ("points", "gripper_position")}
    faults = replace(lift, **of, gripper_axis=None, table_height=height).validate()
    found = [fault for fault in faults if "rises along" in fault.what]
    if up == "z":
        assert not found
        return
    assert len(found) == 1 and f"rises along {up}," in found[0].what
    assert found[0].severity == "error" or height is not None
    formula = found[0].fix.removeprefix("give z up: ").partition(" in place")[0]
    x, y, z = np.moveaxis(of["points"], -1, 0)
    cured = np.stack([eval(part, {"x": x, "y": y, "z": z}) for part in formula.split(", ")], -1)
    right_handed = np.linalg.det(np.linalg.lstsq(of["points"], cured)[0]) > 0
    assert np.ptp(cured[:400, 2]) < 0.1 and right_handed


def test_times_that_count_frames_are_told(lift):
    """Of a motion in which time matters."""
    rise = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 0.1], 12)
    clouds, grip = [lift.frame(0) + up for up in rise], rise + np.array([0.4, 0.0, 0.0])
    slow = Recording.from_frames(
        clouds, time=np.arange(12), gripper_position=grip, object=lift.object, table_height=0.0
    )
    assert "frame numbers" in str(slow.validate()[0])
    assert replace(slow, quasi_static=True).validate() == []
    assert replace(slow, time=0.9 * slow.time).validate() == []


def test_files_that_are_no_recordings(lift, tmp_path):
    lift.write(tmp_path / "good.npz")
    whole, path = (tmp_path / "good.npz").read_bytes(), tmp_path / "bad.npz"
    no_text = "meta: is missing, or no JSON text; gendom.Recording.from_frames(...).write makes"
    for data, said in (
        (whole[: len(whole) // 2], "is damaged ("),
        (b"", "is no .npz file; write gendom-recording/1 with numpy.savez"),
        (archive(points=np.zeros((1, 3))), no_text),
        (archive(meta=np.array(["{}", "{}"])), no_text),
        (archive(meta=np.array(3)), no_text),
        (archive(meta=np.array("{")), "meta: is not JSON"),
        (archive(meta=np.array("[]")), "meta: holds a JSON list, not an object"),
    ):
        path.write_bytes(data)
        assert refusal(path)[0].startswith(said)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "w") as twice:
        for name in ("time.npy", "meta.npy", "time.npy"):
            twice.writestr(name, b"")
    assert refusal(path) == ["has time.npy twice; write it with numpy.savez"]
    with zipfile.ZipFile(path, "w") as text:
        text.writestr("meta", b"{}")
    assert refusal(path) == ["meta is no array; write gendom-recording/1 with numpy.savez"]
    assert refusal(tmp_path / "absent.npz") == ["no such file; check the path"]


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_clouds_in_another_order_are_refused(lift, order):
    """A rope that is lifted off at one end, by its length."""
    rise = np.linspace(0.0, 0.4, 20)
    clouds = [np.linspace([h, 0.0, h], [0.4, 0.0, 0.0], 30) for h in rise]
    grip = np.stack([rise, 0.0 * rise, rise], axis=1)
    taken = {"time": 0.1 * np.arange(20), "gripper_position": grip, "object": lift.object}
    assert Recording.from_frames(clouds, **taken).validate() == []
    places = np.random.default_rng(0).permutation(20) if order == "shuffled" else range(20)[::-1]
    fault = Recording.from_frames([clouds[k] for k in places], **taken).validate()[0]
    assert fault.severity == "error" and "lie at its place of another time" in str(fault)
