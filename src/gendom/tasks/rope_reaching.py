"""Rope reaching: pull the tip of a hanging rope back, let go, and see how far it swings.

After Kuroki et al. (2024), "GenDOM: Generalizable One-shot Deformable Object Manipulation with
Parameter-Aware Policy". Their scene has no unit: a rope 0.5 long and 0.028 thick under gravity
12. Ours is in metres, and every length of it is a multiple of the rope's length L.

Similarity. Measured in L, and in time in sqrt(L / g), the motion of an elastic rope depends only
on nu, on diameter / L and on E / (rho g L): dividing rho x_tt = div P(F; E, nu) + rho g by rho g
leaves E / (rho g L) as the only coefficient. So ropes of any length share one task, scaled by
L, and the paper's times and moduli carry over by

    t = t_paper sqrt((L / g) / (0.5 / 12))         E / rho = (E / rho)_paper (g L) / (12 * 0.5).

A slender rope is hardly stretched by its weight (by rho g L / E, here about 1 % and less); it
bends. For bending, E and the diameter count only together, as E k^2 / (rho g L^3) = (bending
length / L)^3 with the section's radius of gyration k (see `bending_length` in `materials`).
`RopeReaching.conditioned_on` uses that for ropes of another diameter / L.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Body, Gripper, Simulator, claimed, rope, stable_substep
from gendom.tasks.base import Outcomes

LENGTH, DIAMETER, GRAVITY = 0.25, 0.014, 9.81
"""The rope [m] and gravity [m/s^2] that the constants below are given for."""

SPECIFIC_MODULUS = (200.0, 4300.0)
"""Range of E / density [m^2/s^2]: the paper's 500 to 10500, times (9.81 * 0.25) / (12 * 0.5)."""

POISSONS_RATIO = (0.2, 0.4)
"""Range of Poisson's ratio [-], as in the paper."""

DENSITY = 1000.0
"""Mass density of simulated ropes [kg/m^3]; the motion depends on E / density alone."""

PAPER_SCENE = (0.5, 12.0)
"""Length of the rope and gravity in the paper's scene [-]."""

PAPER_TIMES = (0.38, 0.57, 1.14)
"""When the tip arrives, is let go, and the rollout ends in the paper's scene [-]."""

RELEASE_X, RELEASE_Z = (0.24, 0.9), (0.24, 1.0)
"""Box of release points, in rope lengths from the robot's base."""

RELEASE_DISTANCE = (0.6, 0.94)
"""Distance of a release point from where the top is held, in rope lengths."""

TOP_HEIGHT = 1.1
"""Height at which the top is held, in rope lengths; it is one length in front of the base."""

GRIP = 0.042
"""Radius of the held regions in rope lengths: the free length does not depend on thickness."""

LEAST_GRIP = 0.75
"""Least radius of the held regions in diameters: less does not hold a thick rope."""

BATCH = 8192
"""Demonstrations simulated at once at the most."""

FRAMES = 150
"""Times at which the tip is recorded between release and end."""


@dataclass(frozen=True, kw_only=True)
class ReachingOutcome:
    """What W worlds did. T is `FRAMES` + 1, the first frame at the release."""

    reached: NDArray[np.float64]
    """[W] farthest x of the tip from its release to the end [m]."""
    sideways: NDArray[np.float64]
    """[W] farthest |y| of the tip from its release to the end [m]."""
    tip_path: NDArray[np.float64]
    """[T, W, 3] the tip [m]."""
    times: NDArray[np.float64]
    """[T] [s]."""
    positions: NDArray[np.floating] | None = None
    """[T, W, N, 3] all particles [m], if they were asked for."""
    failures: Mapping[int, SimulationError] = field(default_factory=dict)
    """Worlds that diverged, where told to keep going; their numbers above are NaN."""


@dataclass(frozen=True, kw_only=True)
class RopeReaching:
    """A rope hangs from a gripper; a second one pulls its tip to a release point and lets go.

    World frame: robot base at the origin, x forward, z up. The top is held at (L, 0, 1.1 L), so
    the tip hangs at (L, 0, 0.1 L). The tip's gripper moves on a straight line at constant speed
    to the release point (x, 0, z), holds still, and opens at `release_time`; the top stays held.

    Action: release point (x, z) [m]. Releases are drawn uniformly from the box x in [0.24, 0.9]
    L, z in [0.24, 1.0] L, less what is closer to the top's gripper than 0.6 L or farther than
    0.94 L. The paper draws from the whole box, but a rope does not stretch to its far corners,
    and close to the top it stands in an arc that may fall to either side.

    Goal: the farthest x [m] that the tip reaches in its first swing. It is the maximum from
    release to `end_time`, which comes 0.53 of the pendulum's period after the release: the tip
    has then swung forward once and is not back a second time. (The first time that the tip's
    velocity turns back would not do: right after the release the rope's own vibration turns it
    back and forth.)

    A stiff rope whose ends are held close together stands in an unstable arc and may fall out of
    the plane. When and how far it does so follows from the smallest disturbance, in the
    simulator from rounding; `ReachingOutcome.sideways` shows it.

    Raises:
        ParameterError: If a setting is not positive and finite, or damping or the air's density is
            negative.
    """

    name: ClassVar[str] = "rope-reaching"
    action_names: ClassVar[tuple[str, ...]] = ("release_x", "release_z")
    goal_names: ClassVar[tuple[str, ...]] = ("x",)

    length: float = LENGTH
    """Length L of the rope [m]."""
    diameter: float = DIAMETER
    """Diameter of its round section [m]."""
    gravity: float = GRAVITY
    """Magnitude of gravity [m/s^2]."""
    cells_across: float = 1.5
    """Grid cells across the diameter."""
    damping: float = 0.0
    """Rate at which velocities decay [1/s]."""
    air_density: float = 1.2
    """Of the air that drags on the rope [kg/m^3]."""
    engine: str = "mpm"
    """Of the simulator: ``mpm`` or ``thin``, a rod."""

    def __post_init__(self) -> None:
        for name in ("length", "diameter", "gravity", "cells_across"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name} must be positive and finite, got {value}")
        for name in ("damping", "air_density"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ParameterError(f"{name} must be finite and not negative, got {value}")
        if self.diameter > 0.2 * self.length:
            raise ParameterError(
                f"a rope {self.diameter} m thick and {self.length} m long is no rope",
                fix="give a diameter of at most 0.2 lengths",
            )

    # ---- scene -----------------------------------------------------------------------------------

    @property
    def top(self) -> NDArray[np.float64]:
        """[3] where the top is held [m]."""
        return self.length * np.array([1.0, 0.0, TOP_HEIGHT])

    @property
    def bottom(self) -> NDArray[np.float64]:
        """[3] where the tip hangs at the start [m]."""
        return self.length * np.array([1.0, 0.0, TOP_HEIGHT - 1.0])

    @property
    def move_time(self) -> float:
        """When the tip arrives at the release point [s]."""
        return PAPER_TIMES[0] * self._clock(*PAPER_SCENE)

    @property
    def release_time(self) -> float:
        """When the tip is let go [s]."""
        return PAPER_TIMES[1] * self._clock(*PAPER_SCENE)

    @property
    def end_time(self) -> float:
        """When the rollout ends [s]."""
        return PAPER_TIMES[2] * self._clock(*PAPER_SCENE)

    def _clock(self, length: float, gravity: float) -> float:
        """This rope's unit of time sqrt(L / g) over that of another [-]."""
        return math.sqrt((self.length / self.gravity) / (length / gravity))

    @property
    def parameter_ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest parameters that `draw` gives, in SI units.

        E / density is that of `SPECIFIC_MODULUS`, carried over to this rope by
        `conditioned_on`.
        """
        low, high = (
            self.conditioned_on(value, length=LENGTH, diameter=DIAMETER, gravity=GRAVITY)
            for value in SPECIFIC_MODULUS
        )
        return {
            "specific_modulus": (low, high),
            "poissons_ratio": POISSONS_RATIO,
            "density": (DENSITY, DENSITY),
        }

    def body(self) -> Body:
        """The rope, hanging straight down from the top."""
        return rope(
            diameter=self.diameter,
            length=self.length,
            start=self.top,
            direction=(0.0, 0.0, -1.0),
            cells_across=self.cells_across,
        )

    def grippers(self, action: ArrayLike) -> list[Gripper]:
        """The top's and the tip's gripper for a release point [2] [m].

        The simulator holds what is inside their radius and one grid cell beyond.

        Raises:
            ParameterError: As `check_action`.
        """
        x, z = self.check_action(action)
        radius = max(GRIP * self.length, LEAST_GRIP * self.diameter)
        return [
            Gripper.still(self.top, radius=radius),
            Gripper(
                time=[0.0, self.move_time],
                position=np.stack([self.bottom, [x, 0.0, z]]),
                radius=radius,
                hold_until=self.release_time,
            ),
        ]

    # ---- actions and parameters ------------------------------------------------------------------

    def sample_actions(self, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
        """[n, 2] release points drawn uniformly from all that are allowed [m]."""
        low, high = np.array([RELEASE_X, RELEASE_Z]).T
        actions = np.empty((n, 2))
        for i in range(n):
            while True:
                release = rng.uniform(low, high)
                if _allowed(release):
                    break
            actions[i] = release
        return actions * self.length

    def check_action(self, action: ArrayLike) -> NDArray[np.float64]:
        """The release point [2] [m], if it is one that the task allows.

        Raises:
            ParameterError: If it is not, with the limits in metres.
        """
        release = np.asarray(action, dtype=float)
        if release.shape != (2,) or not np.isfinite(release).all():
            raise ParameterError(
                f"is {release.tolist()}", where="action", fix="give two finite numbers, x and z [m]"
            )
        if not _allowed(release / self.length, slack=1e-6):
            limits = [
                f"{name} in [{lo * self.length:.4g}, {hi * self.length:.4g}] m"
                for name, (lo, hi) in [("x", RELEASE_X), ("z", RELEASE_Z)]
            ]
            near, far = (limit * self.length for limit in RELEASE_DISTANCE)
            raise ParameterError(
                f"release point ({release[0]:.4g}, {release[1]:.4g}) m is out of limits",
                where="action",
                fix=f"choose {' and '.join(limits)}, {near:.4g} to {far:.4g} m from the top at "
                f"({self.top[0]:.4g}, {self.top[2]:.4g}) m",
            )
        return release

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """One demonstration: a release point, and a rope of random E / density and nu.

        E / density is drawn log-uniformly, nu uniformly, from `parameter_ranges`.

        Returns:
            release_x, release_z [m]; youngs_modulus [Pa], poissons_ratio, density [kg/m^3],
            specific_modulus [m^2/s^2]; length, diameter [m].
        """
        ranges = self.parameter_ranges
        modulus = math.exp(rng.uniform(*np.log(ranges["specific_modulus"])))
        nu = rng.uniform(*ranges["poissons_ratio"])
        x, z = self.sample_actions(rng, 1)[0]
        return {
            "release_x": float(x),
            "release_z": float(z),
            "youngs_modulus": modulus * DENSITY,
            "poissons_ratio": float(nu),
            "density": DENSITY,
            "specific_modulus": modulus,
            "length": self.length,
            "diameter": self.diameter,
        }

    def conditioned_on(
        self, specific_modulus: float, *, length: float, diameter: float, gravity: float = GRAVITY
    ) -> float:
        """E / density [m^2/s^2] that makes this task's rope bend like a given one.

        Its bending length over its length is then that of the given rope. At equal diameter /
        length the two ropes move alike, scaled by their lengths; otherwise they do so as far as
        stretching, shear and the size of the grippers do not count. Poisson's ratio carries
        over unchanged.

        Args:
            specific_modulus: E / density of the given rope [m^2/s^2].
            length, diameter: Of the given rope [m].
            gravity: That the given rope hangs in [m/s^2].

        Raises:
            ParameterError: If an argument is not positive and finite.
        """
        given = {
            "specific_modulus": specific_modulus,
            "length": length,
            "diameter": diameter,
            "gravity": gravity,
        }
        for name, value in given.items():
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name} must be positive and finite, got {value}")
        # equal `bending_length` over length, k = d / 4; as ratios, so that the rope itself comes
        # back to the last bit
        return (
            specific_modulus
            * (diameter / self.diameter) ** 2
            * (self.length / length) ** 3
            * (self.gravity / gravity)
        )

    def scaled_to(self, length: float, diameter: float | None = None) -> RopeReaching:
        """The same task for a rope of another size: actions, goals and paths scale with L.

        Times and the rate of damping follow the rope's own clock sqrt(L / g). What the air does to
        the rope is only similar where diameter and density keep their product.

        Args:
            length: [m].
            diameter: [m]; by default it keeps its ratio to the length.
        """
        _check_length(length)
        ratio = length / self.length
        return replace(
            self,
            length=length,
            diameter=self.diameter * ratio if diameter is None else diameter,
            damping=self.damping / math.sqrt(ratio),
        )

    def settings(self) -> dict[str, Any]:
        """The arguments that rebuild this task."""
        return asdict(self)

    # ---- simulation ------------------------------------------------------------------------------

    def simulate(
        self,
        actions: ArrayLike,
        materials: Sequence[Material],
        *,
        device: str = "cpu",
        dtype: str | None = None,
        threads: int | None = None,
        on_frame: Callable[[int], None] | None = None,
        record_particles: bool = False,
        keep_going: bool = False,
    ) -> ReachingOutcome:
        """Carry out W releases with W ropes, side by side.

        Args:
            actions: [W, 2] release points [m].
            materials: W materials.
            device: ``cpu``, ``cuda`` or ``cuda:0`` and so on.
            dtype: ``float32`` or ``float64``; by default the engine's.
            threads: Worlds simulated side by side on the CPU (default: one a core).
            on_frame: Called with the number of recorded frames that are done in all worlds.
            record_particles: Also return all particles (or points), and begin at time 0 instead of
                at the release, T being twice as large.
            keep_going: Let a world that diverges end with NaN while the others go on.

        Raises:
            ParameterError: If an action is out of limits or the numbers do not agree.
            SimulationError: If a world diverges, unless told to keep going; `world` says which.
        """
        points = np.atleast_2d(np.asarray(actions, dtype=float))
        if points.ndim != 2 or len(points) != len(materials):
            raise ParameterError(
                f"are of shape {points.shape} for {len(materials)} materials",
                where="actions",
                fix="give one release point (x, z) for each material",
            )
        body = self.body()
        grippers = [self.grippers(point) for point in points]
        along = body.material_coordinates[:, 0]
        tip = np.flatnonzero(along == along.max())
        if self.engine == "thin":
            tip = np.array([len(body.points) - 1])
        times = np.linspace(self.release_time, self.end_time, FRAMES + 1)
        if record_particles:
            before = np.linspace(0.0, self.release_time, FRAMES, endpoint=False)
            times = np.concatenate([before, times])
        with claimed(device):
            simulator = Simulator(
                body,
                materials,
                engine=self.engine,
                grippers=grippers,
                gravity=(0.0, 0.0, -self.gravity),
                velocity_damping=self.damping,
                air_density=self.air_density,
                dtype=dtype,
                device=device,
                threads=threads,
            )
            recorded = simulator.run(
                times,
                on_frame=on_frame,
                particles=None if record_particles else tip,
                keep_going=keep_going,
            )
        ends = recorded[:, :, tip] if record_particles else recorded
        path = ends.astype(np.float64).mean(axis=2)
        free = path[-(FRAMES + 1) :]
        return ReachingOutcome(
            reached=free[:, :, 0].max(axis=0),
            sideways=np.abs(free[:, :, 1]).max(axis=0),
            tip_path=path,
            times=times,
            positions=recorded if record_particles else None,
            failures=simulator.failures,
        )

    def demonstrate(
        self,
        draws: Sequence[Mapping[str, float]],
        *,
        device: str = "cpu",
        dtype: str = "float32",
        on_frame: Callable[[int], None] | None = None,
    ) -> Outcomes:
        """Simulate what `draw` gave, side by side; one that diverges does not stop the others.

        Args:
            draws: Demonstrations.
            device, dtype, on_frame: As in `simulate`.

        Returns:
            Columns goal_x [m], sideways [m] and substep [s].

        Raises:
            ParameterError, DeviceError: As `simulate`.
        """
        materials = [
            Material(E=d["youngs_modulus"], nu=d["poissons_ratio"], density=d["density"])
            for d in draws
        ]
        actions = np.array([[d[name] for name in self.action_names] for d in draws])
        goal, sideways = np.full((2, len(draws)), np.nan)
        faults: list[str | None] = [None] * len(draws)

        dx = self.body().dx
        substep = np.array([stable_substep(m, dx) for m in materials])
        # worlds of like substep go together: a batch takes as long as its slowest
        order = np.argsort(substep, kind="stable")
        for group in np.split(order, range(BATCH, len(order), BATCH)):
            chosen = [materials[w] for w in group]
            result = self.simulate(
                actions[group],
                chosen,
                device=device,
                dtype=dtype,
                on_frame=on_frame,
                keep_going=True,
            )
            goal[group], sideways[group] = result.reached, result.sideways
            for w, error in result.failures.items():
                when = "" if error.time is None else f" at {error.time:.4f} s"
                faults[group[w]] = error.what + when
        columns = {"goal_x": goal, "sideways": sideways, "substep": substep}
        return Outcomes(columns=columns, faults=tuple(faults))

    # ---- robot -----------------------------------------------------------------------------------

    def trajectory(self, action: ArrayLike, *, control_dt: float = 0.02) -> dict[str, Any]:
        """The motion of the tip's gripper for a robot, ready for JSON.

        Args:
            action: [2] release point [m].
            control_dt: Longest time between two positions [s].

        Returns:
            time [K] [s], position [K][3] [m] in the robot's base frame, release_time [s] (the
            last time; the gripper opens then), speed [m/s] of the move, and top [3] [m], where
            the rope's other end is held.

        Raises:
            ParameterError: As `check_action`, or if control_dt is not positive.
        """
        if not (math.isfinite(control_dt) and control_dt > 0.0):
            raise ParameterError(f"control_dt must be positive and finite, got {control_dt}")
        _, gripper = self.grippers(action)
        move, release = self.move_time, self.release_time
        moving = np.linspace(0.0, move, math.ceil(move / control_dt) + 1)
        holding = np.linspace(move, release, math.ceil((release - move) / control_dt) + 1)
        times = np.concatenate([moving, holding[1:]])
        start, end = np.asarray(gripper.position)
        return {
            "time": times.tolist(),
            "position": gripper.position_at(times).tolist(),
            "release_time": release,
            "speed": float(np.linalg.norm(end - start)) / move,
            "top": self.top.tolist(),
        }


def _allowed(release: NDArray[np.float64], *, slack: float = 0.0) -> bool:
    """Whether a release point [2] in rope lengths is within all limits."""
    x, z = release
    distance = math.hypot(x - 1.0, z - TOP_HEIGHT)
    limits = [(x, RELEASE_X), (z, RELEASE_Z), (distance, RELEASE_DISTANCE)]
    return all(low - slack <= value <= high + slack for value, (low, high) in limits)


def _check_length(length: float) -> None:
    if not (math.isfinite(length) and length > 0.0):
        raise ParameterError(f"length must be positive and finite, got {length}")
