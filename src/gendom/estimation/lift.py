"""A recorded lift as a simulation with unknowns: initial state, gripper motion, clock."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.materials import Material
from gendom.observation import visible
from gendom.sim import CFL, Body, Gripper, Simulator, Table, check_numbers, cloth, rope

QUASI_STATIC_SPEED = 0.12
"""Gripper speed at which quasi-static recordings are replayed [m/s]."""

QUASI_STATIC_DAMPING = 4.0
"""Damping of quasi-static replays [1/s]; at the speed above its drag is 5 % of gravity."""

DYNAMIC_DAMPING = 1.0
"""Damping of replays on the recorded clock [1/s]."""

ASSUMED_DENSITY = 1000.0
"""Density where the mass is unknown [kg/m^3]: only E / density shows in the motion."""

ASSUMED_THICKNESS = 0.001
"""Thickness of a cloth that the recording does not state [m]."""

HANG_RISE = 2.0
"""Rise over which a held corner turns from lying to hanging, in reaches of the grip."""

FLOOR_MARGIN = 0.003
"""Height above the lowest recorded point up to which a crop has taken the table away [m]."""

SHOWN_AT_REST = 0.5
"""A recording that shows less of the resting object than this has had its table cropped away."""

RAMP_SPEED = 0.1
"""Speed at which the gripper takes the object from rest to its first recorded position [m/s]."""

CLOTH_CELLS = 14
"""Grid cells along a cloth's longer side at full resolution."""


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """How a recording is simulated; written into every result."""

    cells_across: float = 1.5
    """Grid cells across a rope's diameter; cloths scale with it."""
    clock: float | None = None
    """Recorded seconds for one simulated second, or None to choose (1 unless quasi-static)."""
    damping: float | None = None
    """[1/s], or None for the default of the kind of motion."""
    friction: float = 0.3
    """Coefficient of friction of the table."""
    law: str = "neo-hookean"
    dtype: str = "float64"
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        check_numbers("cells_across", self.cells_across, above=0.0)
        check_numbers("friction", self.friction, least=0.0)
        if self.clock is not None:
            check_numbers("clock", self.clock, above=0.0)
        if self.damping is not None:
            check_numbers("damping", self.damping, least=0.0)


@dataclass(frozen=True, kw_only=True)
class Theta:
    """What a lift leaves unknown, besides the density."""

    specific_modulus: float
    """E / density [m^2/s^2]."""
    nu: float = 0.3
    """Poisson's ratio [-]."""
    grip_offset: float = 0.0
    """How much higher the object hangs than the stated gripper position [m]."""


class Lift:
    """One recording, ready to be simulated for any parameters.

    The object starts at rest on its table: a rope along its visible centre line, from the
    gripper on, as long as stated; a cloth as the flat square that holds most of the recorded
    points, held where the recording says. It is carried along the recorded path; heights below
    rest mean slack.

    Args:
        recording: What was seen.
        settings: How to simulate it.

    Raises:
        RecordingError: If the recording shows too little to place the object.
    """

    def __init__(self, recording: Recording, settings: ReplaySettings | None = None):
        self.recording = recording
        self.settings = settings or ReplaySettings()
        self.notes: list[str] = []
        self.frames = [t for t in range(recording.num_frames) if recording.frame_valid[t]]
        if not self.frames:
            raise RecordingError("no frame holds a point", where="points", fix="record again")
        if recording.object.kind == "rope":
            self.body, self.grip = self._place_rope()
        elif recording.object.kind == "cloth":
            self.body, self.grip = self._place_cloth()
        else:
            raise RecordingError(
                f"objects of kind {recording.object.kind!r} cannot be simulated",
                where="meta.object.kind",
                fix="use rope or cloth",
            )
        self.radius = self._grip_radius()
        self.clock = self._choose_clock()
        quasi = recording.quasi_static
        damping = self.settings.damping
        if damping is None:
            damping = QUASI_STATIC_DAMPING if quasi else DYNAMIC_DAMPING
        self.damping = damping
        self.density, self.density_assumed = self._density()
        self.floor = self._find_floor()

    # ---- what the estimator needs -------------------------------------------------------------

    def material(self, theta: Theta) -> Material:
        """The object's material for these parameters."""
        return Material(E=theta.specific_modulus * self.density, nu=theta.nu, density=self.density)

    def simulate(
        self,
        thetas: Sequence[Theta],
        *,
        frames: Sequence[int] | None = None,
        on_frame: Callable[[int], None] | None = None,
    ) -> NDArray[np.floating]:
        """Particle positions [T, W, N, 3] at recorded frames (default: all with points) [m].

        Raises:
            SimulationError: If a world diverges.
        """
        chosen = self.frames if frames is None else list(frames)
        grippers = [self._grippers(theta) for theta in thetas]
        begin = min(float(np.asarray(g.time)[0]) for world in grippers for g in world)
        table = None
        if self.table_height is not None:
            table = Table(height=self.table_height, friction=self.settings.friction)
        simulator = Simulator(
            self.body,
            [self.material(theta) for theta in thetas],
            grippers=grippers,
            table=table,
            damping=self.damping,
            law=self.settings.law,
            cfl=CFL,
            start_time=begin,
            dtype=self.settings.dtype,
            device=self.settings.device,
            threads=self.settings.threads,
        )
        times = self._sim_time(self.recording.time[chosen])
        return simulator.run(times, on_frame=on_frame)

    def inside(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """[n] which points [n, 3] lie in the recorded space: all, or all above ``floor``."""
        if self.floor is None:
            return np.ones(len(points), dtype=bool)
        above = points[:, 2] > self.floor
        return above if above.any() else np.ones(len(points), dtype=bool)

    def visible(self, surface: NDArray[np.floating]) -> NDArray[np.bool_]:
        """[n] which points [n, 3] of the object's surface the cameras could see.

        Without camera positions a rope is seen from above; of a cloth everything counts, since
        both of its sides lie where the cloud is.
        """
        cameras = self.recording.camera_positions
        if cameras is None and self.body.kind == "cloth":
            return np.ones(len(surface), dtype=bool)
        return visible(surface, camera_positions=cameras)

    @property
    def table_height(self) -> float | None:
        return self.recording.table_height

    @property
    def radius_of_gyration(self) -> float:
        """sqrt(I / A) of the real section: d / 4 of a rope, h / sqrt(12) of a sheet [m]."""
        if self.body.kind == "rope":
            return self.body.thickness / 4.0
        return self.body.thickness / math.sqrt(12.0)

    @property
    def size(self) -> float:
        """Length of a rope, diagonal of a cloth [m]."""
        if self.body.kind == "rope":
            return float(np.ptp(self.body.material_coordinates[:, 0]))
        return float(np.linalg.norm(np.ptp(self.body.material_coordinates[:, :2], axis=0)))

    # ---- initial state ---------------------------------------------------------------------------

    def _place_rope(self) -> tuple[Body, NDArray[np.floating]]:
        """The rope along its centre line and the held points [G, 3]."""
        described = self.recording.object
        assert described.length is not None  # the recording's own check
        diameter = described.diameter
        if diameter is None:
            diameter = described.length / 50.0
            self.notes.append(f"diameter not stated: {diameter:.4g} m assumed (length / 50)")
        grip = self.recording.gripper_position[self.frames[0]]
        if len(grip) > 1:
            line = self._line_between(grip)
            start = 0.0
        else:
            line = self._line_from(grip[0], diameter, described.length)
            start = diameter / 2.0
        body = rope(
            diameter=diameter,
            length=described.length,
            centre_line=line,
            cells_across=self.settings.cells_across,
        )
        ends = [start] if len(grip) == 1 else [start, described.length]
        return body, _centre_at(body, np.array(ends))

    def _line_from(self, grip: NDArray, diameter: float, length: float) -> NDArray[np.floating]:
        """Centre line of a rope at rest, from half a diameter behind the gripper on."""
        early = self._early_points(diameter)
        flat = early[:, :2] - grip[:2]
        far = flat[np.linalg.norm(flat, axis=1) > 0.25 * length]
        if len(far) < 5:
            raise RecordingError(
                "the first frames show too little of the rope to tell which way it lies",
                where=f"frames {self.frames[0]}-{self.frames[min(9, len(self.frames) - 1)]}",
                fix="record from the rope at rest on",
            )
        axis = far.mean(axis=0) / np.linalg.norm(far.mean(axis=0))
        side = np.array([-axis[1], axis[0]])
        along, across = flat @ axis, flat @ side
        # bends of the visible line, held straight where a hole in the cloud leaves it open
        fit = np.polynomial.Polynomial.fit(along, across, 2, domain=[0.0, length])
        keep = np.abs(across - fit(along)) < 2.0 * np.std(across - fit(along)) + 1e-6
        fit = np.polynomial.Polynomial.fit(along[keep], across[keep], 2, domain=[0.0, length])
        s = np.linspace(-diameter / 2.0, length, 60)
        inside = np.clip(s, along.min(), along.max())
        curve = fit(inside) + fit.deriv()(inside) * (s - inside)
        height = float(np.median(early[:, 2])) - diameter / 2.0
        if self.table_height is not None:
            height = self.table_height + diameter / 2.0
        xy = grip[:2] + s[:, None] * axis + curve[:, None] * side
        return np.concatenate([xy, np.full((len(s), 1), height)], axis=1)

    def _line_between(self, grip: NDArray) -> NDArray[np.floating]:
        """Centre line of a rope held at both ends, from the first frame."""
        cloud = self.recording.frame(self.frames[0]).astype(float)
        if not self.recording.extra.get("ordered_markers", False):
            axis = (grip[1] - grip[0]) / np.linalg.norm(grip[1] - grip[0])
            cloud = cloud[np.argsort((cloud - grip[0]) @ axis)]
            bins = np.array_split(cloud, min(24, max(2, len(cloud) // 4)))
            cloud = np.array([b.mean(axis=0) for b in bins])
        elif np.linalg.norm(cloud[0] - grip[0]) > np.linalg.norm(cloud[-1] - grip[0]):
            cloud = cloud[::-1]
        self.notes.append("held at both ends: its first shape is taken as free of stress")
        return cloud

    def _place_cloth(self) -> tuple[Body, NDArray[np.floating]]:
        """The flat cloth and the held point [1, 3]."""
        described = self.recording.object
        width, height = described.width, described.height
        assert width is not None and height is not None  # the recording's own check
        thickness = described.thickness
        if thickness is None:
            thickness = ASSUMED_THICKNESS
            self.notes.append(f"thickness not stated: {thickness * 1e3:.3g} mm assumed")
        dx = max(width, height) / CLOTH_CELLS * 1.5 / self.settings.cells_across
        grip = self.recording.gripper_position[self.frames[0], 0]
        yaw = self._cloth_yaw(width, height)
        low = self.table_height
        if low is None:
            low = float(np.percentile(self._early_points(dx)[:, 2], 5))
        mid = low + thickness / 2.0
        local = np.zeros(2) if described.grasp == "corner" else np.array([width, height]) / 2
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        corner = np.append(grip[:2] - turn @ local, mid)
        body = cloth(width=width, height=height, thickness=thickness, dx=dx, corner=corner, yaw=yaw)
        return body, np.array([[grip[0], grip[1], mid]])

    def _cloth_yaw(self, width: float, height: float) -> float:
        """Turn of the flat cloth about the held point.

        Held by a corner it hangs evenly about its diagonal, so the diagonal points to where the
        lifted cloud is. Held elsewhere, the turn whose footprint holds the low points best.
        """
        grip = self.recording.gripper_position[self.frames[0], 0]
        if self.recording.object.grasp == "corner":
            later = self.frames[len(self.frames) // 2 :]
            towards = [self.recording.frame(t)[:, :2].mean(axis=0) - grip[:2] for t in later]
            x, y = np.median(np.array(towards, dtype=float), axis=0)
            return math.atan2(y, x) - math.atan2(height, width)
        points = np.concatenate([self.recording.frame(t) for t in self.frames]).astype(float)
        base = self.table_height if self.table_height is not None else points[:, 2].min()
        low = points[points[:, 2] < base + 0.15 * max(width, height)]
        flat = (low if len(low) > 50 else points)[:, :2] - grip[:2]
        turns = np.linspace(0.0, math.pi, 72, endpoint=False)

        def outside(yaw: float) -> float:
            c, s = math.cos(yaw), math.sin(yaw)
            local = np.abs(flat @ np.array([[c, -s], [s, c]])) - np.array([width, height]) / 2
            return float(np.linalg.norm(np.maximum(local, 0.0), axis=1).mean())

        return float(min(turns, key=outside))

    def _early_points(self, size: float) -> NDArray[np.floating]:
        """Points of the frames before the gripper has moved by ``size`` [m]."""
        path = self.recording.gripper_position[:, 0]
        moved = np.linalg.norm(path - path[self.frames[0]], axis=1)
        early = [t for t in self.frames if moved[t] <= size] or self.frames[:1]
        return np.concatenate([self.recording.frame(t) for t in early]).astype(float)

    # ---- motion ----------------------------------------------------------------------------------

    def _grip_radius(self) -> float:
        if self.body.kind == "rope":
            return 0.75 * self.body.thickness
        return 1.25 * self.body.dx

    def _choose_clock(self) -> float:
        if self.settings.clock is not None:
            return self.settings.clock
        if not self.recording.quasi_static:
            return 1.0
        path = self.recording.gripper_position
        length = np.linalg.norm(np.diff(path, axis=0), axis=-1).sum(axis=0).max()
        duration = float(self.recording.time[-1] - self.recording.time[0])
        return duration * QUASI_STATIC_SPEED / max(float(length), 1e-6)

    def _sim_time(self, recorded: ArrayLike) -> NDArray[np.floating]:
        t = np.asarray(recorded, dtype=float)
        return (t - self.recording.time[self.frames[0]]) / self.clock

    def _find_floor(self) -> float | None:
        """Height below which the recording shows nothing although the object lies there [m]."""
        if self.table_height is None:
            return None
        first = KDTree(self.recording.frame(self.frames[0]).astype(float))
        gaps = first.query(self.body.x)[0]
        shown = float(np.mean(gaps < 0.05 * self.size))
        if shown >= SHOWN_AT_REST:
            return None
        lowest = min(float(self.recording.frame(t)[:, 2].min()) for t in self.frames)
        self.notes.append(
            f"the first frame shows {shown:.0%} of the object at rest: what lies flat was cropped "
            f"away, so particles below {lowest + FLOOR_MARGIN:.4g} m are not compared"
        )
        return lowest + FLOOR_MARGIN

    def _hanging(self, rise: NDArray[np.floating]) -> NDArray[np.floating] | None:
        """[K, 4] turn of the grip: a pinched corner does not stay level, it hangs.

        Args:
            rise: [K] height of the gripper above the resting object [m].
        """
        if self.body.kind != "cloth" or self.recording.object.grasp != "corner":
            return None
        inwards = self.body.x.mean(axis=0) - self.grip[0]
        axis = np.cross(inwards / np.linalg.norm(inwards), [0.0, 0.0, -1.0])
        reach = self.radius + self.body.dx
        angle = math.pi / 2.0 * np.clip(rise / (HANG_RISE * reach), 0.0, 1.0)
        return Rotation.from_rotvec(angle[:, None] * axis).as_quat()

    def _grippers(self, theta: Theta) -> list[Gripper]:
        """The recorded paths, moved onto the held points, with slack and a ramp from rest."""
        made = []
        first = self.frames[0]
        time = self._sim_time(self.recording.time[first:])
        for g, held in enumerate(self.grip):
            path = self.recording.gripper_position[first:, g].astype(float).copy()
            path[:, :2] += held[:2] - path[0, :2]
            path[:, 2] += theta.grip_offset
            if self.table_height is not None:
                path[:, 2] = np.maximum(path[:, 2], held[2])
            knots, at = time, path
            away = np.linalg.norm(path[0] - held)
            if away > 0.0:
                # the first recorded position is reached before the first frame, not in a jump
                knots = np.concatenate([[-away / RAMP_SPEED - 1e-3], time])
                at = np.concatenate([held[None], path])
            turn = self._hanging(at[:, 2] - held[2])
            made.append(Gripper(time=knots, position=at, quat_xyzw=turn, radius=self.radius))
        return made

    def _density(self) -> tuple[float, bool]:
        """Density that is simulated [kg/m^3], and whether it was assumed."""
        mass = self.recording.object.mass
        if mass is None:
            return ASSUMED_DENSITY, True
        return mass / (self.body.volume * self.body.num_particles), False

    def coarser(self, share: float, *, hurry: float) -> "Lift":
        """The same lift on a grid with ``share`` of the cells, quasi-static motion ``hurry`` times
        as fast."""
        clock = self.clock * (hurry if self.recording.quasi_static else 1.0)
        cells = self.settings.cells_across * share
        return Lift(self.recording, replace(self.settings, cells_across=cells, clock=clock))


def _centre_at(body: Body, along: NDArray[np.floating]) -> NDArray[np.floating]:
    """[K, 3] points of a rope's centre line at distances [K] from its first end [m]."""
    s, section = np.unique(body.material_coordinates[:, 0], return_inverse=True)
    count = np.bincount(section)
    centre = [np.bincount(section, body.x[:, a]) / count for a in range(3)]
    return np.stack([np.interp(along, s, c) for c in centre], axis=-1)
