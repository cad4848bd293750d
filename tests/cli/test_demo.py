"""What the demo says about itself."""

import shlex
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import tyro

from gendom import cli
from gendom.cli import demo
from gendom.cli.demo import Command
from gendom.viz import ReachOutcome
from gendom.viz.report.motion import WITH


@pytest.mark.parametrize("command", [Command(), Command(out=Path("a b"), task="rope-reaching")])
def test_commands_to_try_next_are_commands(command):
    """Of the files that the demo writes; each as a user would type it."""
    steps = command.next_steps([0.3, 0.1])
    assert [words.split()[1] for words, _ in steps] == ["check", "replay", "act", "demo"]
    assert command.next_steps(None) == steps[:1]  # nothing that needs a usable estimate
    for words, _ in steps:
        said = shlex.split(words)
        module = import_module(f"gendom.cli.{said[1]}")
        tyro.cli(module.Command, args=said[2:], config=(tyro.conf.FlagCreatePairsOff,))


def test_without_mujoco_actions_are_carried_out_in_our_simulator(monkeypatch):
    """With the rope as it truly is: its own prediction is then right."""
    monkeypatch.setattr(demo, "_lacking", lambda: True)
    rope, policies, goals = Command(goal=(0.4, 0.1))._rope_and_goals()
    task, action = policies[0].task(), np.array(policies[0].act(goals[0], rope, force=True).values)
    last = demo.execute(rope, task, action)
    assert last.trial is None
    outcome = ReachOutcome(goal=goals[0], runs={WITH: last.run})
    clouds, apart = demo.predicted(task, [outcome], last, rope, "cpu")
    assert apart == pytest.approx(0.0, abs=1e-9) and outcome.error(WITH) < 0.01
    assert len(clouds.recorded) == len(clouds.simulated) > 10 and clouds.arm is None


def test_a_live_lift_without_mujoco_is_refused(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(demo, "_lacking", lambda: True)
    assert cli.main(["demo", "--live", "--out", str(tmp_path / "demo")]) == 2
    said = capsys.readouterr().err
    assert "MuJoCo is not installed; pip install" in said and "[reality]' brings it" in said
