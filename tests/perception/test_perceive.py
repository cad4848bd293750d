"""The Python API, with cameras that are no folders."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.arrays import rigid
from gendom.errors import RecordingError
from gendom.perception import CameraRecording, FrameSource, PerceptionSettings, RobotPath, perceive

ROPE = {"object": {"kind": "rope", "length": 0.4, "diameter": 0.01}, "table_height": 0.0}
SETTINGS = PerceptionSettings(colour=(180, 30, 35), workspace=(-0.4, -0.4, -0.05, 0.4, 0.4, 0.4))


def lifted(world, t):
    return world.lifted_rope(tip=(0.0, 0.0, 0.2 + 0.01 * t))


@pytest.fixture
def live(world):
    def recorded(
        frames=3, meta=ROPE, path=((0, 0, 0.2), (0, 0, 0.5)), times=(0.0, 1.0), held=lifted, **other
    ):
        """Of two cameras, `held` on a table; `stated` are their poses [4, 4]."""
        cameras = world.pair(other.get("scale", 0.5))
        stated = other.get("stated", [camera.calibrated() for camera in cameras])
        scene = lambda t: world.Scene([world.Plane(), held(world, t)])  # noqa: E731
        sources = [
            world.Live(c, scene, frames, c.at(T)) for c, T in zip(cameras, stated, strict=True)
        ]
        robot = RobotPath(np.array(times), np.array(path, float)[:, None])
        return CameraRecording([*sources], robot, meta, where="live")

    return recorded


def test_any_source_of_frames_will_do(live):
    """Frames outside of the robot's path are not decoded."""
    recorded, warnings = live(4, times=(1 / 30, 1.0)), []
    assert all(isinstance(source, FrameSource) for source in recorded.sources)
    found = perceive(recorded, SETTINGS, on_warning=warnings.append)
    assert recorded.sources[0].decoded == 3 and "1 of 4 frames are outside" in str(warnings[0])
    assert found.counts[:, -1].tolist() == np.diff(found.recording.offsets).tolist()
    assert found.recording.gripper_position[0, 0, 2] == pytest.approx(0.2)
    assert found.recording.extra["perception"]["cameras"] == ["left", "right"]
    # table height is measured where it is unknown
    found = perceive(live(1, {"object": ROPE["object"]}), SETTINGS)
    assert found.recording.table_height == pytest.approx(0.0, abs=1e-3)
    with pytest.raises(RecordingError, match="correct table_height"):
        perceive(live(1, {**ROPE, "table_height": 0.04}), SETTINGS)


def test_a_cloth_lifted_by_its_corner(world, live):
    """Steep enough for both cameras to see one side each."""

    def held(world, t):
        return world.Sheet((0.0, 0.0, 0.25 + 0.01 * t), (0.14, 0.05, -0.15), (-0.14, -0.05, -0.15))

    side = float(np.linalg.norm([0.14, 0.05, 0.15]))
    cloth = {"kind": "cloth", "width": side, "height": side, "thickness": 0.001, "grasp": "corner"}
    path = ((0.0, 0.0, 0.25), (0.0, 0.0, 0.55))
    lift = live(2, {"object": cloth, "table_height": 0.0}, path, held=held, scale=1.0)
    found = perceive(lift, PerceptionSettings(colour=(30, 60, 170)))
    assert found.recording.object.kind == "cloth" and found.seen_share > 0.7
    assert found.disagreement is not None and found.disagreement < 0.005
    for t in range(2):
        error = held(world, t).distance(found.recording.frame(t).astype(float))
        assert abs(error.mean()) < 1e-3 and np.sqrt(np.mean(error**2)) < 0.003


@pytest.mark.parametrize(("degrees", "rise", "told"), [(0.3, 0.003, 0), (1.5, -0.007, 2)])
def test_cameras_are_levelled_by_the_table(live, world, degrees, rise, told):
    """Their calibration is off in opposite ways; what lies on the table lies there again."""

    def heights(degrees, rise, level=True):
        """[2] of a rod to each camera [m], warnings, and how cameras were moved."""
        stated, warnings = [], []
        for sign, camera in zip((1.0, -1.0), world.pair(), strict=True):
            turn = Rotation.from_euler("xy", [sign * degrees, 0.5 * degrees], degrees=True)
            stated.append(rigid(turn.as_matrix(), [0.0, 0.0, sign * rise]) @ camera.calibrated())
        rod = world.Rope(np.array([[-0.2, 0.0, 0.005], [0.2, 0.0, 0.005]]))
        path = ((-0.2, 0.0, 0.005), (-0.2, 0.0, 0.3))
        found = live(1, path=path, held=lambda world, t: rod, stated=stated)
        p = perceive(found, replace(SETTINGS, no_level=not level), on_warning=warnings.append)
        points = [p.recording.points[p.recording.seen_by == 1 << k] for k in (0, 1)]
        said = sum("it is moved to where that is right" in str(w) for w in warnings)
        moved = p.recording.extra["perception"]["levelled"]
        return np.array([np.median(x[:, 2]) for x in points]), said, moved

    exact, none, _ = heights(0.0, 0.0, level=False)
    level, said, moved = heights(degrees, rise)
    stated, _, unmoved = heights(degrees, rise, level=False)
    assert np.abs(level - exact).max() < 1e-3 < 2e-3 < np.abs(stated - exact).max()
    assert (none, said) == (0, told)
    assert moved["left"]["rise"] == pytest.approx(-rise, abs=1e-3)
    assert moved["right"]["turn"] == pytest.approx(np.radians(1.118 * degrees), abs=2e-3)
    assert unmoved == {}
