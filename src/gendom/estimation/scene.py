"""A `LiftScene`: everything about a recording that does not depend on unknown parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

from gendom.arguments import check_choice, require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation.hands import clamp_frame, clamp_steps
from gendom.estimation.placing import CELLS, Placed, lost_time, place, with_points
from gendom.estimation.priors import (
    BENDING_RANGE,
    CLAMPS,
    material_prior,
    stated_priors,
    thickness_stated,
)
from gendom.materials import STANDARD_GRAVITY, catalogue
from gendom.materials.parameters import E_over_rho_of, bending_length
from gendom.materials.posterior import Prior, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.sim import ENGINES, Body, check_numbers
from gendom.sim.bodies import CELLS_ACROSS
from gendom.sim.thin import rotation

SPACING, MOST_SHELL_POINTS, MOST_ROD_POINTS = 1.0 / 3.0, 49, 65
"""Limp objects are then estimated again with points this many bending lengths apart, up to so many
of cloths and ropes, where that is at least a tenth more. Lifted ropes with points twice as far
apart are off by 0.5 to 5 mm, as if their bending length was 5 to 40 % another."""

SHELL_ERROR = 1.5
"""Error of ln(E) by the distance of a cloth's points, in bending lengths and to the third power
(docs/notes/cloths.md)."""

STRETCH = 0.002
"""An object's own weight lengthens it by this at most, hanging by a side or an end: the simulated
stiffness along it is limited to that, so that cloths' steps are two to four times as long. A rope
gets at least that: fibres resist stretch more than bending, in which they slide past each other.
With one E for both soft ropes stretch by up to 4 %, and their tails follow less over the table."""

COARSE_POINTS, COARSE_FRAMES = {"rope": 17, "cloth": 21}, 18
"""Where a search begins: points of a rod, or along the longer side of a shell, and frames that are
compared, at most. With a `STRETCH` of 0.01 there E of cloths came out twice too large."""

STATIC_DAMPING, STATIC_SETTLING = 3.0, 6.0
"""Rate at which velocities decay where nothing moves [1/s], and time in which such an object comes
to rest [s]; its slowest swing then has e^-9 left."""

QUASI_STATIC_SPEED, QUASI_STATIC_DAMPING = 0.05, 1.0
"""Gripper speed at which quasi-static recordings are replayed [m/s]: faster, a rope that leaves the
table swings. And the rate of decay then [1/s]: the drag is 0.5 % of gravity."""

PATH_STEP, SPARSE, RAMP = 0.005, 0.2, 0.1
"""Times between a path's places, between frames that do not show how a gripper starts and stops,
and in which it then does [s]."""

SLOW, AFTER_FAST = 0.15, 1.5
"""Speed of a gripper below which frames are alike [m/s], and time for which an object moves on
after that [s]."""

LIFTED = 0.15
"""Rise of the gripper, in a rope's length or a cloth's longer side, before which clouds show hardly
more than how it lay."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """How a recording is turned into a simulation; written into every result."""

    engine: Literal["thin", "mpm"] = "thin"
    """Engine of the simulator. thin: ropes as rods, cloths as shells. mpm: material points, slower.
    """
    material: str | None = None
    """Its material, by a name of gendom materials: narrows the priors, and gives the density where
    the mass is unknown."""
    points: int | None = None
    """Points of a rod, or along the longer side of a shell; by default as many as it needs."""
    cells_across: float = CELLS
    """With mpm: grid cells across a rope's diameter (cloths alike); finer is slower."""
    slow_frames: int = 36
    """Frames that are compared where the gripper is slow, at most."""
    fast_frames: int = 60
    """Frames that are compared elsewhere, at most."""
    dtype: str | None = None
    """``float32`` or ``float64``; None: the first for rods and shells, else the engine's own."""
    substep: float | None = None
    """Of all worlds [s]; None: each its own. Then the number of substeps between two frames depends
    on E, and where it changes, positions jump by some 1e-7 m, which shows in exact clouds only."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.material is not None:
            catalogue.get(self.material)
        check_choice("engine", self.engine, ENGINES)
        (low, high), substep, points = CELLS_ACROSS, self.substep, self.points
        what, fix = f"is {self.cells_across:g}", f"give {low:g} to {high:g}"
        require(low <= self.cells_across <= high, what, where="cells_across", fix=fix)
        check_numbers("substep", 1.0 if substep is None else substep, above=0.0)
        require(points is None or points >= 5, f"is {points}", where="points", fix="give 5 or more")


@dataclass(frozen=True, kw_only=True, eq=False)
class LiftScene(Placed):
    """A recorded object as it begins, its grippers, and the frames that are compared."""

    recording: Recording
    settings: SceneSettings
    frames: tuple[int, ...]
    """Those that hold points and are compared."""
    calm: tuple[int, ...]
    """Those of them in which nothing moves fast and, where anything does, the object is lifted."""
    clock: float
    """Recorded seconds for one simulated second."""
    density: float
    """That is simulated [kg/m^3]."""
    begins_with: str = ""
    """`Recording.begins_with`, before any registration."""
    digest: str = ""
    """`Recording.digest`, likewise."""
    limp: bool = False
    """Whether it is a rope that bends over so little that it has more points than others."""
    registration: Array | None = None
    """[4, 4] by which the recording's clouds were moved [m]; None: camera poses are as stated."""
    notes: tuple[str, ...] = ()
    """What was assumed."""

    @classmethod
    def of(
        cls,
        recording: Recording,
        settings: SceneSettings | None = None,
        registration: Array | None = None,
    ) -> LiftScene:
        """The scene of a recording, with `registration` [4, 4] of its clouds to the robot's frame.

        Raises:
            RecordingError: The recording shows too little to place the object.
            ParameterError: Settings do not fit it.
        """
        settings, stated, notes = settings or SceneSettings(), recording, []
        frames = with_points(recording)
        what, fix = "no frame holds a point", "record again"
        require(frames, what, where="points", fix=fix, error=RecordingError)
        if registration is not None:
            recording = recording.moved(registration)
            shift = (recording.points - stated.points).mean(axis=0, dtype=float)
            turn = math.degrees(Rotation.from_matrix(registration[:3, :3]).magnitude())
            moved = f"clouds moved by {1e3 * np.linalg.norm(shift):.0f} mm and {turn:.1f} degrees"
            notes.append(f"camera poses unknown: {moved}")
        missing = float(lost_time(recording)[-1])
        if missing > 0.0:
            leaps = "the hands leap where frames were lost"
            notes.append(f"{leaps}: {missing:.3g} s added to the times")
        cells = settings.cells_across if settings.engine == "mpm" else None
        placed = place(recording, settings.points, notes, cells=cells)
        clock = _choose_clock(recording)
        lasts = float(recording.time[frames[-1]] - recording.time[frames[0]]) / clock
        longer = f"lasts {lasts:.4g} s, longer than the 300 s that are simulated"
        fix = "give seconds; cut what does not belong to the motion"
        require(lasts <= 300.0, longer, where="time", fix=fix, error=RecordingError)
        hanging = frames
        if recording.object.kind == "cloth" and recording.object.grasp == "corner":
            lifted = _lifted(recording, frames)
            hanging = lifted if len(lifted) >= 5 else frames
        calm, fast = _compared(recording, settings, hanging)
        return cls(
            **vars(placed),
            recording=recording,
            settings=settings,
            frames=tuple(sorted(calm + fast)),
            calm=_lifted(recording, calm) if fast else calm,
            clock=clock,
            density=_density(recording, placed.body, settings, notes),
            begins_with=stated.begins_with,
            digest=stated.digest,
            registration=registration,
            notes=tuple(notes),
        )

    @property
    def kind(self) -> str:
        return self.body.kind

    @property
    def thin(self) -> bool:
        """Whether the engine models a rope by its centre line, a cloth by its middle surface."""
        return self.settings.engine == "thin"

    @property
    def dtype(self) -> str | None:
        """Of its simulation; None: the engine's own. Those of ``float32`` take half the time; they
        are 0.8 um off in the mean of a lift and 15 um at most."""
        return self.settings.dtype or ("float32" if self.thin else None)

    @property
    def quasi_static(self) -> bool:
        """Whether it is replayed on another clock than the recorded one, or nothing moves."""
        return self.static or (self.recording.quasi_static and self.clock != 1.0)

    @property
    def static(self) -> bool:
        """Whether nothing moves: frames are repeats of one shape at rest."""
        return bool(self.recording.extra.get("static", False))

    @property
    def velocity_damping(self) -> float:
        return STATIC_DAMPING if self.static else QUASI_STATIC_DAMPING * self.quasi_static

    @property
    def ordered(self) -> bool:
        """Whether points are the same markers in every frame, in order along the rope."""
        return bool(self.recording.extra.get("ordered_markers", False))

    @property
    def captured(self) -> bool:
        """Whether a motion capture saw markers and hands move."""
        return self.ordered and not self.static

    @property
    def beside(self) -> bool:
        """Whether markers move between two hands: they may be beside the axis."""
        return self.captured and len(self.held) > 1

    @cached_property
    def markers(self) -> tuple[Array, Array]:
        """[m, 2] points of a rope around markers between two hands, and their shares."""
        assert self.places is not None
        index = np.clip(self.places.astype(int), 0, len(self.initial) - 2)
        share = self.places - index
        return np.stack([index, index + 1], axis=1), np.stack([1.0 - share, share], axis=1)

    @property
    def by_corner(self) -> bool:
        """Whether it is a cloth held by a corner."""
        return self.kind == "cloth" and self.recording.object.grasp == "corner"

    @property
    def begins(self) -> int:
        """The first frame with points, in which the object is at rest."""
        return int(np.argmax(self.recording.frame_valid))

    @property
    def size(self) -> float:
        """Length of a rope, diagonal of a cloth [m]."""
        assert self.recording.object.size is not None  # the recording's own check
        return self.recording.object.size

    @property
    def along(self) -> int:
        """Points along a rope, or a cloth's longer side."""
        return len(self.initial) if self.kind == "rope" else max(self.body.shape)

    @property
    def radius_of_gyration(self) -> float:
        """sqrt(I / A) of the section: d / 4 of a rope, h / sqrt(12) of a sheet [m]."""
        return self.body.thickness / (4.0 if self.kind == "rope" else math.sqrt(12.0))

    def bending_length(self, E_over_rho: float, thickness: float = 1.0) -> float:
        """[m], of an object whose thickness is this multiple of the stated one."""
        return bending_length(E_over_rho, thickness * self.radius_of_gyration, STANDARD_GRAVITY)

    def density_of(self, theta: Theta) -> float:
        """[kg/m^3] of an object as thick as estimated; of the stated mass, where there is one."""
        if self.recording.object.mass is None:
            return self.density
        return self.density / theta.thickness ** (2 if self.kind == "rope" else 1)

    def rise(self, times: float) -> float:
        """How much higher the middle of an object so many times as thick lies on its table [m]."""
        if self.recording.table_height is None or len(self.held) > 1:
            return 0.0
        return 0.5 * (times - 1.0) * self.body.thickness

    def finer(self, theta: Theta) -> LiftScene:
        """The same with the resolution that an object of this bending length needs, unless it has
        it, is held by two hands, or the settings fix the number of points."""
        described, rope = self.recording.object, self.kind == "rope"
        if not self.thin or self.settings.points is not None or (rope and len(self.held) > 1):
            return self
        bends = self.bending_length(theta.E_over_rho, theta.thickness)
        longer = max(described.length or 0.0, described.width or 0.0, described.height or 0.0)
        most = MOST_ROD_POINTS if rope else MOST_SHELL_POINTS
        points = min(math.ceil(longer / (SPACING * bends)) + 1, most)
        if points <= 1.1 * self.along:
            return self
        return replace(self.simulated_with(points), limp=rope)

    def simulated_with(self, points: int) -> LiftScene:
        """The same with so many points; in the settings their number stays open, to grow again."""
        placed = place(self.recording, points, [], self.lies)
        return replace(self, **vars(placed))

    def mesh_error(self, theta: Theta) -> float:
        """Standard deviation of ln(E) by the distance of a cloth's points."""
        if self.kind != "cloth" or not self.thin:
            return 0.0
        apart = float(np.linalg.norm(self.body.points[1] - self.body.points[0]))
        bends = self.bending_length(theta.E_over_rho, theta.thickness)
        return SHELL_ERROR * (apart / bends) ** 3

    def body_of(self, theta: Theta) -> Body:
        """The body as thick as estimated, for display; simulations take the stated thickness."""
        return replace(self.body, thickness=theta.thickness * self.body.thickness)

    def E_over_rho(self, bending: float) -> float:
        """E / density [m^2/s^2] of an object with this bending length [m]."""
        return E_over_rho_of(bending, self.radius_of_gyration, STANDARD_GRAVITY)

    @cached_property
    def floor(self) -> float | None:
        """Height below which the recording shows nothing although the object lies there [m]: where
        clouds of tables were cut off above them, less than half of the object at rest is seen."""
        gaps = KDTree(self.recording.frame(self.begins)).query(self.body.points)[0]
        seen = float(np.mean(gaps < 0.05 * self.size))
        if self.recording.table_height is None or seen >= 0.5:
            return None
        return 0.003 + min(float(self.recording.frame(t)[:, 2].min()) for t in self.frames)

    def sim_time(self, recorded: Array | float) -> Array:
        """Simulated time of recorded ones; 0 in the first frame [s]."""
        t, time, late = np.asarray(recorded, dtype=float), self.recording.time, self._lost
        return (t + np.interp(t, time, late - late[self.begins]) - time[self.begins]) / self.clock

    @cached_property
    def _lost(self) -> Array:
        return lost_time(self.recording)

    @cached_property
    def paths(self) -> list[tuple[Array, Array, Rotation | None]]:
        """For each gripper from the first frame on simulated times [K] [s], its stated positions
        [K, 3] [m], between frames of fast motion without corners, and how it has turned since."""
        first = self.begins
        t, found = self.sim_time(self.recording.time[first:]), []
        for g in range(len(self.held)):
            own, x = t, self.recording.gripper_position[first:, g].astype(float)
            if not (self.quasi_static or len(t) < 3):
                own = np.linspace(t[0], t[-1], max(2, round(float(t[-1] - t[0]) / PATH_STEP)))
                x = _between(t, x, own, captured=self.captured)
            found.append((own, x, self.turned(g, own)))
        return found

    def turned(self, g: int, times: Array) -> Rotation | None:
        """How a gripper has turned since the first frame at simulated times [K], None: not. As its
        recorded axis does, without turning about it."""
        axes, first = self.recording.gripper_axis, self.begins
        if axes is None or np.ptp(axes[first:, g], axis=0).max() < 1e-3:
            return None
        level, shown = np.array([0.0, 0.0, 0.0, 1.0]), self.sim_time(self.recording.time[first:])
        turned = Rotation.from_quat(rotation.transported(level, axes[first:, g].astype(float)))
        return Slerp(shown, turned * turned[0].inv())(np.clip(times, shown[0], shown[-1]))

    @cached_property
    def clamp_frames(self) -> list[Array]:
        """`clamp_frame` of each hand of two."""
        return [clamp_frame(self.recording, self.inwards, g) for g in range(len(self.held))]

    @cached_property
    def curved(self) -> bool:
        """Whether a rope lies curved, so that it counts how much of that it is by nature."""
        if self.kind != "rope" or not self.thin or len(self.held) > 1:
            return False
        ahead = np.diff(self.body.points, axis=0)
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        return float(np.linalg.norm(np.diff(ahead, axis=0), axis=1).sum()) > 0.1  # [rad]

    @property
    def guesses(self) -> list[dict[str, float]]:
        """Values of a recording's own unknowns from which a search should begin.

        With commanded gripper positions, a level corner at the stated point and a hanging corner at
        fingertips below it give similar clouds, and a search from one does not reach the other.
        """
        if "natural_curvature" in self._shown:  # stiff ropes lie as they are curved by nature
            return [{"natural_curvature": share} for share in (0.3, 1.0)]
        if not self.by_corner or self.recording.gripper_axis is not None:
            return [{}]  # an axis gives the direction of the corner
        hanging = {"grip_tilt": 1.4}
        if self.recording.gripper_source != "measured":
            hanging |= {"grip_along": 0.02, "grip_height": -0.02, "delay": 0.1}
        return [{"grip_tilt": 0.2}, {"grip_tilt": 0.8}, hanging]

    def prior(
        self, wanted: tuple[str, ...] = (), also: tuple[str, ...] = ()
    ) -> tuple[Prior, Theta]:
        """The prior of the unknowns of these names (default: what a recording of this kind shows),
        and also of further ones, and default values of all others.

        Raises:
            ParameterError: There is no such unknown, or the object has none, or it cannot be of
                the stated material.
        """
        for name in (*wanted, *also):
            known = name not in UNKNOWNS or self.kind in UNKNOWNS[name].kinds
            require(known, f"a {self.kind} has no {name}", where="unknowns")
        kind = self.kind if len(self.held) == 1 else "held rope"
        low, high = (self.E_over_rho(b * self.size) for b in BENDING_RANGE[kind])
        logs = np.log([low, high])
        mean, sd = math.exp(logs.mean()), float(np.ptp(logs)) / 2
        base, changes = Theta(E_over_rho=mean), stated_priors(self.recording)
        # searched over its range without preference: a wide Gaussian
        changes["E_over_rho"] = {"low": low, "high": high, "mean": mean, "sd": sd}
        if self.kind == "cloth":
            changes["E_over_rho"]["step"] = 0.06
        if len(self.held) > 1:
            changes |= clamp_steps(self.recording, self.inwards)
        if self.beside and self.shown_length is not None:
            changes["length_ratio"] = {"mean": self.shown_length / self.size}
        if self.settings.material is not None:
            listed = catalogue.get(self.settings.material)
            of_material = material_prior(listed, self.kind, (low, high))
            changes |= {n: changes.get(n, {}) | change for n, change in of_material.items()}
            base = base.with_values({n: change["mean"] for n, change in of_material.items()})
        stated = self.recording.object.extra.get("natural_curvature")
        if stated is not None:
            base = base.with_values({"natural_curvature": stated})
        prior = prior_of((*(wanted or self._shown), *also), changes)
        return prior, prior.theta(prior.mean, base)

    @property
    def _shown(self) -> tuple[str, ...]:
        """Unknowns that such a recording may determine."""
        described, rope = self.recording.object, self.kind == "rope"
        two, natural = self.recording.num_grippers > 1, described.extra.get("natural_curvature")
        swinging = two and self.captured
        drag = swinging and (not thickness_stated(described) or described.mass is None)
        rows = (
            (True, ("E_over_rho",)),
            (rope and not swinging, ("nu",)),
            (self.recording.table_height is not None, ("friction",)),
            (not two, ("grip_height", "grip_along")),
            (not self.quasi_static, ("damping",)),
            # markers are seen by what sees the hands that hold them
            (not self.static and not self.ordered, ("delay",)),
            (two and not self.static, CLAMPS),
            (swinging, ("length_ratio",)),
            (drag, ("air_drag",)),
            (not two and rope and self.thin, ("grip_turn",)),
            (not rope, ("warp_over_weft",)),
            (self.by_corner, ("grip_aside", "grip_tilt", "grip_reach", "yaw")),
            (self.curved and natural is None, ("natural_curvature",)),
        )
        return tuple(name for holds, names in rows if holds for name in names)


def _between(t: Array, x: Array, fine: Array, *, captured: bool) -> Array:
    """[K, 3] a path at times [K], that is at places [T, 3] at times [T]; one that was captured by
    slopes that do not depend on the axes' directions."""
    if captured:
        return CubicHermiteSpline(t, x, np.gradient(x, t, axis=0))(fine)
    if np.median(np.diff(t)) < SPARSE:
        return PchipInterpolator(t, x, axis=0)(fine)
    from scipy.ndimage import uniform_filter1d  # which takes long to import

    knots, x = with_corners(t, x)
    x = np.stack([np.interp(fine, knots, own) for own in x.T], axis=1)
    return uniform_filter1d(x, round(RAMP / PATH_STEP), axis=0, mode="nearest")


def with_corners(t: Array, x: Array) -> tuple[Array, Array]:
    """Times [K] [s] and places [K, 3] [m] of a path with its corners between frames.

    Where it goes straight and as fast before and after an interval as in the intervals beside it,
    it turns, starts or stops where these lines meet. It is at rest before the first frame, and
    where it slows down in the last interval, after that.
    """
    v = np.diff(x, axis=0) / np.diff(t)[:, None]
    times, places = list(t), list(x)
    for k in range(len(v)):
        before = v[k - 1] if k else np.zeros(3)
        after = v[k + 1] if k + 1 < len(v) else np.zeros(3)
        faster, step = before - after, t[k + 1] - t[k]
        if float(faster @ faster) == 0.0:
            continue
        # before * u = v[k] * step + after * (u - step), as nearly as it holds
        u = float((v[k] - after) @ faster / (faster @ faster)) * step
        off = np.linalg.norm((v[k] - after) * step - faster * u)
        if 0.0 < u < step and off < 0.02 * np.linalg.norm(v, axis=1).max() * step:
            times.append(t[k] + u)
            places.append(x[k] + before * u)
    order = np.argsort(times)
    return np.array(times)[order], np.array(places)[order]


def _density(recording: Recording, body: Body, settings: SceneSettings, notes: list[str]) -> float:
    """That is simulated [kg/m^3]; what is assumed for it goes to `notes`."""
    density, made_of = 1000.0, ""
    if settings.material is not None:
        listed = catalogue.get(settings.material)
        density, made_of = listed.density.typical, f" of {listed.name}"
        notes.append(
            f"material {listed.name}: E of {listed.E.low:.2g} to {listed.E.high:.2g} Pa and what "
            "else the catalogue says of it are believed before the recording is seen"
        )
    if recording.object.mass is not None:
        return recording.object.mass / (body.volume * body.num_particles)
    notes.append(
        f"mass not stated: a density{made_of} of {density:.4g} kg/m^3 assumed, so E is worth no "
        "more than E / density and the bending length"
    )
    return density


def _choose_clock(recording: Recording) -> float:
    """Recorded seconds for one simulated second: 1 where inertia is a part of the motion."""
    static = recording.extra.get("static", False)
    if not recording.quasi_static or static or recording.num_frames < 2:
        return 1.0
    path, time = recording.gripper_position, recording.time
    steps = np.linalg.norm(np.diff(path, axis=0), axis=-1).max(axis=1)
    moving = steps > 0.1 * steps.max()
    speed = float(steps[moving].sum() / max(float(np.diff(time)[moving].sum()), 1e-9))
    # motion near that speed keeps its clock: a faster one would make the object swing
    clock = QUASI_STATIC_SPEED / max(speed, 1e-9)
    return clock if clock > 1.5 else 1.0


def _lifted(recording: Recording, frames: tuple[int, ...]) -> tuple[int, ...]:
    """Those of some frames in which one gripper has lifted the object."""
    if recording.num_grippers > 1:
        return frames
    height, described = recording.gripper_position[:, 0, 2], recording.object
    sides = (described.length, described.width, described.height)
    least = LIFTED * max(side for side in sides if side is not None)
    begin = height[np.argmax(recording.frame_valid)]
    return tuple(t for t in frames if height[t] - begin > least)


def _compared(
    recording: Recording, settings: SceneSettings, frames: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Frames in which the object is carried slowly, and moves fast; not too many of each."""
    time, path = recording.time, recording.gripper_position
    fast = np.zeros(recording.num_frames, dtype=bool)
    if not recording.quasi_static and recording.num_frames > 1:
        moves = np.linalg.norm(np.gradient(path, time, axis=0), axis=-1).max(axis=1) > SLOW
        if recording.gripper_closed is not None:
            moves |= (~recording.gripper_closed).any(axis=1)
        for moment in time[moves]:
            fast |= (time >= moment) & (time <= moment + AFTER_FAST)

    def some(kind: bool, most: int) -> tuple[int, ...]:
        those = [t for t in frames if fast[t] == kind]
        if len(those) <= most:
            return tuple(those)
        return tuple(those[k] for k in np.linspace(0, len(those) - 1, most).round().astype(int))

    return some(False, settings.slow_frames), some(True, settings.fast_frames)
