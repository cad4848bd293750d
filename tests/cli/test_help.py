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
from gendom.cli.parsing import PARSING, described

COMMANDS = sorted(cli.COMMANDS)


def command_class(name):
    return import_module(cli.COMMANDS[name][0]).Command


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_page_has_an_example_that_parses(name, capsys):
    assert cli.main(["help", name]) == 0
    page = capsys.readouterr().out
    (example,) = re.findall(rf"^For example: gendom {name} (.*)$", page, re.MULTILINE)
    words = shlex.split(example.partition(">")[0])
    tyro.cli(described(command_class(name)), args=words, config=PARSING)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_80_columns_and_breaks_no_example(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["help", name]) == 0
    page = capsys.readouterr().out
    lines = [
        line for line in page.splitlines() if not line.startswith(("usage: ", "For example: "))
    ]
    assert max(map(len, lines)) <= 80
    after = page.partition("\nFor example: ")[2].splitlines()
    assert after[1] == ""


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_of_python_leaks_into_help(name, capsys):
    assert cli.main([name, "--help"]) == 0
    page = capsys.readouterr().out
    for leak in ("None", "True", "False", "(default: )"):
        assert leak not in page


@pytest.mark.parametrize("name", COMMANDS)
def test_flags_say_what_they_do_when_they_are_given(name):
    """A flag `--no-x` is a field `no_x`, whose help tells of the absence."""
    on = [f.name for f in dataclasses.fields(command_class(name)) if f.default is True]
    assert on == []


def test_help_of_what_is_no_command(capsys):
    assert cli.main(["help", "estimte"]) == 2
    assert "did you mean 'estimate'?" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_flags(shell, capsys, tmp_path):
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "estimate" in script and "cells-across" in script
    if shutil.which(shell):
        (tmp_path / "script").write_text(script, encoding="utf-8")
        subprocess.run([shell, "-n", str(tmp_path / "script")], check=True)


SEEDED = [
    n for n in COMMANDS if any(f.name == "seed" for f in dataclasses.fields(command_class(n)))
]


@pytest.mark.parametrize("name", SEEDED)
def test_seeds_below_zero_are_refused(name, capsys):
    page = (command_class(name).__doc__ or "").split("For example: ")[1].split()
    assert cli.main([*page[1:], "--seed", "-1"]) == 2
    assert capsys.readouterr().err == f"gendom {name}: --seed: is -1; give 0 or more\n"
