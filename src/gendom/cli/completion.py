"""`gendom completion`: a script that completes commands and flags in a shell."""

from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any, Literal, Union

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

        parts = []
        for name, (module, line) in COMMANDS.items():
            command = import_module(module).Command
            arguments_of(command)
            parts.append(Annotated[command, tyro.conf.subcommand(name, description=line)])
        commands: Any = Union[tuple(parts)]  # noqa: UP007
        words = ["--tyro-write-completion", self.shell, "-"]
        try:
            tyro.cli(commands, prog="gendom", args=words, config=PARSING)
        except SystemExit as stop:  # how it ends
            return int(stop.code or 0)
        return 0
