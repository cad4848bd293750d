"""What tests of several folders need: recordings, new interpreters, the RealSense SDK."""

import gc
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from gendom import cli
from gendom.datasets import ObjectDescription, Recording
from gendom.errors import DeviceError
from gendom.estimation import LiftScene, SceneSettings, Theta, replay
from gendom.materials.parameters import E_over_rho_of
from gendom.observation import visible
from gendom.perception.realsense import realsense_sdk
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation

gc.disable()  # while modules are imported
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # programs of tests inherit that

CAMERAS = np.array([[0.1, -0.8, 0.6], [0.1, 0.8, 0.6]])
"""On both sides of an object that lies along x [m]."""


@dataclass(frozen=True, kw_only=True)
class SimulatedLift:
    """An object that is lifted in 1.6 s and then held still, seen by two noisy cameras."""

    object: ObjectDescription
    rise: float
    """[m]."""
    settings: SceneSettings
    """A coarse and quick simulation."""
    truth: Theta
    """Of the object; its recordings are held as they say."""
    lying: np.ndarray = field(repr=False)
    """[n, 3] its upper side at rest [m]."""
    lowest: float
    """Of the gripper [m]."""

    def recording(self, clouds, swing: float = 0.0, **changes) -> Recording:
        """These clouds, seen while the gripper goes up and then jerks ``swing`` metres on."""
        time = np.linspace(0.0, 2.8 if swing else 2.0, len(clouds))
        onwards = swing * np.clip((time - 1.6) / 0.15, 0.0, 1.0)
        share = np.clip(time / 1.6, 0.0, 1.0)
        height = self.lowest + self.rise * (3.0 * share**2 - 2.0 * share**3)
        values = {
            "object": self.object,
            "table_height": 0.0,
            "gripper_source": "measured",
            "camera_positions": CAMERAS,
            "source": "made by a test",
        }
        return Recording.from_frames(
            clouds,
            time=time,
            gripper_position=np.stack([onwards, 0.0 * time, height], axis=1),
            **{**values, **changes},
        )

    def at_rest(self, frames: int = 3, **changes) -> Recording:
        """The lift, its clouds as if the object had stayed on the table."""
        return self.recording([self.lying] * frames, **changes)

    def seen(self, *, frames=12, points=120, noise=1e-3, seed=0, swing=0.0, **truth) -> Recording:
        """The simulated lift, as the cameras see it: clouds of some points with noise [m]; the
        gripper jerks at the end by a swing [m]. `truth` are changes to the parameters."""
        rng = np.random.default_rng(seed)
        scene = LiftScene.of(self.at_rest(frames, swing=swing), self.settings)
        scene = replace(scene, frames=tuple(range(frames)))  # not only those worth comparing
        clouds = []
        for x in replay(scene, [self.truth.with_values(truth)])[:, 0]:
            skin = filled(scene, x)
            if scene.kind == "rope":
                skin = skin[visible(skin, camera_positions=CAMERAS)]
            skin = skin[rng.choice(len(skin), size=min(points, len(skin)), replace=False)]
            clouds.append(skin + noise * rng.normal(size=skin.shape))
        return self.recording(clouds, swing=swing)


def filled(scene: LiftScene, x: np.ndarray) -> np.ndarray:
    """[m, 3] points all over the skin of a simulated object [N, 3] of the thin engine [m]."""
    if scene.kind == "rope":
        return scene.body.surface(x)
    rows, columns = scene.body.shape
    sheet = x.reshape(rows, columns, 3)
    for axis in (0, 1):
        at = np.linspace(0.0, sheet.shape[axis] - 1.0, 40)
        k = np.minimum(at.astype(int), sheet.shape[axis] - 2)
        share = np.expand_dims(at - k, (1, 2) if axis == 0 else (0, 2))
        sheet = (1.0 - share) * sheet.take(k, axis) + share * sheet.take(k + 1, axis)
    return sheet.reshape(-1, 3)


def pytest_collection_finish() -> None:
    gc.freeze()  # looking for garbage in what is imported took a fiftieth of the time
    gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests of GPUs skip where there is none."""
    if item.get_closest_marker("gpu") is not None and not wp.is_cuda_available():
        pytest.skip("no CUDA device on this machine")


@pytest.fixture(scope="session")
def rope_lift() -> SimulatedLift:
    """A rope of 0.25 m that bends over a third of its length."""
    length, diameter, density = 0.25, 0.012, 1000.0
    x = np.linspace(0.0, length, 300)
    return SimulatedLift(
        object=ObjectDescription(
            kind="rope", length=length, diameter=diameter,
            mass=density * math.pi / 4.0 * diameter**2 * length,
        ),
        rise=0.12,
        settings=SceneSettings(points=15, threads=1),
        truth=Theta(E_over_rho=E_over_rho_of(0.35 * length, diameter / 4.0, 9.81)),
        lying=np.stack([x, 0.0 * x, np.full(300, diameter)], axis=1),
        lowest=diameter / 2.0,
    )  # fmt: skip


@pytest.fixture(scope="session")
def cloth_lift() -> SimulatedLift:
    """A square of 0.2 m, lifted by a corner, that bends over a tenth of its diagonal."""
    side, thickness, density = 0.2, 0.002, 400.0
    u, v = (g.ravel() for g in np.meshgrid(*[np.linspace(0.0, side, 30)] * 2))
    return SimulatedLift(
        object=ObjectDescription(
            kind="cloth", width=side, height=side, thickness=thickness, grasp="corner",
            mass=density * side**2 * thickness,
        ),
        rise=0.2,
        settings=SceneSettings(points=9, threads=1),
        truth=Theta(
            E_over_rho=E_over_rho_of(0.1 * side * 2**0.5, thickness / 12**0.5, 9.81),
            grip_tilt=0.8,
        ),
        lying=np.stack([u, v, np.full(len(u), thickness)], axis=1),
        lowest=thickness / 2.0,
    )  # fmt: skip


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test skips where there is none."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    folder = Path(os.environ.get("GENDOM_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}; set GENDOM_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def run_python() -> Callable[[str], str]:
    """Runs code in a new interpreter, in which nothing has been imported; gives what it prints."""

    def run(code: str) -> str:
        words = [sys.executable, "-c", code]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()

    return run


@pytest.fixture
def refused(capsys) -> Callable[..., str]:
    """Runs a command that ends with exit code 2 and prints nothing but one line: gives that."""

    def run(*words: object) -> str:
        code, (out, err) = cli.main([str(word) for word in words]), capsys.readouterr()
        assert (code, out, err.count("\n")) == (2, "", 1), err
        return err

    return run


@pytest.fixture
def quick(monkeypatch):
    """A world that takes no time and reaches twice as far as the release; every fifth demonstration
    fails."""

    def carry_out(self, task, items, actions, **_):
        if self.device == "ctrl-c":
            raise KeyboardInterrupt
        rope, cloth = task.name == "rope-reaching", {"share": 0.8, "unspread": 0.2}
        made = ({"x": 2.0 * a[0], "sideways": 0.01 * k} for k, a in enumerate(np.asarray(actions)))
        faults = (None if k % 5 else "diverged" for k in range(len(actions)))
        return [
            Outcome(values=values if rope else cloth, fault=fault)
            for values, fault in zip(made, faults, strict=True)
        ]

    monkeypatch.setattr(Simulation, "carry_out", carry_out)


@pytest.fixture(scope="session")
def sdk():
    """RealSense's module; without it the test is skipped."""
    try:
        return realsense_sdk()
    except DeviceError as error:
        pytest.skip(str(error))
