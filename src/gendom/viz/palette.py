"""Colours of all pictures, and round steps of axes."""

import math

# From Okabe and Ito's palette, told apart with every common form of colour blindness.
RECORDED_COLOR = "#0072B2"
SIMULATED_COLOR = "#E69F00"
OBSTACLE_COLOR = "#8C96A0"
GOAL_COLOR = "#009E73"
ARM_COLOR = "#B4BBC3"
GRIPPER_COLOR = "#222222"

INK = (34, 34, 34)
TABLE_FILL = (244, 244, 244)
TABLE_LINE = (150, 150, 150)
SIMULATED_OPACITY = 0.55
RECORDED_OPACITY = 0.9


def nice_step(at_least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is not below `at_least`."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))
