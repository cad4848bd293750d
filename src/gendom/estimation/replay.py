"""Simulated positions of an object in a scene, for given parameters, and its `Shape`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.estimation.markers import aside, axis_beside, material_frames
from gendom.estimation.scene import COARSE_POINTS, STATIC_SETTLING, STRETCH, LiftScene
from gendom.materials import AIR_DENSITY, STANDARD_GRAVITY, Material
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.sim import Gripper, Physics, Solver, Table, Variation
from gendom.sim.thin import rotation

if TYPE_CHECKING:
    from gendom.sim import Simulator

HEM = 0.01
"""Breadth of a cloth's border that may be hemmed [m]."""

RAMP_SPEED, CLAMPING, CLAMPING_SHOWN = 0.1, 0.1, 0.02
"""Speed of the gripper from rest to its first recorded position [m/s], and time in which clamps
turn from where markers show them to how they hold the rope [s], and where offsets are known."""

TWIST_SHOWN, TWIST_SD, TWIST_NOISE = 0.1, 1.0, 2e-4
"""Time in which the twist of a cable is looked for [s], how far hands may be turned about it in
another recording [rad], and how exact markers and their first motion are [m]."""

FEET, SAMPLED, PROJECTIONS = 48, 16, 2
"""Places along the longer side of a cloth that hide others, about, and at least that are looked
for in clouds; Gauss-Newton steps from the middles of cells to feet."""

TURNING, EDGES = 2.0, 48
"""Rotary inertia of a rope's edges over that of stiff ones, so that shear limits no step; and most
edges: thinner ropes are as stiff along as if as thick as those are long, which no bend shows."""

ROPE_REACH, CLOTH_REACH = 0.75, 0.02
"""Where `grasp_radius` is not stated: of a rope [diameters], of two fingertips on a cloth [m]."""


@dataclass
class WorldInputs:
    """Inputs of one simulated world: parameters, and what begins as the recording states it and is
    changed by each unknown's `Unknown.on_replay`, in the order of the registry."""

    scene: LiftScene
    theta: Theta
    positions: Array
    """[N, 3] in the beginning [m]."""
    E_over_rho: float
    """Of a body as thick as stated [m^2/s^2]."""
    stiffness: Array | None = None
    """[N] factors of E along the object; None: 1."""
    mass: Array | None = None
    """[N] factors of the mass of points; None: 1."""
    raised: float = 0.0
    """How much higher than stated one gripper holds the object [m]."""
    clamps: Array = field(default_factory=lambda: np.zeros((2, 3)))
    """Turn of the clamps at a rope's first and last end from what is recorded [rad]: across the
    rope, in two directions, and about it."""
    clamping: float = CLAMPING
    """Time in which they turn so [s]."""

    @classmethod
    def of(cls, scene: LiftScene, theta: Theta) -> WorldInputs:
        """Of a scene with these parameters."""
        inputs, twist = cls(scene, theta, scene.initial, theta.E_over_rho), 0.0
        if scene.beside:
            inputs.positions, twist = axis_beside(scene, theta.offsets, theta.length_ratio)
            inputs.clamping = CLAMPING_SHOWN if theta.offsets else CLAMPING
        for name, unknown in UNKNOWNS.items():
            if unknown.on_replay is not None:
                unknown.on_replay(inputs, theta[name])
        # half of it at each end
        inputs.clamps[:, 2] = 0.5 * (inputs.clamps[1, 2] + twist) * np.array([-1.0, 1.0])
        return inputs

    def thicken(self, times: float) -> None:
        """Make the object so many times as thick as stated.

        The simulated body stays as it is: with its mass, r times as thick, it takes r^2 times the E
        to bend equally, since stiffness over weight goes with the square of the radius of gyration.
        Its middle lies higher on the table, so the gripper is lowered instead.
        """
        self.E_over_rho *= times**2
        self.raised -= self.scene.rise(times)

    def stiffen_along(self, slope: float) -> None:
        """Let ln(E) grow by so much from one end of a rope to the other."""
        scene, share = self.scene, np.linspace(0.0, 1.0, len(self.positions))
        if slope and not scene.thin:
            share = scene.body.material_coordinates[:, 0] / scene.size
        if slope:
            self.stiffness = np.exp(slope * (share - 0.5))

    def hem(self, *, stiffness: float = 1.0, mass: float = 1.0) -> None:
        """Make a cloth's border so many times as stiff in bending, and as heavy as the rest; its
        mass stays as stated."""
        if stiffness != 1.0:
            self.stiffness = self._bordered(stiffness)[0]
        if mass != 1.0:
            factors, area = self._bordered(mass)
            self.mass = factors * (area.sum() / (factors @ area))

    def _bordered(self, times: float) -> tuple[Array, Array]:
        """[N] means of so many times in a border and once elsewhere, over areas [N] [m^2]."""
        rest, breadth = [], []
        for x in lattice(self.scene):
            inwards, half = np.minimum(x, x[-1] - x), 0.5 * (x[1] - x[0])
            low, high = np.maximum(inwards - half, 0.0), inwards + half
            rest.append(1.0 - np.clip((HEM - low) / (high - low), 0.0, 1.0))
            breadth.append(high - low)
        within, area = (np.outer(second, first).ravel() for first, second in (rest, breadth))
        return times + within * (1.0 - times), area

    def weigh_tip(self, share: float) -> None:
        """Let a share of a rope's mass, which stays as stated, sit at its free end."""
        if share:
            points = len(self.positions)
            self.mass = np.full(points, 1.0 - share)
            # half an edge's mass is its own
            self.mass[-1] += 2.0 * share * (points - 1)

    def shift(self, *, along: float = 0.0, aside: float = 0.0) -> None:
        """Hold the object so much farther from its end or corner, or from its diagonal [m]: the
        object is moved, so that what is held is where the gripper closes."""
        if len(self.scene.held) == 1:
            inwards = self.scene.inwards[0]
            left = np.array([-inwards[1], inwards[0], 0.0])
            self.positions = self.positions - along * inwards - aside * left

    def turn(self, yaw: float) -> None:
        """Turn the lying cloth about the held point [rad]."""
        if yaw and len(self.scene.held) == 1:
            turn, held = Rotation.from_euler("z", yaw).as_matrix(), self.scene.held[0]
            self.positions = held + (self.positions - held) @ turn.T

    def soften_grip(self, turn: float) -> None:
        """Let a rope turn in soft fingers, by its moment there: by so much [rad] when its other end
        leaves the table.

        The pads are a spring in series with the joint at the fingers' border (`sim.thin.grips`).
        The moment then is half the weight times the length of a stick; of a chain,
        sqrt(2 E I w L), with w the weight by length.
        """
        from gendom.sim.thin.rods import SHORTEST  # Warp, which takes long to import

        scene, x = self.scene, self.positions
        if not turn or not scene.thin or len(scene.held) > 1:
            return
        reach, step = held_reach(scene), scene.size / (len(x) - 1)
        away = np.linalg.norm(0.5 * (x[1:] + x[:-1]) - scene.held[0], axis=1)
        held = np.flatnonzero(away < max(reach, float(away.min()) + 1e-9))
        joint = min(int(held[-1]) + 1, len(x) - 2)
        inset = float(np.linalg.norm(scene.held[0] - x[0]))
        border = float(np.clip(inset + reach - joint * step, -0.5 * step, 0.5 * step))
        own = max(0.375 * step - border + 0.5 * border**2 / step, SHORTEST * step)
        bends = scene.bending_length(self.E_over_rho)
        lever = min(math.sqrt(2.0 * bends**3 * scene.size), 0.5 * scene.size**2)  # M / w
        self.stiffness = np.ones(len(x)) if self.stiffness is None else self.stiffness
        self.stiffness[joint] *= own / (own + turn * bends**3 / lever)

    @property
    def material(self) -> Material:
        """The object's material."""
        scene, described, more = self.scene, self.scene.recording.object, {}
        E = self.E_over_rho * scene.density
        hangs = described.length or max(described.width or 0.0, described.height or 0.0)
        along = scene.density * STANDARD_GRAVITY * hangs / (2.0 * STRETCH)
        if scene.kind == "cloth" and scene.thin:
            warp = math.sqrt(self.theta.warp_over_weft)
            more = {"membrane": min(E, along), "warp": warp, "weft": 1.0 / warp}
        elif scene.thin:
            # fibres, which slide past each other in bending
            most = max(along, E * min(1.0, EDGES * scene.body.thickness / scene.size) ** 2)
            more = {} if most == E else {"membrane": most}
        nu, damping = self.theta.nu, self.theta.damping
        return Material(E=E, nu=nu, density=scene.density, damping=damping, **more)

    def gripper(self, g: int) -> Gripper:
        """The recorded path, moved onto the held point, with slack and a ramp from rest."""
        scene, held = self.scene, self.scene.held[g]
        delay, (knots, path, turned) = self.theta.delay / scene.clock, scene.paths[g]
        knots, at = knots + delay, path.copy()
        if len(scene.held) == 1:
            at[:, :2] += held[:2] - at[0, :2]
            at[:, 2] += self.raised
            if scene.recording.table_height is not None:
                at[:, 2] = np.maximum(at[:, 2], held[2])
        away = float(np.linalg.norm(at[0] - held))
        if away > 0.0:
            # the first recorded position is reached before the first frame, not in a jump
            begin = knots[0] - away / RAMP_SPEED - 1e-3
            knots, at = np.append(begin, knots), np.concatenate([held[None], at])
            turned = None if turned is None else Rotation.concatenate([turned[0], turned])
        reach = held_reach(scene, self.theta.grip_reach, self.positions)
        return Gripper(
            time=knots,
            position=at,
            quat_xyzw=self._turned(g, knots, at, reach, turned),
            radius=reach,
            **_closed(scene, g, delay),
        )

    def _turned(
        self, g: int, knots: Array, at: Array, reach: float, recorded: Rotation | None
    ) -> Array | None:
        """[K, 4] how a gripper turns, or None: as its recorded axis does; and a pinched corner does
        not stay level beside it, it hangs once the gripper has risen by its reach."""
        scene, found = self.scene, [] if recorded is None else [recorded.as_quat()]
        if scene.by_corner:
            rise = at[:, 2] - scene.held[g, 2]
            inwards = Rotation.from_euler("z", self.theta.yaw).apply(scene.inwards[g])
            axis = np.cross(inwards, [0.0, 0.0, -1.0])
            angle = self.theta.grip_tilt * np.clip(rise / (2.0 * reach), 0.0, 1.0)
            found.append(Rotation.from_rotvec(angle[:, None] * axis).as_quat())
        if len(scene.held) > 1 and self.clamps[g].any():
            # the first frame shows how markers lie, not how the rope leaves the clamp
            begun = np.clip((knots - knots[0]) / self.clamping, 0.0, 1.0)
            turn = scene.clamp_frames[g] @ self.clamps[g]
            found.append(Rotation.from_rotvec(begun[:, None] * turn).as_quat())
        return reduce(rotation.product, found) if found else None


def simulator_of(scene: LiftScene, thetas: Sequence[Theta]) -> tuple[Simulator, Array]:
    """W worlds about to replay a scene, and the simulated times [T] of its frames [s].

    Raises:
        ParameterError: A parameter is out of its range.
    """
    from gendom.sim import Simulator  # Warp, which takes long to import

    worlds = [WorldInputs.of(scene, theta) for theta in thetas]
    grippers = [[world.gripper(g) for g in range(len(scene.held))] for world in worlds]
    times = scene.sim_time(scene.recording.time[list(scene.frames)])
    begin = min(float(np.asarray(g.time)[0]) for world in grippers for g in world)
    begin = min(begin, float(times[0])) - (STATIC_SETTLING if scene.static else 0.0)
    table, height = None, scene.recording.table_height
    if height is not None:
        table = Table(height=height, friction=[theta.friction for theta in thetas])
    simulator = Simulator(
        scene.body,
        [w.material for w in worlds],
        grippers=grippers,
        table=table,
        variation=Variation(
            stiffness=_stacked([w.stiffness for w in worlds], len(scene.initial)),
            mass=_stacked([w.mass for w in worlds], len(scene.initial)),
            natural_curvature=[t.natural_curvature for t in thetas] if scene.curved else 1.0,
            stretch=[theta.length_ratio for theta in thetas] if scene.beside else 1.0,
            turning=TURNING if scene.kind == "rope" and scene.thin else 1.0,
        ),
        positions=np.stack([w.positions for w in worlds]),
        start_time=begin,
        physics=Physics(
            velocity_damping=scene.velocity_damping,
            air_density=[AIR_DENSITY * theta.air_drag for theta in thetas],
        ),
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
    """[T, W, N, 3] particles, or points of a rod or shell, at the frames of a scene [m]; of a cable
    with markers beside its axis the line through these. ``on_frame`` is called with the number of
    frames done; `keep_going` leaves NaN in worlds that cannot be simulated.

    Raises:
        SimulationError: A world diverges, and `keep_going` is not set.
    """
    thetas = [with_twist_shown(scene, theta) for theta in thetas]
    x = replay_axis(scene, thetas, keep_going=keep_going, on_frame=on_frame)
    return x + _beside(scene, x, thetas)


def _beside(scene: LiftScene, x: Array, thetas: Sequence[Theta]) -> Array:
    """[T, W, n, 3] by how much lines through markers are beside axes [m]."""
    found = np.zeros(x.shape)
    for w, offsets in enumerate(theta.offsets for theta in thetas):
        if scene.beside and offsets and np.isfinite(x[:, w]).all():
            frames = material_frames(scene, x[:, w : w + 1])
            found[:, w] = aside(scene, frames[:, 0], np.asarray(offsets))
    return found


def with_twist_shown(scene: LiftScene, theta: Theta) -> Theta:
    """Parameters of an instrumented cable with the twist with which this recording begins, which
    pushes a bent cable aside at once: that with which its first tenth of a second is nearest."""
    recording, begins = scene.recording, scene.begins
    shown = recording.time <= recording.time[begins] + TWIST_SHOWN
    early = tuple(int(t) for t in np.flatnonzero(shown & recording.frame_valid) if t >= begins)
    if not (scene.beside and theta.offsets and len(early) > 4):
        return theta
    scene = replace(scene, frames=early)
    changes = TWIST_SD * np.linspace(-2.5, 2.5, 11)
    twists = theta.clamp_twist + changes
    every = [theta.with_values({"clamp_twist": float(twist)}) for twist in twists]
    x, (index, weight) = replay_axis(scene, every, keep_going=True), scene.markers
    at = np.einsum("mk,twmka->twma", weight, (x + _beside(scene, x, every))[:, :, index])
    off = at - np.stack([recording.frame(t) for t in early])[:, None]
    mean = np.nan_to_num(((off - off[:1]) ** 2).mean(axis=(0, 2, 3)), nan=np.inf)
    # as many errors are independent as there are markers
    value = len(index) * mean / max(mean.min(), TWIST_NOISE**2) + (changes / TWIST_SD) ** 2
    k = int(np.clip(value.argmin(), 1, len(value) - 2))
    bend, slope, _ = np.polyfit(changes[k - 1 : k + 2] - changes[k], value[k - 1 : k + 2], 2)
    found = twists[k] - (0.5 * slope / bend if bend > 0.0 else 0.0)
    return theta.with_values({"clamp_twist": float(np.clip(found, twists[0], twists[-1]))})


def replay_axis(scene: LiftScene, thetas: Sequence[Theta], **run: Any) -> Array:
    """As `replay`, with the options of `Simulator.run`; of a cable its axis."""
    simulator, times = simulator_of(scene, thetas)
    x = simulator.run(times, **run).astype(float)
    # a thicker object lies higher: its table is raised and its grippers are lowered
    x[..., 2] += np.array([scene.rise(theta.thickness) for theta in thetas])[:, None]
    return x


def middle(scene: LiftScene, x: Array) -> Array:
    """[..., n, 3] a rope's centre line or a cloth's middle surface, row by row along its first
    axis, for positions [..., N, 3] of `replay` [m]; `lattice` has its shape."""
    if scene.thin:
        return x
    first, second = (len(ticks) for ticks in lattice(scene))
    layers = x.reshape(*x.shape[:-2], first, second, -1, 3).mean(axis=-2)
    return np.swapaxes(layers, -3, -2).reshape(*x.shape[:-2], -1, 3)


def lattice(scene: LiftScene) -> tuple[Array, Array]:
    """Places of `middle`'s points in the object: [n] along a rope and [1] 0, or columns and rows of
    a cloth, which has them row by row [m]."""
    body, described = scene.body, scene.recording.object
    if not scene.thin:
        first, second = (np.unique(x) for x in body.material_coordinates[:, :2].T)
        return first, np.zeros(1) if scene.kind == "rope" else second
    if scene.kind == "rope":
        return np.linspace(0.0, scene.size, len(body.points)), np.zeros(1)
    rows, columns = body.shape
    assert described.width is not None and described.height is not None
    return np.linspace(0.0, described.width, columns), np.linspace(0.0, described.height, rows)


def _stacked(factors: Sequence[Array | None], points: int) -> Array | float:
    """[W, N] factors of each world's points, or 1."""
    if all(f is None for f in factors):
        return 1.0
    return np.stack([np.ones(points) if f is None else f for f in factors])


def _closed(scene: LiftScene, g: int, delay: float) -> dict[str, Any]:
    """When a gripper closes and opens, halfway between frames."""
    closed, first = scene.recording.gripper_closed, scene.begins
    if closed is None:
        return {}
    states, time = closed[first:, g], scene.sim_time(scene.recording.time[first:]) + delay
    between, starts = 0.5 * (time[1:] + time[:-1]), int(np.argmax(states))
    opens = starts + np.flatnonzero(~states[starts:])[:1]
    found = {"hold_from": between[starts - 1 : starts], "hold_until": between[opens - 1]}
    return {name: float(at[0]) for name, at in found.items() if len(at)}


def held_reach(scene: LiftScene, farther: float = 0.0, x: Array | None = None) -> float:
    """How far from its point a gripper holds the object, at [N, 3] or where it is shown to begin,
    fast; a cloth so much farther than stated [m]."""
    stated, thick = scene.recording.object.grasp_radius, scene.body.thickness
    if scene.kind == "rope" and len(scene.held) > 1:
        # a gripper holds the part from its point to the end, and as much on the other side
        ends = np.stack([scene.initial, scene.initial if x is None else x])[:, [0, -1]]
        gap = float(np.linalg.norm(ends - scene.held, axis=2).max())
        return max(stated or 0.5 * thick, (1.0 + 1e-6) * gap)
    if scene.kind == "rope":
        return stated or ROPE_REACH * thick
    side, least = scene.size / math.sqrt(2.0), 0.4 * scene.body.dx
    if scene.thin:
        # so that it holds points wherever it is
        least = 0.6 * side / (COARSE_POINTS[scene.kind] - 1)
    return max((stated or CLOTH_REACH) + farther, least)


class Shape:
    """The middle line or surface of a scene's object as a finite element."""

    def __init__(self, scene: LiftScene):
        self.rope = scene.kind == "rope"
        self.radius = scene.body.thickness / 2.0
        self.lattice = a, b = lattice(scene)
        if self.rope:
            k = np.arange(len(a) - 1)
            index = np.repeat(np.stack([k, k + 1], axis=1), 2, axis=0)
            self.samples = index, np.tile([[0.75, 0.25], [0.25, 0.75]], (len(k), 1))
            self.spacing = float(a[1] - a[0])
            return
        parts = max(2, round(FEET / max(len(a) - 1, len(b) - 1)))
        self.spacing = float(max(a[1] - a[0], b[1] - b[0])) / parts
        middles = [np.arange(len(k) - 1) + 0.5 for k in self.lattice]
        every = [max(1, len(k) // SAMPLED) for k in middles]
        kept = [k[n // 2 :: n] for k, n in zip(middles, every, strict=True)]
        ticks = [(np.arange(parts * len(k)) + 0.5) / parts for k in middles]
        self.cells, self.samples, self.fine = (
            self._places(np.stack(np.meshgrid(*own)).reshape(2, -1))
            for own in (middles, kept, ticks)
        )

    def _places(self, at: Array) -> tuple[Array, Array]:
        """[..., 4] corners of a sheet's cells, and shares, at places [2, ...] in cells by side."""
        across, up = (len(k) for k in self.lattice)
        column = np.minimum(at[0], across - 2.0).astype(int)
        row = np.minimum(at[1], up - 2.0).astype(int)
        u, v = at[0] - column, at[1] - row
        shares = (1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v
        corners = (row * across + column)[..., None] + [0, 1, across, across + 1]
        return corners, np.stack(shares, axis=-1)

    def taken_from(self, other: Shape, values: Array) -> Array:
        """[T, n, ...] at this shape's points, linear between values at those of another one."""
        if [len(k) for k in self.lattice] == [len(k) for k in other.lattice]:
            return values
        Ka, Kb = (
            np.stack([np.interp(ours, theirs, e) for e in np.eye(len(theirs))], axis=1)
            for ours, theirs in zip(self.lattice, other.lattice, strict=True)
        )
        T, _, *rest = values.shape
        rows = values.reshape(T, Kb.shape[1], Ka.shape[1], -1)
        found = np.einsum("ij,kl,tjlp->tikp", Kb, Ka, rows, optimize=True)
        return found.reshape(T, len(Kb) * len(Ka), *rest)

    def nearest(self, x: Array, points: Array) -> tuple[Array, Array, Array]:
        """Middle points around the feet of points [T, m, 3] on shapes [T, n, 3], [T, m, k], their
        shares, and the feet [T, m, 3]."""
        if self.rope:
            a, d = x[:, :-1], np.diff(x, axis=1)
            long = np.maximum((d**2).sum(axis=2), 1e-18)[:, None]
            # |p - a - u d|^2 - |p|^2 with u the foot's share of each edge, by products of matrices
            p = _with_ones(points)
            along = p @ _columns(d, -(a * d).sum(axis=2))
            far = p @ _columns(-2.0 * a, (a**2).sum(axis=2))
            u = np.clip(along / long, 0.0, 1.0)
            k = (far - u * (2.0 * along - u * long)).argmin(axis=2)
            share = np.take_along_axis(u, k[..., None], axis=2)
            foot = np.take_along_axis(a, k[..., None], axis=1)
            foot = foot + share * np.take_along_axis(d, k[..., None], axis=1)
            return np.stack([k, k + 1], axis=2), np.concatenate([1.0 - share, share], axis=2), foot
        index, weight = self.cells
        places = np.einsum("mk,tmka->tma", weight, x[:, index])
        # trees that are built fast, for about as many queries as they have points
        trees = (KDTree(a, balanced_tree=False, compact_nodes=False) for a in places)
        near = np.stack([tree.query(b)[1] for tree, b in zip(trees, points, strict=True)])
        most = np.array([len(k) - 1.0 for k in self.lattice]).reshape(2, 1, 1)
        at = np.stack(np.divmod(near, len(self.lattice[0]) - 1)[::-1]) + 0.5
        # points that belonged to such places would pull sheets along themselves: registrations
        # would creep, and the likelihood jitter
        for left in range(PROJECTIONS, -1, -1):
            index, weight = self._places(at)
            q = taken(x, index)
            foot = np.einsum("tmk,tmka->tma", weight, q)
            if not left:
                break
            e, ways = points - foot, tangents(q, weight)
            (A, B), (_, C) = ([(d * other).sum(axis=2) for other in ways] for d in ways)
            f, g = ((d * e).sum(axis=2) for d in ways)
            size = np.maximum(A * C - B * B, 1e-3 * A * C + 1e-18)
            step = np.stack([C * f - B * g, A * g - B * f]) / size
            at = np.clip(at + np.clip(step, -1.0, 1.0), 0.0, most)
        return index, weight, foot

    def normals(self, x: Array, index: Array, weight: Array) -> Array:
        """[T, m, 3] unit normals of sheets [T, n, 3] at places in cells with corners [T, m, 4], by
        the corners' shares."""
        n = np.cross(*tangents(taken(x, index), weight))
        return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-18)


def tangents(q: Array, weight: Array) -> tuple[Array, Array]:
    """[..., 3] along a cell's first and second side, at places by the shares [..., 4] of its
    corners [..., 4, 3]; 1 is from one side to the other."""
    u, v = (weight[..., k, None] + weight[..., 3, None] for k in (1, 2))
    edges = (q[..., b, :] - q[..., a, :] for a, b in ((0, 1), (2, 3), (0, 2), (1, 3)))
    near, far, left, right = edges
    return near + v * (far - near), left + u * (right - left)


def nearest_of(points: Array, places: Array) -> Array:
    """[T, m] which of few points [T, k, 3] are nearest to places [T, m, 3]."""
    return (_with_ones(places) @ _columns(-2.0 * points, (points**2).sum(axis=2))).argmin(axis=2)


def _with_ones(x: Array) -> Array:
    """[T, m, 4] vectors [T, m, 3] with 1 as a last component."""
    return np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=2)


def _columns(of: Array, last: Array) -> Array:
    """[T, 4, n] of vectors [T, n, 3] and a last component [T, n]."""
    return np.swapaxes(np.concatenate([of, last[..., None]], axis=2), 1, 2)


def taken(J: Array, index: Array) -> Array:
    """[T, m, k, 3] of [T, n, 3] at indices [T, m, k]."""
    return J[np.arange(len(index))[:, None, None], index]
