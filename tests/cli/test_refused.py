"""What commands refuse: one line of what, where and what to do, exit code 2, nothing left."""

import shlex
from dataclasses import replace
from importlib import resources

import pytest

from gendom.files import write_json
from simulated_cell import write_cell

REFUSED = """
estimte | gendom: there is no command 'estimte'; did you mean 'estimate'?
help estimte | gendom: there is no command 'estimte'; did you mean 'estimate'?
zzz | gendom: there is no command 'zzz'; see gendom --help
--zzz | gendom: there is no flag '--zzz'; see gendom --help
act rope-casting --gaol 1 2 | act: there is no flag '--gaol'; did you mean '--goal'?
estimate x --qqq=3 | estimate: there is no flag '--qqq'; see gendom estimate --help
estimate x -s 3 | estimate: there is no flag '-s'; see gendom estimate --help
check x y -3 | check: 'y -3' is too much; see gendom check --help
check | check: lacks RECORDING; for example: gendom check lift.npz
export x | export: lacks --out; for example: gendom export casts --out casts-lerobot
dataset | lacks TASK, --size, --out; for example: gendom dataset rope-casting --size 1000
estimate x --seed | estimate: --seed: has no value; give a whole number
estimate x --seed --json | estimate: --seed: has no value; give a whole number
estimate x --level=q | estimate: --level: is 'q'; give a number
estimate x --cells_across q | estimate: --cells-across: is 'q'; give a number
perceive x --colour 1 2 | perceive: --colour: is '1 2'; give 3 whole numbers
act rope-casting --goal a b | act: --goal: is 'a b'; give numbers
dataset rope-casting --size 1 --out x --range nu 1 | is 'nu 1'; give a word, a number, a number
estimate x --frames lst | estimate: --frames: is 'lst'; did you mean 'last'?
estimate x --frames q | estimate: --frames: is 'q'; choose all, last
estimate x --camera-pose q | estimate: --camera-pose: is 'q'; choose stated, unknown
estimate x --method gauss | estimate: there is no method 'gauss'; did you mean 'gauss-newton'?

estimate file.npz | file.npz
check absent.npz | absent.npz: no such file; check the path
estimate lift.npz --seed -1 | seed must be at least 0, got -1
estimate lift.npz --level 1 | level
estimate lift.npz --cells-across 0.2 | cells_across
estimate lift.npz --points 2 | points
estimate lift.npz --points 100000 | --points: is 100000; give 1000 or fewer: 20 to 60 are usual
estimate lift.npz --engine fem | fem
estimate lift.npz ./lift.npz | lift.npz: is given twice; name each recording once
estimate lift.npz longer.npz | longer.npz: length is 0.3, in lift.npz 0.25
dataset rope-reaching --size 0 --out set | --size: is 0; give 1 or more
dataset rope-reaching --size 99999999999999 --out set | size: is 99999999999999; give 409600000 at
dataset rope-reaching --size 9 --seed 9223372036854775808 --out set | --seed: is 9223372036854775808
dataset rope-reaching --size 9 --out= | one of the words is empty; give it a value
dataset knitting --size 3 --out set | knitting
record --out new | give either --reality or --cell
record --reality rope-cotton --cell cell.toml --out new | give either --reality or --cell
record --cell cell.toml --rise 30 --out new | --rise: is 30 m, and the rope 0.3 m long
record --cell cell.toml --end swing --rise 0.2 --object no.toml --out new | no.toml
record --reality rope-cotton --rise 225 --out new | 0.3 m long; give metres: 225 mm are
record --reality rope-cotton --rise 22 --out new | 0.3 m long; give metres: 22 cm are 0.22
record --reality rope-cotton --rise nan --out new | --rise: is nan m
record --reality rope-cotton --rise 0 --out new | --rise: is 0 m
record --reality rope-cotton --frame-rate 0 --out new | --frame-rate: is 0.0; give 90 or less
record --reality cloth-cotton --rise 150 --out new | --rise: is 150 m, and the cloth 0.3 m wide
record --reality rope-cotton --motion null.json --out new | lift: expected object, got null
record --reality rope-cotton --motion high.json --out new | lift: rise: expected float
record --reality rope-cotton --motion throw.json --out new | end is 'throw'
record --reality rope-cotton --motion sheet.json --out new | is for a cloth, and rope-cotton is
record --reality rope-cotton --motion high.json --end drop --out new | leave out --rise and --end
act rope-casting --goal 0.3 0.4 --params nothing.json | nothing was estimated: no frame holds
act rope-casting --goal 0.3 0.4 --params lift.npz | give a file written by gendom estimate
act rope-casting --goal 0.3 0.4 --thickness 0.01 | --thickness: a rope has no thickness
evaluate rope-casting --policy reaching.onnx | is for rope-reaching; use a policy for rope-casting
check lift.npz --bending-length 0.1 | give a file written by gendom estimate
plan-lift rope --length 0.3 | lacks the rope's diameter; give --diameter in metres
plan-lift rope --side 0.3 | --side: a rope has no side; give --length and --diameter
plan-lift rope --length 1 2 3 | --length: has 3 numbers; give one, or from and to

view nowhere.npz --html lift.txt | does not end in .html
estimate lift.npz --out file.npz | is a file, not a folder
estimate lift.npz --out file.npz/below | is a file, not a folder
estimate lift.npz --report page.pdf | name a file that ends in .html
estimate lift.npz --report folder.html | is a folder
estimate lift.npz --report file.npz/page.html | is a file, not a folder

estimate loop | loop: cannot be read
import loop --out o.npz | loop: cannot be read
twin loop --to usd --out o | loop
"""
PLANS = {
    "--mass 0.2 0.1": "mass: is 0.2 to 0.1; give one number above 0, or the lower end and then the",
    "--length -1": "length: is -1 to -1; give one number above 0, or",
    "--material iron": "there is no material 'iron'",
    "--material cotton-shirting": "cotton-shirting is no material of a rope",
    "--draws 0": "draws: is 0; give 1 or more",
    "--mass 27": "mass: is 27 kg, a density of 9.55e+05 kg/m^3; it looks like",
    "--level 2": "level: is 2.0; give 0 to 1, as 0.9",
    "--rises 0": "motion: rise is 0.0; give a number above 0, in SI units",
    "--for nu": "--for: is 'nu'; choose E, all, damping, friction",
    "--fro E": "there is no flag '--fro'; did you mean '--for'?",
}
MOTIONS = {
    "null": None,
    "high": {"kind": "rope", "rise": "high", "speed": 0.1, "end": "hold"},
    "throw": {"kind": "rope", "rise": 0.2, "speed": 0.1, "end": "throw"},
    "sheet": {"kind": "cloth", "rise": 0.2, "speed": 0.1, "end": "hold"},
}
FOLDERS = {
    "demo": "",
    "record": "--reality absent",
    "dataset": "rope-casting --size 4",
    "export": "absent",
}
FILES = {
    "replay absent.npz --params absent.json --out a.json --gif": ".gif",
    "act rope-casting --policy absent.onnx --out": ".json",
    "train rope-casting --data absent --out": ".onnx",
    "perceive absent --out": ".npz",
    "calibrate absent --camera absent.toml --out": ".toml",
}
CASES = [line.partition(" | ")[::2] for line in REFUSED.splitlines() if line]
CASES += [(f"plan-lift rope --length 0.25 --diameter 0.012 {w}", said) for w, said in PLANS.items()]
for command, given in FOLDERS.items():
    CASES += [
        (f"{command} {given} --out file.npz", "is a file, not a folder"),
        (f"{command} {given} --out file.npz/below", "is a file, not a folder"),
        (f"{command} {given} --out a.json", "is named like a file"),
    ]
for given, ending in FILES.items():
    CASES += [
        (f"{given} a.mp4", f"does not end in {ending}, which is what is written"),
        (f"{given} file.npz/a{ending}", "is a file, not a folder"),
    ]


@pytest.fixture(scope="module")
def place(rope_lift, tmp_path_factory):
    """A folder with what the commands name."""
    folder, lift = tmp_path_factory.mktemp("refused"), rope_lift.seen()
    lift.write(folder / "lift.npz")
    replace(lift, object=replace(lift.object, length=0.3)).write(folder / "longer.npz")
    (folder / "file.npz").write_bytes(b"nothing")
    (folder / "folder.html").mkdir()
    (folder / "loop").symlink_to("loop")
    shipped = resources.files("gendom") / "assets" / "rope-reaching.onnx"
    (folder / "reaching.onnx").write_bytes(shipped.read_bytes())
    for name, content in MOTIONS.items():
        write_json(folder / f"{name}.json", {"format": "gendom-motion/1", "lift": content})
    verdict = {"usable": False, "reasons": ["no frame holds a point"]}
    write_json(folder / "nothing.json", {"format": "gendom-estimate/1", "verdict": verdict})
    write_cell(folder)
    return folder


@pytest.mark.parametrize(("words", "line"), CASES)
def test_what_is_refused(words, line, place, refused, monkeypatch):
    if words.startswith(("record", "demo")):
        pytest.importorskip("mujoco", reason="needs the extra reality")
    monkeypatch.chdir(place)
    before = sorted(place.rglob("*"))
    assert line in refused(*shlex.split(words))
    assert sorted(place.rglob("*")) == before
