"""`gendom completion`: a script that completes commands and flags in a shell."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Literal

import tyro

from gendom.cli.parsing import PARSING, arguments_of


@dataclass(frozen=True, kw_only=True)
class Command:
    """Print a script that completes commands, flags and files in a shell.

    bash takes it from ~/.local/share/bash-completion/completions/gendom, zsh from a file _gendom in
    a folder of $fpath, fish from ~/.config/fish/completions/gendom.fish.

    For example: gendom completion bash > ~/.local/share/bash-completion/completions/gendom
    """

    shell: tyro.conf.Positional[Literal["bash", "zsh", "fish"]]
    """The shell."""

    def run(self) -> int:
        from gendom.cli import COMMANDS

        commands = {name: import_module(module).Command for name, (module, _) in COMMANDS.items()}
        for command in commands.values():
            arguments_of(command)
        with suppress(SystemExit):  # how it ends
            words = ["--tyro-write-completion", self.shell, "-"]
            tyro.extras.subcommand_cli_from_dict(
                commands, prog="gendom", args=words, config=PARSING
            )
        return 0
