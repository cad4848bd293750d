"""Recordings kept as folders of clouds."""

from contextlib import nullcontext

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.datasets.folder import check_named, in_order, read_gripper
from gendom.errors import RecordingError


def write_ply(path, points, *, text=False):
    """Points [n, 3] as PLY: binary little endian, or exact text."""
    name, code = ("double", "<f8") if points.dtype == np.float64 else ("float", "<f4")
    lines = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0"]
    lines += [f"element vertex {len(points)}", *(f"property {name} {axis}" for axis in "xyz")]
    head = "\n".join([*lines, "end_header", ""])
    rows = "".join(" ".join(map(str, point)) + "\n" for point in points.astype(code))
    path.write_bytes(head.encode() + (rows.encode() if text else points.astype(code).tobytes()))


@pytest.fixture
def folder(lift, tmp_path):
    """The lift as a folder, with file names whose natural order is not the alphabetical one."""
    folder = tmp_path / "take"
    folder.mkdir()
    for t in range(5):
        write_ply(folder / f"frame_{8 + t}.ply", lift.frame(t))
    rows = np.column_stack([lift.time, lift.gripper_position[:, 0], lift.gripper_axis[:, 0]])
    form: dict = {"fmt": "%.17g", "delimiter": ",", "header": "time,x,y,z,ax,ay,az", "comments": ""}
    np.savetxt(folder / "gripper.csv", rows, **form)
    (folder / "object.toml").write_text(
        'table_height = 0.0\noperator = "nobody"\n'
        '[object]\nkind = "rope"\nlength = 0.4\nmass = 0.02\ngrasp = "end"\n'
    )
    return folder


def test_folder_equals_the_recording(lift, folder):
    recording = Recording.read(folder)
    for name in ("points", "offsets", "time", "gripper_position", "gripper_axis"):
        np.testing.assert_array_equal(getattr(recording, name), getattr(lift, name))
    assert (recording.object.length, recording.object.mass) == (0.4, 0.02)
    assert recording.table_height == 0.0 and not recording.quasi_static
    assert recording.extra == {"operator": "nobody"}
    # recordings among the clouds are left alone
    lift.write(folder / "recording.npz")
    assert Recording.read(folder).num_frames == 5
    # keys below the table that belong beside it count too, and are not those of the object
    object_ = '[object]\nkind = "rope"\nlength = 0.4\n'
    more = 'table_height = -0.1\nquasi_static = true\nnotes = "b"\nsource = "c"\ngrasp = "end"'
    (folder / "object.toml").write_text(f'notes = "a"\n{object_}{more}')
    recording = Recording.read(folder)
    assert recording.table_height == -0.1 and recording.quasi_static
    assert (recording.notes, recording.source) == ("a", "c")
    assert recording.object.extra == {"notes": "b"} and recording.object.grasp == "end"
    # missing table height is a warning
    (folder / "object.toml").write_text(object_)
    faults = []
    assert Recording.read(folder, on_warning=faults.append).table_height is None
    assert [fault.where for fault in faults] == ["table_height"]


def as_pcd(path, cloud):
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS {len(cloud)}\nDATA binary\n"
    path.write_bytes(head.encode() + cloud.astype("<f4").tobytes())


@pytest.mark.parametrize(("suffix", "write"), [(".pcd", as_pcd), (".npz", np.savez)])
def test_clouds_in_other_formats(lift, folder, suffix, write):
    for t in range(5):
        (folder / f"frame_{8 + t}.ply").unlink()
        write(folder / f"frame_{8 + t}{suffix}", lift.frame(t))
    np.testing.assert_array_equal(Recording.read(folder).points, lift.points)
    path = folder / f"frame_9{suffix}"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(RecordingError, match=f"^{path}: is "):
        Recording.read(folder)


def test_columns_of_grippers_in_any_order(tmp_path):
    path = tmp_path / "gripper.csv"
    names = "closed1,z1,y1,x1,az1,ay1,ax1,time,x0,y0,z0,ax0,ay0,az0,closed0"
    path.write_text(f"{names}\n0,13,12,11,16,15,14,0.5,1,2,3,4,5,6,1\n")
    assert {name: value.tolist() for name, value in read_gripper(path).items()} == {
        "time": [0.5], "gripper_position": [[[1, 2, 3], [11, 12, 13]]],
        "gripper_axis": [[[4, 5, 6], [14, 15, 16]]], "gripper_closed": [[True, False]],
    }  # fmt: skip
    path.write_text("time,x,y,z\n0,1,2,3\n")
    assert read_gripper(path).keys() == {"time", "gripper_position"}


def rewrite(name, old, new):
    def spoil(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return spoil


def header(names, *rows):
    """A path of these rows, or of zeros, under other names."""
    rows = rows or (",".join("0" for _ in names.split(",")),)
    return lambda folder: (folder / "gripper.csv").write_text("\n".join([names, *rows]))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: [p.unlink() for p in f.glob("*.ply")],
         ": holds no .ply, .pcd, .npz file; put one point cloud a frame there"),
        (lambda f: [p.rename(p.with_suffix(".ply.gz")) for p in f.glob("*.ply")],
         ": holds no .ply, .pcd, .npz file; make such files of its 5 .ply.gz files"),
        (lambda f: (f / "frame_13.pcd").write_bytes(b""),
         ": holds 5 .ply and 1 .pcd files; keep those of one kind"),
        (lambda f: (f / "frame_9.ply").unlink(),
         ": 4 .ply files but 5 rows in gripper.csv; give one row a frame"),
        (lambda f: (f / "gripper.csv").unlink(),
         "/gripper.csv: no such file; write one row a frame under time,x,y,z"),
        (lambda f: (f / "object.toml").unlink(), "/object.toml: no such file; "),
        (rewrite("object.toml", "length = 0.4", ""),
         ": object.length: is missing for a rope; measure it and give metres"),
        (rewrite("gripper.csv", "time", "seconds"),
         "/gripper.csv: the header lacks 'time'; use time,x,y,z[,ax,ay,az][,closed], or"),
        (rewrite("gripper.csv", "ax,ay,az", "force,,torque"),
         "/gripper.csv: the header has unknown 'force', '', 'torque'; "),
        (header("time,x,y"), "/gripper.csv: the header lacks 'z'"),
        (header("time,x,y,z,z"), "/gripper.csv: the header repeats 'z'"),
        (header("time,x,y,z,ax"), "/gripper.csv: the header lacks 'ay', 'az'"),
        (header("time,x0,y0,z0,x1,y1,z1,closed0"),
         "/gripper.csv: the header lacks 'closed1'; use time,x,y,z[,ax,ay,az][,closed], or"),
        (header("time,x,y,z,closed", "0,0,0,0,1", "1,0,0,0,0.5"), "/gripper.csv, line 3, column "
         "closed: is '0.5'; give 1 where the gripper is closed, 0 where it is open"),
        (lambda f: (f / "frame_10.ply").write_bytes(b"no"), "/frame_10.ply: is not a PLY file"),
    ],
)  # fmt: skip
def test_bad_folders(folder, spoil, message):
    spoil(folder)
    with pytest.raises(RecordingError) as caught:
        Recording.read(folder)
    assert str(caught.value).startswith(f"{folder}{message}")
    assert "\n" not in str(caught.value)


NAMES = {
    "seconds": (0.066667, lambda t: str(round(1700000000.0 + t, 6))),
    "seconds from the start": (1.25e-5, lambda t: str(round(t, 9))),
    "before and after": (0.5, lambda t: f"frame_{t - 3.0}"),
    "negative numbers": (0.1, lambda t: f"{round(t / 0.1) - 7}"),
    "nanoseconds": (0.066667, lambda t: f"cloud-{1700000000000000000 + round(1e9 * t)}"),
    "seconds and nanoseconds": (0.066667, lambda t: f"{17 + int(t)}_{round(1e9 * (t % 1.0))}"),
    "seconds.nanoseconds": (0.066667, lambda t: f"{17 + int(t)}.{round(1e9 * (t % 1.0))}"),
    "versions": (0.1, lambda t: f"take1.{round(t / 0.1) + 1}"),
    "counters behind a point": (0.05, lambda t: f"take1.{round(t / 0.05) + 1:04d}"),
    "dates and times": (5.0, lambda t: f"2024060112{30 + round(t) // 60}{round(t) % 60:02d}"),
    "dates": (0.1, lambda t: f"2024-06-{1 + round(t / 0.1):02d}"),
    "numbers": (0.1, lambda t: f"Frame{round(t / 0.1)}"),
}


@pytest.mark.parametrize("case", NAMES)
def test_names_are_put_in_order_of_time(case):
    step, name_of = NAMES[case]
    time = step * np.arange(25)
    names = [name_of(t) for t in time]
    assert in_order(sorted(names), time, where="") == names


@pytest.mark.parametrize("start", [0, 1700000000])
def test_times_in_names_must_be_those_of_the_frames(start):
    time = 0.1 * np.arange(20)
    lost = np.where(np.arange(20) > 9, time + 0.5, time)
    names = [f"{start + t:.3f}" for t in lost]
    with pytest.raises(RecordingError, match=r"lift: times in names, .* 0\.(25|188) s"):
        in_order(names, time, where="lift")
    assert in_order(names, lost + 7.0, where="lift") == names


@pytest.mark.parametrize(("off", "right"), [(0.099, True), (0.101, False)])
def test_names_that_are_times_may_be_off_by_a_frame(off, right):
    """Those since 1970 as times; most of them."""
    time = 0.1 * np.arange(11)
    names = [f"f{1700000000 + t + off * (t == time[5]):.4f}" for t in time]
    said = r"lift: times in names, as 'f1700000000\.0000', are up to 0\.101 s from those of the"
    with nullcontext() if right else pytest.raises(RecordingError, match=said):
        check_named(names, time, where="lift")
    check_named([n[1:4] + n[12:] for n in names], time, where="")  # no time since 1970
    counters = [f"a{k}" for k in range(11)]
    assert in_order(counters[::-1], time, where="") == counters
    check_named([*names[:5], *counters[5:]], time, where="")
    assert in_order(["b2", "B10", "a3"], np.arange(3.0), where="") == ["a3", "b2", "B10"]


def test_names_in_two_orders_of_which_neither_fits():
    names = [f"{n}.{k}" for n in range(3) for k in (1, 5, 13, 9)]
    with pytest.raises(RecordingError, match="can be put in two orders"):
        in_order(names, 0.1 * np.arange(12), where="lift")
    with pytest.raises(RecordingError, match="'A1' and 'a01' are the same number; number the"):
        in_order(["A1", "a2", "a01"], 0.1 * np.arange(3), where="lift")
