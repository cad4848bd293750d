"""A recorded lift as a simulation with unknowns: initial state, gripper motion, clock."""

import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.datasets import Recording
from gendom.errors import ParameterError, RecordingError, SimulationError
from gendom.estimation.hold import Held, Hold, fit_hold
from gendom.estimation.lying import Lying
from gendom.estimation.placing import place
from gendom.estimation.priors import (
    LEAST_REACH,
    hold_bounds,
    hold_guesses,
    shaped_guesses,
)
from gendom.estimation.shapes import Sheet, held_height
from gendom.materials import Material
from gendom.materials.parameters import bending_length, specific_modulus_of
from gendom.observation import visible
from gendom.sim import CFL, ENGINES, GRAVITY, Body, Gripper, Simulator, Table, check_numbers
from gendom.sim.device import cores

_log = logging.getLogger(__name__)

QUASI_STATIC_SPEED = 0.12
"""Gripper speed at which quasi-static recordings are replayed [m/s]."""

QUASI_STATIC_DAMPING = 4.0
"""Damping of quasi-static replays [1/s]; at the speed above its drag is 5 % of gravity."""

DYNAMIC_DAMPING = 1.0
"""Damping of replays on the recorded clock [1/s]."""

ASSUMED_DENSITY = 1000.0
"""Density where the mass is unknown [kg/m^3]: only E / density shows in the motion."""

CLOTH_DAMPING = 3.0
"""Damping of cloths on the recorded clock: the drag of the air on a sheet [1/s]."""

HANG_RISE = 1.0
"""Rise over which a held corner turns from lying to hanging, in reaches of the grip."""

FLOOR_MARGIN = 0.003
"""Height above the lowest recorded point up to which a crop has taken the table away [m]."""

SHOWN_AT_REST = 0.5
"""A recording that shows less of the resting object than this has had its table cropped away."""

RAMP_SPEED = 0.1
"""Speed at which the gripper takes the object from rest to its first recorded position [m/s]."""

HOLD_STAGES = {"commanded": ((0.6, 8), (1.0, 4)), "measured": ((1.0, 6),)}
"""Grids on which the hold of a corner is found, one after the other, by the source of the gripper's
path: cells for each cell of the estimate, and the batches that may be spent. Where the path was
measured, the first guess is near enough for the estimate's own grid."""

SHAPE_STAGES = ((1.0 / 9.0, 8), (1.0 / 15.0, 6))
"""Thicknesses in bending lengths, and batches that may be spent, for the search of a cloth that is
not flat: a thicker sheet is more pliant in its plane, so that a wrong shape finds its way out."""

SHAPE_GAIN = 0.9
"""Share of a flat cloth's summed distances that one with a shape must come below."""

HOLD_FRAMES = 10
"""Frames from which the hold of a corner is found."""

HOLD_THICKNESS = 1.0 / 15.0
"""Thickness of the sheet with which the hold of a thinner cloth is found, in bending lengths: one
that hangs by its edge is stretched by less than 1 % for each 0.3 m below."""


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """How a recording is simulated; written into every result."""

    engine: str = "mpm"
    """Of the simulator: ``mpm``, or ``thin`` (ropes as rods)."""
    cells_across: float = 1.5
    """Grid cells across a rope's diameter; cloths scale with it. Of the MPM."""
    clock: float | None = None
    """Recorded seconds for one simulated second, or None to choose (1 unless quasi-static)."""
    damping: float | None = None
    """[1/s], or None for the default of the kind of motion."""
    law: str = "neo-hookean"
    dtype: str = "float32"
    """``float32`` or ``float64``: E comes out the same within 0.1 %."""
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        check_numbers("cells_across", self.cells_across, above=0.0)
        if self.engine not in ENGINES:
            raise ParameterError(
                f"unknown engine {self.engine!r}", fix=f"choose one of {', '.join(ENGINES)}"
            )
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
    friction: float = 0.3
    """Coefficient of friction on the table [-]."""

    def __post_init__(self) -> None:
        check_numbers("friction", self.friction, least=0.0)


class Lift:
    """One recording, ready to be simulated for any parameters.

    The object starts at rest on its table: a rope along its visible centre line, from the
    gripper on, as long as stated; a cloth as the flat square that holds most of the recorded
    points, held where the recording says. It is carried along the recorded path; heights below
    rest mean slack. How the corner of a cloth is held is found from the clouds, together with how
    far the cloth bends; where the first frames show a ridge, also how it lay other than flat.

    Args:
        recording: What was seen.
        settings: How to simulate it.
        hold: How the corner of a cloth is held, or None to find it.
        known: The object's parameters, if they are known while the hold is found.
        on_hold: Called while that is found with the share of its work that is done, the best so
            far and its summed distances [m].
        sheet: How a crumpled cloth lies, or None to find that where it is needed.

    Raises:
        RecordingError: If the recording shows too little to place the object.
    """

    def __init__(
        self,
        recording: Recording,
        settings: ReplaySettings | None = None,
        *,
        hold: Hold | None = None,
        known: Theta | None = None,
        on_hold: Callable[[float, Held, float], None] | None = None,
        sheet: Sheet | None = None,
    ):
        self.recording = recording
        self.settings = settings or ReplaySettings()
        self.notes: list[str] = []
        self.frames = [t for t in range(recording.num_frames) if recording.frame_valid[t]]
        if not self.frames:
            raise RecordingError("no frame holds a point", where="points", fix="record again")
        self.body, self.grip = place(recording, self.settings.cells_across, self.notes)
        self.thin = self.settings.engine == "thin"
        if self.thin and self.body.kind == "cloth":
            raise ParameterError(
                "cloths are estimated with particles only: how one lies and is held is found so",
                where="engine",
                fix="engine 'mpm'",
            )
        self.clock = self._choose_clock()
        quasi = recording.quasi_static
        damping = self.settings.damping
        if damping is None:
            dynamic = CLOTH_DAMPING if self.body.kind == "cloth" else DYNAMIC_DAMPING
            damping = QUASI_STATIC_DAMPING if quasi else dynamic
        self.damping = damping
        self.density, self.density_assumed = self._density()
        self.floor = self._find_floor()
        self._lying = Lying(
            recording=recording, frames=self.frames, flat=self.body, grip=self.grip[0],
            size=self.size, floor=self.floor, sheet=sheet,
        )  # fmt: skip
        self.hold = hold
        self.held: Held | None = None
        if hold is None and self.held_by_corner:
            _log.info("finding how the corner is held")
            self.held = self._find_hold(known, on_hold)
            self.hold = Hold() if self.held is None else self.held.hold
        if self.hold is not None:
            self.body = self._lying.laid(self.hold).moved(_from_simulated(self.hold))

    # ---- what the estimator needs -------------------------------------------------------------

    def material(self, theta: Theta) -> Material:
        """The object's material for these parameters."""
        return Material(E=theta.specific_modulus * self.density, nu=theta.nu, density=self.density)

    def simulate(
        self,
        thetas: Sequence[Theta],
        *,
        frames: Sequence[int] | None = None,
        holds: Sequence[Hold] | None = None,
        on_frame: Callable[[int], None] | None = None,
    ) -> NDArray[np.floating]:
        """Positions [T, W, N, 3] of particles, or of a rod's points, at recorded frames (default:
        all with points) [m].

        Args:
            thetas: W sets of parameters.
            frames: Recorded frames.
            holds: How each world holds its cloth (default: ``hold``).
            on_frame: Called with the number of frames done.

        Raises:
            SimulationError: If a world diverges.
        """
        chosen = self.frames if frames is None else list(frames)
        every = [self.hold] * len(thetas) if holds is None else list(holds)
        bodies = [self._lying.flat if h is None else self._lying.laid(h) for h in every]
        # worlds of one batch share the shape that is free of stress
        alike: dict[bytes, list[int]] = {}
        for w, body in enumerate(bodies):
            key = b"" if body.curvature is None else body.curvature.tobytes()
            alike.setdefault(key, []).append(w)
        batches, threads = list(alike.values()), self.settings.threads or cores()
        at_once = 1
        if len(batches) > 1 and self.settings.device == "cpu":
            # a world keeps a core busy by itself
            batches, threads, at_once = [[w] for w in range(len(thetas))], 1, threads
        x = np.empty((len(chosen), len(thetas), len(self.rest_points), 3), self.settings.dtype)

        def run(worlds: list[int]) -> None:
            x[:, worlds] = self._simulate_alike(
                [thetas[w] for w in worlds],
                [every[w] for w in worlds],
                [bodies[w] for w in worlds],
                chosen,
                threads,
                on_frame,
            )

        with ThreadPoolExecutor(at_once) as pool:
            list(pool.map(run, batches))
        x += np.array([[0.0] * 3 if h is None else _from_simulated(h) for h in every])[:, None]
        return x

    def _simulate_alike(
        self,
        thetas: Sequence[Theta],
        holds: Sequence[Hold | None],
        bodies: Sequence[Body],
        frames: Sequence[int],
        threads: int,
        on_frame: Callable[[int], None] | None,
    ) -> NDArray[np.floating]:
        """[T, W, N, 3] particles of worlds whose bodies are free of stress in the same shape, on
        the stated table [m]."""
        grippers = [self._grippers(theta, h) for theta, h in zip(thetas, holds, strict=True)]
        begin = min(float(np.asarray(g.time)[0]) for world in grippers for g in world)
        times = self._sim_time(self.recording.time[list(frames)])
        begin = min(begin, float(times[0]))  # a path that lags begins after the clouds
        table = None
        if self.table_height is not None:
            table = Table(height=self.table_height, friction=[t.friction for t in thetas])
        simulator = Simulator(
            bodies[0] if bodies[0].curvature is not None else self._lying.flat,
            [self.material(theta) for theta in thetas],
            engine=self.settings.engine,
            grippers=grippers,
            table=table,
            velocity_damping=self.damping,
            law=self.settings.law,
            cfl=None if self.thin else CFL,
            positions=[body.points if self.thin else body.x for body in bodies],
            start_time=begin,
            dtype=self.settings.dtype,
            device=self.settings.device,
            threads=threads,
        )
        return simulator.run(times, on_frame=on_frame)

    @property
    def rest_points(self) -> NDArray[np.floating]:
        """[N, 3] the object's particles, or a rod's points, at rest [m]."""
        return self.body.points if self.thin else self.body.x

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
    def held_by_corner(self) -> bool:
        """Whether this is a cloth held by a corner."""
        return self.body.kind == "cloth" and self.recording.object.grasp == "corner"

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

    # ---- motion ----------------------------------------------------------------------------------

    def _grip_radius(self, hold: Hold | None) -> float:
        """How far from the held point the object moves with the gripper as one [m]."""
        if self.body.kind == "rope":
            return 0.75 * self.body.thickness
        return max((hold or Hold()).reach, LEAST_REACH * self.body.dx)

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

    def _find_hold(
        self, known: Theta | None, on_hold: Callable[[float, Held, float], None] | None
    ) -> Held | None:
        """How the corner is held, from the frames in which it hangs; None: it never does."""
        height = self.recording.gripper_position[:, 0, 2]
        rise = height - height[self.frames[0]]
        hanging = [
            t for t in self.frames if rise[t] > HANG_RISE * (self._grip_radius(None) + self.body.dx)
        ]
        if not hanging:
            self.notes.append("the corner is never lifted: taken as held at its very tip")
            return None
        # the last frame is the one in which most of the cloth hangs
        count = min(HOLD_FRAMES, len(hanging))
        chosen = [hanging[n] for n in np.linspace(0, len(hanging) - 1, count).round().astype(int)]
        guesses = hold_guesses(self.recording, size=self.size)
        given = {}
        if known is not None:
            length = bending_length(known.specific_modulus, self.radius_of_gyration, -GRAVITY[2])
            given = {"bending": length, "friction": known.friction}
            guesses = [replace(g, **given) for g in guesses]
        stages = HOLD_STAGES.get(self.recording.gripper_source, HOLD_STAGES["commanded"])
        plan = [(share, HOLD_THICKNESS, iterations) for share, iterations in stages]
        formed = [(1.0, thickness, iterations) for thickness, iterations in SHAPE_STAGES]
        formed = formed if self._lying.lies_raised else []
        batches = sum(iterations for *_, iterations in plan + formed)
        spent = 0

        def tell(best: Held, loss: float) -> None:
            nonlocal spent
            spent += 1
            if on_hold is not None:
                on_hold(spent / batches, best, loss)

        found = self._search_hold(plan, guesses, chosen, given, tell)
        if formed:
            self._lying.register()
            guesses = shaped_guesses(guesses)
            other = self._search_hold(formed, guesses, chosen, given, tell)
            if other is not None and (found is None or other.loss < SHAPE_GAIN * found.loss):
                self.notes.append(
                    "the cloth does not lie flat: how it lies was read off the first frames"
                )
                found = other
        return found or guesses[0]

    def _search_hold(
        self,
        stages: Sequence[tuple[float, float, int]],
        guesses: Sequence[Held],
        chosen: Sequence[int],
        given: dict[str, float],
        tell: Callable[[Held, float], None],
    ) -> Held | None:
        """The best held cloth from these guesses, or None where none can be simulated.

        Args:
            stages: Cells for each cell of the estimate, thickness in bending lengths, batches.
            guesses: First guesses.
            chosen: Frames that are compared.
            given: What is known, for ``hold_bounds``.
            tell: Called after each batch.
        """
        clouds = [self.recording.frame(t) for t in chosen]
        found = None
        for share, thickness, iterations in stages:
            lift = self._for_hold(share, thickness * guesses[0].bending)
            k = lift.radius_of_gyration

            def simulate(held: Sequence[Held], lift: Lift = lift, k: float = k):
                moduli = [specific_modulus_of(h.bending, k, -GRAVITY[2]) for h in held]
                thetas = [
                    Theta(specific_modulus=modulus, friction=h.friction)
                    for modulus, h in zip(moduli, held, strict=True)
                ]
                return lift.simulate(thetas, frames=chosen, holds=[h.hold for h in held])

            bounds = hold_bounds(
                self.recording,
                size=self.size,
                cell=lift.body.dx,
                table_seen=self.floor is None,
                shaped=guesses[0].hold.shaped,
                **given,
            )
            try:
                found = fit_hold(
                    simulate,
                    clouds,
                    self.floor,
                    bounds,
                    guesses,
                    iterations=iterations,
                    on_iteration=tell,
                )
            except SimulationError as error:
                self.notes.append(f"how the corner is held could not be found: {error}")
                break
            guesses = [found]
        return found

    def _for_hold(self, share: float, thickness: float) -> "Lift":
        """A cheap lift to find the hold with, of a sheet of this thickness [m] or its own.

        With equal bending a thinner sheet is stiffer in its plane, as 1 / thickness^2, which costs
        substeps and tells nothing of the hold.
        """
        lift = self.coarser(share, hurry=1.0)
        if lift.body.thickness >= thickness:
            return lift
        described = replace(self.recording.object, thickness=thickness)
        seen = replace(self.recording, object=described)
        return Lift(seen, lift.settings, hold=lift.hold, sheet=self._lying.sheet)

    def _hanging(self, rise: NDArray[np.floating], hold: Hold) -> NDArray[np.floating]:
        """[K, 4] turn of the grip: a pinched corner does not stay level, it hangs.

        Args:
            rise: [K] height of the gripper above the resting object [m].
            hold: How the corner is held.
        """
        c, s = math.cos(hold.turn), math.sin(hold.turn)
        inwards = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ self._lying.inwards()
        axis = np.cross(inwards, [0.0, 0.0, -1.0])
        reach = self._grip_radius(hold) + self.body.dx
        angle = hold.tilt * np.clip(rise / (HANG_RISE * reach), 0.0, 1.0)
        return Rotation.from_rotvec(angle[:, None] * axis).as_quat()

    def _grippers(self, theta: Theta, hold: Hold | None) -> list[Gripper]:
        """The recorded paths, moved onto the held points, with slack and a ramp from rest."""
        made = []
        first = self.frames[0]
        time = self._sim_time(self.recording.time[first:])
        higher = theta.grip_offset
        pinch = 0.0
        if hold is not None:
            pinch = held_height(hold)
            time = time + hold.lag / self.clock
            higher += hold.height + hold.sink
        for g, held in enumerate(self.grip + np.array([0.0, 0.0, pinch])):
            path = self.recording.gripper_position[first:, g].astype(float).copy()
            path[:, :2] += held[:2] - path[0, :2]
            path[:, 2] += higher
            if self.table_height is not None:
                path[:, 2] = np.maximum(path[:, 2], held[2])
            knots, at = time, path
            away = np.linalg.norm(path[0] - held)
            if away > 0.0:
                # the first recorded position is reached before the first frame, not in a jump
                knots = np.concatenate([[time[0] - away / RAMP_SPEED - 1e-3], time])
                at = np.concatenate([held[None], path])
            turn = None if hold is None else self._hanging(at[:, 2] - held[2], hold)
            radius = self._grip_radius(hold)
            made.append(Gripper(time=knots, position=at, quat_xyzw=turn, radius=radius))
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
        hold = self.hold or (Hold() if self.held_by_corner else None)
        cells = self.settings.cells_across * share
        settings = replace(self.settings, cells_across=cells, clock=clock)
        return Lift(self.recording, settings, hold=hold, sheet=self._lying.sheet)


def _from_simulated(hold: Hold) -> NDArray[np.floating]:
    """[3] from where a cloth was simulated to where it is: worlds share one table, and where it
    lies lower, everything was simulated that much higher [m]."""
    return np.array([hold.east, hold.north, -hold.sink])
