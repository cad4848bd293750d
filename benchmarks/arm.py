"""How long the arm takes for motions that are commanded far beyond its limits.

    python benchmarks/arm.py [--json]

For each motion: the time that the path asks for, the time that `follow` takes, the largest joint
speed, joint acceleration and tool speed over their limits, and the CPU time of planning.
"""

import json
import sys
import time
from dataclasses import replace

import numpy as np

from gendom.robot import DOWN, XARM7, JointMotion, TcpPath, follow, lift, pointing
from gendom.tasks import ClothSpreading, RopeReaching

FORWARD = pointing([1, 0, 0], [0, 1, 0])


def square(speed: float) -> TcpPath:
    """Around a square of 0.2 m without a stop."""
    corners = np.array([[0.4, -0.1], [0.6, -0.1], [0.6, 0.1], [0.4, 0.1], [0.4, -0.1]])
    position = np.column_stack([corners, np.full(5, 0.2)])
    return TcpPath(
        time=0.2 / speed * np.arange(5.0),
        position=position,
        quat_xyzw=np.array(DOWN),
        max_blend=0.1 / speed,
    )


def line(seconds: float) -> TcpPath:
    """0.21 m back and up, and a pause, as in the tests."""
    return TcpPath(
        time=np.array([0.0, seconds, seconds + 0.2]),
        position=np.array([[0.45, 0.0, 0.1], [0.3, 0.0, 0.25], [0.3, 0.0, 0.25]]),
        quat_xyzw=np.array(DOWN),
        max_blend=0.15,
    )


def releases(count: int) -> list[TcpPath]:
    """Rope reaching at random release points, the gripper forward, near to the arm's own body."""
    task, rng, paths = RopeReaching(), np.random.default_rng(0), []
    for action in task.sample_actions(task.item, rng, count):
        path = task.tool_path(task.item, action)
        moved = path.position + np.array([0.3, 0.0, 0.1])
        paths.append(replace(path, position=moved, quat_xyzw=FORWARD))
    return paths


def cast() -> TcpPath:
    """0.25 m sideways in 10 ms, between pauses of 50 ms."""
    start = np.array([0.45, -0.12, 0.45])
    end = start + np.array([0.0, 0.25, 0.0])
    return TcpPath(
        time=np.array([0.0, 0.05, 0.06, 0.11]),
        position=np.array([start, start, end, end]),
        quat_xyzw=np.array(DOWN),
        max_blend=0.1,
    )


def spreading(seconds: float) -> TcpPath:
    """Cloth spreading with A = 0.25, in steps of some seconds."""
    task = ClothSpreading()
    path = task.tool_path(task.item, np.array([0.25]))
    steps = path.position[2:-1] + np.array([0.3, 0.0, 0.03])
    return TcpPath(
        time=seconds * np.arange(float(len(steps))),
        position=steps,
        quat_xyzw=np.array(DOWN),
        max_blend=0.2,
    )


MOTIONS = {
    "lift by 60 mm at 2 m/s": lift([0.3325, 0, 0.01], height=0.06, speed=2.0, wait=0.5, after=0.5),
    "lift by 225 mm at 2 m/s": lift([0.45, 0, 0.02], height=0.225, speed=2.0, wait=0.5, after=0.5),
    "lift by 225 mm at 10 m/s": lift([0.45, 0, 0.02], height=0.225, speed=10, wait=0.5, after=0.5),
    "line of 212 mm in 90 ms": line(0.09),
    "line of 212 mm in 20 ms": line(0.02),
    "cast of 0.25 m in 10 ms, pauses of 50 ms": cast(),
    "square of 0.2 m at 1.5 m/s": square(1.5),
    "square of 0.2 m at 5 m/s": square(5.0),
    "spreading, A = 0.25, steps of 10 ms": spreading(0.01),
}


def used(motion: JointMotion) -> dict[str, float]:
    """Largest speed, acceleration and tool speed over their limits, by dense sampling."""
    t = np.linspace(motion.start, motion.end, 20001)
    tool = np.linalg.norm(np.diff(motion.tcp_at(XARM7, t)[:, :3, 3], axis=0), axis=1)
    return {
        "speed": np.abs(motion.speed_at(t) / XARM7.max_speed).max(),
        "acceleration": np.abs(motion.acceleration_at(t) / XARM7.max_acceleration).max(),
        "tool": tool.max() / (t[1] - t[0]) / XARM7.max_tcp_speed,
    }


def followed(path: TcpPath) -> dict[str, float]:
    began = time.process_time()
    motion = follow(XARM7, path)
    spent = time.process_time() - began
    asked, takes = path.end - path.start, motion.end - motion.start
    slowed = motion.slowed_by
    return {"asked": asked, "takes": takes, "slowed": slowed, **used(motion), "planning": spent}


def main() -> None:
    found = {name: followed(path) for name, path in MOTIONS.items()}
    every = [followed(path) for path in releases(40)]
    slowed = [one["slowed"] for one in every if one["slowed"] > 1.0]
    found["40 releases"] = {
        "slowed": len(slowed),
        "by at most": max(slowed, default=1.0),
        "planning, median": float(np.median([one["planning"] for one in every])),
    }
    if "--json" in sys.argv:
        print(json.dumps(found))
        return
    for name, one in found.items():
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in one.items()))


if __name__ == "__main__":
    main()
