"""`replay`: simulated positions of an object in a scene, for given parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from gendom.estimation.scene import LiftScene
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.sim import Gripper, Physics, Simulator, Solver, Table

Array = NDArray[np.floating]


def material_of(scene: LiftScene, theta: Theta) -> Material:
    """The object's material for these parameters.

    A scene's body is as thick as stated. With its mass, an object that is r times as thick takes
    r^2 times the E, so that it bends equally: stiffness over weight goes with the square of the
    radius of gyration, of ropes and of sheets.
    """
    E, membrane = theta.E_over_rho * theta.thickness**2 * scene.density, None
    if scene.kind == "cloth" and scene.thin:
        width, height = (scene.recording.object.width, scene.recording.object.height)
        assert width is not None and height is not None
        weight = scene.density * STANDARD_GRAVITY * max(width, height)
        membrane = min(E, weight / (2.0 * scene.settings.stretch))
    return Material(
        E=E, nu=theta.nu, density=scene.density, damping=theta.damping, membrane=membrane
    )


@dataclass(kw_only=True)
class WorldInputs:
    """What unknowns change of one simulated world; hooks of the registry may change it further."""

    material: Material
    friction: float
    """On the table."""
    stiffness: Array | None
    """[N] factors of E along the object; None: 1."""
    positions: Array
    """[N, 3] in the beginning [m]."""
    grippers: list[Gripper]

    @classmethod
    def of(cls, scene: LiftScene, theta: Theta) -> WorldInputs:
        """Of a scene with these parameters."""
        inputs = cls(
            material=material_of(scene, theta),
            friction=theta.friction,
            stiffness=_stiffness(scene, theta.stiffness_slope),
            positions=_laid(scene, theta),
            grippers=_grippers(scene, theta),
        )
        for name, unknown in UNKNOWNS.items():
            if unknown.on_replay is not None:
                unknown.on_replay(inputs, theta[name])
        return inputs


def simulator_of(scene: LiftScene, thetas: Sequence[Theta]) -> tuple[Simulator, Array]:
    """W worlds about to replay a scene, and the simulated times [T] of its frames [s].

    Raises:
        ParameterError: A parameter is out of its range.
    """
    worlds = [WorldInputs.of(scene, theta) for theta in thetas]
    grippers = [world.grippers for world in worlds]
    times = scene.sim_time(scene.recording.time[list(scene.frames)])
    begin = min(float(np.asarray(g.time)[0]) for world in grippers for g in world)
    begin = min(begin, float(times[0])) - scene.settles
    table, height = None, scene.recording.table_height
    if height is not None:
        table = Table(height=height, friction=[w.friction for w in worlds])
    simulator = Simulator(
        scene.body,
        [w.material for w in worlds],
        grippers=grippers,
        table=table,
        stiffness=_stacked(scene, worlds),
        positions=np.stack([w.positions for w in worlds]),
        start_time=begin,
        physics=Physics(velocity_damping=scene.velocity_damping),
        solver=Solver(
            engine=scene.settings.engine,
            substep=scene.settings.substep,
            dtype=scene.dtype,
            device=scene.settings.device,
            threads=scene.settings.threads,
        ),
    )
    if scene.velocities is not None:
        simulator.set_velocities(np.tile(scene.velocities, (len(thetas), 1, 1)))
    return simulator, times


def replay(
    scene: LiftScene,
    thetas: Sequence[Theta],
    *,
    keep_going: bool = False,
    on_frame: Callable[[int], None] | None = None,
) -> Array:
    """[T, W, N, 3] particles, or points of a rod or shell, at the frames of a scene [m].

    Args:
        scene: What was recorded.
        thetas: W sets of parameters.
        keep_going: Leave NaN in worlds that cannot be simulated.
        on_frame: Called with the number of frames done.

    Raises:
        SimulationError: A world diverges, and `keep_going` is not set.
    """
    simulator, times = simulator_of(scene, thetas)
    x = simulator.run(times, keep_going=keep_going, on_frame=on_frame).astype(float)
    # a thicker object lies higher: its table is raised and its grippers are lowered
    x[..., 2] += np.array([scene.rise(theta) for theta in thetas])[:, None]
    return x


def middle(scene: LiftScene, x: Array) -> Array:
    """[..., n, 3] a rope's centre line or a cloth's middle surface, row by row along its first
    axis, for positions [..., N, 3] of `replay` [m]; `lattice` has its shape."""
    if scene.thin:
        return x
    if scene.kind == "rope":
        return x.reshape(*x.shape[:-2], -1, scene.body.section, 3).mean(axis=-2)
    first, second = _ticks(scene)
    layers = x.reshape(*x.shape[:-2], len(first), len(second), -1, 3).mean(axis=-2)
    return np.swapaxes(layers, -3, -2).reshape(*x.shape[:-2], -1, 3)


def lattice(scene: LiftScene) -> tuple[Array, Array]:
    """Places of `middle`'s points in the object: [n] along a rope and [1] 0, or columns and rows of
    a cloth [m]."""
    if scene.kind == "rope":
        if scene.thin:
            return np.linspace(0.0, scene.size, len(scene.body.points)), np.zeros(1)
        return np.unique(scene.body.material_coordinates[:, 0]), np.zeros(1)
    if not scene.thin:
        return _ticks(scene)
    rows, columns = scene.body.shape
    described = scene.recording.object
    assert described.width is not None and described.height is not None
    return np.linspace(0.0, described.width, columns), np.linspace(0.0, described.height, rows)


def _ticks(scene: LiftScene) -> tuple[Array, Array]:
    """Places of a cloth's particles along its first and second axis [m]."""
    m = scene.body.material_coordinates
    return np.unique(m[:, 0]), np.unique(m[:, 1])


def _stacked(scene: LiftScene, worlds: Sequence[WorldInputs]) -> Array | float:
    """[W, N] factors of the stiffness, or 1."""
    if all(w.stiffness is None for w in worlds):
        return 1.0
    one = np.ones(len(scene.initial))
    return np.stack([one if w.stiffness is None else w.stiffness for w in worlds])


def _stiffness(scene: LiftScene, slope: float) -> Array | None:
    """[N] factors of E along a rope."""
    if not slope:
        return None
    if scene.thin:
        share = np.linspace(-0.5, 0.5, len(scene.body.points))
    else:
        share = scene.body.material_coordinates[:, 0] / scene.size - 0.5
    return np.exp(slope * share)


def _laid(scene: LiftScene, theta: Theta) -> Array:
    """[N, 3] the object in the beginning, so that what is held is where the gripper closes [m]."""
    x = scene.initial
    if len(scene.held) > 1:
        return x
    inwards = scene.inwards[0]
    left = np.array([-inwards[1], inwards[0], 0.0])
    x = x - theta.grip_along * inwards - theta.grip_aside * left
    if theta.yaw:
        turn = Rotation.from_euler("z", theta.yaw).as_matrix()
        x = scene.held[0] + (x - scene.held[0]) @ turn.T
    return x


def _grippers(scene: LiftScene, theta: Theta) -> list[Gripper]:
    """The recorded paths, moved onto the held points, with slack and a ramp from rest."""
    recording, made = scene.recording, []
    delay = theta.delay / scene.clock
    for g, held in enumerate(scene.held):
        time, path = scene.path(g)
        time, path = time + delay, path.copy()
        if len(scene.held) == 1:
            path[:, :2] += held[:2] - path[0, :2]
            path[:, 2] += theta.grip_height - scene.rise(theta)
            if recording.table_height is not None:
                path[:, 2] = np.maximum(path[:, 2], held[2])
        knots, at = time, path
        away = float(np.linalg.norm(path[0] - held))
        if away > 0.0:
            # the first recorded position is reached before the first frame, not in a jump
            ramp = away / scene.settings.ramp_speed + 1e-3
            knots, at = np.concatenate([[time[0] - ramp], time]), np.concatenate([held[None], path])
        made.append(
            Gripper(
                time=knots,
                position=at,
                quat_xyzw=_turns(scene, g, theta, knots, at),
                radius=held_reach(scene, theta),
                **_closed(scene, g, delay),
            )
        )
    return made


def _closed(scene: LiftScene, g: int, delay: float) -> dict[str, Any]:
    """When a gripper closes and opens, halfway between frames."""
    closed = scene.recording.gripper_closed
    if closed is None:
        return {}
    first = scene.begins
    states, time = closed[first:, g], scene.sim_time(scene.recording.time[first:]) + delay
    found = {}
    starts = int(np.argmax(states))
    if starts > 0:
        found["hold_from"] = float(time[starts - 1 : starts + 1].mean())
    opens = np.flatnonzero(~states[starts:])
    if len(opens):
        k = starts + int(opens[0])
        found["hold_until"] = float(time[k - 1 : k + 1].mean())
    return found


def held_reach(scene: LiftScene, theta: Theta | None = None) -> float:
    """How far from its point a gripper holds the object fast [m]."""
    settings, stated = scene.settings, scene.recording.object.grasp_radius
    if scene.kind == "rope" and len(scene.held) > 1:
        # a gripper holds the part from its point to the end, and as much on the other side
        ends = scene.initial[[0, -1]]
        return stated or max(
            float(np.linalg.norm(ends - scene.held, axis=1).max()), 0.5 * scene.body.thickness
        )
    if scene.kind == "rope":
        return stated or settings.rope_reach * scene.body.thickness
    least = settings.least_reach_cells * scene.body.dx
    if scene.thin:
        side = scene.size / math.sqrt(2.0)
        least = settings.least_reach_points * side / (settings.coarse_points - 1)
    return max(
        (stated or settings.cloth_reach) + (0.0 if theta is None else theta.grip_reach), least
    )


def _turns(scene: LiftScene, g: int, theta: Theta, knots: Array, at: Array) -> Array | None:
    """[K, 4] how a gripper turns, or None.

    As its recorded axis does, without turning about it; a pinched corner does not stay level beside
    it: it hangs once the gripper has risen by its reach.
    """
    turned, turns = None, scene.turns[g]
    if turns is not None:
        t = turns[0] + theta.delay / scene.clock
        turned = Slerp(t, turns[1])(np.clip(knots, t[0], t[-1]))
    if scene.kind == "cloth" and scene.recording.object.grasp == "corner":
        rise = at[:, 2] - scene.held[g, 2]
        inwards = Rotation.from_euler("z", theta.yaw).apply(scene.inwards[g])
        axis = np.cross(inwards, [0.0, 0.0, -1.0])
        angle = theta.grip_tilt * np.clip(rise / (2.0 * held_reach(scene, theta)), 0.0, 1.0)
        tilted = Rotation.from_rotvec(angle[:, None] * axis)
        turned = tilted if turned is None else turned * tilted
    return None if turned is None else turned.as_quat()
