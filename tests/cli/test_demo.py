"""What the demo says about itself."""

import shlex
from pathlib import Path

import pytest
import tyro

from gendom.cli.demo import Command, _command_line


@pytest.mark.parametrize(
    "command",
    [
        Command(),
        Command(out=Path("a b"), goal=(0.3, 0.35), starts=1, seed=4),
        Command(live=True, reality="rope-polyester", frame_rate=10.0),
    ],
)
def test_the_reported_command_repeats_the_run(command):
    words = shlex.split(_command_line(command))
    assert words[:2] == ["gendom", "demo"]
    config = (tyro.conf.FlagCreatePairsOff,)
    assert tyro.cli(Command, args=words[2:], config=config) == command
