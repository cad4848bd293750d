"""Filmstrips and the frames that animations are made of."""

import io

import numpy as np
import pytest
from PIL import Image

from gendom.errors import GendomError
from gendom.viz import CloudSequence, encode_filmstrip, write_filmstrip
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR
from gendom.viz.stage import Stage
from gendom.viz.views import choose_view


def near(image, color, tolerance=60):
    """[height, width] bool: pixels of about a colour."""
    want = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return (np.abs(np.asarray(image, dtype=int) - want) < tolerance).all(axis=2)


def test_filmstrip_is_a_grid_of_panels(make_lift, tmp_path):
    path = tmp_path / "new" / "film.png"
    clouds = CloudSequence(**make_lift())
    write_filmstrip(path, clouds, frames=5, columns=3, width=900)
    with Image.open(path) as image:
        image.load()
        assert image.format == "PNG"
        assert image.width == 900
        assert image.height % 2 == 0  # two rows
    assert path.read_bytes() == encode_filmstrip(clouds, frames=5, columns=3, width=900)
    assert len(list(path.parent.iterdir())) == 1


def test_points_are_drawn_where_they_are():
    """One point at the lower left, simulated too, and one at the upper right."""
    recorded = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    sequence = CloudSequence(recorded=[recorded], simulated=[recorded[:1]], times=np.array([0.0]))
    stage = Stage(sequence, view="xz", width=400)
    # The legend shows both colours above the picture.
    picture = np.asarray(stage.draw(0))[26:]
    blue_rows, blue_columns = np.nonzero(near(picture, RECORDED_COLOR))
    assert blue_columns[blue_rows < 100].mean() > 200 > blue_columns[blue_rows > 200].mean()
    assert not near(picture, SIMULATED_COLOR, 20).any()  # under the recorded one, and pale


def test_the_legend_has_the_clouds_own_names(make_lift):
    """Other names, another legend, and the same picture below it."""
    pictures = [
        np.asarray(Stage(CloudSequence(**make_lift(), labels=labels)).draw(0))
        for labels in (("recorded", "simulated"), ("carried out", "predicted"))
    ]
    rows = np.flatnonzero((pictures[0] != pictures[1]).any(axis=(1, 2)))
    assert len(rows) and rows.max() < 40


def test_limits_do_not_change_between_frames(make_lift):
    stage = Stage(CloudSequence(**make_lift()))
    images = [np.asarray(stage.draw(t)) for t in (0, 19)]
    assert images[0].shape == images[1].shape == (*stage.size[::-1], 3)
    axis = slice(-38, None)  # the row of axis labels
    assert (images[0][axis] == images[1][axis]).all()


def test_a_stray_point_does_not_shrink_the_rest(make_lift):
    clean = make_lift(recorded=400)
    stray = make_lift(recorded=400)
    stray["recorded"][3] = np.vstack([stray["recorded"][3], [[50.0, 0.0, 50.0]]])
    boxes = [CloudSequence(**lift).box() for lift in (clean, stray)]
    assert np.allclose(*boxes, atol=0.01)


@pytest.mark.parametrize(
    ("size", "names"),
    [
        ((1.0, 0.2, 0.5), ("x", "z")),
        ((0.2, 1.0, 0.5), ("y", "z")),
        ((1.0, 0.8, 0.01), ("x", "y")),
    ],
)
def test_auto_view_shows_where_the_object_moves(size, names):
    points = np.random.default_rng(0).uniform(size=(200, 3)) * size
    view = choose_view(CloudSequence(recorded=[points], times=np.array([0.0])))
    assert view.names == names
    axes = np.eye(3)[["xyz".index(name) for name in names]]
    assert view.axes == pytest.approx(axes, abs=1e-12)


def test_oblique_axes_are_orthonormal(make_lift):
    axes = choose_view(CloudSequence(**make_lift()), "oblique").axes
    assert axes @ axes.T == pytest.approx(np.eye(2))
    assert axes[1, 2] > 0.5  # up stays up


def test_every_view_and_missing_parts_are_drawn(make_lift):
    clouds = CloudSequence(**make_lift(frames=3))
    for view in ("xz", "yz", "xy", "oblique"):
        encode_filmstrip(clouds, view=view, frames=2, width=300)
    bare = make_lift(frames=3) | {"simulated": None, "table_height": None}
    bare |= {"gripper": None, "chamfer": None}
    for view in ("auto", "oblique"):
        data = encode_filmstrip(CloudSequence(**bare), view=view, frames=1, width=300)
        Image.open(io.BytesIO(data)).load()


def test_empty_frames_are_allowed_but_not_only_those(make_lift):
    lift = make_lift(frames=3)
    lift["recorded"][0] = np.empty((0, 3))
    encode_filmstrip(CloudSequence(**lift), width=300)
    nothing = CloudSequence(recorded=[np.empty((0, 3))], times=np.zeros(1))
    with pytest.raises(GendomError, match="recorded: has no points at all"):
        encode_filmstrip(nothing)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": []}, "times: is empty"),
        ({"times": np.zeros(20)}, "times: does not increase"),
        ({"recorded": [np.zeros((1, 3))]}, "recorded: has 1 frames, but times has 20"),
        ({"simulated": np.zeros((20, 5, 2))}, r"simulated\[0\]: has shape \[5, 2\]"),
        ({"simulated": np.full((20, 5, 3), np.nan)}, r"simulated\[0\]: holds NaN or infinity"),
        ({"gripper": np.zeros((20, 1, 2))}, r"gripper: has shape \[20, 1, 2\]"),
        ({"chamfer": np.zeros(3)}, "chamfer: has 3 frames"),
        ({"arm": np.zeros((20, 4, 2, 3))}, "arm_radius: has 0 numbers"),
        ({"arm": np.zeros((2, 4, 2, 3)), "arm_radius": np.ones(4)}, "arm: has 2 frames"),
        ({"goal": np.zeros(3)}, r"goal: has shape \[3\]"),
        ({"table_height": "low"}, "table_height: is no array of numbers"),
    ],
)
def test_bad_clouds(make_lift, change, message):
    with pytest.raises(GendomError, match=message):
        CloudSequence(**make_lift() | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"view": "top"}, "view: is 'top'; choose from auto, xz"),
        ({"frames": 0}, "max_frames: is 0"),
        ({"columns": 0}, "columns: is 0"),
    ],
)
def test_bad_input_keeps_the_old_file(make_lift, tmp_path, change, message):
    path = tmp_path / "film.png"
    path.write_text("old")
    with pytest.raises(GendomError, match=message):
        write_filmstrip(path, CloudSequence(**make_lift()), **change)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
