"""Pictures and films: what is drawn where, and from where it is seen."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gendom.errors import GendomError
from gendom.viz import Animation, Layer, write_film, write_report
from gendom.viz.animation import axes_of
from gendom.viz.films import Stage
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR
from gendom.viz.views import draw_views
from viz.made_up import content, lift


def near(image, color, tolerance=60):
    """[height, width] bool: pixels of about a colour."""
    want = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return (np.abs(np.asarray(image, dtype=int) - want) < tolerance).all(axis=2)


def drawn(animation):
    """The first frame [height, width, 3]."""
    return np.asarray(Stage(animation).draw(0))


def test_points_are_drawn_where_they_are():
    """One point at the lower left, simulated too, and one at the upper right."""
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    orange = Layer(name="s", color=SIMULATED_COLOR, points=[ends[:1]], radius=0.005, opacity=0.5)
    blue = Layer(name="r", color=RECORDED_COLOR, points=[ends], radius=0.005)
    # The legend shows both colours above the picture.
    picture = drawn(Animation(times=np.zeros(1), layers=(orange, blue)))[30:]
    blue_rows, blue_columns = np.nonzero(near(picture, RECORDED_COLOR))
    assert blue_columns[blue_rows < 100].mean() > 320 > blue_columns[blue_rows > 320].mean()
    assert not near(picture, SIMULATED_COLOR, 20).any()  # under the recorded one, and pale
    # an empty frame is drawn
    empty = replace(blue, points=[np.empty((0, 3)), ends])
    drawn(Animation(times=np.arange(2), layers=(empty, orange)))


def test_what_is_nearer_hides_what_is_behind():
    """A red square before and behind a blue one, as they are seen from the usual place."""
    flat = np.array([[-0.1, 0, -0.1], [0.1, 0, -0.1], [0.1, 0, 0.1], [-0.1, 0, 0.1]])
    faces, reds = np.array([[0, 1, 2], [0, 2, 3]]), []
    for y in (-0.05, 0.05):
        blue = Layer(name="blue", color="#0000ff", points=[flat], faces=faces)
        red = Layer(name="red", color="#ff0000", points=[0.5 * flat + [0, y, 0]], faces=faces)
        picture = drawn(Animation(times=np.zeros(1), layers=(blue, red)))[60:]
        reds.append(np.count_nonzero((picture[..., 0] > 120) & (picture[..., 2] < 60)))
    assert reds[0] > 10_000 and reds[1] == 0


@pytest.mark.parametrize(
    ("size", "turn"), [((1.0, 0.2, 0.5), 25.0), ((0.2, 1.0, 0.5), 115.0), ((1.0, 0.8, 0.01), 25.0)]
)
def test_the_view_is_of_the_broad_side(size, turn):
    points = np.random.default_rng(0).uniform(size=(200, 3)) * size
    layer = Layer(name="a", color="#000000", points=[points])
    view = Animation(times=np.zeros(1), layers=(layer,)).view
    assert np.degrees(view) == pytest.approx([turn, 18.0])
    right, up, away = axes_of(*view)
    np.testing.assert_allclose(np.cross(right, up), -away, atol=1e-12)
    assert away[2] < 0.0 < up[2] and right[2] == 0.0
    # from three sides
    image = np.asarray(draw_views([points, points + 0.1], table=0.0))
    assert image.shape == (420, 1260, 3) and near(image, RECORDED_COLOR).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": np.empty(0)}, "times: must increase"),
        ({"times": np.zeros(20)}, "times: must increase"),
        ({"points": [np.zeros((1, 3))] * 2}, "a: has 2 frames, but there are 20 times"),
        ({"points": np.zeros((20, 5, 2))}, r"a\[0\] must be \[n, 3\] .* shape \[5, 2\]"),
        ({"points": np.full((20, 5, 3), np.nan)}, r"a\[0\] must be finite, got nan"),
        ({"distance": ("rms", np.zeros(3))}, r"distance must be \[20\] numbers, got shape \[3\]"),
    ],
)
def test_bad_animations(change, message):
    given = {"times": np.arange(20), "points": np.zeros((20, 5, 3)), **change}
    with pytest.raises(GendomError, match=message):
        layer = Layer(name="a", color="#000000", points=given.pop("points"))
        Animation(layers=(layer,), **given)


# ---- files ---------------------------------------------------------------------------------------


def durations(path):
    with Image.open(path) as image:
        assert (image.format, image.width, image.info["loop"]) == ("GIF", 640, 0)
        return [frame.info["duration"] for frame in ImageSequence.Iterator(image)]


def test_films_last_as_long_as_the_motion(tmp_path):
    path = tmp_path / "lift.gif"
    write_film(path, lift(frames=8))
    assert durations(path) == [100] * 7 + [1100]
    assert list(tmp_path.iterdir()) == [path]
    # long ones stay small
    places = [np.array([[x, 0.0, 0.0]]) for x in range(500)]
    dot = Layer(name="a", color="#000000", points=places)
    write_film(path, Animation(times=0.1 * np.arange(500), layers=(dot,)))
    shown = durations(path)
    assert len(shown) <= 121 and sum(shown) == pytest.approx(50_000 + 1_000, rel=0.02)


def test_failure_keeps_the_old_file(tmp_path):
    path = tmp_path / "shown.gif"
    path.write_text("old")
    none = Layer(name="a", color="#000000", points=[np.empty((0, 3))])
    for write in (write_film, lambda at, of: write_report(at, content(lift=of))):
        with pytest.raises(GendomError, match="no points at all"):
            write(path, Animation(times=np.zeros(1), layers=(none,)))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
