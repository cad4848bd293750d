"""Residuals of a lift over time, and what the policy's actions reached."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gendom.viz.animation import Animation
from gendom.viz.charts import Axis, Plot
from gendom.viz.markup import escaped, table
from gendom.viz.player import player
from gendom.viz.quantities import length_text, numbers_text

WITH, WITHOUT = "with the estimate", "without parameters"
"""Names of the runs that are compared first: of one network, with the estimate's parameters and
without any."""


def residuals(lift: Animation) -> str:
    """HTML: how far recorded points were from the simulated surface over time, where known."""
    if lift.distance is None or lift.num_frames == 1:
        return ""
    times, shown = lift.times, 1e3 * lift.distance[1]
    plot = Plot(
        x=Axis(low=float(times[0]), high=float(times[-1]), label="time [s]"),
        y=Axis(low=0.0, high=1.15 * max(float(shown.max()), 1e-6)),
    )
    plot.area(times, shown, "recorded")
    plot.line(times, shown, "recorded")
    mean = float(shown.mean())
    plot.line(times[[0, -1]], [mean, mean], "soft", f"mean {mean:.1f} mm", "dashed")
    note = "Distance of recorded points from the simulated surface, root mean square in each frame "
    return plot.figure("Points to simulated surface [mm]", f"{note}that was compared.")


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

    item: str
    """The object's name."""
    goal: np.ndarray
    """[1] distance, or [2] distance and height [m]."""
    runs: Mapping[str, PolicyRun]
    """By what they are called: `WITH`, `WITHOUT`, and whatever else was tried."""

    def error(self, name: str) -> float:
        """Distance between the place that a run reached and the goal [m]."""
        return float(np.linalg.norm(self.runs[name].reached - self.goal))

    def records(self) -> dict[str, dict[str, Any]]:
        """The runs by name, ready for JSON."""
        return {
            name: {"action": run.action, "reached": run.reached, "error": self.error(name)}
            for name, run in self.runs.items()
        }


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """The task carried out for one or several goals, all with runs of the same names."""

    outcomes: Sequence[ReachOutcome]
    goal_name: str
    action_names: Sequence[str]
    """One for each number of an action, with its unit: "release x [m]"."""
    motion: Animation
    """One motion as it was carried out, and as our simulator predicts it."""
    motion_note: str = ""
    """What that shows."""

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
    errors = done.mean_errors()
    names = f"Goal: {done.goal_name}. Action: {', '.join(done.action_names)}."
    said = _verdict(errors[WITH], errors[WITHOUT], done.goals_text)
    head = f"<p>{said}</p>\n<p>{escaped(done.motion_note)}</p>"
    shown, reached = player(done.motion, name="motion", subject="The motion"), _outcomes_table(done)
    return "\n".join([head, shown, reached, f'<p class="soft">{escaped(names)}</p>'])


def _outcomes_table(done: ActionSummary) -> str:
    """A row for each run of each goal, and means."""
    columns = {"Object": "name", "Goal": "number", "Policy": "name"}
    columns |= dict.fromkeys(("Action", "Reached", "Error"), "number")
    rows = []
    for outcome in done.outcomes:
        item, goal = outcome.item, numbers_text(outcome.goal, "m")
        for name, run in outcome.runs.items():
            reached, error = numbers_text(run.reached, "m"), length_text(outcome.error(name))
            rows.append([item, goal, name, numbers_text(run.action), reached, error])
            item = goal = ""  # said once
    errors = done.mean_errors() if len(done.outcomes) > 1 else {}
    means = [["mean", "", name, "", "", length_text(e)] for name, e in errors.items()]
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
