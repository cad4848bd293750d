"""Help, examples and completion of every command."""

import dataclasses
import re
import shlex
import shutil
import subprocess
from importlib import import_module

import pytest
import tyro

from gendom import cli
from gendom.cli.parsing import PARSING, arguments_of

COMMANDS = sorted(cli.COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_page(name, capsys, monkeypatch):
    """It has an example that parses in one line, fits 80 columns, and nothing of Python leaks.
    Flags say what they do when they are given: `--no-x` is a field `no_x`, whose help tells of the
    absence."""
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["help", name]) == 0
    page = capsys.readouterr().out
    (example,) = re.findall(rf"^For example: gendom {name} (.*)$\n\n", page, re.MULTILINE)
    words = shlex.split(example.partition(">")[0])
    command = import_module(cli.COMMANDS[name][0]).Command
    arguments_of(command)
    tyro.cli(command, args=words, config=PARSING)
    lines = [x for x in page.splitlines() if not x.startswith(("usage: ", "For example: "))]
    assert max(map(len, lines)) <= 80
    for leak in ("None", "True", "False", "(default: )"):
        assert leak not in page
    assert [f.name for f in dataclasses.fields(command) if f.default is True] == []
    if any(f.name == "seed" for f in dataclasses.fields(command)):
        assert cli.main([name, *words, "--seed", "-1"]) == 2
        assert (
            capsys.readouterr().err == f"gendom {name}: --seed: is -1; give 0 or more, below 2^63\n"
        )


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_flags(shell, capsys, tmp_path):
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "estimate" in script and "cells-across" in script
    if shutil.which(shell):
        (tmp_path / "script").write_text(script, encoding="utf-8")
        subprocess.run([shell, "-n", str(tmp_path / "script")], check=True)
