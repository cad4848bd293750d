"""The estimate of one or more recordings, and how well it fits each of them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparison
from gendom.estimation.observed import NoiseModel
from gendom.estimation.problem import Found, Problem
from gendom.estimation.replay import replay
from gendom.estimation.scene import LiftScene
from gendom.materials import KINDS
from gendom.materials.estimate import Estimate, Verdict
from gendom.materials.estimate_file import assumed_density_sd
from gendom.materials.posterior import Posterior
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.observation import chamfer, visible


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordingFit:
    """The best fit beside one recording."""

    name: str
    """Empty where it is the only one."""
    scene: LiftScene
    theta: Theta
    """The material, and how the object is held here and when."""
    positions: Array
    """[T, N, 3] particles or points at the scene's frames [m]."""
    chamfer: Array
    """[T] distance to all of the object [m]."""
    chamfer_surface: Array
    """[T] to the part that cameras could see [m]."""

    def record(self, comparison: Comparison, noise: NoiseModel) -> dict[str, Any]:
        """The file's entries for this recording."""
        scene, fit = self.scene, comparison.fit(noise)
        moved = comparison.moved(self.positions, fit.a)
        if scene.thin:
            moved = scene.body_of(self.theta).surface(moved)
        registered = _chamfer(scene, moved)
        away = {"": self.chamfer, "_surface": self.chamfer_surface, "_registered": registered}
        return {
            "theta": {n: v for n, v in self.theta.items() if not UNKNOWNS[n].material},
            **{f"chamfer_last{part}": float(own[-1]) for part, own in away.items()},
            **{f"chamfer_mean{part}": float(own.mean()) for part, own in away.items()},
            "rms": comparison.rms,
            "rms_by_frame": comparison.rms_by_frame(),
            "rms_registered": fit.rms,
            "noise": {"sensor": noise.sensor, "model": noise.model, "patch": noise.patch},
            "calibration": {
                "shift": fit.a[-7:-4].tolist(),
                "turn": fit.a[-4:-1].tolist(),
                "skin": comparison.outside(noise),
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
class FittedEstimate(Estimate):
    """An `Estimate` with the recordings that it was found from."""

    fits: tuple[RecordingFit, ...]
    """One for each recording."""

    @property
    def scene(self) -> LiftScene:
        """Of the first recording."""
        return self.fits[0].scene


def chamfers(scene: LiftScene, x: Array, theta: Theta) -> tuple[Array, Array]:
    """Chamfer distance a frame, to all of the object and to what the cameras could see [T] [m], at
    positions [T, N, 3] of a scene's frames [m] and a thickness of ``theta``.

    Parts of the object below `LiftScene.floor` do not count. Without camera positions a rope is
    seen from above; of a cloth both sides count, which lie where the cloud is.
    """
    skins, cameras = scene.body_of(theta).surface(x), scene.recording.camera_positions
    seen = list(skins)
    if scene.kind == "rope" or cameras is not None:
        with ThreadPoolExecutor(max_workers=scene.settings.threads) as pool:
            in_sight = pool.map(partial(visible, camera_positions=cameras), skins)
            seen = [skin[own] for skin, own in zip(skins, in_sight, strict=True)]
    return _chamfer(scene, skins if scene.thin else x), _chamfer(scene, seen)


def _chamfer(scene: LiftScene, every: Sequence[Array] | Array) -> Array:
    """[T] the distance of a scene's clouds from points of the object in each frame [m]."""
    floor = -np.inf if scene.floor is None else scene.floor

    def one(t: int, own: Array) -> float:
        above = own[:, 2] > floor
        cloud = scene.recording.frame(t).astype(float)
        return chamfer(cloud, own, of_b=above if above.any() else ~above)

    with ThreadPoolExecutor(max_workers=scene.settings.threads) as pool:
        return np.array(list(pool.map(one, scene.frames, every)))


def result_of(
    problem: Problem,
    found: Found,
    posterior: Posterior,
    alone: Sequence[Posterior],
    verdict: Verdict,
    seconds: float,
    notes: Sequence[str] = (),
) -> FittedEstimate:
    """Everything about a search that took so many seconds; ``alone`` is empty if not computed."""
    fits, recordings = [], []
    for k, (part, theta) in enumerate(zip(problem.parts, posterior.thetas, strict=True)):
        x = replay(part.scene, [theta])[:, 0]
        whole, seen = chamfers(part.scene, x, theta)
        held = {"name": part.name, "scene": part.scene, "theta": theta, "positions": x}
        fits.append(RecordingFit(**held, chamfer=whole, chamfer_surface=seen))
        own = fits[k].record(found.best.compared.parts[k], found.noise[k])
        by_itself = None
        if verdict.usable and alone and "E_over_rho" in alone[k].names:
            ends = list(alone[k].interval("E_over_rho", problem.settings.level))
            by_itself = {"E_over_rho": alone[k].theta.E_over_rho, "interval": ends}
        recordings.append({"name": part.name, **own, "alone": by_itself})
    about = {
        **{k: v for k, v in recordings[0].items() if k not in ("name", "alone")},
        "recordings": recordings,
        "notes": [*dict.fromkeys(note for fit in fits for note in fit.scene.notes), *notes],
        **_search(problem, found, seconds),
    }
    weighed = problem.scene.recording.object.mass is not None
    return FittedEstimate(
        kind=problem.scene.kind,
        known=_known(problem.scene, posterior),
        posterior=posterior,
        verdict=verdict,
        level=problem.settings.level,
        density_sd=0.0 if weighed else assumed_density_sd(problem.scene.settings.material),
        about=about,
        fits=tuple(fits),
    )


def _known(scene: LiftScene, posterior: Posterior) -> dict[str, float]:
    """Sizes, mass and density, and what was not estimated but has an effect."""
    described, theta = scene.recording.object, posterior.theta
    stated = {n: getattr(described, n) for n in ("length", "width", "height", "mass")}
    known = {n: float(v) for n, v in stated.items() if v is not None}
    small = KINDS[scene.kind].sizes[1]
    known |= {small: scene.body.thickness, "density": scene.density}
    if "thickness" not in posterior.names:
        known |= {small: theta.thickness * known[small], "density": scene.density_of(theta)}
    return known | {n: theta[n] for n in ("E_over_rho", "nu") if n not in posterior.names}


def _search(problem: Problem, found: Found, seconds: float) -> dict[str, Any]:
    """The file's entries about the search."""
    settings, scene = problem.settings, problem.scene
    starts = []
    for s in found.starts:
        if s.comparison is None:
            continue
        theta = problem.theta(s.vector)
        bends = scene.bending_length(theta.E_over_rho, theta.thickness)
        initial, final = (_named(problem, v) for v in (s.initial, s.vector))
        ended = {"loss": s.comparison.rms, "converged": bool(s.done)}
        starts.append({"initial": initial, "final": final, "bending_length": bends, **ended})
    return {
        "iterations": sum(s.iterations for s in found.starts),
        "seconds": seconds,
        "method": settings.method,
        "frames": settings.frames,
        "seed": settings.seed,
        "device": scene.settings.device,
        "interrupted": found.interrupted,
        "starts": starts,
    }


def _named(problem: Problem, vector: Sequence[float] | Array) -> dict[str, float]:
    """A point of the search by the names of the file."""
    theta, prior = problem.theta(vector), problem.prior
    own = {prior.names[k]: theta[prior.names[k]] for k in prior.of(0)}
    E = theta.E_over_rho * problem.scene.density_of(theta)
    return {"E": E} | {n: theta[n] for n in ("E_over_rho", "nu", "friction")} | own
