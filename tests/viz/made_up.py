"""Made-up parts of a report."""

import io
import math

import numpy as np
from PIL import Image

from gendom.viz import (
    ActionSummary,
    CloudSequence,
    EstimateSummary,
    LiftPictures,
    PolicyRun,
    Provenance,
    ReachOutcome,
    ReportContent,
)
from gendom.viz.report.action import WITH, WITHOUT

POSTERIOR = {
    "names": ["E_over_rho", "grip_height"],
    "log": [True, False],
    "mean": [math.log(1834.0), 0.001],
    "covariance": [[0.0004, 0.0], [0.0, 1e-8]],
    "prior_mean": [math.log(1000.0), 0.0],
    "prior_sd": [3.0, 0.002],
    "low": [math.log(500.0), -0.1],
    "high": [math.log(50000.0), 0.1],
}
"""Of an estimate's file."""


def estimate(**changes):
    history = [
        {
            "start": start,
            "iteration": k,
            "E": 1800.0 + 500.0 * 0.5**k,
            "nu": 0.3,
            "loss": 0.1 * 0.5**k + 0.001 * start,
        }
        for start in range(2)
        for k in range(4)
    ]
    final = {"E": 1800.0, "nu": 0.3}
    return {
        "format": "gendom-estimate/1",
        "E": 1834.0,
        "nu": 0.312,
        "density": 1.0,
        "density_assumed": True,
        "E_over_rho": 1834.0,
        "bending_length": 0.113,
        "intervals": {
            "level": 0.95,
            "E": [1790.0, 1902.0],
            "nu": [0.211, 0.391],
            "E_over_rho": [1790.0, 1902.0],
        },
        "bounds": {"E": [500.0, 50000.0], "nu": [0.2, 0.4]},
        "identifiable": {"E": True, "nu": False},
        "chamfer_mean": 0.0082,
        "method": "gauss-newton",
        "object": {"kind": "rope", "length": 0.26, "mass": None},
        "starts": [{"initial": final, "final": final, "loss": loss} for loss in (0.001, 0.002)],
        "history": history,
    } | changes


def run(reached):
    reached = np.array(reached)
    path = np.stack([np.linspace(0.1, reached[0], 9), np.zeros(9), np.ones(9)], axis=1)
    return PolicyRun(action=np.array([0.2, 0.5]), reached=reached, tip_path=path)


def outcomes():
    return [
        ReachOutcome(
            goal=np.array([goal]), runs={WITH: run([goal + 0.004]), WITHOUT: run([goal - 0.02])}
        )
        for goal in (0.3, 0.35, 0.4)
    ]


def picture():
    buffer = io.BytesIO()
    Image.new("RGB", (64, 48), "grey").save(buffer, "JPEG")
    return buffer.getvalue()


def content(recorded_lift, **changes):
    parts = {
        "title": "A rope",
        "recording_source": "Made by a simulator.",
        "cameras": picture(),
        "lift": LiftPictures(clouds=CloudSequence(**recorded_lift)),
        "estimate": EstimateSummary(
            values=estimate(),
            truth={"E": 1850.0, "nu": 0.35},
        ),
        "action": ActionSummary(outcomes=outcomes(), action_names=("x [m]", "z [m]")),
        "provenance": Provenance(
            commands=("gendom demo",), seeds={"all": 7}, stage_seconds={"estimate": 3.0}
        ),
        "next_steps": [("gendom check a.npz", "Look at it.")],
    }
    return ReportContent(**parts | changes)
