"""The scene in GenDOM."""

import sys
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
from scene import Scene
from worker import serve

from gendom.materials import Material
from gendom.sim import Body, Gripper, Physics, Rollout, Simulator, Solver, rope

CELLS_ACROSS, CELLS_LONG = 2.0, 42.0

RECORDED = 1e9
"""With --recorded, what a rollout may keep for its reverse [bytes]; else the package's default."""


def rope_of(dx: float, start: Any) -> Body:
    """The rope on cells of size dx [m], from its held end [3] on along x [m]."""
    return rope(
        diameter=CELLS_ACROSS * dx,
        length=CELLS_LONG * dx,
        start=start,
        cells_across=CELLS_ACROSS,
    )


def make_scene() -> Scene:
    """A rope of about 1,000 particles, two cells thick, lifted by one end for 70 x 19 substeps."""
    dx, cells = 0.006, 64
    start = np.array([11.0 * dx, 0.5 * cells * dx, 0.5 * cells * dx])
    body = rope_of(dx, start)
    return Scene(
        x=body.x,
        volume=body.volume,
        dx=body.dx,
        cells=cells,
        substep=6.0e-5,
        substeps=70 * 19,
        frames=70,
        E=1.0e6,
        nu=0.3,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        grip_centre=start,
        grip_radius=body.thickness,
        grip_velocity=np.array([0.0, 0.0, 0.6]),
    )


class GendomRope:
    """One world; the loss of its gradient is the mean height of the last frame."""

    version = version("gendom")

    def __init__(
        self,
        scene: Scene,
        dtype: str,
        threads: int,
        gradient: bool,
        memory: float | None = None,
    ):
        self.scene, self.dtype, self.threads, self.gradient = scene, dtype, threads, gradient
        self.settings = {} if memory is None else {"memory": memory}
        self.body = rope_of(scene.dx, scene.grip_centre)
        if not np.array_equal(self.body.x, scene.x):
            raise ValueError("the rope is not the scene's")
        self.times = scene.substep * scene.substeps * np.arange(1, scene.frames + 1) / scene.frames
        self.simulator = self._simulator(scene.E)
        self.x = scene.x
        self.loss_by_log_E = float("nan")

    def _simulator(self, E: float) -> Simulator:
        s = self.scene
        end = self.times[-1]
        gripper = Gripper(
            time=[0.0, end],
            position=[s.grip_centre, s.grip_centre + end * s.grip_velocity],
            radius=s.grip_radius,
        )
        return Simulator(
            self.body,
            [Material(E=E, nu=s.nu, density=s.density)],
            grippers=[gripper],
            physics=Physics(gravity=s.gravity),
            solver=Solver(engine="mpm", substep=s.substep, dtype=self.dtype, threads=self.threads),
        )

    def reset(self) -> None:
        self.simulator = self._simulator(self.scene.E)

    def run(self) -> None:
        if not self.gradient:
            self.x = self.simulator.run(self.times)[-1, 0]
            return
        rollout = Rollout(self.simulator, **self.settings)
        x = rollout.forward(self.times)
        bar = np.zeros_like(x)
        bar[-1, ..., 2] = 1.0 / x.shape[2]
        self.loss_by_log_E = self.scene.E * float(rollout.backward(bar).E[0])
        self.x = x[-1, 0]

    def figures(self) -> dict[str, float]:
        found = {"tip": self.scene.tip(self.x)}
        if self.gradient:
            h = 1e-6 if self.dtype == "float64" else 3e-2
            up, down = (self._mean_height(self.scene.E * np.exp(d)) for d in (h, -h))
            found["loss_by_log_E"] = self.loss_by_log_E
            found["loss_by_log_E_differences"] = (up - down) / (2.0 * h)
        return found

    def _mean_height(self, E: float) -> float:
        x: Any = self._simulator(E).run(self.times)
        return float(np.mean(x[-1, ..., 2], dtype=float))


if __name__ == "__main__":
    serve(partial(GendomRope, memory=RECORDED) if "--recorded" in sys.argv else GendomRope)
