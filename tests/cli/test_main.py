"""The command line: exit codes, one line for a fault, and `gendom check`."""

import json
import logging
import shlex
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from gendom import cli, progress
from gendom.datasets import ObjectDescription, Recording
from gendom.errors import GendomError
from gendom.installation import how_to_install, version


@pytest.fixture
def command(monkeypatch):
    """Put a command named `act` in place whose `run` is the given function."""

    def install(run):
        monkeypatch.setattr(Command, "run", run, raising=False)
        monkeypatch.setitem(cli.COMMANDS, "act", (__name__, "for tests"))

    return install


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command for tests."""

    size: int = 1
    """A number."""


def test_help_and_version(command, capsys):
    assert cli.main(["--help"]) == 0
    out = capsys.readouterr().out
    for name, (_, line) in cli.COMMANDS.items():
        assert f"  {name} " in out and line in out
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"gendom {version()}\n"
    assert cli.main([]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("usage: gendom COMMAND")
    command(lambda self: self.size)
    assert cli.main(["act", "--size", "7"]) == 7  # flags reach it, and its code comes back
    assert cli.main(["act", "--help"]) == 0
    assert "A number." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (GendomError("is odd", where="a", fix="mend it"), 2, "a: is odd; mend it"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (FileNotFoundError(2, "No such file", "a.txt"), 2, "a.txt: No such file"),
        (ModuleNotFoundError("No module named 'torch'", name="torch"), 2,
         f"needs torch; install it with: {how_to_install('train')}"),
        (ZeroDivisionError("by zero\nmore"), 1, "internal error: ZeroDivisionError: by zero; "
         "run it again with --debug and report what it prints"),
    ],
)  # fmt: skip
def test_faults_are_one_line(command, capsys, error, code, line):
    """Below a traceback where that is asked for."""

    def run(_):
        raise error

    command(run)
    assert cli.main(["act"]) == code
    assert capsys.readouterr() == ("", f"gendom act: {line}\n")
    for words in (["--debug", "act"], ["act", "--debug"]):
        assert cli.main(words) == code
        err = capsys.readouterr().err
        assert "Traceback" in err and err.endswith(f"gendom act: {line}\n")


@pytest.mark.parametrize("quiet", [False, True])
def test_log_goes_to_stderr(command, capsys, quiet):
    """With --quiet warnings are left, and no bars."""

    def run(_):
        logging.getLogger("gendom.somewhere").info("so far so good")
        logging.getLogger("gendom.somewhere").warning("careful")
        return int(progress._silent)

    command(run)
    assert cli.main(["act", *["--quiet"] * quiet]) == quiet
    said = "" if quiet else "gendom act: so far so good\n"
    assert capsys.readouterr() == ("", f"{said}gendom act: careful\n")
    logger = logging.getLogger("gendom")
    assert not logger.handlers and logger.propagate


def test_a_closed_pipe_does_not_stop_the_work(tmp_path):
    """More text than a pipe holds, to a reader that has gone; the file comes after it."""
    code = f"""import sys; from gendom import cli; from gendom.cli import policies
def run(_):
    for _ in range(20): print('x' * 20_000)
    open({str(tmp_path / "out")!r}, 'w').write('done')
    return 0
policies.Command.run = run
sys.exit(cli.main(['policies']))"""
    line = f"{sys.executable} -c {shlex.quote(code)}; echo $? >&2"
    told = subprocess.run(["bash", "-c", f"({line}) | true"], capture_output=True, text=True)
    assert told.stderr.strip() == "0" and (tmp_path / "out").read_text() == "done"


def test_without_streams_and_with_a_home_in_a_word(tmp_path, monkeypatch):
    """Shells leave --out=~/made as it is; what runs in the background has no streams."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    words = ["dataset", "rope-casting", "--size", "1", "--out=~/made"]
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert cli.main(words) == 0 and cli.main(["check", "absent"]) == 2
    assert (tmp_path / "made").is_dir() and not (tmp_path / "~").exists()


def test_check_prints_a_summary(refused, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    clouds = [np.linspace([0.0, 0.0, 0.0], [0.4, 0.0, 0.01 * t], 10 + t) for t in range(3)]
    grip: dict = {"gripper_position": [[0.4, 0.0, 0.01 * t] for t in range(4)]}
    grip |= {"gripper_closed": [[True], [True], [False], [False]]}
    held = ObjectDescription(kind="rope", length=0.4, diameter=0.01)
    about: dict = {"time": [0.0, 0.5, 1.0, 1.5], "object": held, "table_height": -0.01}
    Recording.from_frames([*clouds, np.zeros((0, 3))], **grip, **about).write("lift.npz")
    assert cli.main(["check", "lift.npz"]) == 0
    assert capsys.readouterr() == (
        "lift.npz: a recording, can be used\n"
        "  object    rope, length 0.4 m, diameter 0.01 m, mass unknown, held by: end\n"
        "  frames    4, 1 of them empty\n"
        "  points    10 to 12 a frame, median 11\n"
        "  time      0 to 1.5 s\n"
        "  grippers  1 (commanded): path 0.03 m, rise 0.03 m, closed in 2 frames\n"
        "  table     at z = -0.01 m\n"
        "  motion    dynamic\n"
        "  warning   points: 1 of 4 frames are empty (3); nothing need be done: they are skipped\n"
        "  warning   frames: 3 with points; record a whole lift: 4 frames at least\n"
        "next:\n  gendom estimate lift.npz\n      Estimate the object's parameters.\n",
        "",
    )
    # what cannot be used
    with np.load("lift.npz") as file:
        np.savez("bad.npz", **{n: a for n, a in file.items() if n != "gripper_position"})
    fault = {"what": "is missing", "where": "gripper_position", "fix": "add it: float64 [T, G, 3]"}
    line = "gendom check: bad.npz: {where}: {what}; {fix}\n".format(**fault)
    assert refused("check", "bad.npz") == line
    assert cli.main(["check", "bad.npz", "--json"]) == 2
    out, err = capsys.readouterr()
    assert err == line and json.loads(out)["faults"] == [fault]
