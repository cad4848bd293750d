"""Packages of other people add by entry points: each is installed beside ours for one test."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gendom.datasets import Recording

EXAMPLE = Path(__file__).parents[2] / "examples" / "rope_dragging.py"


@pytest.fixture
def add(tmp_path):
    """Installs a module with an object for each kind of entry point, ``tasks="Dragging"``."""

    def installed(module: str, code: str, **points: str) -> None:
        (tmp_path / f"{module}.py").write_text(code, encoding="utf-8")
        info = tmp_path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        lines = [f"[gendom.{k}]\n{module} = {module}:{name}\n" for k, name in points.items()]
        (info / "entry_points.txt").write_text("".join(lines))

    return installed


@pytest.fixture
def gendom(tmp_path):
    """The command line, in a process that finds what was added."""

    def run(*words: object) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
        told = subprocess.run(
            [sys.executable, "-m", "gendom", *map(str, words)],
            capture_output=True,
            text=True,
            encoding="utf-8",
            env={**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"},
            cwd=tmp_path,
            check=False,
        )
        assert "Traceback" not in told.stderr
        return told

    return run


def test_a_package_adds_a_task(add, gendom, tmp_path):
    """Another one cannot be imported, which stops nothing."""
    add("dragging", EXAMPLE.read_text(encoding="utf-8"), tasks="RopeDragging")
    add("broken", "import no_such_module", tasks="Task")
    add("odd", "Task = 3", tasks="Task")
    add("twin", "from gendom.tasks.task import Task\nclass Twin(Task):\n    name = 'rope-casting'",
        tasks="Twin")  # fmt: skip
    drags = tmp_path / "drags"
    made = gendom("dataset", "rope-dragging", "--size", 3, "--out", drags, "--seed", 1)
    assert made.returncode == 0, made.stderr
    assert "'broken' (broken:Task) is left out: ModuleNotFoundError" in made.stderr
    assert "'odd' (odd:Task) is left out: ParameterError: it is no subclass" in made.stderr
    assert "'twin' (twin:Twin) is left out: ParameterError" in made.stderr
    assert "rope-dragging" in gendom("help", "act").stdout.replace("\n", "")
    assert json.loads((drags / "dataset.json").read_text())["task"]["name"] == "rope-dragging"


# ---- estimates -----------------------------------------------------------------------------------

MATERIAL = """
RANGE = {"basis": "estimate", "how": "by hand"}
MATERIALS = {
    "sources": {"own-2024": {"text": "Our own bench, 2024", "says": "hemp of 8 mm: 1.1 MPa"}},
    "materials": {
        "hemp-rope": {
            "kind": "rope",
            "about": "laid hemp",
            "E": {"low": 5e5, "typical": 1.1e6, "high": 3e6, "basis": "measured",
                  "how": "bent by its weight", "source": "own-2024"},
            "nu": {"low": 0.2, "typical": 0.3, "high": 0.4, **RANGE},
            "density": {"low": 600.0, "typical": 800.0, "high": 1000.0, **RANGE},
            "damping": {"low": 0.002, "typical": 0.005, "high": 0.02, **RANGE},
            "friction": {"low": 0.2, "typical": 0.4, "high": 0.6, **RANGE},
            "diameter": {"low": 0.004, "typical": 0.008, "high": 0.02, **RANGE},
        }
    },
}
"""

UNKNOWN = """
from gendom.materials.unknowns import Unknown


def raised(inputs, value):
    inputs.raised += value


LIFT_OFFSET = Unknown(
    name="lift_offset", symbol="dz", unit="m", meaning="how much higher the lift was",
    low=-0.05, high=0.05, mean=0.0, sd=0.002, step=1e-3, widest=0.01, on_replay=raised,
)
"""

METHOD = '''
"""`grid`: the best of 24 moduli, everything else as its prior says."""

import numpy as np

from gendom.estimation import Problem
from gendom.estimation.problem import Found, Start


def grid(problem: Problem) -> Found:
    middle = problem.prior.vector(*problem.bases)
    k = problem.prior.index("E_over_rho")
    moduli = np.linspace(problem.prior.low[k], problem.prior.high[k], 26)[1:-1]
    tried = np.repeat(middle[None], len(moduli), axis=0)
    tried[:, k] = moduli
    noise = problem.first_noise()
    values = problem.values(list(tried), problem.compare(list(tried), derivatives=False), noise)
    best = Start(initial=middle, vector=tried[int(np.argmin(values))], value=min(values), done=True)
    best.comparison = problem.compare([best.vector])[0]
    problem.tell("grid", 1, 1, best)
    return Found(best=best, starts=[best], noise=noise)
'''


def test_packages_add_a_material_an_unknown_and_a_method(add, gendom, rope_lift, tmp_path):
    add("hemp", MATERIAL, materials="MATERIALS")
    add("flax", MATERIAL.replace('"nu"', '"mu"').replace("hemp", "flax"), materials="MATERIALS")
    add("offset", UNKNOWN, unknowns="LIFT_OFFSET")
    add("grid", METHOD, methods="grid")
    listed = gendom("materials", "hemp-rope", "--json")
    assert listed.returncode == 0 and "'flax' is left out: flax-rope: " in listed.stderr
    told = json.loads(listed.stdout)
    assert told["materials"][0]["E"]["typical"] == 1.1e6
    assert told["sources"]["own-2024"]["text"] == "Our own bench, 2024"

    rope_lift.seen().write(tmp_path / "lift.npz")
    words = ["--method", "grid", "--unknowns", "E_over_rho", "lift_offset", "--points", 15]
    made = gendom("estimate", "lift.npz", *words, "--material", "hemp-rope", "--json")
    assert made.returncode == 0, made.stderr
    record = json.loads(made.stdout)
    assert record["method"] == "grid" and record["simulation"]["material"] == "hemp-rope"
    assert 0.5 < record["E_over_rho"] / rope_lift.truth.E_over_rho < 2.0
    assert abs(record["theta"]["lift_offset"]) < 0.01


# ---- perception ----------------------------------------------------------------------------------

CAMERA = '''"""Cameras whose depth is one array: depth.npy [T, height, width] and times.npy [T]."""

from functools import partial

import numpy as np

from gendom.errors import RecordingError
from gendom.perception import Frame, Pictures, read_camera


class NpyCamera:
    def __init__(self, folder, *, on_warning):
        path = self.find(folder)
        self.camera = read_camera(folder / "camera.toml")
        self.times, self.depth = np.load(folder / "times.npy"), np.load(path, mmap_mode="r")
        if self.depth.shape != (len(self.times), self.camera.height, self.camera.width):
            what = f"has the shape {self.depth.shape}"
            raise RecordingError(what, where=str(path), fix="give one picture for each time")

    @staticmethod
    def find(folder):
        path = folder / "depth.npy"
        return path if path.exists() else None

    def __iter__(self):
        for t, time in enumerate(self.times):
            where = f"{self.camera.name}: picture {t}"
            yield Frame(float(time), where, partial(self.pictures, t))

    def pictures(self, t):
        return Pictures(np.array(self.depth[t]))
'''

ROBOT = '''"""A post on a turntable: one joint, about the vertical."""

import numpy as np

from gendom.robot import Arm, LinkCapsule, ParallelGripper

turntable = Arm(
    name="turntable",
    T_links=np.eye(4)[None],
    T_flange_tcp=np.eye(4),
    q_min=np.array([-3.2]),
    q_max=np.array([3.2]),
    max_speed=np.ones(1),
    max_acceleration=np.ones(1),
    max_jerk=np.ones(1),
    max_tcp_speed=1.0,
    home=np.zeros(1),
    capsules=(
        LinkCapsule(
            name="post", link=1, start=(0.12, 0.0, 0.0), end=(0.12, 0.0, 0.4), radius=0.02
        ),
    ),
    gripper=ParallelGripper(
        max_opening=0.05, pivot_y=0.03, pivot_z=0.0, knuckle=0.05, face=0.02
    ),
)
'''

VIEW = """\
width = 160
height = 120
depth_unit = 0.001
K = [[200.0, 0.0, 80.0], [0.0, 200.0, 60.0], [0.0, 0.0, 1.0]]
# at (0, -0.6, 0.2), it looks along y
T_world_camera = [[1, 0, 0, 0], [0, 0, 1, -0.6], [0, -1, 0, 0.2], [0, 0, 0, 1]]
"""


def test_packages_add_a_camera_and_a_robot(add, gendom, tmp_path):
    """A hanging rope before a wall, and the turntable's post beside it."""
    add("npy_camera", CAMERA, cameras="NpyCamera")
    add("turntable", ROBOT, arms="turntable")
    depth = np.full((4, 120, 160), 1500, np.uint16)  # [mm]
    for t in range(4):
        depth[t, 25 : 105 - 3 * t, 79:82] = 600
    depth[:, 20:110, 118:123] = 600  # the post
    lift, out = tmp_path / "lift", tmp_path / "lift.npz"
    camera = lift / "cameras" / "left"
    camera.mkdir(parents=True)
    (camera / "camera.toml").write_text(VIEW)
    np.save(camera / "times.npy", np.arange(4) / 30)
    np.save(camera / "depth.npy", depth)
    rows = ["time,x,y,z", *(f"{t / 30},0,0,0.31" for t in range(4))]
    (lift / "gripper.csv").write_text("\n".join(rows) + "\n")
    rows = ["time,q0", *(f"{t / 30},0" for t in range(4))]
    (lift / "joints.csv").write_text("\n".join(rows) + "\n")
    described = '[object]\nkind = "rope"\nlength = 0.25\ndiameter = 0.01\n'
    (lift / "object.toml").write_text(f'robot = "turntable"\n{described}')

    made = gendom("perceive", lift, "--no-table", "--out", out, "--json")
    assert made.returncode == 0, made.stderr
    told = json.loads(made.stdout)
    assert told["frames"] == 4
    assert told["points"]["robot"]["median"] < 0.5 * told["points"]["support"]["median"]
    points = Recording.read(out).frame(0)
    assert len(points) > 20 and np.abs(points[:, :2]).max() < 0.01

    np.save(camera / "depth.npy", depth[1:])
    refused = gendom("perceive", lift, "--no-table", "--out", out)
    assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1
    assert "depth.npy: has the shape (3, 120, 160)" in refused.stderr
