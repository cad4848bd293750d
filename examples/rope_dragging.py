"""A task of your own: drag a rope over the table so that its free end comes to a goal.

    gendom dataset examples/rope_dragging.py --size 2000 --out drags
    gendom train examples/rope_dragging.py --data drags --out drag.onnx
    gendom evaluate examples/rope_dragging.py --policy drag.onnx
    gendom evaluate examples/rope_dragging.py --policy drag.onnx --world reality --cases 6
    gendom act examples/rope_dragging.py --policy drag.onnx --goal 0.2 0.03 \
        --E 8e5 --nu 0.35 --density 800 --friction 0.4 --length 0.3 --diameter 0.016
"""

from dataclasses import dataclass, field

import numpy as np

from gendom.materials import size_of, thickness_of, unit_of
from gendom.robot import DOWN, GripperEvent, TcpPath
from gendom.tasks import Quantity, Scene, Task

SPEED = 0.15  # of the hand [sqrt(g L)]
REST = 3.0  # still before and after the move [sqrt(L / g)]


@dataclass(frozen=True, kw_only=True)
class RopeDragging(Task):
    """A rope lies along x, its first end at the origin; the hand drags that end to (x, y).

    Goal: where the free end comes to rest [m].
    """

    name = "rope-dragging"
    kind = "rope"
    actions = (Quantity(name="hand_x", unit="m"), Quantity(name="hand_y", unit="m"))
    goals = (Quantity(name="x", unit="m"), Quantity(name="y", unit="m"))

    ranges: dict = field(
        default_factory=lambda: {
            "E_over_rho": (200.0, 4300.0),
            "nu": (0.2, 0.4),
            "friction": (0.1, 0.8),
            "density": (500.0, 1500.0),
        }
    )

    def limits(self, item):
        return size_of(item) * np.array([[-0.6, -0.2], [-0.5, 0.5]])

    def scene(self, item):
        height = 0.5 * thickness_of(item)
        return Scene(origin=(0.0, 0.0, height), grip=0.03 * size_of(item), table=0.0)

    def tool_path(self, item, action):
        start = np.array([0.0, 0.0, 0.5 * thickness_of(item)])
        end = start + np.append(action, 0.0)
        stops = np.linalg.norm(action) / (SPEED * unit_of("m/s", item))
        return TcpPath(
            time=np.array([-REST * unit_of("s", item), 0.0, stops, self.times(item)[-1]]),
            position=np.array([start, start, end, end]),
            quat_xyzw=np.array(DOWN),
            events=(GripperEvent(time=-REST * unit_of("s", item), closed=True),),
        )

    def times(self, item):
        return unit_of("s", item) * np.array([0.8 / SPEED + REST])

    def outcome(self, item, seen):
        return {"x": float(seen.tip[-1, 0]), "y": float(seen.tip[-1, 1])}

    def T_world_task(self, item):
        # x runs along the base's -y: the hand goes to the left and right in front of the arm
        T = np.eye(4)
        T[:3, :3] = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        T[:3, 3] = [0.45, 0.0, 0.0]
        return T
