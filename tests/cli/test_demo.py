"""What the demo says about itself."""

import numpy as np

from gendom.cli import demo
from gendom.cli.demo import Command
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.reality import find_object
from gendom.viz.report.motion import WITH, WITHOUT


def test_without_mujoco_actions_are_carried_out_in_our_simulator(monkeypatch):
    """With the rope as it truly is: its own prediction is then right. The goal is one of those that
    the rope reaches, at which a policy that does not see its parameters acts otherwise."""
    monkeypatch.setattr(demo, "_lacking", lambda: True)
    rope = find_object("rope-polyester")
    policies = [Policy.pretrained("rope-casting", parameters=sees) for sees in (True, False)]
    task, known = policies[0].task(), Estimate.of(rope)
    goal = Command()._goal(rope, known, policies)
    pair = [demo.execute(rope, task, np.array(p.act(goal, rope).values)) for p in policies]
    assert pair[0].trial is None
    off = [np.linalg.norm(of.reached - goal) for of in pair]
    assert off[0] < 0.002 < off[1]
    shown = demo.compared(task, rope, {WITH: pair[0], WITHOUT: pair[1]}, goal)
    assert [of.name for of in shown.layers] == [WITH, WITHOUT, "gripper", "goal"]
    assert shown.num_frames > 10
