"""Arrays for contact of thin bodies with themselves, see ``native/contact.h`` and its adjoint."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.sim.setting import spread

MARGIN_OF_LISTS = 0.3
"""Margin of the list of pairs that may come into contact [spacings]."""

PAIRS = 40
"""Maximum number of such pairs for each point."""

TURNS = 4
"""Turns over the contacts of a step that friction needs."""

MOST_TURNS = 12
"""Maximum number of turns: after those they go on until one finds nothing nearer than enough. Where
a hand presses layers on a table there is no room for all of them, and turns are in vain."""

ENOUGH = 0.9
"""Distance that is enough [thicknesses]."""

CLOSE = 1.25
"""Distance from which on pairs play no part in a step's contacts [thicknesses]."""

LISTED = 3
"""Components of a kept state that hold where points were when pairs were listed."""


def fill_contact(engine: Any, body: Any) -> None:
    """Set what the kernels' body needs for contact.

    Args:
        engine: A thin engine.
        body: The kernels' body.
    """
    e, s = engine, engine.setting
    W, n, P = e.num_worlds, e.num_points, e.row_length
    on = int(s.self_contact)
    thickness, spacing = s.body.thickness, e.spacing
    body.contact = on
    body.contact_distance = thickness
    body.contact_margin = MARGIN_OF_LISTS * spacing
    body.contact_turns = TURNS
    body.contact_most_turns = MOST_TURNS
    body.contact_enough = ENOUGH * thickness
    body.self_friction = e.array(spread(s.self_friction, (W,), "self_friction"))
    body.push = e.zeros((W * on, 7, P))
    # where nothing is near: the first step lists pairs
    nowhere = np.broadcast_to(1e6 * (1.0 + np.arange(n)), (W * on, 3, n))
    body.listed = e.array(e.rows(nowhere))
    body.boxes = e.zeros((W * on, 6, P))
    body.near = e.zeros((W * on, PAIRS * n, 2), wp.int32)
    body.near_count = e.zeros((W * on, 2), wp.int32)
    body.close = e.zeros((W * on, PAIRS * n, 2), wp.int32)
    body.close_count = e.zeros((W * on, 2), wp.int32)
    body.touching = e.zeros((W * on, PAIRS * n), wp.int32)
    body.touching_count = e.zeros(W * on, wp.int32)
    body.contact_close = CLOSE * thickness
    body.loose = e.array(loose(e, np.arange(W * on)))


def loose(engine: Any, worlds: NDArray[np.int64]) -> NDArray[np.float64]:
    """Inverse masses of points of worlds [k], 0 for held ones, [k, 1, P] [1/kg]."""
    e = engine
    free = 1.0 - np.any(e.holds[worlds] & 1, axis=1)
    per_mass = np.broadcast_to(e.per_mass, (e.num_worlds, e.num_points))[worlds]
    return e.rows(per_mass * free)[:, None]


def kept_turns(engine: Any, worlds: int) -> wp.array:
    """Memory for points in the turns of a step of so many worlds, for the reverse pass."""
    rows = worlds * int(engine.setting.self_contact)
    shape = (rows, 6 * engine.body.contact_most_turns, engine.row_length)
    return wp.empty(shape, dtype=engine.real, device=engine.setting.device)
