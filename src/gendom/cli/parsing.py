"""Parse words into a command with tyro; each refusal is one line."""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import textwrap
from collections.abc import Sequence
from dataclasses import fields
from itertools import pairwise, takewhile
from typing import Annotated, Any, get_type_hints

import tyro
import tyro._errors as refusals  # its hook for refusals; no public one has as much

from gendom.errors import ParameterError, did_you_mean

PARSING = (tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone)
"""How flags are read: none has a twin with --no-, and those without a value are left out."""

EVERYWHERE = ("--help", "--debug", "--quiet")
"""Flags that all commands take."""


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

    def refuse(event: refusals.ParseErrorEvent) -> None:
        # an unknown flag is often why something else is missing
        flags = _flags(command)
        unknown = [w for w in words if w.startswith("--") and _flag(w) not in flags and w != "--"]
        if isinstance(event, refusals.UnrecognizedArgs | refusals.MissingArgs):
            tokens = getattr(event, "tokens", ()) or getattr(event, "unrecognized_tokens", ())
            unknown += [token for token in tokens if re.match(r"-[^\d.]", token)]
        if unknown:
            flag = unknown[0].partition("=")[0]
            advice = did_you_mean(flag, flags) or f"see gendom {name} --help"
            raise ParameterError(f"there is no flag {flag!r}", fix=advice)
        if isinstance(event, refusals.UnrecognizedArgs):
            extra = " ".join(event.tokens)
            raise ParameterError(f"{extra!r} is too much", fix=f"see gendom {name} --help")
        if isinstance(event, refusals.MissingArgs):
            missing = [_called(context.arg) for context in event.missing_arguments]
            raise ParameterError(f"lacks {', '.join(missing)}", fix=_example(command))
        if isinstance(event, refusals.BadValue):
            called, wanted = _called(event.argument), _wanted(event.argument)
            given = _given(called, words, flags)
            if given or called.startswith("--"):
                raise ParameterError(_is(given), where=called, fix=f"give {wanted}")
            raise ParameterError(f"lacks {called}", fix=_example(command))
        if isinstance(event, refusals.InvalidChoice):
            advice = did_you_mean(event.value, event.choices)
            choices = f"choose {', '.join(event.choices)}"
            raise ParameterError(
                f"is {event.value!r}", where=_called(event.argument), fix=advice or choices
            )
        if isinstance(event, refusals.InstantiationFailure) and event.argument is not None:
            called, wanted = _called(event.argument), _wanted(event.argument)
            given = _given(called, words, flags)
            raise ParameterError(_is(given), where=called, fix=f"give {wanted}")
        # tyro prints anything else itself

    with refusals.on_parse_error(refuse):
        return tyro.cli(
            described(command),
            prog=f"gendom {name}",
            description=_description(command),
            args=words,
            config=PARSING,
        )


def described(command: type) -> type:
    """A command's class with help texts in one line (tyro keeps line breaks of indented
    docstrings), and without defaults such as None and False."""

    def default_told(default: str) -> str:
        return "" if default in ("None", "False", "") else f"(default: {default})"

    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(command))).body
    assert isinstance(tree, ast.ClassDef)
    told = {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        if isinstance(text.value.value, str)
    }
    for name, kind in get_type_hints(command, include_extras=True).items():
        said = tyro.conf.arg(help=told.get(name), help_behavior_hint=default_told)
        command.__annotations__[name] = Annotated[kind, said]
    return command


def _description(command: type) -> str:
    """A command's docstring for its help, wrapped to the terminal.

    An example stays in one line, to be copied. Further lines are indented: tyro joins others.
    """
    width = shutil.get_terminal_size().columns
    text = inspect.cleandoc(command.__doc__ or "")
    return "\n\n".join(
        textwrap.fill(
            " ".join(paragraph.split()),
            10_000 if paragraph.startswith("For example: ") else width,
            subsequent_indent="  ",
        )
        for paragraph in text.split("\n\n")
    )


def _flags(command: type) -> list[str]:
    """All that it takes."""
    (positional,) = tyro.conf.Positional[int].__metadata__  # pyright: ignore[reportAttributeAccessIssue]
    hints = get_type_hints(command, include_extras=True)
    named = [
        field.name.rstrip("_")  # a flag may be a word of Python's
        for field in fields(command)
        if not any(mark is positional for mark in getattr(hints[field.name], "__metadata__", ()))
    ]
    return [*(f"--{name.replace('_', '-')}" for name in named), *EVERYWHERE]


def _flag(word: str) -> str:
    """A flag as it is defined: without its value, with ``-`` for ``_``."""
    return word.partition("=")[0].replace("_", "-")


def _called(argument: Any) -> str:
    """The flag, or what help calls a word without one: a list of choices by its field."""
    if not argument.is_positional():
        return argument.lowered.name_or_flags[0]
    metavar = str(argument.lowered.metavar)
    return metavar if metavar.isalpha() else argument.field.intern_name.upper()


def _given(called: str, words: Sequence[str], flags: Sequence[str]) -> list[str]:
    """The words behind a flag."""
    for n, word in enumerate(words):
        if word.startswith("--") and _flag(word) == called:
            after = word.partition("=")[2]
            rest = takewhile(lambda w: _flag(w) not in flags, words[n + 1 :])
            return [after] if after else list(rest)
    return []


def _is(given: Sequence[str]) -> str:
    return f"is {' '.join(given)!r}" if given else "has no value"


_KINDS = {"INT": "whole number", "FLOAT": "number", "PATH": "path", "STR": "word"}


def _wanted(argument: Any) -> str:
    """What an argument takes, by the names that tyro has for it."""
    metavar = str(argument.lowered.metavar)
    kinds = [_KINDS[word] for word in re.findall("|".join(_KINDS), metavar)]
    if not kinds:
        return metavar
    if "..." in metavar:
        return f"{kinds[0]}s"
    return f"a {kinds[0]}" if len(kinds) == 1 else f"{len(kinds)} {kinds[0]}s"


def _example(command: type) -> str:
    """The line that every command's help ends with."""
    found = re.search(r"For example: (gendom .*)", command.__doc__ or "")
    return f"for example: {found[1]}" if found else "see its --help"
