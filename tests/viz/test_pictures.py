"""Clouds, from where they are seen, the frames of animations, and GIFs."""

import io

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gendom.errors import GendomError
from gendom.viz import CloudSequence, encode_camera_views, palette, write_gif, write_report
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR
from gendom.viz.stage import Stage, clouds_scene
from viz.made_up import content, lift


def near(image, color, tolerance=60):
    """[height, width] bool: pixels of about a colour."""
    want = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return (np.abs(np.asarray(image, dtype=int) - want) < tolerance).all(axis=2)


def count(image):
    return sum(1 for _ in ImageSequence.Iterator(image))


def drawn(clouds):
    """The first frame [height, width, 3]."""
    return np.asarray(Stage(clouds_scene(clouds, [0]), clouds.distance).draw(0))


def test_points_are_drawn_where_they_are():
    """One point at the lower left, simulated too, and one at the upper right."""
    recorded = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    sequence = CloudSequence(recorded=[recorded], simulated=[recorded[:1]], times=np.array([0.0]))
    # The legend shows both colours above the picture.
    picture = drawn(sequence)[30:]
    blue_rows, blue_columns = np.nonzero(near(picture, RECORDED_COLOR))
    assert blue_columns[blue_rows < 100].mean() > 320 > blue_columns[blue_rows > 320].mean()
    assert not near(picture, SIMULATED_COLOR, 20).any()  # under the recorded one, and pale
    # missing parts and empty frames are drawn
    bare = lift(frames=3, table_height=None, gripper=None, chamfer=None)
    bare["recorded"][0] = np.empty((0, 3))
    for oblique in (False, True):
        drawn(CloudSequence(**bare, oblique=oblique))


@pytest.mark.parametrize(
    ("size", "names"),
    [((1.0, 0.2, 0.5), "xz"), ((0.2, 1.0, 0.5), "yz"), ((1.0, 0.8, 0.01), "xy")],
)
def test_the_view_shows_where_the_object_moves(size, names):
    points = np.random.default_rng(0).uniform(size=(200, 3)) * size
    view = CloudSequence(recorded=[points], simulated=[points], times=[0.0]).projection()  # pyright: ignore
    axes = np.eye(3)[["xyz".index(name) for name in names]]
    assert view.axes == pytest.approx(axes, abs=1e-12)


def test_camera_views_of_one_size_become_a_picture(monkeypatch):
    """Nearest is yellow, and what was not measured black."""
    monkeypatch.setattr(palette, "WIDTH", 32)
    depth = np.repeat([[0.5, 0.0]], 8, axis=0).repeat(8, axis=1)
    view = np.zeros((8, 16, 3), np.uint8), depth
    with Image.open(io.BytesIO(encode_camera_views([view, view]))) as image:
        near, none = (np.array(image.getpixel((x, 4))) for x in (19, 29))
    np.testing.assert_allclose(near, [253, 231, 37], atol=12)
    np.testing.assert_allclose(none, 0, atol=12)
    with pytest.raises(GendomError, match="views: has pictures of 2 sizes"):
        encode_camera_views([view, (view[0][:4], depth[:4])])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": []}, "times: is empty"),
        ({"times": np.zeros(20)}, "times: does not increase"),
        ({"recorded": [np.zeros((1, 3))]}, "recorded: has 1 frames, but times has 20"),
        ({"simulated": np.zeros((20, 5, 2))}, r"simulated\[0\] must be \[n, 3\] .* shape \[5, 2\]"),
        ({"simulated": np.full((20, 5, 3), np.nan)}, r"simulated\[0\] must be finite, got nan"),
        ({"gripper": np.zeros((20, 1, 2))}, r"gripper must be .* got shape \[20, 1, 2\]"),
        ({"chamfer": np.zeros(3)}, r"chamfer must be \[20\] numbers, got shape \[3\]"),
        ({"arm": np.zeros((20, 4, 2, 3))}, r"arm_radius must be \[4\] numbers, got None"),
        ({"arm": np.zeros((2, 4, 2, 3)), "arm_radius": np.ones(4)}, r"arm must be \[20, C, 2, 3\]"),
        ({"goal": np.zeros(3)}, r"goal must be \[n, 3\] numbers, got shape \[3\]"),
        ({"table_height": "low"}, "table_height must be a number, got 'low'"),
    ],
)
def test_bad_clouds(change, message):
    with pytest.raises(GendomError, match=message):
        CloudSequence(**lift() | change)


# ---- files ---------------------------------------------------------------------------------------


def test_frames_durations_and_loop(tmp_path):
    path = tmp_path / "lift.gif"
    write_gif(path, CloudSequence(**lift(frames=8)))
    with Image.open(path) as image:
        assert (image.format, count(image), image.width) == ("GIF", 8, 640)
        assert image.info["loop"] == 0
        durations = []
        for t in range(8):
            image.seek(t)
            image.load()
            durations.append(image.info["duration"])
    assert durations == [80] * 7 + [1080]
    assert list(tmp_path.iterdir()) == [path]
    # equal frames are not merged
    still = lift(frames=5, gripper=None, chamfer=None)
    for name in ("recorded", "simulated"):
        still[name] = [still[name][0]] * 5
    still["times"] = 0.001 * np.arange(5)  # the same to two decimals
    for name in ("a.gif", "b.gif"):
        write_gif(tmp_path / name, CloudSequence(**still))
    with Image.open(tmp_path / "a.gif") as image:
        assert count(image) == 5
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


@pytest.mark.parametrize("write", [write_gif, lambda at, of: write_report(at, content(lift=of))])
def test_failure_keeps_the_old_file(tmp_path, write):
    path = tmp_path / "shown"
    path.write_text("old")
    none = [np.empty((0, 3))]
    with pytest.raises(GendomError, match="no points at all"):
        write(path, CloudSequence(recorded=none, simulated=none, times=np.zeros(1)))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
