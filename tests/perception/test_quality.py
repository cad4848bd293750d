"""Agreement of cameras, and how much they see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.datasets import ObjectDescription
from gendom.perception.line import find_line
from gendom.perception.quality import seen_share

ROPE = ObjectDescription(kind="rope", length=0.4, diameter=0.01)


def test_share_of_a_cloth_that_is_seen():
    """Lying in any direction."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(0, 0.12, 90), np.linspace(0, 0.3, 150))
    p = np.stack([u, v, 0 * u], axis=-1).reshape(-1, 3)
    cloth = ObjectDescription(kind="cloth", width=0.3, height=0.3)
    turns = Rotation.from_quat(rng.normal(size=(5, 4)))
    assert [seen_share(turn.apply(p), cloth) for turn in turns] == pytest.approx([0.4] * 5, abs=0.2)


def bent(turn):
    """[n, 3] a cloud of a rope of 0.4 m whose direction turns along it, turn [rad] of 0 to 1."""
    s = np.linspace(0.0, 1.0, 2000)
    steps = 2e-4 * np.stack([np.cos(turn(s)), np.sin(turn(s)), 0.0 * s], axis=1)
    noise = np.random.default_rng(0).normal(scale=0.002, size=(2000, 3))
    return np.cumsum(steps, axis=0) + noise


def test_line_of_points_at_one_place():
    """Averages of such points may fall together."""
    p = np.repeat([[0.0099, 0.0, 0.0], [0.0101, 0.0, 0.0]], 3, axis=0)
    assert find_line(p, ROPE, np.zeros(3)).own.all()


@pytest.mark.parametrize("stated", [0.9, 1.0, 1.1])
def test_a_line_alone_is_the_rope(stated):
    """Neither cut nor refused where its length is stated a tenth off. Steps between noisy nodes
    zigzag; chords hardly do."""
    rope = replace(ROPE, length=0.4 * stated)
    rng = np.random.default_rng(0)
    p = np.column_stack([rng.uniform(0.0, 0.4, 800), rng.normal(scale=0.006, size=(800, 2))])
    line = find_line(p, rope, np.zeros(3))
    assert line.length == pytest.approx(0.4, rel=0.06) and line.clear and line.own.all()


@pytest.mark.parametrize(
    "turn",
    [
        lambda s: np.interp(s, [0.3, 0.42, 0.62, 0.74], [0.0, np.pi, np.pi, 0.0]),
        lambda s: 12.0 * s**0.5,
        lambda s: np.interp(s, [0.45, 0.55], [0.0, np.pi]),
    ],
    ids=["S", "coil", "hairpin"],
)
@pytest.mark.parametrize("diameter", [0.01, None])
def test_a_rope_near_itself_is_whole_and_with_something_beside_it_is_refused(turn, diameter):
    """Its way does not cross to the next turn, 13 to 30 mm away, of unknown diameter either."""
    p, rope = bent(turn), replace(ROPE, diameter=diameter)
    line = find_line(p, rope, np.zeros(3))
    assert line.clear and line.own.mean() > 0.99
    assert line.length == pytest.approx(0.4, rel=0.1) and seen_share(p, rope) > 0.9
    away = p[1000] + np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 0.15], 500)
    assert not find_line(np.concatenate([p, away]), ROPE, np.zeros(3)).clear
    assert not find_line(p, replace(ROPE, length=0.3), np.zeros(3)).clear
