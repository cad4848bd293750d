"""Made-up parts of a report: a lift, an estimate, actions and what they reached."""

import io
import math
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from gendom.materials.estimate import Estimate, Verdict
from gendom.materials.posterior import Posterior, prior_of
from gendom.viz import ActionSummary, Animation, Layer, PolicyRun, ReachOutcome, ReportContent
from gendom.viz.layers import gripper_layer
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR
from gendom.viz.report.motion import WITH, WITHOUT


def lift(frames=20, recorded=40, simulated=120, distance=None, more=(), **changes) -> Animation:
    """Of a rope of 0.25 m, lifted by 5 mm a frame: a thin row of points that one end pulls up from
    the table."""
    rng = np.random.default_rng(0)

    def cloud(t, count):
        s = np.sort(rng.uniform(0.0, 1.0, count))
        shape = np.stack([0.3 + 0.25 * s, 0.0 * s, 0.005 * t * (1.0 - s) ** 2], axis=1)
        return shape + rng.normal(scale=0.002, size=shape.shape)

    rise = 0.005 * np.arange(frames)
    gripper = np.stack([np.full(frames, 0.3), np.zeros(frames), rise], axis=1)
    made = (("simulated", SIMULATED_COLOR, simulated), ("recorded", RECORDED_COLOR, recorded))
    dots = [
        Layer(name=n, color=c, radius=0.001, points=[cloud(t, count) for t in range(frames)])
        for n, c, count in made
    ]
    return Animation(
        times=0.1 * np.arange(frames),
        layers=(*dots, gripper_layer(gripper[:, None], 0.25), *more),
        table_height=-0.006,
        distance=distance or ("rms", np.linspace(0.002, 0.006, frames)),
        **changes,
    )


DISTANCES = [f"chamfer_{w}{of}" for w in ("mean", "last") for of in ("", "_surface", "_registered")]


def estimate(*, reasons=(), mass=None, **about):
    """Of a rope: E is determined, nu is not."""
    ends = {"low": np.array([math.log(500.0), 0.2, -0.1])}
    ends |= {"high": np.array([math.log(50000.0), 0.45, 0.1])}
    prior = replace(prior_of(("E_over_rho", "nu", "grip_height")), **ends)
    mean, covariance = np.array([math.log(1834.0), 0.312, 0.001]), np.diag([0.0004, 0.0025, 1e-8])
    posterior = Posterior(prior=prior, mean=mean, covariance=covariance, bases=())
    known = {"length": 0.26, "diameter": 0.0123456789, "density": 1.0}
    return Estimate(
        kind="rope",
        known=known if mass is None else {**known, "mass": mass},
        posterior=posterior,
        verdict=Verdict(usable=not reasons, reasons=tuple(reasons)),
        level=0.95,
        about={
            **dict.fromkeys(DISTANCES, 0.0082), "rms": 0.00385042488550871, "rms_by_frame": [],
            "method": "gauss-newton", "device": "cpu", "seed": 12345678, "iterations": 8,
            "seconds": 51.45626372600009, "notes": [], **about,
        },
    )  # fmt: skip


def outcome(goal, ours, without):
    reached = {WITH: np.array(ours), WITHOUT: np.array(without)}
    runs = {n: PolicyRun(action=np.array([0.2, 0.5]), reached=x) for n, x in reached.items()}
    return ReachOutcome(item="a rope", goal=np.array(goal), runs=runs)


def action(*outcomes, **changes):
    """By default three goals; a goal is missed by 4 mm, without parameters by 20 mm."""
    usual = [outcome([g], [g + 0.004], [g - 0.02]) for g in (0.3, 0.35, 0.4)]
    values: dict[str, Any] = {"outcomes": outcomes or usual, "motion": lift(3)}
    values |= {"goal_name": "farthest x of the tip", "action_names": ("x [m]", "z [m]")}
    return ActionSummary(**values | changes)


def content(**changes):
    """All parts of a report."""
    picture = io.BytesIO()
    Image.new("RGB", (64, 48), "grey").save(picture, "JPEG")
    parts: dict[str, Any] = {
        "title": "A rope",
        "summary": "One lift.",
        "command": "gendom demo",
        "recording_source": "Made by a simulator.",
        "cameras": picture.getvalue(),
        "lift": lift(),
        "estimate": estimate(),
        "truth": {"E": 1850.0, "nu": 0.35},
        "action": action(),
        "next_steps": [("gendom check a.npz", "Look at it.")],
    }
    return ReportContent(**parts | changes)


def only(**parts):
    """A report of these parts alone."""
    return ReportContent(**{"title": "Plain", "summary": "", "command": "", **parts})


def record_of(truth, recording, points, compared):
    """The file of an estimate that found the true parameters of a recording."""
    prior = prior_of(("E_over_rho",))
    mean = np.log([truth.E_over_rho])
    own = {
        "theta": dict(truth), "compared": compared, "digest": recording.digest,
        "begins_with": recording.begins_with, "calibration": {"registration": None},
        "simulation": {"engine": "thin", "points": points, "cells_across": 1.5},
    }  # fmt: skip
    held, kind = recording.object, recording.object.kind
    sizes = ("length", "diameter") if kind == "rope" else ("width", "height", "thickness")
    sizes = (*sizes, "mass")
    return Estimate(
        kind=kind,
        known={**{name: getattr(held, name) for name in sizes}, "density": 800.0, "nu": truth.nu},
        posterior=Posterior(prior=prior, mean=mean, covariance=np.eye(1), bases=(truth,)),
        about={"recordings": [own]},
    ).record
