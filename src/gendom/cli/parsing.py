"""Parse words into a command with tyro; each refusal is one line."""

import ast
import inspect
import io
import os
import re
import shutil
import textwrap
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import tyro

from gendom.errors import ParameterError, did_you_mean

PARSING = (tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone, tyro.conf.HelptextFromCommentsOff)
"""How flags are read: none has a twin with --no-, and those without a value are left out."""

EVERYWHERE = ("--help", "--debug", "--quiet")
"""Flags that all commands take."""

TYPED: list[str] = []
"""The words of the command that was parsed last."""

_KINDS = {int: "whole number", float: "number", Path: "path", str: "word"}


def parse(command: type, name: str, words: Sequence[str]) -> Any:
    """A command with its flags.

    Args:
        command: Its class, a frozen dataclass.
        name: As it is called.
        words: What stands behind the name.

    Raises:
        ParameterError: A flag is unknown, or a value is missing or of another type.
        SystemExit: Help was requested and has been printed.
    """
    TYPED[:] = "gendom", name, *words
    if any(word == "" or re.fullmatch("--[-a-z]+=", word) for word in words):
        fix = "give it a value; a variable of the shell may be unset"
        raise ParameterError("one of the words is empty", fix=fix)
    # shells leave --out=~/a as it is
    home = os.path.expanduser("~")  # "~" where nobody knows it
    words = [re.sub("^(--[-a-z]+=|)~(?=/|$)", lambda m: m[1] + home, word) for word in words]
    arguments = arguments_of(command)
    flags = [*(called for called in arguments if called.startswith("--")), *EVERYWHERE]
    for word in takewhile(lambda w: w != "--", words):
        flag = word.partition("=")[0]
        short = re.match("-(?!inf|nan)[a-zA-Z]", word) and word != "-h"
        if short or (word.startswith("--") and _flag(word) not in flags):
            advice = did_you_mean(flag, flags) or f"see gendom {name} --help"
            raise ParameterError(f"there is no flag {flag!r}", fix=advice)
    printed = io.StringIO()
    try:
        with redirect_stderr(printed):
            prog, about = f"gendom {name}", _description(command)
            return tyro.cli(command, prog=prog, description=about, args=words, config=PARSING)
    except SystemExit as stop:
        if not stop.code:
            raise
    text = " ".join(re.sub("[│╭╮╰╯─|+]|-{4,}", " ", printed.getvalue()).split())
    raise _refusal(text, arguments, words, f"see gendom {name} --help", _example(command))


class NotFlags:
    """Names of fields, of settings that a command has, that are no flags; a mark in `Annotated`."""

    def __init__(self, *names: str):
        self.names = names


class Argument(NamedTuple):
    """One flag, or word without one."""

    kind: Any
    help: str
    required: bool


@cache
def arguments_of(command: type, hidden: tuple[str, ...] = ()) -> dict[str, Argument]:
    """All that a command takes: by the flag, or by what help calls a word without one.

    A field that is a dataclass of settings gives its fields as flags of their own names, but for
    the hidden ones. The annotations become such that tyro shows help in one line (it keeps line
    breaks of indented docstrings), without defaults such as None and False.
    """
    positional = get_args(tyro.conf.Positional[int])[1]
    help_of, found = _help(command), {}
    hints = get_type_hints(command, include_extras=True)
    for field in fields(command):
        hint = hints[field.name]
        kind, *marks = get_args(hint) or (hint,)
        if field.name in hidden:
            command.__annotations__[field.name] = tyro.conf.Suppress[hint]
            continue
        if isinstance(kind, type) and is_dataclass(kind):
            names = next((mark.names for mark in marks if isinstance(mark, NotFlags)), hidden)
            found |= arguments_of(kind, names)
            command.__annotations__[field.name] = tyro.conf.OmitArgPrefixes[kind]
            continue
        shared = (getattr(mark, "help", None) for mark in marks)  # of cli.arguments
        told = help_of.get(field.name) or next(filter(None, shared), "")
        called = f"--{field.name.rstrip('_').replace('_', '-')}"  # a flag may be a word of Python's
        if any(mark is positional for mark in marks):
            named = [m.metavar for m in marks if str(getattr(m, "metavar", "") or "").isalpha()]
            called = named[0] if named else field.name.upper()
        required = field.default is MISSING and field.default_factory is MISSING
        found[called] = Argument(hint, told, required)
        said = tyro.conf.arg(help=told, help_behavior_hint=_default_told)
        command.__annotations__[field.name] = Annotated[hint, said]
    return found


def _default_told(default: str) -> str:
    return "" if default in ("None", "False", "''", "") else f"(default: {default})"


def _refusal(
    text: str, arguments: dict[str, Argument], words: Sequence[str], see: str, example: str
) -> ParameterError:
    """What tyro has refused and said in its own words, in one line."""
    if choice := re.search(r"invalid choice '(.*?)' for argument '(.*?)'.*?\((.*?)\)", text):
        word, where = choice[1], choice[2]
        choices = sorted({*re.findall("'(.*?)'", choice[3])} - {"None"})
        fix = did_you_mean(word, choices) or f"choose {', '.join(choices)}"
        if where.startswith("--"):
            return ParameterError(f"is {word!r}", where=where, fix=fix)
        return ParameterError(f"does not take {word!r}", fix=fix)
    if bad := re.search("(?:Error parsing|for argument) '?(--[-a-z]+)", text):
        at = next(n for n, word in enumerate(words) if _flag(word) == bad[1])
        after = words[at].partition("=")[2]
        others = takewhile(lambda w: _flag(w) not in (*arguments, *EVERYWHERE), words[at + 1 :])
        given = after or " ".join(others)
        what = f"is {given!r}" if given else "has no value"
        wanted = _wanted(arguments[bad[1]].kind)
        return ParameterError(what, where=bad[1], fix=f"give {wanted}")
    if extra := re.search("Unrecognized options: (.*?) For full helptext", text):
        return ParameterError(f"{' '.join(extra[1].split(', '))!r} is too much", fix=see)
    printed = "".join(text.split())
    missing = [
        called
        for called, argument in arguments.items()
        if argument.required
        and ("".join(argument.help.split()) in printed or f"forargument'{called}'" in printed)
    ]
    return ParameterError(f"lacks {', '.join(missing)}" if missing else text, fix=example or see)


def _example(command: type) -> str:
    """The line that every command's help ends with."""
    found = re.search(r"For example: (gendom .*)", command.__doc__ or "")
    return f"for example: {found[1]}" if found else ""


def _help(command: type) -> dict[str, str]:
    """The docstrings of a command's fields, inherited ones too, each in one line."""
    found = {}
    for base in reversed([kind for kind in command.__mro__ if is_dataclass(kind)]):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(tree, ast.ClassDef)
        found |= {
            field.target.id: " ".join(text.value.value.split())
            for field, text in pairwise(tree.body)
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
            if isinstance(text.value.value, str)
        }
    return found


def _description(command: type) -> str:
    """A command's docstring for its help, wrapped to the terminal.

    An example stays in one line, to be copied. Further lines are indented: tyro joins others.
    """
    width = shutil.get_terminal_size().columns
    text = inspect.cleandoc(command.__doc__ or "")
    parts = (" ".join(paragraph.split()) for paragraph in text.split("\n\n"))
    lengths = ((10_000 if p.startswith("For example: ") else width, p) for p in parts)
    return "\n\n".join(textwrap.fill(p, n, subsequent_indent="  ") for n, p in lengths)


def _flag(word: str) -> str:
    """A flag as it is defined: without its value, with ``-`` for ``_``."""
    return word.partition("=")[0].replace("_", "-")


def _wanted(kind: Any) -> str:
    """What a flag of a type takes."""
    inner = [part for part in get_args(kind) if part not in (type(None), ...)]
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, inner))}"
    if get_origin(kind) is tuple:
        if get_origin(inner[0]) is tuple:
            return _wanted(inner[0])
        nouns = [_KINDS.get(each, "word") for each in inner]
        if len({*nouns}) > 1:
            return f"a {', a '.join(nouns)}"
        return f"{nouns[0]}s" if ... in get_args(kind) else f"{len(inner)} {nouns[0]}s"
    if inner:  # annotated, or optional
        names = [m.metavar for m in inner[1:] if isinstance(getattr(m, "metavar", None), str)]
        return names[0] if names else _wanted(inner[0])
    return f"a {_KINDS.get(kind, 'word')}"
