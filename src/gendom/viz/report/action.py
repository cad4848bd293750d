"""The section that shows what the policy's action reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gendom.arguments import check_numbers, require
from gendom.viz.charts import Axis, Plot
from gendom.viz.clouds import CloudSequence
from gendom.viz.report.lift import viewer
from gendom.viz.report.markup import DASH, Section, cell, chart_figure, escaped, number, table
from gendom.viz.report.summary import length_text, place_text, with_minus


@dataclass(frozen=True, kw_only=True)
class PolicyRun:
    """One action, and what it reached. Arrays are converted to float64.

    Raises:
        ParameterError: An array has another shape, or a number is not finite.
    """

    action: np.ndarray
    """[A]."""
    reached: np.ndarray
    """[D], or one number, in the goal's coordinates [m]."""
    tip_path: np.ndarray | None = None
    """[T, 3] of the rope's tip from the release on [m]."""
    shape_at_release: np.ndarray | None = None
    """[n, 3] points along the rope [m]."""
    shape_at_farthest: np.ndarray | None = None
    """[n, 3] points along the rope when its tip is farthest [m]."""

    def __post_init__(self):
        for name in ("action", "reached", "tip_path", "shape_at_release", "shape_at_farthest"):
            value, flat = getattr(self, name), name in ("action", "reached")
            if value is not None:
                value = check_numbers(name, np.atleast_1d(value), ("n",) if flat else ("n", 3))
                object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class ReachOutcome:
    """One goal, and what both policies reached.

    Raises:
        ParameterError: Goal and place reached differ in shape, or the goal is not 1-D or 2-D.
    """

    goal: np.ndarray
    """[1] or one number: distance; [2]: distance and height [m]."""
    ours: PolicyRun
    """The policy that knows the estimate."""
    without: PolicyRun | None = None
    """The same network without parameters."""
    further: Mapping[str, PolicyRun] = field(default_factory=dict)
    """What else was tried for this goal, by what it is called."""

    def __post_init__(self):
        goal = check_numbers("goal", np.atleast_1d(self.goal), (1,), (2,))
        object.__setattr__(self, "goal", goal)
        for name, run in {"ours": self.ours, "without": self.without, **self.further}.items():
            if run is not None:
                check_numbers(f"{name}.reached", run.reached, goal.shape)

    def error(self, run: PolicyRun) -> float:
        """Distance between the place reached and the goal [m]."""
        return float(np.linalg.norm(run.reached - self.goal))


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """The task carried out for one or several goals.

    Raises:
        ParameterError: There is no outcome, or goals or actions differ in shape.
    """

    outcomes: Sequence[ReachOutcome]
    goal_name: str = "farthest distance of the tip"
    action_names: Sequence[str] = ()
    """One for each number of an action, with its unit: "release x [m]"."""
    motion: CloudSequence | None = None
    """One motion as it was carried out, and perhaps as our simulator predicts it."""

    def __post_init__(self):
        fix = "give one goal or leave it out"
        require(self.outcomes, "is empty", where="outcomes", fix=fix)
        sizes = {
            (len(o.goal), len(run.action))
            for o in self.outcomes
            for run in (o.ours, o.without, *o.further.values())
            if run is not None
        }
        where, fix = "goals and actions", "give one task's"
        require(len(sizes) == 1, "differ in shape", where=where, fix=fix)
        actions, names = next(iter(sizes))[1], len(self.action_names)
        what = f"has {names} names for {actions} numbers"
        where, fix = "action_names", "give one each"
        require(names in (0, actions), what, where=where, fix=fix)

    def mean_errors(self) -> tuple[float, float | None]:
        """Mean distance from the goals [m], of our policy and of the one without parameters.

        The second is None unless that policy was run for every goal: other means would not
        compare.
        """
        ours = float(np.mean([o.error(o.ours) for o in self.outcomes]))
        others = [o.error(o.without) for o in self.outcomes if o.without is not None]
        return ours, float(np.mean(others)) if len(others) == len(self.outcomes) else None


def action_section(action: ActionSummary) -> Section:
    """One motion to look at, what was reached of each goal, charts of goals and of one swing."""
    parts: list[str] = []
    ours, without = action.mean_errors()
    if without is not None:
        parts.append(f"<p>{_verdict(ours, without, len(action.outcomes))}</p>")
    if action.motion is not None:
        parts.append(_motion_viewer(action.motion))
    outcomes = action.outcomes
    groups: dict[str, Sequence[PolicyRun | None]]
    groups = {"With the estimate": [o.ours for o in outcomes]}
    if any(o.without is not None for o in outcomes):
        groups["Without parameters"] = [o.without for o in outcomes]
    parts.append(_outcomes_table(action, groups))
    labels = dict.fromkeys(label for o in outcomes for label in o.further)
    if labels:
        parts.append(
            _outcomes_table(action, {w: [o.further.get(w) for o in outcomes] for w in labels})
        )
    names = f"Goal: {action.goal_name}."
    if action.action_names:
        names += f" Action: {', '.join(action.action_names)}."
    parts.append(f'<p class="soft">{escaped(names)}</p>')
    figures = [_goal_figure(action)] if len(action.outcomes) > 1 else []
    drawn = next((o for o in action.outcomes if o.ours.tip_path is not None), None)
    if drawn is not None:
        figures.append(_swing_figure(drawn))
    if figures:
        parts.append(f'<div class="pair">{"".join(figures)}</div>')
    return Section(title="The action", body="\n".join(parts))


def _outcomes_table(action: ActionSummary, groups: Mapping[str, Sequence[PolicyRun | None]]) -> str:
    """A row for each goal and one of means; three columns for each group of runs."""
    outcomes, compared = action.outcomes, len(groups) > 1
    columns = ["Action", "Reached", "Error"]
    titles = "".join(f'<th class="number">{column}</th>' for column in columns * len(groups))
    rowspan = ' rowspan="2"' if compared else ""
    head = f'<th{rowspan} class="number">Goal</th>'
    if compared:
        head += "".join(f'<th colspan="3" class="group">{escaped(g)}</th>' for g in groups)
        head += f"</tr><tr>{titles}"
    else:
        head += titles

    def said(column: str, group: str) -> str:
        return f"{column.lower()}, {group.lower()}" if compared else column.lower()

    rows = []
    for k, outcome in enumerate(outcomes):
        cells = [number(place_text(outcome.goal), "goal")]
        for group, runs in groups.items():
            run, texts = runs[k], [DASH] * 3
            if run is not None:
                action_text = with_minus(", ".join(f"{a:.3f}" for a in run.action))
                texts = [action_text, place_text(run.reached), length_text(outcome.error(run))]
            cells += [number(t, said(c, group)) for t, c in zip(texts, columns, strict=True)]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    if len(outcomes) > 1:
        cells = [cell("mean", "number")]
        for group, runs in groups.items():
            done = [o.error(r) for o, r in zip(outcomes, runs, strict=True) if r is not None]
            # other means would not compare
            text = length_text(float(np.mean(done))) if len(done) == len(outcomes) else DASH
            cells += [cell("", columns=2), number(text, said("error", group))]
        rows.append(f'<tr class="total">{"".join(cells)}</tr>')
    return table([head], rows)


def _goal_figure(action: ActionSummary) -> str:
    outcomes = action.outcomes
    goals = np.array([o.goal for o in outcomes])
    reached = np.array([o.ours.reached for o in outcomes])
    missing = np.full_like(goals[0], np.nan)
    others = np.array([missing if o.without is None else o.without.reached for o in outcomes])
    groups = [(reached, "ours", "with the estimate")]
    if any(o.without is not None for o in outcomes):
        groups.append((others, "without", "without parameters"))
    every = np.concatenate([goals, *(places for places, *_ in groups)])
    if goals.shape[1] == 1:  # reached against goal, and the line on which they are equal
        title = "Reached distance [m] of each goal"
        ends = Axis.around(every, margin=0.08)
        plot = Plot.to_scale(replace(ends, label="goal [m]"), ends)
        diagonal = [plot.x.low, plot.x.high]
        plot.line(diagonal, diagonal, "soft", "reached = goal", dashed=True)
        for places, kind, label in groups:
            plot.dots(goals[:, 0], places[:, 0], kind, label, square=kind == "without")
        return chart_figure(title, [plot])
    # the plane of the goals, each joined with the places reached
    plot = Plot.to_scale(
        Axis.around(every[:, 0], margin=0.1, label="along [m]"),
        Axis.around(every[:, 1], margin=0.1),
    )
    for k, goal in enumerate(goals):
        plot.cross(goal[0], goal[1], "ink", "" if k else "goal")
    for places, kind, label in groups:
        for goal, place in zip(goals, places, strict=True):
            plot.line([goal[0], place[0]], [goal[1], place[1]], kind)
        plot.dots(places[:, 0], places[:, 1], kind, label, square=kind == "without")
    return chart_figure("Goals and places reached: height [m]", [plot])


def _verdict(ours: float, without: float, goals: int) -> str:
    """One sentence that compares both policies, whichever was better."""
    what = "the goal is missed" if goals == 1 else f"the {goals} goals are missed on average"
    text = (
        f"With the estimate {what} by <strong>{length_text(ours)}</strong>; the same network "
        f"without parameters misses by <strong>{length_text(without)}</strong>"
    )
    if ours < without:
        return (
            f"{text}: the estimate takes away {100.0 * (1.0 - ours / without):.0f} % of the error."
        )
    return f"{text}: here the estimate did not help."


def _swing_figure(outcome: ReachOutcome) -> str:
    """Paths of the tip in the plane of the swing, the rope at its two moments, and the goal."""
    ways = (
        (outcome.without, "without parameters", "without"),
        (outcome.ours, "with the estimate", "ours"),
    )
    drawn = []
    for run, label, kind in ways:
        if run is not None and run.tip_path is not None:
            shapes = [s for s in (run.shape_at_release, run.shape_at_farthest) if s is not None]
            # a few hundred dots show the rope as well as thousands, in a smaller file
            shapes = [s[:: max(1, len(s) // 250), ::2] for s in shapes if len(s)]
            drawn.append((run.tip_path[:, ::2], shapes, label, kind))
    goal = outcome.goal
    points = np.concatenate([p for path, shapes, *_ in drawn for p in (path, *shapes)])
    plot = Plot.to_scale(
        Axis.around(
            np.append(points[:, 0], goal[0]),
            margin=0.04,
            label="distance along the goal's direction [m]",
        ),
        Axis.around(np.append(points[:, 1], goal[1:]), margin=0.04),
    )
    for path, shapes, label, kind in drawn:
        for k, shape in enumerate(shapes):
            plot.dots(shape[:, 0], shape[:, 1], kind, size=5.0, faint=k == 0)
        plot.line(path[:, 0], path[:, 1], kind, f"tip, {label}", dashed=kind == "without")
    for path, _, _, kind in drawn:
        first, farthest = path[:1], path[[np.argmax(path[:, 0])]]
        plot.dots(first[:, 0], first[:, 1], kind, size=9.0)
        plot.dots(farthest[:, 0], farthest[:, 1], kind, size=9.0, square=True)
    if len(goal) == 1:
        plot.upright(goal[0], "ink", "goal")
    else:
        plot.cross(goal[0], goal[1], "ink", "goal")
    return chart_figure(
        "Paths of the rope's tip: height [m]",
        [plot],
        f"Goal {place_text(outcome.goal)}. Circles: the tip when it is let go, or when the hand "
        "stands; squares: the tip at its farthest. "
        "Dots: the rope at two moments, the earlier one pale.",
    )


def _motion_viewer(motion: CloudSequence) -> str:
    text = f"The last goal's motion as it was {motion.labels[0]} (blue)"
    if motion.simulated is not None:
        text += f" and as the simulator {motion.labels[1]} it with the estimate (orange)"
    return f"<p>{escaped(text)}.</p>{viewer(motion, name='motion', subject='The motion')}"
