"""`Cell` and `gendom cell`: what a file may say, what is wrong with a cell, what may be planned."""

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from PIL import Image

from gendom import cli
from gendom.errors import RobotError
from gendom.hardware.cell import BARE, Cell
from gendom.robot import DOWN, FR3, XARM7, Box, TcpPath, tcp_pose
from simulated_cell import box, write_cell

UNMOVED = np.eye(4).tolist()
STAND = '[[stand]]\nname = "s"\nend = [0, 0, 1]\n'
CAMERA = '[[camera]]\nname = "c"\ndevice = "simulated"\n'


@pytest.mark.parametrize(
    ("more", "changed", "words"),
    [
        (["[[boxes]]"], {}, "unknown key 'boxes'; did you mean 'box'?"),
        (['[[stand]]\nname = "a"\nradios = 1.0'], {}, "stand[0]: has the unknown key 'radios'"),
        ([], {"share": "0.3\nshar = 1"}, "speed: has the unknown key 'shar'; did you mean"),
        ([], {"tool": "0.9"}, "speed.tool: is not valid; give m/s up to 0.8"),
        ([], {"workspace": "[[0, 0, 0.5], [1, 1, 0.2]]"}, "workspace: is not valid"),
        ([], {"table_height": "0.0\nself_clearance = nan"}, "self_clearance: is not valid"),
        ([], {"robot": '"xarm6"'}, "there is no robot 'xarm6'; did you mean 'xarm7'?"),
        ([], {"robot": '"simulated"\narm = "ur5"'}, "there is no robot 'ur5'"),
        ([f"{STAND}radius = 1.0\nstart = [0, 0]"], {}, "its start is"),
        ([box("left", (0, 1, 1), (1, 1, 1)), box("left", (0, 2, 1), (1, 1, 1))], {}, "name of its"),
        ([box("a", (400, 300, 100), (80, 80, 80))], {}, "give metres, in the frame"),
        ([], {"robot": '"xarm7"\narm = "fr3"', "max_opening": "0.08"}, "arm: is not valid; give x"),
        ([], {"address": '"rope-coton"'}, "there is no object 'rope-coton'"),
        ([CAMERA.replace('"c"', '"../c"')], {}, "it names a folder"),
        ([f'{CAMERA}serial = "left"'], {}, "camera.serial: is not valid; give each its own"),
        ([f"{CAMERA}stated_error = -0.002"], {}, "stated_error: is not valid; give metres above 0"),
        ([f'{CAMERA}calibration = "no.toml"'], {}, "no such"),
        (['[[camera]]\nname = "c"\ndevice = "realsens"'], {}, "did you mean 'realsense'?"),
        ([f"{CAMERA}T_world_camera = {(2.0 * np.eye(4)).tolist()}"], {}, "is no rigid transform"),
        ([f'{CAMERA}T_world_camera = {UNMOVED}\ncalibration = "a.toml"'], {}, "leave one of them"),
    ],
)  # fmt: skip
def test_what_no_cell_can_say_is_refused_in_one_line(tmp_path, refused, more, changed, words):
    assert words in refused("cell", "check", write_cell(tmp_path, *more, **changed))


@pytest.mark.parametrize(
    ("more", "changed", "words"),
    [
        ([], {}, None),
        ([box("board", tcp_pose(XARM7, XARM7.home)[:3, 3], (0.1, 0.1, 0.1))], {}, "and board are "),
        ([], {"workspace": "[[0.5, -0.6, 0.0], [0.8, 0.6, 0.8]]"}, "does not hold the tool"),
        ([], {"workspace": "[[-800, -600, 0], [800, 600, 800]]"}, "goes 1.28e+03 m from the"),
        ([], {"workspace": "[[0.15, -0.6, -0.03], [0.8, 0.6, 0.8]]"}, "begins 30 mm below"),
    ],
)
def test_errors_of_a_cell(tmp_path, more, changed, words):
    faults = Cell.read(write_cell(tmp_path, *more, **changed)).faults(date(2026, 11, 25))
    assert [f.severity for f in faults] == ["error"] * (words is not None)
    assert all(words in f.what for f in faults)


def test_calibrations_that_are_old_or_absent_are_warned_of(tmp_path):
    path = write_cell(tmp_path, '[[camera]]\nname = "new"\ndevice = "realsense"')
    path.write_text(path.read_text().replace("stated_error = 0.002", "stated_error = 0.02", 1))
    ahead = {f.what for f in Cell.read(path).faults(date(2026, 11, 1))}
    assert "is calibrated 19 days from now" in ahead
    faults = Cell.read(path).faults(date(2027, 3, 1))
    assert {(f.severity, f.where, f.what) for f in faults} == {
        ("warning", "camera left", "states 0.02 m as its error"),
        ("warning", "camera left", "was calibrated 101 days ago"),
        ("warning", "camera new", "is not calibrated"),
        ("warning", "camera right", "was calibrated 101 days ago"),
    }


def test_what_was_planned_is_checked_against_the_cell_as_it_is(tmp_path):
    """0.3 m sideways between a wall and a shelf: a limit, a clearance of 2 mm more than there are,
    the workspace, what hangs out of the fingers, another arm."""
    shelf = box("shelf", (0.5, 0.3, 0.05), (0.2, 0.1, 0.1))  # from y = 0.25 on
    wall = box("wall", (0.5, 0.42, 0.4), (0.2, 0.1, 0.3))
    cell = Cell.read(write_cell(tmp_path, shelf, wall, tool="0.25", cameras=False))
    points = np.array([[0.5, 0.0, 0.35], [0.5, 0.25, 0.35]])
    path = TcpPath(time=np.array([0.0, 0.5]), position=points, quat_xyzw=np.array(DOWN))
    plan = cell.plan(path, opening=0.016)
    cell.check(plan)
    (scene, which), own = cell.least_clearances(plan.motion.q, opening=0.016)
    assert 0.0 < scene < 0.1 and "wall" in which and own[0] > 0.01
    replace(cell, scene_clearance=scene - 0.002).check(plan)
    for changes, words in (
        ({"scene_clearance": scene + 0.002}, r"wall are 2\.0 mm too near"),
        ({"self_clearance": 0.2}, r"mm too near"),
        ({"workspace": np.array([cell.workspace[0], [0.8, 0.2, 0.8]])}, "the workspace by 50 mm"),
        ({"speed": replace(cell.speed, tool=0.2)}, r"the tool .*limit 0\.2"),
        ({"arm": "fr3"}, "planned for xarm7, the cell has fr3"),
    ):
        with pytest.raises(RobotError, match=words):
            replace(cell, **changes).check(plan)
    with pytest.raises(RobotError, match="held object and shelf"):
        cell.check(replace(plan, hangs=0.35))
    # speeds are the cell's
    uses, slow = plan.motion.limit_uses(XARM7), plan.approach.limit_uses(XARM7)
    assert plan.motion.slowed_by > 1.5
    assert plan.approach.q[[0, -1]] == pytest.approx(np.array([XARM7.home, plan.motion.q[0]]))
    assert max(u.value for u in uses if u.joint is None) == pytest.approx(0.25, rel=0.02)
    assert max(u.share for u in uses if u.kind in ("speed", "acceleration")) <= 0.3 + 1e-9
    assert max(u.share for u in slow if u.kind != "angle") <= 0.1 + 1e-6
    slower = replace(cell, speed=replace(cell.speed, tool=0.05))
    tool = slower.approach(XARM7.home, plan.first).limit_uses(XARM7)[-1]
    assert tool.value <= 0.05 + 1e-6


def test_an_arm_is_its_robot_s_unless_the_cell_names_another(tmp_path):
    changed = {"robot": '"fr3"', "max_opening": "0.08"}
    assert Cell.read(write_cell(tmp_path, cameras=False, **changed)).model is FR3
    assert Cell.read(write_cell(tmp_path, cameras=False)).model is XARM7


def test_an_approach_goes_around_what_stands_in_its_way():
    q, size = XARM7.home + np.array([0.9, 0.3, 0, 0.3, 0, 0.0, 0]), np.full(3, 0.03)
    home, middle = tcp_pose(XARM7, np.stack([XARM7.home, 0.5 * (XARM7.home + q)]))[:, :3, 3]
    straight = BARE.approach(XARM7.home, q)
    around = replace(BARE, box=(Box(name="post", position=middle, size=size),))
    with pytest.raises(RobotError, match="post"):
        around.slow_move(XARM7.home, q, surroundings=around.surroundings, opening=0.084)
    way = around.approach(XARM7.home, q)
    assert way.end > straight.end and way.q[-1] == pytest.approx(q)
    with pytest.raises(RobotError, match=r"the approach: .* post are"):
        near = replace(BARE, box=(Box(name="post", position=home, size=5 * size),))
        near.approach(XARM7.home, XARM7.home + 0.01)


def test_the_picture_shows_what_stands_where(tmp_path, capsys):
    """A box that is moved towards larger y goes left in the view from the top, as the camera's."""
    columns = []
    for y in (-0.4, 0.4):
        path = write_cell(tmp_path, box("shelf", (0.5, y, 0.1), (0.1, 0.1, 0.2)), cameras=False)
        picture = tmp_path / "cell.png"
        assert cli.main(["cell", "check", str(path), "--picture", str(picture)]) == 0
        assert "warning" in capsys.readouterr().out  # no camera
        top = np.asarray(Image.open(picture).convert("RGB")).astype(int)[:620]
        columns.append(np.nonzero(np.abs(top - (214, 170, 140)).max(axis=2) < 12)[1].mean())
    assert columns[0] - columns[1] > 200
