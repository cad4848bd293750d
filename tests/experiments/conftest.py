"""The command that makes a table."""

import json

import pytest

from experiments.__main__ import main


@pytest.fixture
def table(tmp_path, capsys):
    """Function (words, exit code): what ``python -m experiments`` says; it writes to tmp_path."""

    def made(*words, code=0):
        given = [str(word) for word in (*words, "--out", tmp_path, "--jobs", 1)]
        assert main(given) == code
        said, error = capsys.readouterr()
        return error if code else json.loads(said) if "--json" in words else said

    return made
