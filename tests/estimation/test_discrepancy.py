"""What the simulator cannot explain makes parameters uncertain."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import SimulationError
from gendom.estimation import EstimateSettings, estimate
from gendom.estimation import discrepancy as room
from gendom.estimation.calibration import IntervalCalibration
from gendom.estimation.discrepancy import discrepancy, tip_suspected, with_fingers
from gendom.estimation.likelihood import NoiseModel
from gendom.materials.posterior import IDENTIFIABLE

NAMES = ("E_over_rho", "grip_height")
SIZE, LEAST = 0.5, 1e-7


@dataclass
class Given:
    """A problem whose shapes have one point, whose x is a function of the first unknown."""

    x: Any
    held: int = 2
    static: bool = False
    shown: Any = (0, 1)

    def __post_init__(self):
        self.prior = SimpleNamespace(
            names=NAMES, sd=np.array([2.0, 0.01]), low=np.full(2, -9.0), high=np.full(2, 9.0)
        )
        scene = SimpleNamespace(
            size=SIZE, held=[None] * self.held, static=self.static, thin=True, kind="rope"
        )
        self.parts = [SimpleNamespace(scene=scene, shown=np.array(self.shown))]

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


def test_what_no_recording_shows_is_left_alone():
    assert deviations(0.004, lambda v: 0.02 * v, shown=(1,)).tolist() == [0.0, 0.0]


def test_changes_too_small_to_be_tried_are_extrapolated():
    assert deviations(1e-5, lambda v: 0.02 * v)[0] == pytest.approx(5e-4, rel=1e-3)


@pytest.mark.parametrize("by", [0.0012, 0.0045, 0.016, 0.06, 0.3])
def test_between_changes_that_are_tried_it_is_linear(by):
    """Of a displacement that grows with the square of the change."""
    changes = 2.0 * np.array([0.0, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, IDENTIFIABLE])
    expected = np.interp(by, changes**2, changes)
    assert deviations(by, lambda v: (v - 1.0) ** 2)[0] == pytest.approx(expected, rel=1e-4)


def test_a_turn_in_the_fingers_counts_a_quarter():
    names = ("damping", "E_over_rho", "grip_turn", "nu")
    sd = np.array([1.0, 2.0, 0.15, 0.02])
    covariance = np.diag([0.1, 0.2, 0.01, 0.001]) + 0.005 * (1.0 - np.eye(4))
    given: Any = SimpleNamespace(prior=SimpleNamespace(names=names, sd=sd))
    found: Any = SimpleNamespace(best=SimpleNamespace(vector=np.array([3.0, 4.0, 0.4, 0.3])))
    moved = np.array([0.05, 0.05, 0.1, 0.02])  # the last no more than its prior's
    expected = covariance + np.outer(moved, moved)
    assert with_fingers(given, found, covariance) == pytest.approx(expected)
    given.prior.names = ("damping", "E_over_rho", "friction", "nu")
    assert (with_fingers(given, found, covariance) == covariance).all()


class Heavy:
    """A problem of one rope in which a heavier tip is the last unknown."""

    def __init__(self, sign, won, *, world=True):
        self.sign, self.won, self.tried = sign, won, []
        self.heavier = SimpleNamespace(parts=[Compared()]) if world else None
        self.prior = SimpleNamespace(
            names=NAMES, mean=np.zeros(2), sd=np.array([2.0, 1.0, 0.1]), clipped=np.array
        )
        self.scene = SimpleNamespace(held=[None], static=False, kind="rope", thin=True)
        self.parts, self.with_unknown = [self.scene], lambda name: self

    def compare(self, worlds, free):
        assert free == [2] and worlds[0].tolist() == [7.0, 1.0, 0.0]
        return [self.heavier]

    def gradient_and_hessian(self, evaluation, noise):
        # the tip's deviation is 1 / 3
        hessian = np.array([[4.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 9.25]])
        return -hessian @ np.array([0.6, 0.0, self.sign / 3.0]), hessian

    def value(self, vector, comparison, noise):
        return self.won if comparison is self.heavier else 0.0

    def searched(self, problem, settings):
        self.tried += list(settings.initial)
        if self.won is None:
            raise SimulationError("diverges")
        return SimpleNamespace(
            best=SimpleNamespace(vector=np.array([5.0, 1.0, 0.2]), comparison=self)
        )


class Compared:
    def __init__(self):
        self.J, self.widens, self.begun = np.zeros((1, 3)), np.zeros(3), []
        self.warm_start = self.begun.append


@pytest.mark.parametrize(
    ("sign", "won", "options", "said"),
    [
        (1.1, 9.1, {}, True),
        (0.9, 9.1, {}, False),  # no sign of it
        (1.1, 8.9, {}, False),  # hardly better
        (1.1, None, {}, False),  # diverges
        (1.1, 9.1, {"world": False}, False),
    ],
)
def test_a_heavy_tip_is_told(sign, won, options, said, monkeypatch):
    given: Any = Heavy(sign, won, **options)
    monkeypatch.setattr(room, "gauss_newton", given.searched)
    now = Compared()
    now.J, now.widens = np.full((1, 2), 3.0), np.full(2, 4.0)

    @dataclass
    class Best:
        vector: Any
        comparison: Any

    best = Best(np.array([7.0, 1.0]), SimpleNamespace(parts=[now]))
    found: Any = SimpleNamespace(best=best, noise=[None])
    moved, words = tip_suspected(given, found)
    assert moved.tolist() == ([-2.0, 0.0] if said else [0.0, 0.0])
    assert bool(words) == said and all("as if 20% of the mass" in text for text in words)
    if options:
        return
    (heavier,) = given.heavier.parts
    assert heavier.J.tolist() == [[3.0, 3.0, 0.0]] and heavier.widens.tolist() == [4.0, 4.0, 0.0]
    assert heavier.begun == [now]
    # the second search begins a prior's deviation of the tip away
    begun = [7.0 + 0.6 * 0.1 / (sign / 3.0), 1.0, 0.1]
    assert len(given.tried) == (sign > 1.0) and np.allclose(given.tried or [begun], [begun])


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
