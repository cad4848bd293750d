"""What files of cameras name and announce is bounded."""

import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from gendom.errors import GendomError, RecordingError
from gendom.perception import PngCamera, read_camera
from gendom.perception.calibration import read_views
from gendom.perception.png import read_png

CAMERA = """
width = 8
height = 4
depth_unit = 0.001
K = [[10.0, 0.0, 4.0], [0.0, 10.0, 2.0], [0.0, 0.0, 1.0]]
T_world_camera = [[1,0,0,0.1],[0,-1,0,0.2],[0,0,-1,0.8],[0,0,0,1]]
"""


@pytest.fixture
def folder(tmp_path):
    """A camera's folder with one picture beside it and two in it."""
    folder = tmp_path / "left"
    (folder / "depth").mkdir(parents=True)
    (folder / "camera.toml").write_text(CAMERA)
    for path in (tmp_path / "0.png", folder / "depth" / "0.png", folder / "depth" / "1.png"):
        Image.fromarray(np.full((4, 8), 900, np.uint16)).save(path)
    return folder


def frames(folder, *names):
    rows = [f"{0.1 * k},{name}" for k, name in enumerate(names)]
    (folder / "frames.csv").write_text("\n".join(["time,depth", *rows, ""]))
    return PngCamera(folder)


def test_names_of_windows(folder):
    for frame in frames(folder, r"depth\0.png", r"depth\1.png"):
        assert (frame.read().depth == 900).all()


@pytest.mark.parametrize("name", ["../0.png", "/etc/passwd", r"..\0.png", r"C:\0.png"])
def test_pictures_elsewhere_are_refused(folder, tmp_path, name):
    with pytest.raises(RecordingError, match=r"frames\.csv, line 2: .* is not in"):
        frames(folder, name)
    (tmp_path / "board.toml").write_text("squares_x=7\nsquares_y=5\nsquare=0.04\nmarker=0.03\n")
    (tmp_path / "poses.csv").write_text(f"picture,x,y,z,qx,qy,qz,qw\n{name},0,0,0,0,0,0,1\n")
    with pytest.raises(RecordingError, match=r"poses\.csv, line 2: .* is not in"):
        read_views(tmp_path, read_camera(folder / "camera.toml"), on_warning=print)


def test_times_in_names_of_pictures(folder):
    names = [f"depth/{1700000000.0 + t:.3f}.png" for t in (0.0, 0.1, 0.2, 0.8, 0.9)]
    with pytest.raises(RecordingError, match=r"frames\.csv: times in names"):
        frames(folder, *names)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_file(folder, kind):
    path = folder / "depth" / "0.png"
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(RecordingError, match="folder" if kind == "folder" else "pipe or device"):
        next(iter(frames(folder, "depth/0.png"))).read()


def test_pictures_of_too_many_pixels(tmp_path):
    head = struct.pack(">IIBBBBB", 40_000, 40_000, 16, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(bytes(1 << 20))), (b"IEND", b"")]
    data = b"".join(
        struct.pack(">I", len(of)) + kind + of + struct.pack(">I", zlib.crc32(kind + of))
        for kind, of in chunks
    )
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    with pytest.raises(RecordingError, match="has 40000 x 40000 pixels"):
        read_png(tmp_path / "a.png")


def test_cameras_of_too_many_pixels(folder):
    text = CAMERA.replace("width = 8", "width = 40000").replace("height = 4", "height = 40000")
    (folder / "camera.toml").write_text(text)
    with pytest.raises(RecordingError, match=r"width, height: is 40000 x 40000; .* at most"):
        read_camera(folder / "camera.toml")


def test_boards_of_too_many_squares(tmp_path, folder):
    (tmp_path / "board.toml").write_text("squares_x=9999\nsquares_y=5\nsquare=0.04\nmarker=0.03\n")
    with pytest.raises(GendomError, match="9999 x 5 squares; use 3 or more, 100 at most"):
        read_views(tmp_path, read_camera(folder / "camera.toml"), on_warning=print)


def test_the_hint_for_old_boards_is_right(tmp_path):
    """A board of even rows, printed by OpenCV before 4.6."""
    cv2 = pytest.importorskip("cv2", reason="needs the extra `camera`")
    text = "squares_x=5\nsquares_y=6\nsquare=0.04\nmarker=0.03\n"
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((5, 6), 0.04, 0.03, dictionary)
    board.setLegacyPattern(True)
    Image.fromarray(board.generateImage((500, 600), marginSize=40)).save(tmp_path / "0.png")
    (tmp_path / "poses.csv").write_text("picture,x,y,z,qx,qy,qz,qw\n0.png,0,0,0,0,0,0,1\n")
    (tmp_path / "camera.toml").write_text(
        CAMERA.replace("width = 8", "width = 500").replace("height = 4", "height = 600")
    )
    camera, told = read_camera(tmp_path / "camera.toml"), []
    (tmp_path / "board.toml").write_text(text)
    with pytest.raises(RecordingError, match=r"write legacy = true in board\.toml"):
        read_views(tmp_path, camera, on_warning=told.append)
    (tmp_path / "board.toml").write_text(text + "legacy = true\n")
    assert len(read_views(tmp_path, camera, on_warning=told.append)[0].points) == 20
