"""What is believed of a lift before its clouds are seen: ranges, means and deviations."""

from collections.abc import Sequence
from dataclasses import astuple, replace

import numpy as np

from gendom.datasets import Recording
from gendom.estimation.gauss_newton import Bounds
from gendom.estimation.hold import NAMES, Held, Hold

BENDING_RANGE = {"rope": (0.08, 1.2), "cloth": (0.015, 0.2)}
"""Bending lengths searched for, in lengths of a rope or diagonals of a cloth."""

START_RANGE = {"rope": (0.2, 0.7), "cloth": (0.04, 0.1)}
"""Bending lengths from which starts are drawn, likewise."""

NU_PRIOR = (0.3, 0.06)
"""Mean and standard deviation of Poisson's ratio."""

NU_RANGE = (0.05, 0.45)
"""Poisson's ratios that are searched."""

FRICTION_PRIOR = (0.4, 0.25)
"""Mean and standard deviation of the coefficient of friction."""

FRICTION_RANGE = (0.05, 1.2)
"""Coefficients of friction that are searched."""

OFFSET_PRIOR = {"commanded": 0.01, "measured": 0.002}
"""Standard deviation of the grip offset [m] by the source of the gripper's path."""

HOLD_MEAN = Hold(lag=0.05, inset=0.02, tilt=0.8, sink=0.005)
"""How the corner of a flat cloth is held."""

SHAPE_SD = {
    "east": 0.01, "north": 0.01, "pleat": 0.8, "pleat_width": 0.01, "pleat_turn": 0.15,
    "arch_along": 8.0, "arch_across": 8.0, "crumple": 0.4,
}  # fmt: skip
"""Standard deviations about ``SHAPE_MEAN`` of what only a cloth that does not lie flat shows."""

SHAPE_MEAN = {"crumple": 0.6}
"""Means of that where they are not those of a flat cloth."""

LEAST_CRUMPLE = 0.05
"""Least share of its curvature that a crumpled cloth keeps."""

HOLD_SD = {
    "commanded": Hold(
        lag=0.1, height=0.02, inset=0.02, aside=0.015, turn=0.2, tilt=0.6, sink=0.01, reach=0.008
    ),
    "measured": Hold(
        lag=0.02, height=0.005, inset=0.02, aside=0.015, turn=0.2, tilt=0.6, sink=0.01, reach=0.008
    ),
}
"""Standard deviations of that by the source of the gripper's path: an arm trails its commands and
what it is sent to is a point of the hand, not of the fingertips."""

HOLD_RANGE = 4.0
"""How far from that mean a hold is looked for, in standard deviations."""

LEAST_REACH = 0.4
"""The smallest grip that a grid resolves, in cells."""

STATED_REACH_SD = 0.003
"""Standard deviation of a reach that the recording states [m]."""

LEAST_TILT = -0.2
"""Fingers turn a corner down, hardly ever up [rad]."""

LARGEST_BEND = 0.4
"""Largest step of the search for a hold in the logarithm of the bending length."""

_LEVEL = Held(hold=replace(HOLD_MEAN, tilt=0.2), bending=0.05)
_HANGING = Held(
    hold=replace(HOLD_MEAN, lag=0.1, height=-0.03, inset=0.04, tilt=1.4, sink=0.015), bending=0.08
)


def hold_guesses(recording: Recording, *, size: float) -> list[Held]:
    """Where the search for a hold begins.

    A level corner at the stated point; where the path was commanded, also a hanging one at
    fingertips below it that reach further in: what lies between them looks alike from afar, and a
    search from one side stays there.

    Args:
        recording: The lift.
        size: Diagonal of the cloth [m].
    """
    guesses = [_LEVEL, _HANGING]
    if recording.gripper_source == "measured":
        guesses = [replace(_LEVEL, hold=replace(_LEVEL.hold, lag=0.0))]
    reach = recording.object.grasp_radius or HOLD_MEAN.reach
    return [Held(hold=replace(g.hold, reach=reach), bending=g.bending * size) for g in guesses]


def shaped_guesses(guesses: Sequence[Held]) -> list[Held]:
    """Where the search for a cloth that does not lie flat begins: hanging, its corner pleated."""
    last = guesses[-1]
    return [replace(last, hold=replace(last.hold, pleat=1.0, **SHAPE_MEAN))]


def hold_bounds(
    recording: Recording,
    *,
    size: float,
    cell: float,
    table_seen: bool,
    shaped: bool = False,
    bending: float | None = None,
    friction: float | None = None,
) -> Bounds:
    """Limits and prior of a held cloth, in the order of ``hold.NAMES``.

    Args:
        recording: The lift.
        size: Diagonal of the cloth [m].
        cell: Of the grid with which it is searched [m].
        table_seen: Whether clouds show what lies on the table.
        shaped: Whether the cloth may be other than flat.
        bending: How far the cloth bends, where that is known [m].
        friction: Its coefficient of friction, where that is known.
    """
    described, source = recording.object, recording.gripper_source
    assert described.width is not None and described.height is not None
    sd = np.array([*astuple(HOLD_SD.get(source, HOLD_SD["commanded"])), FRICTION_PRIOR[1], 1.0])
    mean = np.array([*astuple(HOLD_MEAN), FRICTION_PRIOR[0], 0.0])
    lag, inset, tilt, sink, reach, rubs, bends = (
        NAMES.index(name)
        for name in ("lag", "inset", "tilt", "sink", "reach", "friction", "log_bending")
    )
    if source == "measured":
        mean[lag] = 0.0
    if described.grasp_radius is not None:
        mean[reach], sd[reach] = described.grasp_radius, STATED_REACH_SD
    sd[sd == 0.0] = 1.0  # of what a flat cloth has no more than one value of
    # how far it bends is searched over its range without preference: a wide Gaussian
    logs = np.log(np.array(BENDING_RANGE["cloth"]) * size)
    mean[bends], sd[bends] = logs.mean(), np.ptp(logs)
    low, high = mean - HOLD_RANGE * sd, mean + HOLD_RANGE * sd
    low[bends], high[bends] = logs
    low[rubs], high[rubs] = FRICTION_RANGE
    low[[lag, inset, sink]] = 0.0
    low[tilt], low[reach] = LEAST_TILT, LEAST_REACH * cell
    high[inset] = min(high[inset], described.width / 4.0, described.height / 4.0)
    if recording.quasi_static:
        # its clock is rescaled, so that a lag in seconds means nothing
        mean[lag] = high[lag] = 0.0
    if table_seen:
        # it lies where it is stated
        mean[sink] = high[sink] = 0.0
    for name, deviation in SHAPE_SD.items():
        n = NAMES.index(name)
        if shaped:
            mean[n], sd[n] = SHAPE_MEAN.get(name, mean[n]), deviation
        wide = HOLD_RANGE * sd[n] if shaped else 0.0
        low[n], high[n] = mean[n] - wide, mean[n] + wide
    if shaped:
        low[NAMES.index("crumple")] = LEAST_CRUMPLE
    if bending is not None:
        mean[bends] = low[bends] = high[bends] = np.log(bending)
    if friction is not None:
        mean[rubs] = low[rubs] = high[rubs] = friction
    largest = sd.copy()
    largest[bends] = LARGEST_BEND
    return Bounds(
        low=low, high=high, mean=mean, sd=sd, largest_step=largest, tolerance=0.02 * largest
    )
