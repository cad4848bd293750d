"""What counts of shapes beside clouds."""

import numpy as np

from gendom.estimation.observed import Observation
from gendom.estimation.scene import LiftScene


def test_a_shape_where_no_points_are_counts_except_where_fingers_hide_it(rope_lift):
    scene = LiftScene.of(rope_lift.seen(frames=5), rope_lift.settings)
    observed, rest = Observation(scene), scene.initial
    aside = np.repeat(rest[None] + [0.0, 0.5, 0.0], len(scene.frames), axis=0)
    every = np.ones(len(observed.in_view), bool)
    counts = observed.rows(aside, 0.006, lambda _: every).counts[:, -len(every) :]
    assert (counts[:, observed.in_view] > 0.0).all() and observed.in_view.any()
    assert (counts[:, ~observed.in_view] == 0.0).all() and not observed.in_view.all()
    # nor does what the object hides of itself
    assert not observed.rows(aside, 0.006, lambda _: ~every).counts[:, -len(every) :].any()
