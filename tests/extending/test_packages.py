"""The six recipes of CONTRIBUTING: packages of other people add by entry points, and what they add
is used on the command line."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.estimation import LiftScene
from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS, register
from gendom.policies.belief import believed
from gendom.tasks import RopeReaching
from gendom.viz.viewer import recording_model

EXAMPLES = Path(__file__).parents[2] / "examples"
TWIN = """
from gendom.tasks.task import Task
class Twin(Task):
    name = "rope-casting"
"""


def code(*place):
    return EXAMPLES.joinpath(*place).read_text(encoding="utf-8")


HEMP = code("recipes", "hemp.py")


PACKAGES = {  # module: its code, what it adds, by which name
    "dragging": (
        (EXAMPLES / "rope_dragging.py").read_text(encoding="utf-8"),
        "tasks",
        "RopeDragging",
    ),
    "broken": ("import no_such_module", "tasks", "Task"),
    "odd": ("Task = 3", "tasks", "Task"),
    "twin": (TWIN, "tasks", "Twin"),
    "hemp": (HEMP, "materials", "MATERIALS"),
    "flax": (HEMP.replace('"nu"', '"mu"').replace("hemp", "flax"), "materials", "MATERIALS"),
    "wet": (code("recipes", "humidity.py"), "unknowns", "HUMIDITY"),
    "grid": (code("recipes", "grid.py"), "methods", "grid"),
    "npy_camera": (code("recipes", "npy_camera.py"), "cameras", "NpyCamera"),
    "turntable": (code("recipes", "turntable.py"), "arms", "turntable"),
}

RUN = """
import contextlib, io, json, sys
from gendom import cli
told = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        told.append([cli.main(words.split()), out, err])
print(json.dumps([[code, out.getvalue(), err.getvalue()] for code, out, err in told]))
"""

COMMANDS = {
    "help": "help act",
    "dataset": "dataset rope-dragging --size 3 --out drags --seed 1",
    "materials": "materials hemp-rope --json",
    "twin": "twin hemp-rope --length 0.5 --to usd --out twin",
    "grid": "estimate lift.npz --points 15 --json --unknowns E_over_rho --method grid",
    "estimate": "estimate lift.npz --points 15 --json --unknowns E_over_rho humidity --starts 1 "
    "--out . --report report.html",
    "perceive": "perceive lift --no-table --out seen.npz --json",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("packages")


@pytest.fixture(scope="module")
def told(place, rope_lift):
    """Codes, results and logs of all commands, in one process that finds what was added: a module
    with an object for an entry point each."""
    for module, (code, kind, name) in PACKAGES.items():
        (place / f"{module}.py").write_text(code, encoding="utf-8")
        info = place / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[gendom.{kind}]\n{module} = {module}:{name}\n")
    rope_lift.seen().write(place / "lift.npz")
    write_lift(place / "lift")
    path = os.pathsep.join([str(place), *filter(None, sys.path)])
    words = [sys.executable, "-c", RUN, json.dumps(list(COMMANDS.values()))]
    options: dict = {"cwd": place, "env": {**os.environ, "PYTHONPATH": path}}
    run = subprocess.run(words, capture_output=True, text=True, encoding="utf-8", **options)
    assert run.returncode == 0 and run.stderr == "", run.stderr
    return dict(zip(COMMANDS, json.loads(run.stdout), strict=True))


def test_a_package_adds_a_task(told, place):
    """Another one cannot be imported, which stops nothing."""
    assert told["dataset"][0] == 0 and "rope-dragging" in told["help"][1].replace("\n", "")
    log = told["help"][2] + told["dataset"][2]
    for said in ("'broken' (broken:Task) is left out: ModuleNotFoundError",
                 "'odd' (odd:Task) is left out: ParameterError: it is no subclass",
                 "'twin' (twin:Twin) is left out: ParameterError"):  # fmt: skip
        assert said in log
    about = json.loads((place / "drags" / "dataset.json").read_text())
    assert about["task"]["name"] == "rope-dragging"


def test_packages_add_a_material_and_a_method(told, place, rope_lift):
    listed, twin, grid = told["materials"], told["twin"], told["grid"]
    assert [twin[0], grid[0]] == [0, 0], (twin, grid)
    assert any("'flax' is left out: flax-rope: " in log for _, _, log in told.values())
    assert json.loads(listed[1])["sources"]["own-2024"]["text"] == "Our own bench, 2024"
    assert json.loads((place / "twin" / "twin.json").read_text())["object"]["E"] == 1.1e6
    record = json.loads(grid[1])
    assert record["method"] == "grid"
    assert 0.5 < record["E_over_rho"] / rope_lift.truth.E_over_rho < 2.0


def test_a_package_adds_an_unknown(told, rope_lift, place, monkeypatch):
    """It is found in the file, the report, the viewer and the policies' belief."""
    humidity = runpy.run_path(str(EXAMPLES / "recipes" / "humidity.py"))["HUMIDITY"]
    monkeypatch.setitem(UNKNOWNS, "humidity", humidity)  # known here, where the results are read
    made = told["estimate"]
    assert made[0] == 0, made
    record, found = json.loads(made[1]), Estimate.load(place / "estimate.json")
    low, high = found.posterior.interval("humidity", 0.9)
    assert low < found.theta["humidity"] < high and record["intervals"]["humidity"] == [low, high]
    assert humidity.title in "\n".join(name for name, *_ in found.rows())
    page = (place / "report.html").read_text(encoding="utf-8").lower()
    assert f'class="name" data-label="quantity">{humidity.title}</td>' in page
    assert humidity.title in page.split("usable.", 1)[1].split("</p>", 1)[0]  # the verdict
    scene = LiftScene.of(rope_lift.seen(), rope_lift.settings)
    sliders = recording_model(scene, found.theta, "").sliders
    assert "humidity" in [s.unknown.name for s in sliders]
    belief = believed(found, RopeReaching())
    E = [item.material.E for item in belief.draws(50, seed=0)]
    # the lift shows the product of both alone, so E varies less than each of them
    assert 0.0 < np.std(np.log(E)) < 0.5 * belief.sd[belief.names.index("humidity")]
    with pytest.raises(ParameterError, match="already"):
        register(humidity)


VIEW = """\
width = 160
height = 120
depth_unit = 0.001
K = [[200.0, 0.0, 80.0], [0.0, 200.0, 60.0], [0.0, 0.0, 1.0]]
# at (0, -0.6, 0.2), it looks along y
T_world_camera = [[1, 0, 0, 0], [0, 0, 1, -0.6], [0, -1, 0, 0.2], [0, 0, 0, 1]]
"""


def write_lift(lift):
    """A hanging rope before a wall, and the turntable's post beside it."""
    depth = np.full((4, 120, 160), 1500, np.uint16)  # [mm]
    for t in range(4):
        depth[t, 25 : 105 - 3 * t, 79:82] = 600
    depth[:, 20:110, 118:123] = 600  # the post
    camera = lift / "cameras" / "left"
    camera.mkdir(parents=True)
    (camera / "camera.toml").write_text(VIEW)
    np.save(camera / "times.npy", np.arange(4) / 30)
    np.save(camera / "depth.npy", depth)
    for name, header, row in (("gripper", "time,x,y,z", "0,0,0.31"), ("joints", "time,q0", "0")):
        rows = [header, *(f"{t / 30},{row}" for t in range(4))]
        (lift / f"{name}.csv").write_text("\n".join(rows) + "\n")
    described = '[object]\nkind = "rope"\nlength = 0.25\ndiameter = 0.01\n'
    (lift / "object.toml").write_text(f'robot = "turntable"\n{described}')


def test_packages_add_a_camera_and_a_robot(told, place):
    made = told["perceive"]
    assert made[0] == 0, made
    said = json.loads(made[1])
    points = said["points"]
    assert said["frames"] == 4 and points["robot"]["median"] < 0.5 * points["support"]["median"]
    points = Recording.read(place / "seen.npz").frame(0)
    assert len(points) > 20 and np.abs(points[:, :2]).max() < 0.01
