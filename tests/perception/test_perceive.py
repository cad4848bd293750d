"""The Python API, with cameras that are no folders."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.datasets import Recording
from gendom.errors import ParameterError, RecordingError
from gendom.perception import (
    CameraRecording,
    Frame,
    FrameSource,
    PerceptionSettings,
    RobotPath,
    perceive,
)

META = {"object": {"kind": "rope", "length": 0.4, "diameter": 0.01}, "table_height": 0.0}


class Live:
    """A camera that renders when asked, as a device or a vendor's recording would deliver."""

    def __init__(self, world, camera, frames=4, held=None):
        self.camera, self._world, self._frames = camera, world, frames
        self._held = held or (lambda t: world.lifted_rope(tip=(0.0, 0.0, 0.2 + 0.01 * t)))
        self.decoded = 0

    def __iter__(self):
        for t in range(self._frames):
            yield Frame(t / 30, f"frame {t}", lambda t=t: self._render(t))

    def _render(self, t):
        self.decoded += 1
        return self._world.Scene([self._world.Plane(), self._held(t)]).pictures(self.camera, seed=t)


@pytest.fixture
def live(world):
    def sighting(frames=4, meta=META, times=(0.0, 1.0)):
        cameras = [
            world.make_camera("left", scale=0.5),
            world.make_camera("right", eye=(0.1, 0.65, 0.47), scale=0.5),
        ]
        path = np.array([[[0.0, 0.0, 0.2]], [[0.0, 0.0, 0.5]]])
        robot = RobotPath(np.array(times), path)
        return CameraRecording([Live(world, c, frames) for c in cameras], robot, meta, where="live")

    return sighting


SETTINGS = PerceptionSettings(colour=(180, 30, 35), workspace=(-0.4, -0.4, -0.05, 0.4, 0.4, 0.4))


def test_any_source_of_frames_will_do(world, live, tmp_path):
    sighting = live()
    assert all(isinstance(source, FrameSource) for source in sighting.sources)
    seen = []
    found = perceive(
        sighting, SETTINGS, on_frame=lambda time, cloud: seen.append(len(cloud.points))
    )
    assert seen == found.counts[:, -1].tolist() == np.diff(found.recording.offsets).tolist()
    np.testing.assert_allclose(found.recording.gripper_position[:, 0, 2], 0.2 + 0.01 * np.arange(4))
    found.recording.write(tmp_path / "a.npz")
    again = Recording.read(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.points, found.recording.points)
    np.testing.assert_array_equal(again.seen_by, found.recording.seen_by)
    assert again.extra["perception"]["cameras"] == ["left", "right"]
    with pytest.raises(RecordingError, match=r"name the file \.npz"):
        found.recording.write(tmp_path / "a.txt")


def test_a_cloth_lifted_by_its_corner(world):
    """Steep enough for both cameras to see one side each."""

    def held(t):
        return world.Sheet((0.0, 0.0, 0.25 + 0.01 * t), (0.14, 0.05, -0.15), (-0.14, -0.05, -0.15))

    cameras = [world.make_camera(), world.make_camera("right", eye=(0.1, 0.65, 0.47))]
    path = np.array([[[0.0, 0.0, 0.25]], [[0.0, 0.0, 0.55]]])
    side = float(np.linalg.norm([0.14, 0.05, 0.15]))
    cloth = {"kind": "cloth", "width": side, "height": side, "thickness": 0.001, "grasp": "corner"}
    sighting = CameraRecording(
        [Live(world, camera, 2, held) for camera in cameras],
        RobotPath(np.array([0.0, 1.0]), path),
        {"object": cloth, "table_height": 0.0},
    )
    found = perceive(sighting, PerceptionSettings(colour=world.BLUE))
    assert found.recording.object.kind == "cloth" and found.seen_share > 0.7
    assert found.disagreement is not None and found.disagreement < 0.005
    for t in range(2):
        error = held(t).distance(found.recording.frame(t).astype(float))
        assert abs(error.mean()) < 1e-3 and np.sqrt(np.mean(error**2)) < 0.003


def test_specks_before_the_cloth_is_seen_say_nothing_about_the_cameras(world):
    """A cloth that lies within the table's noise: only its rims show, to each camera others."""
    places = {"left": (0.1, 0.1, 0.04), "right": (-0.1, -0.1, 0.04)}
    cameras = [world.make_camera(), world.make_camera("right", eye=(0.1, 0.65, 0.47))]

    def held(name):
        speck = world.Sphere(places[name], 0.012)
        sheet = world.Sheet((-0.1, -0.1, 0.1), (0.2, 0.0, 0.0), (0.0, 0.2, 0.0))
        return lambda t: speck if t < 5 else sheet

    cloth = {"kind": "cloth", "width": 0.2, "height": 0.2, "thickness": 0.001, "grasp": "corner"}
    sighting = CameraRecording(
        [Live(world, camera, 7, held(camera.name)) for camera in cameras],
        RobotPath(np.array([0.0, 1.0]), np.full((2, 1, 3), 0.1) * [-1.0, -1.0, 1.0]),
        {"object": cloth, "table_height": 0.0},
    )
    found = perceive(sighting)
    assert found.disagreement is not None and found.disagreement < 0.005


def test_a_shift_along_a_rope_shows_when_it_is_lifted(world, live):
    """At first it lies straight, and 3 cm along it show nowhere."""
    straight = world.Rope(np.array([[-0.1, 0.0, 0.005], [0.3, 0.0, 0.005]]))

    def held(t):
        return straight if t < 6 else world.lifted_rope(tip=(0.0, 0.0, 0.25))

    def sighting(frames):
        found = live(frames)
        for source in found.sources:
            source._held = held
        right = found.sources[1]
        real, T = right.camera, right.camera.T_world_camera.copy()
        T[:3, 3] += [0.03, 0.0, 0.0]
        right._render = lambda t: world.Scene([world.Plane(), held(t)]).pictures(real, seed=t)
        right.camera = real.at(T)
        height = [[[0.0, 0.0, 0.005]], [[0.0, 0.0, 0.005]], [[0.0, 0.0, 0.25]]]
        return replace(found, robot=RobotPath(np.array([0.0, 0.19, 1.0]), np.array(height)))

    lying = perceive(sighting(6), SETTINGS)
    assert lying.disagreement is not None and lying.disagreement < 0.01
    with pytest.raises(RecordingError, match=r"cameras left, right place the object \d+ mm apart"):
        perceive(sighting(26), SETTINGS)


def test_frames_outside_of_the_robots_path_are_not_decoded(live):
    sighting, warnings = live(times=(1 / 30, 1.0)), []
    found = perceive(sighting, SETTINGS, on_warning=warnings.append)
    assert found.recording.num_frames == 3 and sighting.sources[0].decoded == 3
    assert "1 of 4 frames are outside" in str(warnings[0])


def test_table_height_is_measured_where_it_is_unknown(live):
    meta = {"object": META["object"]}
    found = perceive(live(2, meta), SETTINGS)
    assert found.recording.table_height == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("degrees", "rise", "told"), [(0.3, 0.003, 0), (1.5, -0.007, 2)])
def test_cameras_are_levelled_by_the_table(live, world, degrees, rise, told):
    """Their calibration is off in opposite ways; what lies on the table lies there again."""
    rod = world.Rope(np.array([[-0.2, 0.0, 0.005], [0.2, 0.0, 0.005]]))

    def heights(degrees, rise, level=True):
        """[2] of the rod to each camera [m], warnings, and how cameras were moved."""
        found, warnings = live(2), []
        for sign, source in zip((1.0, -1.0), found.sources, strict=True):
            real, T = source.camera, np.eye(4)
            turn = Rotation.from_euler("xy", [sign * degrees, 0.5 * degrees], degrees=True)
            T[:3, :3], T[2, 3] = turn.as_matrix(), sign * rise
            source._render = lambda t, real=real: world.Scene([world.Plane(), rod]).pictures(
                real, seed=t
            )
            source.camera = real.at(T @ real.T_world_camera)
        held = np.array([[[-0.2, 0.0, 0.005]], [[-0.2, 0.0, 0.3]]])
        found = replace(found, robot=RobotPath(np.array([0.0, 1.0]), held))
        p = perceive(found, replace(SETTINGS, no_level=not level), on_warning=warnings.append)
        points = [p.recording.points[p.recording.seen_by == 1 << k] for k in (0, 1)]
        told = sum("it is moved to where that is right" in str(w) for w in warnings)
        return (
            np.array([np.median(x[:, 2]) for x in points]),
            told,
            p.recording.extra["perception"]["levelled"],
        )

    exact, none, _ = heights(0.0, 0.0, level=False)
    level, said, moved = heights(degrees, rise)
    stated, _, unmoved = heights(degrees, rise, level=False)
    assert np.abs(level - exact).max() < 7e-4 < 2e-3 < np.abs(stated - exact).max()
    assert (none, said) == (0, told)
    assert moved["left"]["rise"] == pytest.approx(-rise, abs=1e-3)
    assert moved["right"]["turn"] == pytest.approx(np.radians(1.118 * degrees), abs=2e-3)
    assert unmoved == {}


def test_wrong_table_height_is_refused(live):
    with pytest.raises(RecordingError, match="correct table_height"):
        perceive(live(2, {**META, "table_height": 0.04}), SETTINGS)


def test_path_between_its_rows():
    axis = np.array([[[0, 0, 1.0]], [[1.0, 0, 0]]])
    path = RobotPath(np.array([0.0, 2.0]), np.array([[[0, 0, 0.0]], [[0, 0, 1.0]]]), axis)
    position, direction = path.at(0.5) or (None, None)
    assert position is not None and direction is not None
    np.testing.assert_allclose(position, [[0, 0, 0.25]])
    np.testing.assert_allclose(np.linalg.norm(direction), 1.0)
    assert direction[0, 2] > direction[0, 0] > 0
    assert path.at(2.1) is None and path.at(2.0) is not None


def test_a_gripper_stays_as_the_last_row_says():
    closed = np.array([[True], [True], [False]])
    path = RobotPath(np.array([0.0, 1.0, 2.0]), np.zeros((3, 1, 3)), closed=closed)
    states = [path.closed_at(time) for time in (0.0, 1.99, 2.0, 2.1)]
    assert [None if state is None else state.tolist() for state in states] == [
        [True],
        [True],
        [False],
        [False],
    ]
    assert RobotPath(path.time, path.position).closed_at(1.0) is None


def test_frames_know_whether_the_gripper_was_closed(live):
    sighting = live(3)
    assert perceive(sighting, SETTINGS).recording.gripper_closed is None
    robot = RobotPath(
        np.array([0.0, 0.05, 1.0]),
        np.array([[[0.0, 0.0, z]] for z in (0.2, 0.215, 0.5)]),
        closed=np.array([[True], [False], [False]]),
    )
    found = perceive(replace(sighting, robot=robot), SETTINGS).recording
    assert found.gripper_closed is not None
    assert found.gripper_closed[:, 0].tolist() == [True, True, False]


@pytest.mark.parametrize(
    "wrong",
    [
        {"colour": (1, 2, 300)},
        {"colour": (1, 2, 3), "pick": ("left", 1, 1)},
        {"sync_tolerance": -1.0},
    ],
)
def test_bad_settings(wrong):
    with pytest.raises(ParameterError):
        PerceptionSettings(**wrong)


def test_milliseconds_are_refused():
    with pytest.raises(ParameterError, match="is 20 s; give seconds: 20 ms are 0"):
        PerceptionSettings(sync_tolerance=20.0)
