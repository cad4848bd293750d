"""What a recording says before any parameter is known: a `Scene`, made once and never changed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from gendom.datasets import Recording
from gendom.errors import ParameterError, RecordingError
from gendom.estimation.theta import Prior, Theta, prior_of
from gendom.materials import STANDARD_GRAVITY
from gendom.materials.parameters import bending_length, specific_modulus_of
from gendom.sim import ENGINES, Body, check_numbers, cloth, rope

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How a recording is turned into a simulation; written into every result."""

    engine: str = "thin"
    """``thin`` (ropes as rods, cloths as shells) or ``mpm``."""
    points: int | None = None
    """Of a rod, or along the longer side of a shell; None: the engine's own for ropes, 26 for
    cloths (with 16 a cotton cloth's E comes out at 0.2 of what it is, with 26 at 0.65)."""
    coarse_points: int = 15
    """Along the longer side of a shell, where a search begins."""
    cells_across: float = 1.5
    """Grid cells across a rope's diameter; cloths scale with it. Of the MPM."""
    clock: float | None = None
    """Recorded seconds for one simulated second, or None to choose (1 unless quasi-static)."""
    quasi_static_speed: float = 0.05
    """Gripper speed at which quasi-static recordings are replayed [m/s]. Faster, a rope that leaves
    the table swings: by 20 mm at 0.12 m/s."""
    quasi_static_damping: float = 1.0
    """Rate at which velocities decay in quasi-static replays [1/s]; at the speed above its drag is
    0.5 % of gravity."""
    static_damping: float = 3.0
    """The same where nothing moves [1/s]."""
    static_settling: float = 6.0
    """Time in which such an object comes to rest [s]; its slowest swing then has e^-9 left."""
    ramp_speed: float = 0.1
    """Speed at which the gripper takes the object from rest to its first recorded position [m/s]"""
    slow: float = 0.15
    """Speed of a gripper below which frames are alike [m/s]."""
    after_fast: float = 1.5
    """Time for which an object goes on moving after its gripper was fast or let go [s]."""
    longest: float = 300.0
    """Longest motion that is simulated [s]; a lift takes ten."""
    slow_frames: int = 36
    """Frames that are compared where the gripper is slow, at most."""
    hangs: float = 0.15
    """Rise of a held corner from which a cloth hangs, in its longer side: before, clouds show
    hardly more than how it lay."""
    fast_frames: int = 60
    """Frames that are compared elsewhere, at most."""
    dtype: str | None = None
    """``float32`` or ``float64``; None: the engine's own."""
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        check_numbers("cells_across", self.cells_across, above=0.0)
        if not 0.5 <= self.cells_across <= 6.0:
            raise ParameterError(
                f"is {self.cells_across:g}", where="cells_across", fix="give 0.5 to 6"
            )
        if self.engine not in ENGINES:
            raise ParameterError(
                f"unknown engine {self.engine!r}", fix=f"choose one of {', '.join(ENGINES)}"
            )
        if self.clock is not None:
            check_numbers("clock", self.clock, above=0.0)
        if self.points is not None and self.points < 5:
            raise ParameterError(f"is {self.points}", where="points", fix="give 5 or more")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A recorded object at rest, what held it and where, and what is compared.

    A rope lies along its visible centre line, from the gripper on, as long as stated; a cloth is
    the flat rectangle that holds most of the recorded points, held where the recording says. Held
    at both ends, a rope that is straight by nature begins as the first frame shows it, as fast as
    its markers are.
    """

    recording: Recording
    settings: SceneSettings
    body: Body
    initial: Array
    """[N, 3] particles, or points of a rod or shell, in the beginning [m]."""
    velocities: Array | None = None
    """[N, 3] likewise [m/s]; None: at rest."""
    held: Array
    """[G, 3] points of the object that the grippers hold then [m]."""
    inwards: Array
    """[G, 3] unit vectors from those along the object: a rope's direction, a cloth's diagonal."""
    frames: tuple[int, ...]
    """Those that hold points and are compared."""
    calm: tuple[int, ...]
    """Those of them in which nothing moves fast."""
    clock: float
    """Recorded seconds for one simulated second."""
    density: float
    """That is simulated [kg/m^3]."""
    notes: tuple[str, ...] = field(default=())
    """What was assumed."""

    @classmethod
    def of(cls, recording: Recording, settings: SceneSettings | None = None) -> Scene:
        """The scene of a recording.

        Raises:
            RecordingError: The recording shows too little to place the object.
            ParameterError: Settings do not fit it.
        """
        settings = settings or SceneSettings()
        frames = tuple(t for t in range(recording.num_frames) if recording.frame_valid[t])
        if not frames:
            raise RecordingError("no frame holds a point", where="points", fix="record again")
        kind, notes = recording.object.kind, []
        if kind not in ("rope", "cloth"):
            raise RecordingError(
                f"objects of kind {kind!r} cannot be simulated",
                where="meta.object.kind",
                fix="use rope or cloth",
            )
        if kind == "cloth":
            placed = _place_cloth(recording, settings, frames, notes)
        elif recording.num_grippers == 1:
            placed = _place_rope(recording, settings, frames, notes)
        else:
            placed = _place_between(recording, settings, frames, notes)
        body = placed.body
        clock = _choose_clock(recording, settings, frames)
        lasts = float(recording.time[frames[-1]] - recording.time[frames[0]]) / clock
        if lasts > settings.longest:
            raise RecordingError(
                f"lasts {lasts:.4g} s, longer than the {settings.longest:g} s that are simulated",
                where="time",
                fix="give seconds; cut what does not belong to the motion",
            )
        calm, fast = _compared(recording, settings, _hanging(recording, settings, frames))
        mass, density = recording.object.mass, 1000.0
        if mass is None:
            notes.append(
                "mass not stated: a density of 1000 kg/m^3 assumed, so E is worth no more than "
                "E / density and the bending length"
            )
        else:
            density = mass / (body.volume * body.num_particles)
        return cls(
            recording=recording,
            settings=settings,
            body=body,
            initial=placed.initial,
            velocities=placed.velocities,
            held=placed.held,
            inwards=placed.inwards,
            frames=tuple(sorted(calm + fast)),
            calm=calm,
            clock=clock,
            density=density,
            notes=tuple(notes),
        )

    @property
    def kind(self) -> str:
        return self.body.kind

    @property
    def thin(self) -> bool:
        """Whether the engine knows a rope by its centre line, a cloth by its middle surface."""
        return self.settings.engine == "thin"

    @property
    def quasi_static(self) -> bool:
        """Whether it is replayed on another clock than the recorded one, or nothing moves."""
        return self.static or (self.recording.quasi_static and self.clock != 1.0)

    @property
    def static(self) -> bool:
        """Whether nothing moves: frames are repeats of one shape at rest."""
        return bool(self.recording.extra.get("static", False))

    @property
    def settles(self) -> float:
        """Simulated time before the first frame in which the object comes to rest [s]."""
        return self.settings.static_settling if self.static else 0.0

    @property
    def velocity_damping(self) -> float:
        if self.static:
            return self.settings.static_damping
        return self.settings.quasi_static_damping if self.quasi_static else 0.0

    @property
    def ordered(self) -> bool:
        """Whether points are the same markers in every frame, in order along the rope."""
        return bool(self.recording.extra.get("ordered_markers", False))

    @property
    def begins(self) -> int:
        """The first frame with points, in which the object is at rest."""
        return int(np.argmax(self.recording.frame_valid))

    @property
    def lets_go(self) -> bool:
        """Whether a gripper opens before the last frame."""
        closed = self.recording.gripper_closed
        return closed is not None and not bool(closed[self.begins :].all())

    @property
    def size(self) -> float:
        """Length of a rope, diagonal of a cloth [m]."""
        size = self.recording.object.size
        assert size is not None  # the recording's own check
        return size

    @property
    def radius_of_gyration(self) -> float:
        """sqrt(I / A) of the section: d / 4 of a rope, h / sqrt(12) of a sheet [m]."""
        share = 4.0 if self.kind == "rope" else math.sqrt(12.0)
        return self.body.thickness / share

    def bending_length(self, specific_modulus: float) -> float:
        """[m]."""
        return bending_length(specific_modulus, self.radius_of_gyration, STANDARD_GRAVITY)

    def specific_modulus(self, bending: float) -> float:
        """E / density [m^2/s^2] of an object with this bending length [m]."""
        return specific_modulus_of(bending, self.radius_of_gyration, STANDARD_GRAVITY)

    @cached_property
    def floor(self) -> float | None:
        """Height below which the recording shows nothing although the object lies there [m].

        Clouds of tables are often cut off a little above them. Less than half of the object at
        rest is then seen.
        """
        table = self.recording.table_height
        if table is None:
            return None
        from scipy.spatial import KDTree

        cloud = self.recording.frame(self.begins).astype(float)
        gaps = KDTree(cloud).query(self.body.points)[0]
        if float(np.mean(gaps < 0.05 * self.size)) >= 0.5:
            return None
        return 0.003 + min(float(self.recording.frame(t)[:, 2].min()) for t in self.frames)

    def sim_time(self, recorded: Array | float) -> Array:
        """Simulated time of recorded ones; 0 in the first frame [s]."""
        t = np.asarray(recorded, dtype=float)
        return (t - self.recording.time[self.begins]) / self.clock

    def path(self, g: int) -> tuple[Array, Array]:
        """Simulated times [K] [s] and stated positions [K, 3] [m] of a gripper from the first
        frame on, between frames of fast motion without corners."""
        first = self.begins
        t = self.sim_time(self.recording.time[first:])
        x = self.recording.gripper_position[first:, g].astype(float)
        if self.quasi_static or len(t) < 3:
            return t, x
        fine = np.linspace(t[0], t[-1], max(2, round(float(t[-1] - t[0]) / 0.005)))
        return fine, PchipInterpolator(t, x, axis=0)(fine)

    @cached_property
    def turns(self) -> list[tuple[Array, Rotation] | None]:
        """How each gripper has turned since the first frame at simulated times, or None: not.

        As its recorded axis does, without turning about it.
        """
        axes, first, found = self.recording.gripper_axis, self.begins, []
        for g in range(len(self.held)):
            if axes is None or np.ptp(axes[first:, g], axis=0).max() < 1e-3:
                found.append(None)
                continue
            turned = [Rotation.identity()]
            for a, b in pairwise(axes[first:, g].astype(float)):
                # the smallest turn from one axis to the next
                normal = np.cross(a, b)
                size = float(np.linalg.norm(normal))
                step = normal * (math.atan2(size, float(a @ b)) / max(size, 1e-12))
                turned.append(Rotation.from_rotvec(step) * turned[-1])
            times = self.sim_time(self.recording.time[first:])
            found.append((times, Rotation.concatenate(turned)))
        return found

    @property
    def guesses(self) -> list[dict[str, float]]:
        """Values of a recording's own unknowns from which a search should begin.

        Where a cloth's corner was sent by commands, a level one at the stated point and one that
        hangs at fingertips below it look alike from afar, and a search from one stays there.
        """
        if self.kind != "cloth" or self.recording.object.grasp != "corner":
            return [{}]
        hanging = {"grip_tilt": 1.4}
        if self.recording.gripper_source != "measured":
            hanging |= {"grip_along": 0.02, "grip_height": -0.02, "delay": 0.1}
        return [{"grip_tilt": 0.2}, {"grip_tilt": 0.8}, hanging]

    def prior(self, wanted: tuple[str, ...] = ()) -> tuple[Prior, Theta]:
        """What is looked for here, its prior, and the estimate that has everything else.

        Args:
            wanted: Names; by default what a recording of this kind shows.

        Raises:
            ParameterError: There is no such unknown, or the object has none.
        """
        return _prior(self, wanted)


# ---- what is believed --------------------------------------------------------------------------

BENDING_RANGE = {"rope": (0.04, 2.5), "cloth": (0.01, 0.2)}
"""Bending lengths that are looked for, in lengths of a rope or diagonals of a cloth: below it hangs
like a chain, above it is a stick."""


def _prior(scene: Scene, wanted: tuple[str, ...]) -> tuple[Prior, Theta]:
    recording, kind = scene.recording, scene.kind
    described = recording.object
    measured = recording.gripper_source == "measured"
    both = scene.recording.num_grippers > 1
    names = ["specific_modulus", "nu", "friction", "grip_height", "grip_along"]
    if not scene.quasi_static:
        names += ["damping", "delay"]
    if recording.table_height is None:
        names.remove("friction")
    if both:
        names.remove("grip_height")
        names.remove("grip_along")
    if kind == "cloth":
        names.remove("nu")
        if described.grasp == "corner":
            names += ["grip_aside", "grip_tilt", "grip_reach", "yaw"]
    if wanted:
        from gendom.estimation.theta import UNKNOWNS

        for name in wanted:
            if name in UNKNOWNS and kind not in UNKNOWNS[name].kinds:
                raise ParameterError(f"a {kind} has no {name}", where="unknowns")
        names = list(wanted)
    low, high = (scene.specific_modulus(b * scene.size) for b in BENDING_RANGE[kind])
    logs = np.log([low, high])
    changes: dict[str, dict[str, float]] = {
        # searched over its range without preference: a wide Gaussian
        "specific_modulus": {
            "low": low, "high": high, "mean": math.exp(logs.mean()), "sd": float(np.ptp(logs)) / 2,
        },
        # an arm trails its commands, and what it is sent to is a point of the hand
        "grip_height": {"sd": 0.002 if measured else (0.02 if kind == "cloth" else 0.01)},
        "delay": {"sd": 0.02 if measured else 0.1, "mean": 0.0 if measured else 0.05},
        "grip_along": {"sd": 0.002 if described.grasp_inset is not None else 0.008},
    }  # fmt: skip
    if kind == "cloth":
        changes["grip_along"] |= {"sd": 0.01 if measured else 0.02, "low": -0.02}
        changes["grip_tilt"] = {"sd": 0.6}
        changes["specific_modulus"]["step"] = 0.06
        changes["grip_height"] |= {"step": 2e-3}
        changes["grip_along"] |= {"step": 3e-3}
    prior = prior_of(names, changes)
    base = Theta(specific_modulus=math.exp(logs.mean()))
    base = prior.theta(prior.mean, base)
    return prior, base


# ---- frames and time ---------------------------------------------------------------------------


def _choose_clock(recording: Recording, settings: SceneSettings, frames: tuple[int, ...]) -> float:
    if settings.clock is not None:
        return settings.clock
    if not recording.quasi_static or recording.extra.get("static", False):
        return 1.0
    if recording.num_frames < 2:
        return 1.0
    path, time = recording.gripper_position, recording.time
    steps = np.linalg.norm(np.diff(path, axis=0), axis=-1).max(axis=1)
    moving = steps > 0.1 * steps.max()
    speed = float(steps[moving].sum() / max(float(np.diff(time)[moving].sum()), 1e-9))
    # what is hardly slower is not hurried: it does not swing where the world did not
    clock = settings.quasi_static_speed / max(speed, 1e-9)
    return clock if clock > 1.5 else 1.0


def _hanging(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...]
) -> tuple[int, ...]:
    """Frames in which a cloth that is held by a corner hangs, all others' without change."""
    described = recording.object
    if described.kind != "cloth" or described.grasp != "corner":
        return frames
    height = recording.gripper_position[:, 0, 2]
    least = settings.hangs * max(described.width or 0.0, described.height or 0.0)
    found = tuple(t for t in frames if height[t] - height[frames[0]] > least)
    return found if len(found) >= 5 else frames


def _compared(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Frames in which the object is carried slowly, and those in which it moves fast, not too many
    of each."""
    time, path = recording.time, recording.gripper_position
    fast = np.zeros(recording.num_frames, dtype=bool)
    if not recording.quasi_static and recording.num_frames > 1:
        speed = np.linalg.norm(np.gradient(path, time, axis=0), axis=-1).max(axis=1)
        moments = list(time[speed > settings.slow])
        if recording.gripper_closed is not None:
            moments += list(time[(~recording.gripper_closed).any(axis=1)])
        for moment in moments:
            fast |= (time >= moment) & (time <= moment + settings.after_fast)
    chosen = []
    for kind, most in ((False, settings.slow_frames), (True, settings.fast_frames)):
        those = [t for t in frames if fast[t] == kind]
        if len(those) > most:
            those = [those[k] for k in np.linspace(0, len(those) - 1, most).round().astype(int)]
        chosen.append(tuple(those))
    return chosen[0], chosen[1]


# ---- places ------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """Where an object is in the beginning."""

    body: Body
    initial: Array
    velocities: Array | None = None
    held: Array
    inwards: Array


def _points_of(body: Body, settings: SceneSettings) -> Array:
    return np.asarray(body.points if settings.engine == "thin" else body.x, dtype=float)


def _sizes_of_rope(recording: Recording, notes: list[str]) -> tuple[float, float]:
    """Length and diameter [m].

    Raises:
        RecordingError: They are no rope's.
    """
    length, diameter = recording.object.length, recording.object.diameter
    assert length is not None  # the recording's own check
    if diameter is None:
        diameter = length / 50.0
        notes.append(f"diameter not stated: {diameter:.4g} m assumed (length / 50)")
    if diameter > 0.2 * length:
        raise RecordingError(
            f"a rope {diameter:g} m thick and {length:g} m long is no rope",
            where="meta.object",
            fix="give diameter and length in metres",
        )
    return length, diameter


def _place_rope(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...], notes: list[str]
) -> _Placed:
    """A rope on its table, held near one end."""
    length, diameter = _sizes_of_rope(recording, notes)
    grip = recording.gripper_position[frames[0], 0].astype(float)
    inset = recording.object.grasp_inset or diameter / 2.0
    body = rope(
        diameter=diameter,
        length=length,
        centre_line=_line_from(recording, grip, frames, diameter, length, inset),
        cells_across=settings.cells_across,
        points=settings.points,
    )
    steps = np.diff(body.points, axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    held = np.array([np.interp(inset, s, x) for x in body.points.T])
    direction = steps[min(int(np.searchsorted(s, inset)), len(steps) - 1)]
    return _Placed(
        body=body,
        initial=_points_of(body, settings),
        held=held[None],
        inwards=direction[None] / np.linalg.norm(direction),
    )


def _place_between(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...], notes: list[str]
) -> _Placed:
    """A rope that two grippers hold by its ends, straight by nature.

    Raises:
        ParameterError: With the MPM, whose bodies are free of stress as they begin.
    """
    if settings.engine != "thin":
        raise ParameterError(
            "a rope held at both ends is simulated as a rod", where="engine", fix="engine 'thin'"
        )
    length, diameter = _sizes_of_rope(recording, notes)
    grip = recording.gripper_position[frames[0]].astype(float)
    s, line, speeds = _line_between(recording, grip, frames, length)
    body = rope(diameter=diameter, length=length, points=settings.points)
    u = np.linspace(0.0, length, len(body.points))
    x = CubicSpline(s, line)(u)
    ends = np.stack([x[1] - x[0], x[-2] - x[-1]])
    notes.append("held at both ends: straight by nature, as far as is known")
    return _Placed(
        body=body,
        initial=x,
        velocities=None if speeds is None else CubicSpline(s, speeds)(u),
        held=grip,
        inwards=ends / np.linalg.norm(ends, axis=1, keepdims=True),
    )


def _line_between(
    recording: Recording, grip: Array, frames: tuple[int, ...], length: float
) -> tuple[Array, Array, Array | None]:
    """Places along a rope [K] [m] from one end to the other, where the first frame shows them
    [K, 3] [m], and how fast markers are there [K, 3] [m/s]."""
    cloud = recording.frame(frames[0]).astype(float)
    speeds = None
    if recording.extra.get("ordered_markers", False):
        first = [t for t in frames[:5] if len(recording.frame(t)) == len(cloud)]
        x = np.stack([recording.frame(t) for t in first]).astype(float)
        if len(first) == 5 and not recording.extra.get("static", False):
            # what a parabola through five frames says of the first
            t = recording.time[first] - recording.time[first[0]]
            fit = np.polynomial.polynomial.polyfit(t, x.reshape(len(t), -1), 2)
            speeds = fit[1].reshape(-1, 3)
        gaps = np.linalg.norm(np.diff(x, axis=1), axis=2).mean(axis=0)
    else:
        axis = (grip[1] - grip[0]) / np.linalg.norm(grip[1] - grip[0])
        cloud = cloud[np.argsort((cloud - grip[0]) @ axis)]
        bins = np.array_split(cloud, min(24, max(2, len(cloud) // 4)))
        cloud = np.array([grip[0], *(b.mean(axis=0) for b in bins), grip[1]])
        gaps = np.linalg.norm(np.diff(cloud, axis=0), axis=1)
    if np.linalg.norm(cloud[0] - grip[0]) > np.linalg.norm(cloud[-1] - grip[0]):
        cloud, gaps = cloud[::-1], gaps[::-1]
        speeds = None if speeds is None else speeds[::-1]
    s = np.concatenate([[0.0], np.cumsum(gaps)])
    return s * (length / s[-1]), cloud, speeds


def _line_from(
    recording: Recording,
    grip: Array,
    frames: tuple[int, ...],
    diameter: float,
    length: float,
    behind: float,
) -> Array:
    """Centre line of a rope at rest, from somewhat behind the gripper on."""
    early = _early_points(recording, frames, diameter)
    flat = early[:, :2] - grip[:2]
    far = flat[np.linalg.norm(flat, axis=1) > 0.25 * length]
    if len(far) < 5:
        raise RecordingError(
            "the first frames show too little of the rope to tell which way it lies",
            where=f"frames {frames[0]}-{frames[min(9, len(frames) - 1)]}",
            fix="record from the rope at rest on; is its length in metres?",
        )
    axis = far.mean(axis=0) / np.linalg.norm(far.mean(axis=0))
    side = np.array([-axis[1], axis[0]])
    along, across = flat @ axis, flat @ side
    # bends of the visible line, held straight where a hole in the cloud leaves it open
    fit = np.polynomial.Polynomial.fit(along, across, 2, domain=[0.0, length])
    keep = np.abs(across - fit(along)) < 2.0 * np.std(across - fit(along)) + 1e-6
    fit = np.polynomial.Polynomial.fit(along[keep], across[keep], 2, domain=[0.0, length])
    s = np.linspace(-behind, length, 60)
    inside = np.clip(s, along.min(), along.max())
    curve = fit(inside) + fit.deriv()(inside) * (s - inside)
    height = float(np.median(early[:, 2])) - diameter / 2.0
    if recording.table_height is not None:
        height = recording.table_height + diameter / 2.0
    xy = grip[:2] + s[:, None] * axis + curve[:, None] * side
    return np.concatenate([xy, np.full((len(s), 1), height)], axis=1)


def _place_cloth(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...], notes: list[str]
) -> _Placed:
    """A flat cloth on its table."""
    described = recording.object
    width, height = described.width, described.height
    assert width is not None and height is not None  # the recording's own check
    thickness = described.thickness
    if thickness is None:
        # of sheets that bend alike a thicker one gives way more in its plane, as what is woven does
        thickness = 0.002
        notes.append(f"thickness not stated: {thickness * 1e3:.3g} mm assumed")
    grip = recording.gripper_position[frames[0], 0].astype(float)
    yaw = _cloth_yaw(recording, frames, width, height)
    low = recording.table_height
    longer = max(width, height)
    if low is None:
        low = float(np.percentile(_early_points(recording, frames, 0.05 * longer)[:, 2], 5))
    mid = low + thickness / 2.0
    corner = described.grasp == "corner"
    local = np.zeros(2) if corner else np.array([width, height]) / 2.0
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    spacing = longer / ((settings.points or 26) - 1)
    counts = (1 + max(2, round(width / spacing)), 1 + max(2, round(height / spacing)))
    body = cloth(
        width=width,
        height=height,
        thickness=thickness,
        dx=longer / 14.0 * 1.5 / settings.cells_across,
        corner=np.append(grip[:2] - turn @ local, mid),
        yaw=yaw,
        points=counts,
    )
    inwards = np.append(turn @ np.array([width, height]) / math.hypot(width, height), 0.0)
    return _Placed(
        body=body,
        initial=_points_of(body, settings),
        held=np.array([[grip[0], grip[1], mid]]),
        inwards=inwards[None],
    )


def _cloth_yaw(recording: Recording, frames: tuple[int, ...], width: float, height: float) -> float:
    """Turn of the flat cloth about the held point.

    Held by a corner it hangs evenly about its diagonal, so the diagonal points to where the
    lifted cloud is. Held elsewhere, the turn whose footprint holds the low points best.
    """
    grip = recording.gripper_position[frames[0], 0]
    if recording.object.grasp == "corner":
        later = frames[len(frames) // 2 :]
        towards = [recording.frame(t)[:, :2].mean(axis=0) - grip[:2] for t in later]
        x, y = np.median(np.array(towards, dtype=float), axis=0)
        return math.atan2(y, x) - math.atan2(height, width)
    points = np.concatenate([recording.frame(t) for t in frames]).astype(float)
    base = recording.table_height if recording.table_height is not None else points[:, 2].min()
    low = points[points[:, 2] < base + 0.15 * max(width, height)]
    flat = (low if len(low) > 50 else points)[:, :2] - grip[:2]

    def outside(yaw: float) -> float:
        c, s = math.cos(yaw), math.sin(yaw)
        local = np.abs(flat @ np.array([[c, -s], [s, c]])) - np.array([width, height]) / 2
        return float(np.linalg.norm(np.maximum(local, 0.0), axis=1).mean())

    return float(min(np.linspace(0.0, math.pi, 72, endpoint=False), key=outside))


def _early_points(recording: Recording, frames: tuple[int, ...], size: float) -> Array:
    """[n, 3] points of the frames before the gripper has moved by ``size`` [m]."""
    path = recording.gripper_position[:, 0]
    moved = np.linalg.norm(path - path[frames[0]], axis=1)
    early = [t for t in frames if moved[t] <= size] or frames[:1]
    return np.concatenate([recording.frame(t) for t in early]).astype(float)
