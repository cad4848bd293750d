"""What else is in view: the cloud is right, or it is refused with the reason."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import CameraRecording, PerceptionSettings, RobotPath, perceive

WHITE, BEIGE, GREY, BLACK = (235, 235, 230), (205, 190, 160), (150, 150, 145), (30, 30, 30)
RED, SKIN = (180, 30, 35), (215, 165, 135)
META = {"object": {"kind": "rope", "length": 0.4, "diameter": 0.016}, "table_height": 0.0}


def rope_of(world, t, own):
    return world.lifted_rope(tip=(0.0, 0.0, 0.2 + 0.01 * t), radius=0.008, colour=own)


HAND = np.array([(0.2, 0.0, 0.03), (0.24, 0.1, 0.06)])
BESIDE = {
    "hand": (HAND, (0.025, 0.04), SKIN),
    "own hand": (HAND, (0.025, 0.04), None),
    "far hand": (np.add(HAND, [0.0, 0.12, 0.0]), (0.025, 0.04), SKIN),
    "own cable": ([[-0.1, 0.12, 0.006], [0.1, 0.15, 0.006], [0.3, 0.12, 0.006]], (0.006,), None),
    "branch": ([[0.1, 0.0, 0.008], [0.13, 0.1, 0.008], [0.15, 0.16, 0.008]], (0.008,), None),
    "crossing": ([[0.15, -0.25, 0.012], [0.17, 0.0, 0.012], [0.2, 0.25, 0.012]], (0.006,), None),
    "": (HAND, (), None),
}
"""Lines, radii and colours, the rope's own if None, of what is beside the rope, which lies on the
table along x up to about 0.25 m."""


def things(world, name, own):
    if name == "checks":
        places = np.mgrid[-1:5, -2:3].reshape(2, -1).T * 0.06
        return [world.Sheet((x, y, 1e-4), (0.03, 0, 0), (0, 0.03, 0), own) for x, y in places]
    line, radii, colour = BESIDE[name]
    return [world.Rope(np.array(line), radius, colour or own) for radius in radii]


def recorded(world, own=RED, table=GREY, beside="", frames=2):
    def scene(t):
        late = beside == "late branch" and t == 1
        others = things(world, "branch" if late else beside.removeprefix("late branch"), own)
        return world.Scene([world.Plane(colour=table), rope_of(world, t, own), *others])

    robot = RobotPath(np.array([0.0, 1.0]), np.array([[[0.0, 0.0, 0.2]], [[0.0, 0.0, 0.5]]]))
    sources = [world.Live(camera, scene, frames) for camera in world.pair()]
    return CameraRecording([*sources], robot, META, where="lift")


def far(world, recording):
    """Share of the points farther than 20 mm from the rope."""
    ropes = (rope_of(world, round(30 * t), BLACK) for t in recording.time)
    off = [r.distance(recording.frame(k).astype(float)) for k, r in enumerate(ropes)]
    return float((np.concatenate(off) > 0.02).mean())


@pytest.mark.parametrize(
    ("own", "table", "beside", "chosen"),
    [
        (WHITE, BEIGE, "far hand", True),
        (WHITE, GREY, "far hand", False),
        (RED, GREY, "checks", True),
        (RED, GREY, "own cable", True),
        (RED, GREY, "crossing", False),
    ],
)
def test_what_is_not_the_object_is_left_out(world, own, table, beside, chosen):
    warned = []
    found = perceive(
        recorded(world, own, table, beside),
        PerceptionSettings(colour=own if chosen else None),
        on_warning=lambda fault: warned.append(str(fault)),
    )
    assert found.recording.num_frames == 2 and found.seen_share > 0.8
    assert far(world, found.recording) < 0.05
    assert any("has the object's colour" in said for said in warned) == chosen


@pytest.mark.parametrize(("beside", "chosen"), [("hand", None), ("own hand", RED)])
def test_a_hand_at_its_end_is_left_out_or_refused(world, beside, chosen):
    try:
        found = perceive(recorded(world, beside=beside), PerceptionSettings(colour=chosen))
    except RecordingError as error:
        assert "other things are among the points" in error.what
    else:
        assert far(world, found.recording) < 0.05 and found.seen_share > 0.6


def test_what_could_be_the_object_is_refused(world):
    """A second rope that begins in the middle, and a table that is not looked for."""
    said = "in 2 of 2 frames other things are among the points, .*: "
    with pytest.raises(RecordingError, match=f"{said}more than one line could be the rope"):
        perceive(recorded(world, RED, GREY, "branch"))
    settings = PerceptionSettings(colour=WHITE, no_table=True)
    with pytest.raises(RecordingError, match=rf"{said}they cover \d+\.\d times as much"):
        perceive(recorded(world, WHITE, WHITE), settings)


def test_a_rope_of_too_few_pixels_needs_a_colour(world):
    """Without one mostly what is behind it would be left."""
    lift = recorded(world)
    lift = replace(lift, meta={**META, "object": {**META["object"], "diameter": 0.006}})
    with pytest.raises(RecordingError, match=r"is 1\.\d pixels across, .*; choose it by --colour"):
        perceive(lift)


def test_frames_with_other_things_are_left_out(world):
    warned = []
    lift = recorded(world, beside="late branch", frames=3)
    found = perceive(lift, on_warning=warned.append)
    assert found.recording.num_frames == 2 and far(world, found.recording) < 0.05
    assert "in 1 of 3 frames other things" in str(warned[0])


@pytest.fixture(scope="module")
def masked(world, tmp_path_factory):
    """A lift whose rope is touched by a hand, and masks of it."""
    folder = tmp_path_factory.mktemp("masked")
    hands = things(world, "hand", SKIN)
    ropes = world.write_lift(folder / "lift", frames=3, things=lambda t: hands)
    for camera in world.pair():
        (folder / "masks" / camera.name).mkdir(parents=True)
        rays = camera.position, camera.rays() @ camera.T_world_camera[:3, :3].T
        hand = np.min([thing.hit(*rays) for thing in hands], 0)
        for t, rope in enumerate(ropes):
            mask = 7 * (rope.hit(*rays) < hand).reshape(240, 320).astype(np.uint8)
            Image.fromarray(mask).save(folder / "masks" / camera.name / f"{t:06d}.png")
    return folder, ropes


def test_masks_of_another_program(masked, command):
    """They take the rope, with what lies on the table, and not the hand that touches it."""
    folder, ropes = masked
    code, said, out = command(folder / "lift", "--masks", folder / "masks")
    assert code == 0, said.err
    recording = Recording.read(out)
    for t, rope in enumerate(ropes):
        off = rope.distance(recording.frame(t).astype(float))
        assert (off > 0.02).mean() < 0.05 and abs(np.median(off)) < 0.003
    assert recording.frame(0)[:, 0].max() > 0.15


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda path: path.unlink(missing_ok=True), "there is no such mask"),
        (lambda path: Image.new("L", (320, 240)).save(path), "masks nothing"),
        (lambda path: Image.new("L", (640, 480), 1).save(path), "640 x 480, the camera 320"),
        (lambda path: path.write_bytes(b"GIF"), "is damaged"),
    ],
)
def test_bad_masks(masked, tmp_path, command, spoil, said):
    """One leaves a frame out with a warning; where all are bad, one line says why."""
    folder, _ = masked
    masks = shutil.copytree(folder / "masks", tmp_path / "masks")
    for places, codes in (([masks / "left" / "000002.png"], 0), (masks.rglob("*.png"), 2)):
        for path in places:
            spoil(path)
        code, printed, out = command(folder / "lift", "--masks", masks)
        assert code == codes and said in (printed.err or printed.out)
        assert len(printed.err.splitlines()) == code / 2
        assert Recording.read(out).num_frames == 2


@pytest.mark.slow
def test_drawn_scenes_are_right_or_refused(tmp_path):
    segmentation = pytest.importorskip("experiments.segmentation")
    rows = [row for number in range(1000, 1006) for row in segmentation.judged(number, tmp_path)]
    assert {outcome for _, _, outcome, _ in rows} <= {"right", "refused"}, rows
