"""Names of places, printed."""

import io
import json
import sys

import pytest

from gendom import cli

ODD = "a\x1b[31mb\nc\x9b\u202e\udcff"
"""A name that colours a terminal, fills two lines, turns what follows and is not UTF-8."""


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_names_are_printed_escaped(tmp_path, capsys, flags):
    """In errors, in results for people, and in JSON, which gives the name back."""
    out = tmp_path / ODD / "set"
    words = ["rope-reaching", "--size", "2", "--out", str(out), *flags]
    assert cli.main(["dataset", *words]) == 0
    printed = capsys.readouterr()
    assert cli.main(["check", str(tmp_path / ODD / "no")]) == 2
    for text in (printed.out, capsys.readouterr().err):
        assert r"a\u001b[31mb\nc\u009b\u202e\udcff" in text
        assert all(c.isprintable() for c in text if c != "\n")
    if flags:
        assert json.loads(printed.out)["path"] == str(out)


@pytest.mark.usefixtures("quick")
def test_what_the_locale_lacks_is_escaped(tmp_path, monkeypatch):
    printed = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", printed)
    out = str(tmp_path / "ropes-é")
    assert cli.main(["dataset", "rope-reaching", "--size", "2", "--out", out]) == 0
    printed.seek(0)
    assert r"ropes-\u00e9: 2 demonstrations" in printed.read()
