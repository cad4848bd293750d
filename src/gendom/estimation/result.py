"""An estimate: values, intervals, verdict and fit, and its file ``estimate.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError
from gendom.estimation.likelihood import Comparison, NoiseModel
from gendom.estimation.posterior import Posterior
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.replay import replay
from gendom.estimation.scene import Scene
from gendom.estimation.theta import UNKNOWNS, Theta
from gendom.estimation.verdict import Verdict
from gendom.files import read_json, write_json
from gendom.materials.names import with_current_names
from gendom.observation import chamfer, visible
from gendom.shown import Shown

Array = NDArray[np.floating]

FORMAT = "gendom-estimate/1"

KEYS = {
    "E_over_rho": "E_over_rho",
    "nu": "nu",
    "damping": "damping",
    "friction": "friction",
}
"""Names of the material's unknowns in the file; `bending_length`,
`E` and `bending_stiffness` follow from the first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordingFit:
    """The best fit beside one recording."""

    name: str
    """Empty where it is the only one."""
    scene: Scene
    theta: Theta
    """The material, and how the object is held here and when."""
    positions: Array
    """[T, N, 3] particles or points at the scene's frames [m]."""
    chamfer: Array
    """[T] distance to all of the object [m]."""
    chamfer_surface: Array
    """[T] to the part that cameras could see [m]."""

    @classmethod
    def of(cls, part: Part, theta: Theta) -> RecordingFit:
        x = replay(part.scene, [theta])[:, 0]
        whole, surface = chamfers(part.scene, x, theta)
        return cls(
            name=part.name,
            scene=part.scene,
            theta=theta,
            positions=x,
            chamfer=whole,
            chamfer_surface=surface,
        )

    def record(self, comparison: Comparison, noise: NoiseModel) -> dict[str, Any]:
        """The file's entries for this recording."""
        scene, fit = self.scene, comparison.fit(noise)
        registered, _ = chamfers(scene, comparison.as_seen(self.positions, noise), self.theta)
        return {
            "theta": {n: v for n, v in asdict(self.theta).items() if not UNKNOWNS[n].material},
            "chamfer_last": float(self.chamfer[-1]),
            "chamfer_mean": float(self.chamfer.mean()),
            "chamfer_last_surface": float(self.chamfer_surface[-1]),
            "chamfer_mean_surface": float(self.chamfer_surface.mean()),
            "chamfer_last_registered": float(registered[-1]),
            "chamfer_mean_registered": float(registered.mean()),
            "rms": comparison.rms,
            "rms_by_frame": [float(np.sqrt((r**2).mean())) for r in comparison.residuals],
            "rms_registered": fit.rms,
            "noise": {"sensor": noise.sensor, "model": noise.model},
            "calibration": {
                "shift": fit.a[-7:-4].tolist(),
                "turn": fit.a[-4:-1].tolist(),
                "skin": float(fit.a[-1]),
                "registration": None if (T := scene.registration) is None else T.tolist(),
            },
            "compared": list(scene.frames),
            "begins_with": scene.begins_with,
            "digest": scene.digest,
            "simulation": {
                **asdict(scene.settings),
                "points_simulated": len(scene.initial),
                "clock": scene.clock,
                "velocity_damping": scene.velocity_damping,
            },
            "notes": list(scene.notes),
        }


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimate(Shown):
    """The result of one or more recordings of an object."""

    theta: Theta
    """The most likely parameters; how the object is held and when is that of the first recording.
    """
    posterior: Posterior
    verdict: Verdict
    record: dict[str, Any] = field(repr=False)
    """The JSON document, format ``gendom-estimate/1``: SI units; ``intervals`` and ``bounds``, the
    range that was searched, hold [low, high] by the names of the values; ``intervals`` is null
    where the verdict is not usable; ``recordings`` has the entries of each recording; those of the
    first are at the top level, too. Files of older versions lack some keys."""
    fits: tuple[RecordingFit, ...] = field(default=(), repr=False)
    """One for each recording; empty of an estimate that was read from a file."""

    @property
    def scene(self) -> Scene | None:
        """Of the first recording; None of one that was read from a file."""
        return self.fits[0].scene if self.fits else None

    @property
    def positions(self) -> Array | None:
        """[T, N, 3] of the first recording, see `RecordingFit`."""
        return self.fits[0].positions if self.fits else None

    @property
    def chamfer(self) -> Array | None:
        """[T] likewise."""
        return self.fits[0].chamfer if self.fits else None

    @property
    def usable(self) -> bool:
        return self.verdict.usable

    def interval(self, key: str) -> tuple[float, float] | None:
        """Ends of the interval of one of the record's values, None where there is none."""
        ends = (self.record["intervals"] or {}).get(key)
        return None if ends is None else (float(ends[0]), float(ends[1]))

    def save(self, path: str | Path) -> None:
        """Write ``estimate.json``, atomically.

        Raises:
            GendomError: The place cannot be written.
        """
        write_json(path, self.record)

    @classmethod
    def load(cls, path: str | Path) -> Estimate:
        """Read what `save` or ``gendom estimate --out`` wrote.

        Raises:
            ParameterError: It is no estimate, or that of a recording that gave none.
            GendomError: It cannot be read.
        """
        read = with_current_names(read_json(path))
        if read.get("format") == FORMAT and read.keys() == {"format", "verdict"}:
            reasons = read["verdict"].get("reasons", ())
            raise ParameterError(
                f"holds no numbers, since nothing was estimated: {', '.join(reasons)}",
                where=str(path),
                fix="record the object again",
            )
        if read.get("format") != FORMAT or "posterior" not in read:
            raise ParameterError(
                f"format is {read.get('format')!r}, not {FORMAT!r} with a posterior",
                where=str(path),
                fix="give a file that gendom estimate --out of this version wrote",
            )
        try:
            theta = Theta(**{k: float(v) for k, v in read["theta"].items()})
            verdict = Verdict(
                usable=bool(read["verdict"]["usable"]), reasons=tuple(read["verdict"]["reasons"])
            )
            # files of older versions are of one recording
            own = [theta.with_values(r["theta"]) for r in read.get("recordings", [read])]
            posterior = Posterior.from_dict(read["posterior"], own)
        except (KeyError, TypeError, ValueError) as error:
            raise ParameterError(
                f"cannot be used: {type(error).__name__} {error}",
                where=str(path),
                fix="estimate again",
            ) from None
        return cls(theta=theta, posterior=posterior, verdict=verdict, record=read)

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and interval of what was found, with units, for tables."""
        return table_rows(self.record)

    def _shown(self) -> tuple[str, list[tuple[str, str, str]]]:
        return f"Estimate ({self.record['object']['kind']}, {self.verdict.text})", self.rows()


def table_rows(record: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Name, value and interval of an estimate's record, with units."""
    level = f"{(record['intervals'] or {}).get('level', 0.9):.0%}"
    rope = record["object"]["kind"] == "rope"
    stiffness = ("bending EI", "N m^2") if rope else ("bending D", "N m")
    names = (
        ("E", "Young's modulus", "Pa", ".4g"),
        ("E_over_rho", "E / density", "m^2/s^2", ".4g"),
        ("bending_length", "bending length", "m", ".4f"),
        ("bending_stiffness", *stiffness, ".4g"),
        ("nu", "Poisson's ratio", "", ".3f"),
        ("damping", "damping", "s", ".2g"),
        ("friction", "friction", "", ".2f"),
        ("stiffness_slope", "d ln(E) / d(s/L)", "", ".2f"),
        ("thickness", "diameter" if rope else "thickness", "m", ".4g"),
        ("density", "density", "kg/m^3", ".4g"),
    )
    rows = []
    for key, name, unit, form in names:
        if record.get(key) is None:
            continue
        remarks = []
        ends = (record["intervals"] or {}).get(key)
        if ends is not None:
            remarks.append(f"{level} in [{ends[0]:{form}}, {ends[1]:{form}}]")
        if (record.get("identifiable") or {}).get(key) is False:
            remarks.append("not determined: mostly the prior")
        if key == "density" and record.get("density_assumed"):
            remarks.append("assumed: the mass is unknown")
        rows.append((name, f"{record[key]:{form}} {unit}".strip(), ", ".join(remarks)))
    return rows


def chamfers(scene: Scene, x: Array, theta: Theta) -> tuple[Array, Array]:
    """Chamfer distance a frame, to all of the object and to what the cameras could see [T] [m].

    Parts of the object outside the recorded space (`Scene.floor`) have no points near and do not
    count. Without camera positions a rope is seen from above; of a cloth everything counts, since
    both of its sides lie where the cloud is.

    Args:
        scene: What was recorded.
        x: [T, N, 3] positions at its frames [m].
        theta: Parameters; the thickness is used.
    """
    whole, surface = [], []
    cameras = scene.recording.camera_positions
    for t, here in zip(scene.frames, x, strict=True):
        cloud = scene.recording.frame(t).astype(float)
        skin = scene.body_of(theta).surface(here)
        every = skin if scene.thin else here
        whole.append(chamfer(cloud, every, of_b=_inside(scene, every)))
        if scene.kind == "rope" or cameras is not None:
            skin = skin[visible(skin, camera_positions=cameras)]
        surface.append(chamfer(cloud, skin, of_b=_inside(scene, skin)))
    return np.array(whole), np.array(surface)


def _inside(scene: Scene, points: Array) -> NDArray[np.bool_]:
    if scene.floor is None:
        return np.ones(len(points), dtype=bool)
    above = points[:, 2] > scene.floor
    return above if above.any() else np.ones(len(points), dtype=bool)


def _bending_length(scene: Scene, theta: Theta) -> float:
    """[m]."""
    return scene.bending_length(theta.E_over_rho, theta.thickness)


def bending_stiffness(scene: Scene, theta: Theta) -> float:
    """E I of a rope's section [N m^2], D of a cloth per width [N m]."""
    E, h = theta.E_over_rho * scene.density_of(theta), theta.thickness * scene.body.thickness
    if scene.kind == "rope":
        return E * math.pi * h**4 / 64.0
    return E * h**3 / (12.0 * (1.0 - theta.nu**2))


def result_of(
    problem: Problem,
    found: Found,
    posterior: Posterior,
    alone: Sequence[Posterior],
    verdict: Verdict,
    seconds: Mapping[str, float],
) -> Estimate:
    """Everything about a finished search.

    Args:
        problem: The problem.
        found: The result of the search.
        posterior: Of all recordings.
        alone: Of each recording alone; empty where that was not computed.
        verdict: Whether it is usable.
        seconds: Duration of each stage before [s].
    """
    scene, settings, theta = problem.scene, problem.settings, posterior.theta
    comparison = found.best.comparison
    assert comparison is not None
    fits = tuple(
        RecordingFit.of(part, own)
        for part, own in zip(problem.parts, posterior.thetas, strict=True)
    )
    own = [
        fit.record(compared, noise)
        for fit, compared, noise in zip(fits, comparison.parts, found.noise, strict=True)
    ]
    described = scene.recording.object
    thickness = theta.thickness * scene.body.thickness
    intervals, bounds, known = _ranges(problem, posterior)
    record: dict[str, Any] = {
        **own[0],
        "theta": asdict(theta),
        "recordings": [
            {"name": fit.name, **r, "alone": _by_itself(alone[k : k + 1], settings.level, verdict)}
            for k, (fit, r) in enumerate(zip(fits, own, strict=True))
        ],
        "notes": list(dict.fromkeys(note for fit in fits for note in fit.scene.notes)),
        "format": FORMAT,
        "E": theta.E_over_rho * scene.density_of(theta),
        "nu": theta.nu,
        "damping": theta.damping if "damping" in posterior.names else None,
        "friction": theta.friction if "friction" in posterior.names else None,
        "density": scene.density_of(theta),
        "density_assumed": described.mass is None,
        "E_over_rho": theta.E_over_rho,
        "bending_length": _bending_length(scene, theta),
        "bending_stiffness": bending_stiffness(scene, theta),
        "stiffness_slope": theta.stiffness_slope if "stiffness_slope" in posterior.names else None,
        "thickness": thickness if "thickness" in posterior.names else None,
        "verdict": {"usable": verdict.usable, "reasons": list(verdict.reasons)},
        "intervals": {"level": settings.level, **intervals} if verdict.usable else None,
        "bounds": bounds,
        "identifiable": known,
        "posterior": posterior.to_dict(),
        "iterations": sum(s.iterations for s in found.starts),
        "seconds": sum(seconds.values()),
        "stage_seconds": {**seconds, **found.seconds},
        "method": settings.method,
        "frames": settings.frames,
        "seed": settings.seed,
        "device": scene.settings.device,
        "interrupted": found.interrupted,
        "object": {
            "kind": described.kind,
            "length": described.length,
            "width": described.width,
            "height": described.height,
            "diameter": thickness if described.kind == "rope" else None,
            "thickness": thickness if described.kind == "cloth" else None,
            "mass": described.mass,
        },
        "starts": [
            {
                "initial": _named(problem, s.initial),
                "final": _named(problem, s.vector),
                "bending_length": _bending_length(scene, problem.theta(s.vector)),
                "loss": math.nan if s.comparison is None else s.comparison.rms,
                "converged": bool(s.done),
            }
            for s in found.starts
            if s.comparison is not None
        ],
        "history": [
            {
                "stage": s.stage(i, settings.method),
                "start": n,
                "iteration": i,
                **_named(problem, v),
                "loss": r,
            }
            for n, s in enumerate(found.starts)
            for i, v, r in s.history
        ],
        **found.extra,
    }  # fmt: skip
    return Estimate(
        theta=theta,
        posterior=posterior,
        verdict=verdict,
        record=record,
        fits=fits,
    )


def _by_itself(alone: Sequence[Posterior], level: float, verdict: Verdict) -> dict[str, Any] | None:
    """E / density from one recording alone, None where that was not computed or is not usable."""
    name = "E_over_rho"
    if not alone or name not in alone[0].names or not verdict.usable:
        return None
    return {name: alone[0].theta.E_over_rho, "interval": list(alone[0].interval(name, level))}


def _ranges(
    problem: Problem, posterior: Posterior
) -> tuple[dict[str, list[float]], dict[str, list[float]], dict[str, bool]]:
    """Intervals, searched ranges, and whether each value is determined, by the record's names."""
    scene, level = problem.scene, problem.settings.level
    intervals: dict[str, list[float]] = {}
    bounds: dict[str, list[float]] = {}
    known: dict[str, bool] = {}
    weighed = scene.recording.object.mass is not None
    mass, heavy = (scene.mass_power, 0.0) if weighed else (0, scene.density_sd)
    # with a known mass, bending stiffness is proportional to the square; else the mass grows, too
    weight = 2 if mass else 2 + scene.mass_power
    for k, name in enumerate(posterior.names):
        u = UNKNOWNS[name]
        if not u.material:
            continue
        key = KEYS.get(name, name)
        unit = scene.body.thickness if name == "thickness" else 1.0
        intervals[key] = [unit * end for end in posterior.interval(name, level)]
        bounds[key] = [
            unit * u.value(float(posterior.prior.low[k])),
            unit * u.value(float(posterior.prior.high[k])),
        ]
        known[key] = posterior.determined(name)
        if name != "E_over_rho":
            continue
        theta = posterior.theta
        for of, value, thicker, power, other in (
            # exponents of E / density and thickness in each value, and deviations of the density
            ("E", theta.E_over_rho * scene.density_of(theta), -mass, 1.0, heavy),
            ("bending_length", _bending_length(scene, theta), 2.0, 1.0 / 3.0, 0.0),
            ("bending_stiffness", bending_stiffness(scene, theta), weight, 1.0, heavy),
        ):
            powers = {name: power, "thickness": power * thicker}
            here = math.prod(getattr(theta, n) ** p for n, p in powers.items())
            intervals[of] = [value / here * end for end in posterior.product(powers, level, other)]
            bounds[of] = [value * (end / theta.E_over_rho) ** power for end in bounds[key]]
        known["E"] = known[key]
    for name in ("E_over_rho", "nu", "friction", "damping"):
        known.setdefault(KEYS[name], False)
    known.setdefault("E", False)
    return intervals, bounds, known


def _named(problem: Problem, vector: Sequence[float] | Array) -> dict[str, float]:
    theta, prior = problem.theta(vector), problem.prior
    names = {prior.names[k] for k in prior.of(0)}
    found = {f.name: getattr(theta, f.name) for f in fields(theta) if f.name in names}
    return {
        "E": theta.E_over_rho * problem.scene.density_of(theta),
        "E_over_rho": theta.E_over_rho,
        "nu": theta.nu,
        "friction": theta.friction,
        **found,
    }
