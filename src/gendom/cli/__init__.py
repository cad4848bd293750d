"""The command line: `gendom COMMAND ...`, one module for each command.

A command's module has a frozen dataclass `Command`: its fields are the flags, their docstrings
the help, and `run()` does the work and returns the exit code. Results go to stdout, the log and
all complaints to stderr. Exit codes: 0 done, 1 a fault of the program, 2 a fault of the input,
3 done, but the recording cannot be used (`gendom estimate`, `gendom demo`), 130
interrupted.
"""

from __future__ import annotations

import atexit
import codecs
import gc
import io
import json
import logging
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module

from gendom.errors import GendomError, ParameterError, did_you_mean, one_line, printable
from gendom.installation import how_to_install, version
from gendom.progress import silence

# Command -> module that holds it, and one line of help.
COMMANDS = {
    "demo": ("gendom.cli.demo", "a recorded lift, the estimate, an action and what it reaches"),
    "estimate": ("gendom.cli.estimate", "Young's modulus and Poisson's ratio from a recording"),
    "replay": ("gendom.cli.replay", "simulate a recorded motion and compare it with the clouds"),
    "view": ("gendom.cli.view", "look at a recording, and simulate it again"),
    "act": ("gendom.cli.act", "the action that reaches a goal with a given object"),
    "cell": ("gendom.cli.cell", "check and draw the cell in which a robot acts"),
    "execute": ("gendom.cli.execute", "show what an action would do in a cell, and do it"),
    "run": ("gendom.cli.run", "from lift to adapted action in a cell, step by step"),
    "adapt": ("gendom.cli.adapt", "update parameters from executed actions and what they reached"),
    "dataset": ("gendom.cli.dataset", "simulate demonstrations"),
    "export": ("gendom.cli.export", "demonstrations or a recording in the format of LeRobot"),
    "train": ("gendom.cli.train", "train a policy on demonstrations"),
    "evaluate": ("gendom.cli.evaluate", "measure how well a policy reaches its goals"),
    "policies": ("gendom.cli.policies", "the shipped policies"),
    "materials": ("gendom.cli.materials", "ropes, cables and cloths with parameters and sources"),
    "twin": ("gendom.cli.twin", "the estimated object for MuJoCo, Newton, Genesis or USD"),
    "doctor": ("gendom.cli.doctor", "what lies there, what is wrong with it, the next command"),
    "check": ("gendom.cli.check", "validate a recording and say what is in it"),
    "calibrate": ("gendom.cli.calibrate", "a camera's pose, from pictures of a board"),
    "plan-lift": ("gendom.cli.plan_lift", "which lift shows an object's parameters best"),
    "record": ("gendom.cli.record", "a lift under depth cameras, in a cell or in the MuJoCo scene"),
    "perceive": ("gendom.cli.perceive", "from depth pictures or a ROS bag to a recording"),
    "import": ("gendom.cli.import_", "from a ROS bag, clouds or LeRobot to a recording"),
    "bench": ("gendom.cli.bench", "measure the simulator's speed on this machine"),
    "completion": ("gendom.cli.completion", "complete commands and flags in your shell"),
}

# Import name -> the extra that brings it.
_EXTRAS = {
    "pyarrow": "data",
    "torch": "train",
    "onnx": "train",
    "mujoco": "reality",
    "pyrealsense2": "camera",
    "cv2": "camera",
    "gymnasium": "reality",
    "ray": "cluster",
    "trimesh": "viz",
    "rosbags": "ros",
    "xarm": "robot",
    "franky": "franka",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Arguments after the program's name; by default those of this process.

    Returns:
        The exit code.
    """
    gc.set_threshold(100_000)  # most objects live on: looking for cycles took a twentieth and more
    atexit.register(gc.freeze)  # nor are they looked for at the end, which took 0.3 s
    words = list(sys.argv[1:] if argv is None else argv)
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # it was closed
            setattr(sys, stream, io.StringIO())
    if isinstance(sys.stdout, io.TextIOWrapper):
        codecs.register_error("escaped", _escaped)
        sys.stdout.reconfigure(errors="escaped")
    debug, quiet = "--debug" in words, "--quiet" in words
    words = [word for word in words if word not in ("--debug", "--quiet")]
    if words in ([], ["-h"], ["--help"], ["help"]):
        print(_usage(), file=sys.stdout if words else sys.stderr)
        return 0 if words else 2
    if words[0] == "--version":
        print(f"gendom {version()}")
        return 0
    name, *rest = [words[1], "--help"] if words[0] == "help" else words
    if name not in COMMANDS:
        kind = "flag" if name.startswith("-") else "command"
        advice = did_you_mean(name, COMMANDS) or "see gendom --help"
        print(f"gendom: there is no {kind} {name!r}; {advice}", file=sys.stderr)
        return 2
    try:
        level = logging.DEBUG if debug else logging.WARNING if quiet else logging.INFO
        with (
            _log_to_stderr(name, level),
            silence() if quiet else nullcontext(),
            warnings.catch_warnings(),
        ):
            if not debug:  # NumPy's, of numbers that are told in a line of ours
                warnings.simplefilter("ignore", RuntimeWarning)
            code = _run(name, rest)
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        with suppress(OSError, ValueError):  # the interpreter's last flush goes nowhere
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as a process that the closed pipe has ended
    except (KeyboardInterrupt, Exception) as error:
        if debug:
            traceback.print_exc()
        message, code = _explain(error)
        for line in message.splitlines():
            print(f"gendom {name}: {line}", file=sys.stderr)
        return code


def _run(name: str, words: list[str]) -> int:
    from gendom.cli.outputs import escaped
    from gendom.cli.parsing import parse

    try:
        command = parse(import_module(COMMANDS[name][0]).Command, name, words)
    except SystemExit as stop:  # help was printed
        return stop.code if isinstance(stop.code, int) else 2
    if not 0 <= (seed := getattr(command, "seed", 0)) < 1 << 63:
        raise ParameterError(f"is {seed}", where="--seed", fix="give 0 or more, below 2^63")
    with escaped() if name != "completion" else nullcontext():
        return command.run()


def _usage() -> str:
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {line}" for name, (_, line) in COMMANDS.items())
    return f"""usage: gendom COMMAND [flags]

Show it one lift of a rope or a cloth, and the robot handles that object.

{lines}

gendom help COMMAND lists a command's flags, with an example. All take --debug, which
shows tracebacks, and --quiet: no progress and no notes, results and errors only.
gendom --version prints the version."""


def _explain(error: BaseException) -> tuple[str, int]:
    """The message for the user, and the exit code."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", 130
    if isinstance(error, GendomError):
        return str(error), 2
    package = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and package in _EXTRAS:
        return f"needs {package}; install it with: {how_to_install(_EXTRAS[package])}", 2
    if isinstance(error, OSError):
        place = None if error.filename is None else str(error.filename)
        return one_line(error.strerror or str(error), where=place), 2
    what = f"internal error: {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return one_line(what, fix="run it again with --debug and report what it prints"), 1


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """What a locale has no signs for, as JSON has it."""
    assert isinstance(error, UnicodeEncodeError)
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


class _LineFormatter(logging.Formatter):
    """One line for each entry of the log, whatever names it holds."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return printable(super().formatMessage(record))


@contextmanager
def _log_to_stderr(name: str, level: int) -> Iterator[None]:
    """Show the package's log while a command runs, and leave logging as it was."""
    handler = logging.StreamHandler()
    handler.setFormatter(_LineFormatter(f"gendom {name}: %(message)s"))
    logger = logging.getLogger("gendom")
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(level)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before[0])
        logger.propagate = before[1]
