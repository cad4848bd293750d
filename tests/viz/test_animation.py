"""Animations are valid GIFs of the right length."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gendom.errors import GendomError
from gendom.viz import CloudSequence, write_gif


def count(image):
    return sum(1 for _ in ImageSequence.Iterator(image))


def test_frames_durations_and_loop(make_lift, tmp_path):
    path = tmp_path / "lift.gif"
    write_gif(path, CloudSequence(**make_lift(frames=8)))
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


def test_equal_frames_are_not_merged(make_lift, tmp_path):
    lift = make_lift(frames=5)
    for name in ("recorded", "simulated"):
        lift[name] = [lift[name][0]] * 5
    lift["times"] = 0.001 * np.arange(5)  # the same to two decimals
    lift["gripper"] = None
    lift["chamfer"] = None
    for name in ("a.gif", "b.gif"):
        write_gif(tmp_path / name, CloudSequence(**lift))
    with Image.open(tmp_path / "a.gif") as image:
        assert count(image) == 5
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_a_long_lift_stays_small(make_lift, tmp_path):
    path = tmp_path / "lift.gif"
    write_gif(path, CloudSequence(**make_lift(frames=120, recorded=150, simulated=4000)))
    assert path.stat().st_size < 1_500_000
    with Image.open(path) as image:
        assert count(image) == 60


def test_bad_input_keeps_the_old_file(make_lift, tmp_path):
    path = tmp_path / "lift.gif"
    path.write_text("old")
    with pytest.raises(GendomError, match="view: is 'yx'"):
        write_gif(path, CloudSequence(**make_lift(frames=3)), view="yx")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
