"""The MuJoCo test scene in time: step it, hold the object, release it, render it.

Held vertices slip between the fingers beyond a largest pull. This is isotropic dry friction: a
vertex is fixed while it pulls by no more than the grip's force, else it slides against that force
until it has come to rest or has left the fingers. Friction is a damping of the vertices (the force
over their speed), which MuJoCo's integrator takes implicitly; it stops below `REST_SPEED`.
"""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.errors import DeviceError, SimulationError
from gendom.installation import gl_faults, headless, load_mujoco
from gendom.materials import AIR_DENSITY
from gendom.perception.camera import Camera
from gendom.reality.air import Air
from gendom.reality.model import Layout, build_model, clamped_vertices
from gendom.reality.objects import RealObject, RealRope
from gendom.reality.twist import Twist

FINGER_WIDTH = 0.025
"""Breadth of the fingers: what they hold reaches half of it to either side [m]."""

SLOW = 0.25
"""Largest speed of a vertex [m/s] at which `slow_timestep` is taken: in 4 ms layers that meet at it
come closer by 1 mm, their distance when they touch."""

REST_SPEED = 1e-4
"""Speed below which a sliding vertex that decelerates is at rest [m/s]."""

GL_PACKAGES = "apt install libegl1 libgl1-mesa-dri, or libosmesa6 with MUJOCO_GL=osmesa"
"""Packages that a Debian machine without a screen needs to render."""


_FREE_HAND = '<body name="hand" mocap="true" pos="0 0 1"/>'


class Slip:
    """The vertices that slide between a hand's fingers.

    Args:
        force: That the fingers hold at most [N]; infinite: all.
        masses: [V] of the vertices [kg].
        dofs: [V, 3] their slides.

    Raises:
        ParameterError: The force is not above 0.
    """

    def __init__(self, force: float, masses: npt.NDArray[np.float64], dofs: npt.NDArray[np.intp]):
        require(force > 0.0, f"is {force:g}", where="grip_force", fix="give newtons above 0")
        self.force = force
        self._masses = masses
        self._dofs = dofs
        self._speed = 0.0
        self.vertices = np.empty(0, dtype=np.intp)
        """Vertices between the fingers that are not fixed."""

    @property
    def possible(self) -> bool:
        return math.isfinite(self.force)

    def begin(self, vertices: npt.NDArray[np.intp]) -> None:
        self.vertices, self._speed = vertices, 0.0

    def end(self, model: Any) -> npt.NDArray[np.intp]:
        """Free all of them; returns which."""
        vertices, self.vertices = self.vertices, self.vertices[:0]
        model.dof_damping[self._dofs[vertices]] = 0.0
        return vertices

    def leave(self, model: Any, away: npt.NDArray[np.bool_]) -> None:
        """Free those of them that have left the fingers."""
        model.dof_damping[self._dofs[self.vertices[away]]] = 0.0
        self.vertices = self.vertices[~away]

    def apply_friction(
        self, model: Any, data: Any, hand: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        """Set friction for the next step.

        Args:
            model, data: MuJoCo's.
            hand: [3] velocity of the fingers [m/s].

        Returns:
            [k, 3] forces on what slides that belong to the damping [N], and whether it has come to
            rest.
        """
        dofs = self._dofs[self.vertices]
        share = self._masses[self.vertices] / self._masses[self.vertices].sum()
        before = self._speed
        self._speed = float(np.linalg.norm(share @ (data.qvel[dofs] - hand)))
        damping = self.force / max(2.0 * self._speed - before, REST_SPEED) * share[:, None]
        model.dof_damping[dofs] = damping
        return damping * hand, self._speed < REST_SPEED and self._speed <= before


def pull_force(mujoco: Any, data: Any, connections: npt.NDArray[np.intp]) -> float:
    """By how much connections to a hand were pulled in the last step [N]."""
    equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    rows = np.flatnonzero(equality & np.isin(data.efc_id, connections))
    # three rows each, along the world's axes
    return float(np.linalg.norm(data.efc_force[rows].reshape(-1, 3).sum(axis=0)))


class Reality:
    """One object on the table, under cameras, touched by a hand.

    The hand is either the robot's (`robot`, see `gendom.reality.arm`) or, without a robot, a free
    body that follows any path exactly, for tests and benches.

    Args:
        item: The object.
        layout: Where it is at the start.
        robot: The arm that carries the hand; None: a free hand.
        cameras: Fixed cameras, with their true poses.
        table: Whether there is a table.
        timestep: [s]; None for the default of the object's kind.
        slow_timestep: That while no vertex is faster than `SLOW` [s]; None: the same.
        tolerance: Of MuJoCo's solver; None for the default of the object's kind.
        gravity: [3] [m/s^2].
        air_density: Of the still air [kg/m^3], see `gendom.reality.air`; 0: none.
        grip_force: That the fingers hold at most [N], see `gendom.reality.world`; infinite: all.

    Raises:
        DeviceError: MuJoCo is not installed.
        ParameterError: The scene cannot be built, `air_density` is negative or not finite, or
            `grip_force` is not above 0.
    """

    def __init__(
        self,
        item: RealObject,
        layout: Layout,
        *,
        robot: Any = None,
        cameras: Sequence[Camera] = (),
        table: bool = True,
        timestep: float | None = None,
        slow_timestep: float | None = None,
        tolerance: float | None = None,
        gravity: npt.ArrayLike = (0.0, 0.0, -9.81),
        air_density: float = AIR_DENSITY,
        grip_force: float = math.inf,
    ):
        self.air = Air(item, air_density)
        self._mujoco = load_mujoco()
        self.item = item
        self.layout = layout
        self.cameras = list(cameras)
        self.robot = robot
        self.model = build_model(
            item,
            layout,
            arm=_FREE_HAND if robot is None else robot.xml(),
            actuators="" if robot is None else robot.actuators(),
            hand="hand",
            cameras=cameras,
            table=table,
            timestep=timestep,
            tolerance=tolerance,
            gravity=gravity,
        )
        self.data = self._mujoco.MjData(self.model)
        self._hand = self.model.body("hand").id
        self._bodies = np.array(self.model.flex_vertbodyid)
        # Each vertex has three slides along the world's axes.
        self._dofs = self.model.body_dofadr[self._bodies][:, None] + np.arange(3)
        self._slip = Slip(grip_force, item.vertex_masses, self._dofs)
        self._connections = np.array(
            [self.model.equality(f"hand_{v}").id for v in range(len(self._bodies))]
        )
        self._path: Callable[[float], npt.ArrayLike] | None = None
        self._twist: Twist | None = None
        self._reach = 0.0
        self._hand_before = np.zeros(3)
        self._usual_step, self._slow_step = self.model.opt.timestep, slow_timestep
        self._last_step = self._usual_step
        self._renderer: Any = None
        self.reset()

    # ---- time ------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Back to time 0: the object in its layout, at rest and free, the hand away."""
        self._mujoco.mj_resetData(self.model, self.data)
        self._path = self._twist = None
        self._slip.end(self.model)
        if self.robot is not None:
            self.robot.reset(self.model, self.data)
        self._mujoco.mj_forward(self.model, self.data)

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
            self._apply_loads()
            step = self.model.opt.timestep
            self._hand_before, self._last_step = self.hand, step
            if self.robot is not None:
                self.robot.control(self.data, self.time + step)
            elif self._path is not None:
                self.data.mocap_pos[0] = self._path(self.time + step)
            self._mujoco.mj_step(self.model, self.data)
            if self._slip.possible:
                self._open_overloaded()
            # only counted anew where the step has changed: half a step must not be rounded twice
            again = self._remaining_steps(time)
            left = left - 1 if self.model.opt.timestep == step else again
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
        if self._slow_step is not None:
            slow = self.speed() <= SLOW
            self.model.opt.timestep = self._slow_step if slow else self._usual_step
        return round((time - self.time) / self.model.opt.timestep)

    def _update_positions(self) -> None:
        """Update the positions of bodies and vertices: a step of MuJoCo leaves the old ones."""
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_flex(self.model, self.data)

    def _apply_loads(self) -> None:
        """Forces of twist and air on the vertices, and the twist's moment on the hand, for the next
        step."""
        if self._twist is None and self.air.density == 0.0 and not self._slip.possible:
            return
        self._mujoco.mj_kinematics(self.model, self.data)
        x = self.data.xpos[self._bodies]
        forces = self.air.forces(x, self.data.qvel[self._dofs])
        if self._twist is not None:
            rotation = self.data.xmat[self._hand].reshape(3, 3)
            more, moment = self._twist.load(x, rotation, self.model.opt.timestep)
            forces += more
            self.data.xfrc_applied[self._hand, 3:] = moment
        if len(self._slip.vertices):
            self._apply_friction(x, forces)
        # As forces on the slides: for wrenches on bodies MuJoCo computes a Jacobian each.
        self.data.qfrc_applied[self._dofs] = forces

    def _apply_friction(self, x: npt.NDArray[np.float64], forces: npt.NDArray[np.float64]) -> None:
        """Add the fingers' friction to forces [V, 3] [N]; what it stops is held again."""
        slip = self._slip
        slip.leave(self.model, np.linalg.norm(x[slip.vertices] - self.hand, axis=1) > self._reach)
        if len(slip.vertices) == 0:
            return
        moved = (self.hand - self._hand_before) / self._last_step
        friction, rests = slip.apply_friction(self.model, self.data, moved)
        if rests:
            self._hold(slip.end(self.model), x)
        else:
            forces[slip.vertices] += friction

    def _open_overloaded(self) -> None:
        """Open the connections where they are pulled by more than the grip holds."""
        held = self._connections[self.data.eq_active[self._connections] > 0]
        if len(held) and pull_force(self._mujoco, self.data, held) > self._slip.force:
            self._slip.begin(self.held)
            self.data.eq_active[self._connections] = 0
            self._untwist()

    # ---- the hand --------------------------------------------------------------------------------

    def follow(self, path: Callable[[float], npt.ArrayLike]) -> None:
        """Send the free hand along a path, time [s] -> position [3] [m]."""
        require(self.robot is None, "the robot moves the hand", fix="give it a motion")
        self._path = path

    @property
    def grip_force(self) -> float:
        """That the fingers hold at most [N]."""
        return self._slip.force

    @property
    def hand(self) -> npt.NDArray[np.float64]:
        """[3] the point between the fingertips [m]."""
        return self.data.xpos[self._hand].copy()

    @property
    def hand_axis(self) -> npt.NDArray[np.float64]:
        """[3] unit vector along the object at the hand: from its free end, for a rope."""
        x, held = self.vertices(), self.held
        if isinstance(self.item, RealRope) and len(held) > 1:
            along = x[held[-1]] - x[held[0]]
            return along / np.linalg.norm(along)
        return self.data.xmat[self._hand].reshape(3, 3)[:, 0].copy()

    @property
    def twist(self) -> float:
        """How far a rope's hand-held end is turned against the one in the stand [rad]; 0 where a
        rope is not held at both ends."""
        return 0.0 if self._twist is None else self._twist.angle

    @property
    def held(self) -> npt.NDArray[np.intp]:
        """Vertices that the hand holds, or that slide between its fingers."""
        held = np.flatnonzero(self.data.eq_active[self._connections])
        return np.union1d(held, self._slip.vertices)

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
        self._reach = max(reach + half, float(distance[near].max())) + 1e-9
        self._hold(near, x)
        R = self.data.xmat[self._hand].reshape(3, 3)
        stand = clamped_vertices(self.item, self.layout)
        if isinstance(self.item, RealRope) and len(stand) and stand[-1] < near[0]:
            # Held at both ends, it can be twisted.
            self._twist = Twist(self.item, x, first=stand[-2], last=near[0], rotation=R.copy())
        return near

    def release(self) -> None:
        """Open the hand: a free end twists back."""
        self.data.eq_active[self._connections] = 0
        self.data.qfrc_applied[self._dofs] = 0.0
        self._slip.end(self.model)
        self._untwist()

    def _hold(self, vertices: npt.NDArray[np.intp], x: npt.NDArray[np.float64]) -> None:
        """Keep vertices where they are, of all [V, 3], relative to the hand."""
        R = self.data.xmat[self._hand].reshape(3, 3)
        for v in vertices:
            e = self._connections[v]
            self.model.eq_data[e, :3] = 0.0
            self.model.eq_data[e, 3:6] = R.T @ (x[v] - self.hand)
        self.data.eq_active[self._connections[vertices]] = 1

    def _untwist(self) -> None:
        self._twist = None
        self.data.xfrc_applied[:] = 0.0

    # ---- ground truth ----------------------------------------------------------------------------

    def vertices(self) -> npt.NDArray[np.float64]:
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
