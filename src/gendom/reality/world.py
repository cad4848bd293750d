"""The MuJoCo test scene in time: step it, hold the object, release it, render it."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError, SimulationError
from gendom.installation import gl_faults, headless, load_mujoco
from gendom.perception.camera import Camera
from gendom.reality.air import Air
from gendom.reality.model import (
    CLOTH_STEP,
    Layout,
    camera_xml,
    clamped_vertices,
    compiled,
    scene_xml,
)
from gendom.reality.objects import RealObject, RealRope
from gendom.reality.twist import Twist

FINGER_WIDTH = 0.025
"""Breadth of the fingers: what they hold reaches half of it to either side [m]."""

FAST_STEP, SLOW = 0.002, 0.25
"""Adaptive time step [s] while a vertex is faster than this [m/s]. At the default of 4 ms a rubber
cloth of 0.2 m that is brought down by A = 0.2 covers 0.60 of its area (31 points a side), at 2 ms
0.80, as at 1 ms; layers that meet at that speed come closer by 1 mm in 4 ms, their distance when
they touch."""

ADAPTIVE_TOLERANCE = 1e-4
"""Of MuJoCo's solver then. It moves the vertices of a lifted cloth by 0.05 mm in the mean, 0.6 mm
at most, so lifts, which are estimated from, keep the default of 1e-6."""

GL_PACKAGES = "apt install libegl1 libgl1-mesa-dri, or libosmesa6 with MUJOCO_GL=osmesa"
"""Packages that a Debian machine without a screen needs to render."""


_FREE_HAND = '<body name="hand" mocap="true" pos="0 0 1"/>'


class Reality:
    """One object on the table, under cameras, touched by a hand.

    The hand is either the robot's (`robot`, see `gendom.reality.arm`) or, without a robot, a free
    body that follows any path exactly, for tests and benches.

    Args:
        item: The object.
        layout: Where it is at the start.
        robot: The arm that carries the hand; None: a free hand.
        cameras: Fixed cameras, with their true poses.
        timestep: [s]; None for the default of the object's kind.
        adaptive: Whether it is shorter while a vertex is faster than `SLOW`.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: The scene cannot be built.
    """

    def __init__(
        self,
        item: RealObject,
        layout: Layout,
        *,
        robot: Any = None,
        cameras: Sequence[Camera] = (),
        timestep: float | None = None,
        adaptive: bool = False,
    ):
        self.air = Air(item)
        self._mujoco = load_mujoco()
        self.item = item
        self.layout = layout
        self.cameras = list(cameras)
        self.robot = robot
        vertices = range(len(item.vertex_masses))
        xml = scene_xml(
            item,
            layout,
            bodies=[*map(camera_xml, cameras), _FREE_HAND if robot is None else robot.xml()],
            ties=vertices,  # see `attach`
            tied=False,
            actuators="" if robot is None else robot.actuators(),
            step=FAST_STEP if adaptive else timestep,
            tolerance=ADAPTIVE_TOLERANCE if adaptive else None,
        )
        self.model = compiled(item, xml)
        self.data = self._mujoco.MjData(self.model)
        self._hand = self.model.body("hand").id
        self._bodies = np.array(self.model.flex_vertbodyid)
        # Each vertex has three slides along the world's axes.
        self._dofs = self.model.body_dofadr[self._bodies][:, None] + np.arange(3)
        self._ties = np.array([self.model.equality(f"hand_{v}").id for v in vertices])
        self._path: Callable[[Array], npt.ArrayLike] | None = None
        self._twist: Twist | None = None
        self._adaptive = adaptive
        self._renderer: Any = None
        if robot is not None:
            robot.reset(self.model, self.data)
        self._mujoco.mj_forward(self.model, self.data)

    # ---- time ------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """[s]."""
        return float(self.data.time)

    def step_to(self, time: float) -> None:
        """Simulate until `time` [s], to the nearest time step.

        Raises:
            SimulationError: The state is no longer finite; says when.
        """
        left = self._remaining_steps(time)
        while left > 0:
            step = self.model.opt.timestep
            # together, which is quicker, and one after the other, as MuJoCo's clock adds them
            ends = np.cumsum(np.r_[self.time, np.full(min(left, 64), step)])[1:]
            driven = None if self.robot is None else self.robot.control(self.data, ends)
            hand = None if self._path is None else np.broadcast_to(self._path(ends), (len(ends), 3))
            for k in range(len(ends)):
                self._apply_loads()
                if driven is not None:
                    next(driven)
                elif hand is not None:
                    self.data.mocap_pos[0] = hand[k]
                self._mujoco.mj_step(self.model, self.data)
                # counted anew only where the step changed: half a step must not be rounded twice
                again, left = self._remaining_steps(time), left - 1
                if self.model.opt.timestep != step:
                    left = again
                    break
        self._update_positions()
        kinds = self._mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        warned = any(self.data.warning[int(w)].number for w in bad)
        require(
            not warned and np.isfinite(self.data.qpos).all(),
            "the second reality diverged",
            where=f"{self.item.name}, t = {self.time:.4g} s",
            fix="take a smaller timestep",
            error=SimulationError,
        )

    def _remaining_steps(self, time: float) -> int:
        """Choose the time step; how many of it there are until `time` [s]."""
        if self._adaptive:
            self.model.opt.timestep = CLOTH_STEP if self.speed() <= SLOW else FAST_STEP
        return round((time - self.time) / self.model.opt.timestep)

    def _update_positions(self) -> None:
        """Update the positions of bodies and vertices: a step of MuJoCo leaves the old ones."""
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_flex(self.model, self.data)

    def _apply_loads(self) -> None:
        """Forces of twist and air on the vertices, and the twist's moment on the hand, for the next
        step."""
        self._mujoco.mj_kinematics(self.model, self.data)
        x = self.data.xpos[self._bodies]
        forces = self.air.forces(x, self.data.qvel[self._dofs])
        if self._twist is not None:
            rotation = self.data.xmat[self._hand].reshape(3, 3)
            more, moment = self._twist.load(x, rotation, self.model.opt.timestep)
            forces += more
            self.data.xfrc_applied[self._hand, 3:] = moment
        # As forces on the slides: for wrenches on bodies MuJoCo computes a Jacobian each.
        self.data.qfrc_applied[self._dofs] = forces

    # ---- the hand --------------------------------------------------------------------------------

    def follow(self, path: Callable[[Array], npt.ArrayLike]) -> None:
        """Send the free hand along a path, times [T] [s] -> positions [T, 3] or [3] [m]."""
        require(self.robot is None, "the robot moves the hand", fix="give it a motion")
        self._path = path

    @property
    def hand(self) -> Array:
        """[3] the point between the fingertips [m]."""
        return self.data.xpos[self._hand].copy()

    @property
    def hand_axis(self) -> Array:
        """[3] unit vector along the object at the hand: from its free end, for a rope."""
        x, held = self.vertices(), self.held
        if isinstance(self.item, RealRope) and len(held) > 1:
            along = x[held[-1]] - x[held[0]]
            return along / np.linalg.norm(along)
        return self.data.xmat[self._hand].reshape(3, 3)[:, 0].copy()

    @property
    def held(self) -> npt.NDArray[np.intp]:
        """Vertices that the hand holds."""
        return np.flatnonzero(self.data.eq_active[self._ties])

    def attach(self, reach: float = FINGER_WIDTH / 2.0) -> npt.NDArray[np.intp]:
        """Close the hand: what lies between the fingers keeps its place relative to them.

        A rope bends at its vertices, and the joint at the last one that is held stands for half an
        edge on both sides: the rope is free from half an edge before it (measured: lifts of four
        ropes are then those of rods that are clamped there, to 0.3 to 0.7 mm).

        Args:
            reach: How far from the point between the fingertips the object is held [m]; of a rope
                to half an edge.

        Returns:
            The vertices that are held; of a rope two at least, so that it is clamped, not
            hinged.

        Raises:
            SimulationError: Nothing is within reach; says how far the object is.
        """
        x = self.vertices()
        distance = np.linalg.norm(x - self.hand, axis=1)
        # a twentieth more: the hand may be a little above
        half = 0.525 * self.item.spacing
        near = np.flatnonzero(distance <= reach + half + 1e-9)
        what = f"the hand closes on nothing: the object is {1e3 * distance.min():.1f} mm away"
        where = f"{self.item.name}, t = {self.time:.4g} s"
        fix = f"bring it within {1e3 * reach:.1f} mm"
        require(len(near) > 0, what, where=where, fix=fix, error=SimulationError)
        if isinstance(self.item, RealRope) and len(near) < 2:
            near = np.sort(np.argsort(distance)[:2])
        R = self.data.xmat[self._hand].reshape(3, 3)
        for v in near:
            self.model.eq_data[self._ties[v], :3] = 0.0
            self.model.eq_data[self._ties[v], 3:6] = R.T @ (x[v] - self.hand)
        self.data.eq_active[self._ties[near]] = 1
        stand = clamped_vertices(self.item, self.layout)
        if isinstance(self.item, RealRope) and len(stand) and stand[-1] < near[0]:
            # Held at both ends, it can be twisted.
            self._twist = Twist(self.item, x, first=stand[-2], last=near[0], rotation=R.copy())
        return near

    def release(self) -> None:
        """Open the hand: a free end twists back."""
        self.data.eq_active[self._ties] = 0
        self.data.qfrc_applied[self._dofs] = 0.0
        self._twist = None
        self.data.xfrc_applied[:] = 0.0

    def place(self, vertices: Array) -> None:
        """Put the object's vertices [V, 3] [m] somewhere, at rest."""
        self.data.qpos[self._dofs] += vertices - self.vertices()
        self._mujoco.mj_forward(self.model, self.data)

    # ---- ground truth ----------------------------------------------------------------------------

    def vertices(self) -> Array:
        """[V, 3] the object's vertices [m]."""
        return self.data.flexvert_xpos.copy()

    def speed(self) -> float:
        """Largest speed of a vertex [m/s]."""
        return float(np.linalg.norm(self.data.qvel[self._dofs], axis=1).max())

    # ---- pictures ----------------------------------------------------------------------------

    def render(self, camera: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        """What a perfect camera sees now.

        Args:
            camera: Index of one of `cameras`.

        Returns:
            depth [height, width] along the optical axis [m] and colour [height, width, 3].

        Raises:
            DeviceError: There is no OpenGL context; says which packages provide one.
        """
        seen = self.cameras[camera]
        renderer = self._open_renderer(seen.width, seen.height)
        renderer.enable_depth_rendering()
        renderer.update_scene(self.data, camera=seen.name)
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        renderer.update_scene(self.data, camera=seen.name)
        return depth, renderer.render().copy()

    def close(self) -> None:
        """Free the renderer's memory."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Reality:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open_renderer(self, width: int, height: int) -> Any:
        r = self._renderer
        if r is not None and (r.width, r.height) != (width, height):
            self.close()
        if self._renderer is None:
            _without_screen()
            try:
                self._renderer = self._mujoco.Renderer(self.model, height, width)
            # Exceptions of PyOpenGL and GLFW about missing libraries have no common base.
            except Exception as error:
                backend = os.environ.get("MUJOCO_GL", "")
                reason = f"{type(error).__name__}: {error}"
                if gl_faults and backend == "disable":  # when mujoco was imported; no further cause
                    backend, reason = gl_faults[0]
                what, where = f"no OpenGL context ({reason})", f"rendering, MUJOCO_GL={backend}"
                raise DeviceError(what, where=where, fix=GL_PACKAGES) from None
        return self._renderer


def _without_screen() -> None:
    """Choose EGL where mujoco was imported before the environment said that there is no screen.

    It would ask GLFW for a window, which ends the process where there is no display.
    """
    from mujoco.rendering.classic import gl_context

    chosen = getattr(gl_context, "GLContext", None)
    if headless() and chosen is not None and "glfw" in chosen.__module__:
        os.environ["MUJOCO_GL"] = "egl"
        importlib.reload(gl_context)
