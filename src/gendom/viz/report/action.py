"""The section that shows what the policy's action reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gendom.viz.charts import Axis, Plot
from gendom.viz.clouds import CloudSequence
from gendom.viz.report.lift import viewer
from gendom.viz.report.markup import Section, escaped, side_by_side, table
from gendom.viz.report.summary import length_text, place_text, with_minus

WITH, WITHOUT = "with the estimate", "without parameters"
"""Names of the runs that are compared first: of one network, with the estimate's parameters and
without any."""


@dataclass(frozen=True, kw_only=True)
class PolicyRun:
    """One action, and what it reached."""

    action: np.ndarray
    """[A]."""
    reached: np.ndarray
    """[D] in the goal's coordinates [m]."""
    tip_path: np.ndarray | None = None
    """[T, 3] of the rope's tip from the release on [m]."""


@dataclass(frozen=True, kw_only=True)
class ReachOutcome:
    """One goal, and what was reached for it."""

    goal: np.ndarray
    """[1] distance, or [2] distance and height [m]."""
    runs: Mapping[str, PolicyRun]
    """By what they are called: `WITH`, perhaps `WITHOUT`, and whatever else was tried."""

    def error(self, run: PolicyRun) -> float:
        """Distance between the place reached and the goal [m]."""
        return float(np.linalg.norm(run.reached - self.goal))


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """The task carried out for one or several goals, all with runs of the same names."""

    outcomes: Sequence[ReachOutcome]
    goal_name: str = "farthest distance of the tip"
    action_names: Sequence[str] = ()
    """One for each number of an action, with its unit: "release x [m]"."""
    motion: CloudSequence | None = None
    """One motion as it was carried out, and perhaps as our simulator predicts it."""

    def mean_errors(self) -> dict[str, float]:
        """Mean distance from the goals [m] by the names of the runs."""
        return {
            name: float(np.mean([o.error(o.runs[name]) for o in self.outcomes]))
            for name in self.outcomes[0].runs
        }


def action_section(action: ActionSummary) -> Section:
    """One motion to look at, what was reached of each goal, and how the tip went there."""
    errors, parts = action.mean_errors(), []
    if WITHOUT in errors:
        parts.append(f"<p>{_verdict(errors[WITH], errors[WITHOUT], len(action.outcomes))}</p>")
    if action.motion is not None:
        labels = action.motion.labels
        text = f"The last goal's motion as it was {labels[0]} (blue)"
        if action.motion.simulated is not None:
            text += f" and as the simulator {labels[1]} it with the estimate (orange)"
        parts.append(f"<p>{escaped(text)}.</p>")
        parts.append(viewer(action.motion, name="motion", subject="The motion"))
    parts.append(_outcomes_table(action, errors))
    names = f"Goal: {action.goal_name}."
    if action.action_names:
        names += f" Action: {', '.join(action.action_names)}."
    parts.append(f'<p class="soft">{escaped(names)}</p>')
    parts.append(side_by_side([_goal_figure(action)]))
    return Section(title="The action", body="\n".join(parts))


def _outcomes_table(action: ActionSummary, errors: Mapping[str, float]) -> str:
    """A row for each run of each goal, and means."""
    columns = {"Goal": "number", "Policy": "name"}
    columns |= dict.fromkeys(("Action", "Reached", "Error"), "number")
    rows = []
    for outcome in action.outcomes:
        goal = place_text(outcome.goal)
        for name, run in outcome.runs.items():
            numbers = with_minus(", ".join(f"{a:.3f}" for a in run.action))
            error = length_text(outcome.error(run))
            rows.append([goal, name, numbers, place_text(run.reached), error])
            goal = ""  # said once
    several = len(action.outcomes) > 1
    means = [["mean", name, "", "", length_text(e)] for name, e in errors.items() if several]
    return table(columns, [*rows, *means], totals=len(means))


def _verdict(ours: float, without: float, goals: int) -> str:
    """One sentence that compares both policies, whichever was better."""
    what = "the goal is missed" if goals == 1 else f"the {goals} goals are missed on average"
    text = (
        f"With the estimate {what} by <strong>{length_text(ours)}</strong>; the same network "
        f"without parameters misses by <strong>{length_text(without)}</strong>"
    )
    if ours < without:
        saved = 100.0 * (1.0 - ours / without)
        return f"{text}: the estimate takes away {saved:.0f} % of the error."
    return f"{text}: here the estimate did not help."


def _goal_figure(action: ActionSummary) -> str:
    """Goals and places reached, and the tip's paths, in the plane of the swing."""
    outcomes = action.outcomes
    ways = {WITHOUT: ("without", "dashed", "square"), WITH: ("ours", "line", "dot")}
    ways = {name: way for name, way in ways.items() if name in outcomes[0].runs}
    drawn = [
        (path[:, ::2], outcome.runs[name].reached, name)
        for outcome in outcomes
        for name in ways
        if (path := outcome.runs[name].tip_path) is not None
    ]
    goals = [outcome.goal for outcome in outcomes]
    if not drawn:
        return ""
    places = np.concatenate([path for path, *_ in drawn])
    across = np.concatenate([places[:, 0], *(g[:1] for g in goals)])
    upwards = np.concatenate([places[:, 1], *(g[1:] for g in goals)])
    plot = Plot.to_scale(
        Axis.around(across, margin=0.04, label="distance along the goal's direction [m]"),
        Axis.around(upwards, margin=0.04),
    )
    for k, (path, reached, name) in enumerate(drawn):
        (kind, line, mark), label = ways[name], name if k < len(ways) else ""
        plot.line(path[:, 0], path[:, 1], kind, f"tip, {label}" if label else "", line)
        # a goal that is a distance is reached by the path's farthest point
        at = reached if len(reached) == 2 else path[np.argmax(path[:, 0])]
        plot.marks([at[0]], [at[1]], kind, shape=mark)
    for k, goal in enumerate(goals):
        label = "" if k else "goal"
        if len(goal) == 1:
            plot.upright(goal[0], "ink", label)
        else:
            plot.marks([goal[0]], [goal[1]], "ink", label, "cross")
    note = "Paths from where the tip is let go, or the hand stands; dots and squares: reached."
    return plot.figure("Paths of the rope's tip: height [m]", note)
