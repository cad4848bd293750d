"""Camera models and their files."""

import numpy as np
import pytest

from gendom.errors import RecordingError
from gendom.perception import Camera, read_camera, write_camera

GOOD = """
width = 640
height = 480
depth_unit = 0.001
K = [[385.0, 0.0, 319.5], [0.0, 386.0, 239.5], [0.0, 0.0, 1.0]]
T_world_camera = [[1,0,0,0.1],[0,-1,0,0.2],[0,0,-1,0.8],[0,0,0,1]]
"""


def test_written_camera_reads_the_same(world, tmp_path):
    camera = world.make_camera(distortion=(0.1, -0.05, 1e-3, -2e-3, 0.01))
    write_camera(tmp_path / "left" / "camera.toml", camera)
    again = read_camera(tmp_path / "left" / "camera.toml")
    assert (again.name, again.width, again.height) == ("left", 640, 480)
    assert again.depth_unit == camera.depth_unit and again.distortion == camera.distortion
    np.testing.assert_array_equal(again.K, camera.K)
    np.testing.assert_array_equal(again.T_world_camera, camera.T_world_camera)


def test_rays_of_a_pinhole():
    K = np.array([[400.0, 0, 320], [0, 200, 240], [0, 0, 1]])
    camera = Camera(name="a", width=640, height=480, K=K, T_world_camera=np.eye(4))
    rays = camera.rays().reshape(480, 640, 3)
    np.testing.assert_allclose(rays[240, 320], [0, 0, 1])
    np.testing.assert_allclose(rays[250, 330], [10 / 400, 10 / 200, 1])


def test_rays_undo_distortion(world):
    """OpenCV's own projection of the rays gives the pixels back."""
    cv2 = pytest.importorskip("cv2", reason="needs the extra `camera`")
    camera = world.make_camera(distortion=(0.12, -0.2, 1e-3, -2e-3, 0.05), scale=0.25)
    rays = camera.rays()
    pixels = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )[0][:, 0]
    v, u = np.mgrid[: camera.height, : camera.width]
    np.testing.assert_allclose(pixels, np.stack([u.ravel(), v.ravel()], 1), atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("K = [[", "Q = [[", "lacks K"),
        ("depth_unit = 0.001", "", "lacks depth_unit"),
        ("depth_unit = 0.001", "depth_unit = 0", "depth_unit: is 0.0"),
        ("depth_unit = 0.001", "depth_unit = 'mm'", "depth_unit: is not a number"),
        ("386.0, 239.5]", "386.0]", "K: is not 3x3 numbers"),
        ("319.5", "959.5", "outside 640 x 480"),
        ("0.8]", "800.0]", "metres, not millimetres"),
        ("[0,-1,0,0.2]", "[0,1,0,0.2]", "is no rigid transform"),
        ("width = 640", "width = 640\nfx = 385", "unknown key 'fx'"),
        ("width = 640", "width = ", "is not TOML"),
        ("width", "distortion = [0.1]\nwidth", "distortion: has 1 numbers"),
    ],
)
def test_bad_files(tmp_path, old, new, line):
    path = tmp_path / "camera.toml"
    assert old in GOOD
    path.write_text(GOOD)
    read_camera(path)
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(RecordingError) as error:
        read_camera(path)
    assert line in str(error.value) and str(error.value).count("\n") == 0


def test_a_camera_without_pose_says_so(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(GOOD[: GOOD.index("T_world")])
    with pytest.raises(RecordingError, match="gendom calibrate"):
        _ = read_camera(path).position
