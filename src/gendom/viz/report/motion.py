"""Motions in a view that turns (`viewer.js` brings it to life), residuals of a lift over time, and
what the policy's action reached."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gendom.viz.charts import Axis, Plot
from gendom.viz.clouds import CloudSequence
from gendom.viz.quantities import length_text, numbers_text
from gendom.viz.report.markup import escaped, table

WITH, WITHOUT = "with the estimate", "without parameters"
"""Names of the runs that are compared first: of one network, with the estimate's parameters and
without any."""

_POINTS = 40_000
"""Of all frames; two viewers then fit into a report of 2 MB."""

_FRAMES = 60
"""With more frames than these, evenly spaced ones are shown."""

_SPEEDS = (("1", "real time"), ("0.5", "half speed"), ("0.25", "quarter speed"))


def viewer(clouds: CloudSequence, *, name: str, subject: str) -> str:
    """HTML, hidden until the script runs, so that a page without scripts has no dead buttons.

    Args:
        clouds: What is played.
        name: Of this viewer in the page, a word.
        subject: What is seen; plain text.

    Raises:
        GendomError: The clouds have no points.
    """
    speeds = "".join(f'<option value="{value}">{said}</option>' for value, said in _SPEEDS)
    recorded, simulated = map(escaped, clouds.labels)
    layers = [
        ("recorded", recorded, "dot", clouds.recorded),
        ("simulated", simulated, "dot", clouds.simulated),
        ("arm", "arm", "area", clouds.arm),
        ("goal", "goal", "ring", clouds.goal),
    ]
    options = "".join(
        f'<label><input type="checkbox" data-layer="{kind}" checked>'
        f'<i class="{kind} key {shape}"></i>{label}</label>'
        for kind, label, shape, shown in layers
        if shown is not None
    )
    options += (
        f'<label>{recorded} <input type="range" class="fade" min="-1" max="1" step="0.05" '
        f'value="0" aria-label="Fade from {recorded} to {simulated}"> {simulated}</label>'
    )
    said = escaped(subject)
    return (
        f'<div class="viewer" id="{name}" data-scene="{name}-scene" hidden>'
        f'<figure><canvas tabindex="0" role="img" aria-label="{said}; drag or use the arrow keys '
        'to turn it"></canvas>'
        "<figcaption>Drag it, or use the arrow keys, to turn it</figcaption></figure>"
        '<div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" class="time" min="0" value="0" aria-label="Time"><output></output>'
        f'<select class="speed" aria-label="Speed">{speeds}</select></div>'
        f'<div class="options">{options}</div></div>'
        f'<script type="application/json" id="{name}-scene">'
        f"{encode_scene(clouds)}</script>"
    )


def encode_scene(sequence: CloudSequence) -> str:
    """What `viewer.js` draws, as JSON that is safe inside a script element.

    Points are thinned to some hundred kilobytes; the simulated ones that are left are the same in
    every frame.

    Raises:
        GendomError: The sequence has no points.
    """
    chosen = sequence.spread(_FRAMES)
    low, high = sequence.box()
    if sequence.goal is not None:
        low = np.minimum(low, sequence.goal.min(axis=0))
        high = np.maximum(high, sequence.goal.max(axis=0))
    high = np.maximum(high, low + 1e-3)
    # Points are few in a recording and many in a simulation: what one leaves the other may use.
    per_frame = _POINTS // len(chosen)
    keep = min(max(len(sequence.recorded[t]) for t in chosen), per_frame // 2)
    dot = 3.2 if keep < 400 else 2.2  # small, or a dense cloud would hide the other
    clouds = [
        {"kind": kind, "size": size, "frames": [_thinned(frames[t], most) for t in chosen]}
        for kind, frames, most, size in (
            ("simulated", sequence.simulated, per_frame - keep, 4.4),
            ("recorded", sequence.recorded, keep, dot),
        )
    ]
    side, grippers, known = sequence.projection(), sequence.gripper, sequence.distance
    arm = None
    if sequence.arm is not None and sequence.arm_radius is not None:
        ends = (1e3 * sequence.arm[chosen]).round().astype(int)
        arm = {
            "radius": (1e3 * sequence.arm_radius).round().astype(int).tolist(),
            "ends": ends.reshape(len(chosen), -1).tolist(),
        }
    scene = {
        "low": low.tolist(),
        "high": high.tolist(),
        "times": sequence.times[chosen].round(5).tolist(),
        "frames": [t + 1 for t in chosen],
        "of": sequence.num_frames,
        "distance": None if known is None else [known[0], known[1][chosen].tolist()],
        "table": sequence.table_height,
        "view": {"turn": side.turn, "tilt": side.tilt},
        "grippers": [] if grippers is None else grippers[chosen].round(5).tolist(),
        "arm": arm,
        "goal": None if sequence.goal is None else sequence.goal.round(5).tolist(),
        "clouds": clouds,
    }
    return json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _thinned(points: np.ndarray, most: int) -> list[int]:
    """Coordinates of at most so many of the points, the same ones for the same number of points, in
    tenths of a millimetre."""
    chosen = np.sort(np.random.default_rng(0).permutation(len(points))[:most])
    return (1e4 * points[chosen]).round().astype(int).ravel().tolist()


def residuals(clouds: CloudSequence) -> str:
    """HTML: distances of both clouds over time, as far as they are known for these frames."""
    if clouds.distance is None or clouds.num_frames == 1:
        return ""
    name, distance = clouds.distance
    title, said = {
        "rms": (
            "Points to simulated surface [mm]",
            "Distance of recorded points from the simulated surface, root mean square in each "
            "frame that was compared.",
        ),
        "Chamfer": (
            "Chamfer distance of both clouds [mm]",
            "Mean distance from each recorded point to the nearest simulated one, plus the mean "
            "distance the other way round. Cameras see one side of the object only, so it is not "
            "zero even for a perfect fit.",
        ),
    }[name]
    times, shown = clouds.times, 1e3 * distance
    plot = Plot(
        x=Axis(low=float(times[0]), high=float(times[-1]), label="time [s]"),
        y=Axis(low=0.0, high=1.15 * max(float(shown.max()), 1e-6)),
    )
    plot.area(times, shown, "recorded")
    plot.line(times, shown, "recorded")
    plot.level(float(shown.mean()), "soft", f"mean {shown.mean():.1f} mm")
    return plot.figure(title, said)


# ---- what actions reached ------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PolicyRun:
    """One action, and what it reached."""

    action: np.ndarray
    """[A]."""
    reached: np.ndarray
    """[D] in the goal's coordinates [m]."""


@dataclass(frozen=True, kw_only=True)
class ReachOutcome:
    """One goal, and what was reached for it."""

    goal: np.ndarray
    """[1] distance, or [2] distance and height [m]."""
    runs: Mapping[str, PolicyRun]
    """By what they are called: `WITH`, `WITHOUT`, and whatever else was tried."""

    def error(self, name: str) -> float:
        """Distance between the place that a run reached and the goal [m]."""
        return float(np.linalg.norm(self.runs[name].reached - self.goal))


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """The task carried out for one or several goals, all with runs of the same names."""

    outcomes: Sequence[ReachOutcome]
    goal_name: str
    action_names: Sequence[str]
    """One for each number of an action, with its unit: "release x [m]"."""
    motion: CloudSequence
    """One motion as it was carried out, and as our simulator predicts it."""

    def mean_errors(self) -> dict[str, float]:
        """Mean distance from the goals [m] by the names of the runs."""
        names = self.outcomes[0].runs
        return {name: float(np.mean([o.error(name) for o in self.outcomes])) for name in names}

    @property
    def goals_text(self) -> str:
        """How many goals there are, as the subject of a sentence on distances."""
        return "the goal" if len(self.outcomes) == 1 else f"{len(self.outcomes)} goals"


def action(done: ActionSummary) -> str:
    """HTML: one motion to look at, what was reached of each goal, and how the tip went there."""
    errors, labels = done.mean_errors(), done.motion.labels
    shown = (
        f"The last goal's motion as it was {labels[0]} (blue) and as the simulator {labels[1]} it "
        "with the estimate (orange)."
    )
    names = f"Goal: {done.goal_name}. Action: {', '.join(done.action_names)}."
    return "\n".join(
        [
            f"<p>{_verdict(errors[WITH], errors[WITHOUT], done.goals_text)}</p>",
            f"<p>{escaped(shown)}</p>",
            viewer(done.motion, name="motion", subject="The motion"),
            _outcomes_table(done, errors),
            f'<p class="soft">{escaped(names)}</p>',
        ]
    )


def _outcomes_table(done: ActionSummary, errors: Mapping[str, float]) -> str:
    """A row for each run of each goal, and means."""
    columns = {"Goal": "number", "Policy": "name"}
    columns |= dict.fromkeys(("Action", "Reached", "Error"), "number")
    rows = []
    for outcome in done.outcomes:
        goal = numbers_text(outcome.goal, "m")
        for name, run in outcome.runs.items():
            reached, error = numbers_text(run.reached, "m"), length_text(outcome.error(name))
            rows.append([goal, name, numbers_text(run.action), reached, error])
            goal = ""  # said once
    several = len(done.outcomes) > 1
    means = [["mean", name, "", "", length_text(e)] for name, e in errors.items() if several]
    return table(columns, [*rows, *means], totals=len(means))


def _verdict(ours: float, without: float, goals: str) -> str:
    """One sentence that compares both policies, whichever was better."""
    text = (
        f"With the estimate the mean distance from {goals} is "
        f"<strong>{length_text(ours)}</strong>; the same network without parameters misses by "
        f"<strong>{length_text(without)}</strong>"
    )
    if ours < without:
        saved = 100.0 * (1.0 - ours / without)
        return f"{text}: the estimate takes away {saved:.0f} % of the error."
    return f"{text}: here the estimate did not help."
