"""What the simulator cannot explain makes parameters uncertain."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, estimate
from gendom.estimation.calibration import IntervalCalibration
from gendom.estimation.discrepancy import discrepancy
from gendom.estimation.likelihood import NoiseModel

NAMES = ("E_over_rho", "grip_height")
SIZE, LEAST = 0.5, 1e-7


@dataclass
class Given:
    """A problem whose shapes have one point, whose x is a function of the first unknown."""

    x: Any
    held: int = 2
    static: bool = False

    def __post_init__(self):
        self.prior = SimpleNamespace(
            names=NAMES, sd=np.array([2.0, 0.01]), low=np.full(2, -9.0), high=np.full(2, 9.0)
        )
        scene = SimpleNamespace(
            size=SIZE, held=[None] * self.held, static=self.static, thin=True, kind="rope"
        )
        self.parts = [SimpleNamespace(scene=scene, shown=np.array([0, 1]))]

    def positions(self, worlds, recording):
        x = np.zeros((1, len(worlds), 1, 3))
        x[0, :, 0] = np.array([[self.x(w[0])] * 3 for w in worlds])
        return x


NOT_CALIBRATED = IntervalCalibration.none()


def deviations(model, x, calibration=NOT_CALIBRATED, **options):
    found: Any = SimpleNamespace(
        noise=[NoiseModel(model=model, least_model=LEAST)],
        best=SimpleNamespace(
            vector=np.array([1.0, 0.0]),
            comparison=SimpleNamespace(
                parts=[SimpleNamespace(fit=lambda noise: SimpleNamespace(rms=0.003))]
            ),
        ),
    )
    given: Any = Given(x, **options)
    return discrepancy(given, found, np.diag([1e-4, 1e-4]) ** 2, calibration)


def test_a_parameter_is_as_uncertain_as_the_displacement_that_it_makes():
    sd = deviations(0.004, lambda v: 0.02 * v)
    assert sd[0] == pytest.approx(0.2)
    assert sd[1] == 0.0  # how it is held is not the object's


def test_changes_too_small_to_be_tried_are_extrapolated():
    assert deviations(1e-5, lambda v: 0.02 * v)[0] == pytest.approx(5e-4, rel=1e-3)


def test_derivatives_of_what_swings_determine_nothing():
    """A small change moves it as much as a large one."""
    assert deviations(0.004, lambda v: 0.003 * np.sin(1e3 * v))[0] == 2.0


def test_one_direction_that_moves_nothing_is_enough():
    assert deviations(0.004, lambda v: 0.02 * min(v, 1.0))[0] == 2.0


def test_worlds_that_diverge_say_nothing():
    sd = deviations(0.004, lambda v: 0.02 * v if v < 1.0 + 1e-9 else np.nan)
    assert sd[0] == pytest.approx(0.2)


def test_what_calibrated_lifts_have_too_does_not_count():
    calibration = IntervalCalibration(factor={}, added={}, displaced=0.01)
    assert deviations(0.0049, lambda v: 0.02 * v, calibration, held=1)[0] == 0.0
    assert deviations(0.013, lambda v: 0.02 * v, calibration, held=1)[0] == pytest.approx(0.6)
    # only lifts by one gripper were calibrated
    assert deviations(0.0049, lambda v: 0.02 * v, calibration)[0] == pytest.approx(0.245)
    # the least that is looked for is none
    assert deviations(LEAST, lambda v: 0.02 * v)[0] == 0.0


def test_of_a_shape_at_rest_all_that_is_left_counts():
    """Its `fit` is 3 mm off; no displacement is estimated."""
    assert deviations(0.0049, lambda v: 0.02 * v, static=True)[0] == pytest.approx(0.15)


@pytest.mark.slow
def test_recordings_of_one_cable_do_not_contradict_each_other(real_data):
    """Each is fitted to 7 mm by moduli that differ by up to two hundred times."""
    found = []
    for name in ("train_001", "train_002", "train_006"):
        path = real_data / f"cable_dlo3_{name}.npz"
        if not path.is_file():
            pytest.skip(f"no {path.name} in {real_data}")
        recording = Recording.read(path, on_warning=lambda _: None)
        found.append(estimate(recording, EstimateSettings(starts=1)))
    ends = [one.interval("E_over_rho") for one in found]
    assert max(low for low, _ in ends) < min(high for _, high in ends)
    assert not any(one.record["identifiable"]["E_over_rho"] for one in found)
