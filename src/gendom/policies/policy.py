"""A trained policy: one ONNX file that carries its own description.

The graph takes and gives numbers in units of similarity (`gendom.materials.unit_of`), which do not
depend on the object's size:

    goal_NAME  float32 [B, 1]  one for each number of a goal
    NAME       float32 [B, 1]  one for each parameter that it sees, of `PARAMETERS`
    action     float32 [B, A]

Of the method ``chance`` it takes the numbers of an action, by their names, in place of a goal, and
gives the probability [B, 1] that this action is enough, ``chance``: such a policy chooses among
known actions, for all objects that an estimate holds for likely.

Standardisation is part of the graph. Under the key `gendom-policy` of the file's metadata lies one
JSON object, see `Description`.
"""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError, PolicyError
from gendom.materials import PARAMETERS, Item, dimensionless_parameters
from gendom.materials.names import current_name, with_current_names
from gendom.policies.graph import LARGEST, check_graph
from gendom.reading import parse_json, read_bytes, record_of
from gendom.shown import Shown

if TYPE_CHECKING:
    from gendom.tasks import Task

FORMAT, OLDER = "gendom-policy/3", "gendom-policy/2"
"""Of files, as they are written and as they were before the method ``chance``."""
METADATA_KEY = "gendom-policy"
METHODS = ("distal", "inverse", "chance")
MARGIN = 0.003
"""Of the method ``chance``: how much less probable to be enough than the best one an action may be
that asks less of the robot."""
GOAL = "goal_"
"""What inputs for goals begin with."""

ASSETS = resources.files("gendom") / "assets"
"""Where policies lie that come with the package."""

NOTABLE_MOVE = 0.01
"""An action moved into the task's limits by more than this is worth a warning [units of
similarity]."""


RANGE_TOLERANCE = 0.01
"""A parameter outside the range by less than this share of its end counts as in it."""

UNLIKE_THICKNESS = 0.25
"""A rope whose thickness over length differs by more than this share from all that a policy was
trained on, which does not see it, is worth a warning."""

UNIT_ERROR_FACTOR = 10.0
"""A goal this many times as far as the farthest that can be reached was given in another unit."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Column:
    """One input or output of a network in units of similarity, and how it is standardised:
    (value - mean) / scale."""

    name: str
    mean: float
    scale: float
    log: bool = False
    """Whether the natural logarithm of the value is standardised, not the value."""


@dataclass(frozen=True, kw_only=True)
class GoalRange:
    """Goals that demonstrations reached, by the object's bending length over its size.

    `low` and `high` are outer quantiles of the goals in bins of that ratio, `at` the bins'
    middles. Between middles the range is interpolated in its logarithm.
    """

    at: tuple[float, ...]
    """Middles of the K bins, ascending [-]."""
    low: tuple[tuple[float, ...], ...]
    """[K][G] smallest goals [units of similarity]."""
    high: tuple[tuple[float, ...], ...]
    """[K][G] largest goals."""

    def __call__(self, E: float | None) -> Array:
        """[G, 2] the range for an object, or of all if None [units of similarity]."""
        low, high = np.array(self.low), np.array(self.high)
        if E is None:
            return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)
        at, x = np.log(self.at), math.log(E)
        ends = [[np.interp(x, at, end) for end in side.T] for side in (low, high)]
        return np.array(ends, dtype=float).T.reshape(-1, 2)


@dataclass(frozen=True, kw_only=True)
class _Errors:
    mean: float | None
    p95: float | None


@dataclass(frozen=True, kw_only=True)
class _Acted:
    cases: int
    error_over_size: _Errors


@dataclass(frozen=True, kw_only=True)
class _Trained:
    """What is read of `Description.training`."""

    demonstrations: int | None = None
    failed: int = 0
    seed: int | None = None
    epochs: int | None = None
    architecture: str | None = None
    refine: int = 0
    refine_cases: int | None = None
    refined_in: dict[str, str | int | float | bool | None] | None = None
    acted: _Acted | None = None


@dataclass(frozen=True, kw_only=True)
class Description:
    """What a policy file says about itself."""

    task: dict[str, Any]
    """`name` and settings of the task."""
    method: str
    """One of `METHODS`."""
    conditioned_on: tuple[str, ...]
    """The parameters that the policy sees, a selection of `PARAMETERS`."""
    inputs: tuple[Column, ...]
    outputs: tuple[Column, ...]
    goals: GoalRange
    """Goals seen in training."""
    parameters: dict[str, tuple[float, float]]
    """Smallest and largest value of each of `PARAMETERS` in training [-]; of files before 0.4
    without ``thickness_ratio``: that of the task's object."""
    candidates: tuple[tuple[float, ...], ...] = ()
    """[K][A] actions to choose among, that which asks least first [units of similarity]; of the
    method ``chance`` only."""
    training: dict[str, Any] = field(default_factory=dict)
    """Figures of the training run: size, seed, epochs, errors, seconds, versions."""

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Names of the numbers of a goal."""
        return tuple(c.name[len(GOAL) :] for c in self.inputs if c.name.startswith(GOAL))

    def to_json(self) -> str:
        """The text that goes into the file."""
        return json.dumps({"format": FORMAT, **asdict(self)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str, *, where: str) -> Description:
        """Read the text back.

        Raises:
            PolicyError: Another format, or acting cannot rely on what it says.
        """
        where, fix = f"{where}: {METADATA_KEY}", "train it again"
        value = parse_json(text, where, PolicyError)
        found = value.get("format")
        what = f"has format {found!r}, this version of gendom reads {FORMAT!r} and {OLDER!r}"
        older = f"{fix}, or use the version of gendom that wrote it"
        require(found in (FORMAT, OLDER), what, where=where, fix=older, error=PolicyError)
        for name in ("conditioned_on", "parameters"):
            value[name] = with_current_names(value.get(name), "network")
        self = record_of(cls, value, where=where, fix=fix, error=PolicyError)
        inputs = tuple(replace(c, name=current_name(c.name, "network")) for c in self.inputs)
        self = replace(self, inputs=inputs)
        record_of(_Trained, self.training, where=f"{where}: training", fix=fix, error=PolicyError)
        for what in self._faults():
            raise PolicyError(what, where=where, fix=fix)
        return self

    def _faults(self) -> Iterator[str]:
        """What acting could not rely on."""
        made = ("seed", "epochs", "architecture") if self.training.get("demonstrations") else ()
        made += ("refine_cases",) if made and self.training.get("refine") else ()
        lacking = [f"training.{n}" for n in made if self.training.get(n) is None]
        lacking += [f"task.{n}" for n in ("name", "item", "ranges") if n not in self.task]
        since_first = [n for n in PARAMETERS if n != "thickness_ratio"]
        lacking += [f"parameters.{n}" for n in since_first if n not in self.parameters]
        if lacking:
            yield f"lacks {', '.join(lacking)}"
        at, G = self.goals.at, len(self.goal_names)
        ascend = len(at) > 0 and at[0] > 0.0 and (np.diff(at) >= 0.0).all()
        ends = (self.goals.low, self.goals.high)
        alike = all(len(end) == len(at) and all(len(row) == G for row in end) for end in ends)
        if not (ascend and alike):
            yield f"its goals are no ranges of {G} numbers"
        if not set(self.conditioned_on) <= set(PARAMETERS):
            yield f"is conditioned on {', '.join(self.conditioned_on)}"
        if any(low > high for low, high in self.parameters.values()):
            yield "has a range of parameters that ends before it begins"
        if bool(self.candidates) != (self.method == "chance"):
            yield "has no actions to choose among"
        if any(len(row) != len(self.outputs) for row in self.candidates):
            yield f"its actions to choose among are not of {len(self.outputs)} numbers"


@dataclass(frozen=True, kw_only=True)
class Action:
    """The action that a policy chooses for a goal and an object."""

    goal: dict[str, float]
    """What was asked for, by name, in SI units."""
    action: dict[str, float]
    """By name, in SI units."""
    network_input: dict[str, float]
    """Parameters that the network was given, by name [-], see `dimensionless_parameters`."""
    chance: float | None = None
    """Probability that it is enough, of a policy that knows [-]."""
    warnings: tuple[str, ...] = ()
    """Goals and parameters outside the training range, an action at its limits; one line each."""

    @property
    def values(self) -> tuple[float, ...]:
        """Of the action, in SI units."""
        return tuple(self.action.values())


class Policy(Shown):
    """A trained policy, run by onnxruntime on the CPU.

    Make one with `Policy.read` or `Policy.pretrained`.
    """

    def __init__(
        self,
        session: Any,
        description: Description,
        *,
        where: str,
        graph_names: Mapping[str, str] | None = None,
    ):
        self._session = session
        self._graph_names = graph_names or {}  # where the graph has names of earlier versions
        self.description = description
        self.where = where

    def _shown(self) -> tuple[str, list[tuple[str, str]]]:
        about = self.description
        return f"Policy ({about.task['name']}, {about.method})", [
            ("conditioned on", ", ".join(about.conditioned_on) or "no parameters"),
            ("goal", ", ".join(about.goal_names) or "none"),
            ("trained", f"on {about.training.get('demonstrations', '?')} demonstrations"),
            ("file", self.where),
        ]

    @classmethod
    def read(cls, path: str | os.PathLike) -> Policy:
        """Read a policy file.

        Raises:
            PolicyError: The file is missing, is not ONNX, or does not describe itself.
        """
        os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it would write into the home
        import onnxruntime

        where = str(path)
        content = read_bytes(path, PolicyError, most=LARGEST)
        check_graph(content, where)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # the network is too small for more
        options.log_severity_level = 4
        fix = "use a policy written by gendom train"
        cpu = ["CPUExecutionProvider"]
        try:
            session = onnxruntime.InferenceSession(content, sess_options=options, providers=cpu)
        except Exception as error:  # onnxruntime's own exceptions share no public base class
            what = "is not an ONNX file that onnxruntime can run"
            raise PolicyError(what, where=where, fix=fix) from error
        text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY, "")
        what = f"is an ONNX file without {METADATA_KEY!r} metadata"
        require(text, what, where=where, fix=fix, error=PolicyError)
        description = Description.from_json(text, where=where)
        inputs = {current_name(i.name, "network"): i.name for i in session.get_inputs()}
        goals = {GOAL + name for name in description.goal_names}
        chosen = {c.name for c in description.outputs if description.candidates}
        described = inputs.keys() == goals | chosen | set(description.conditioned_on)
        what = f"its graph takes {sorted(inputs)}, which its description does not say"
        require(described, what, where=where, fix="train it again", error=PolicyError)
        return cls(session, description, where=where, graph_names=inputs)._tried()

    def _tried(self) -> Policy:
        """Itself, if its network gives the numbers of an action.

        Raises:
            PolicyError: It gives others, or none, as damaged or diverged ones do.
        """
        about = self.description
        middle = {name: sum(about.parameters[name]) / 2.0 for name in about.conditioned_on}
        fault = ""
        try:
            with np.errstate(over="ignore"):
                acted = self.actions(about.goals(None).mean(axis=1)[None], middle)
            if acted.shape != (1, len(about.outputs)):
                fault = f"of shape {acted.shape}"
            elif not np.isfinite(acted).all():
                fault = "that are not finite"
        except Exception as error:  # onnxruntime's own exceptions share no public base class
            fault = f"not at all ({type(error).__name__})"
        what = f"its network gives actions {fault}"
        require(not fault, what, where=self.where, fix="train it again", error=PolicyError)
        return self

    @staticmethod
    def ships(task: str, *, parameters: bool = True) -> bool:
        """Whether such a policy comes with the package, see `pretrained`."""
        return (ASSETS / _asset(task, parameters)).is_file()

    @classmethod
    def pretrained(cls, task: str = "rope-reaching", *, parameters: bool = True) -> Policy:
        """The policy that comes with the package.

        Args:
            task: Name of the task.
            parameters: Whether the policy sees the object's parameters; without them it is the
                baseline that the method is compared with.

        Raises:
            ParameterError: There is no such task.
            PolicyError: The package holds no such policy.
        """
        from gendom.tasks import find_task

        name = _asset(task, parameters)
        find_task(task)  # a name that no task has is refused as such
        what = f"no pretrained policy {name!r} comes with this package"
        fix = (
            f"make demonstrations with gendom dataset {task}, train one with gendom train {task}, "
        )
        require((ASSETS / name).is_file(), what, fix=f"{fix}and name its file", error=PolicyError)
        with resources.as_file(ASSETS / name) as path:
            return cls.read(path)

    @staticmethod
    def shipped() -> list[Policy]:
        """All policies that come with the package, by file name."""
        with resources.as_file(ASSETS) as found:
            return [Policy.read(path) for path in sorted(found.glob("*.onnx"))]

    def task(self) -> Task:
        """The task that the policy was trained on.

        Raises:
            PolicyError: This version of gendom does not know the task or one of its settings.
        """
        from gendom.tasks import rebuild

        try:
            return rebuild(self.description.task)
        except ParameterError as error:
            raise PolicyError(error.what, where=self.where, fix=error.fix) from error

    def actions(self, goals: ArrayLike, parameters: Mapping[str, ArrayLike] | None = None) -> Array:
        """Actions for many goals, in units of similarity and without range checks.

        Parameters beyond the training range are clipped to it.

        Args:
            goals: [B, G], or [B] where a goal is one number.
            parameters: [B] or one number each, by names of `PARAMETERS`
                (`dimensionless_parameters`); those that the policy does not see may be left out.

        Returns:
            [B, A].

        Raises:
            PolicyError: A parameter that the policy needs is missing, or a number is not finite.
        """
        about = self.description
        names = about.goal_names
        goals = np.asarray(goals, dtype=float)
        goals = goals.reshape(-1, len(names)) if names else goals.reshape(len(goals), 0)
        if about.candidates:
            chances = self._chances_of_candidates(parameters or {}, len(goals))
            return np.array(about.candidates)[_least(chances)]
        feed = {GOAL + name: goals[:, k] for k, name in enumerate(names)}
        return self._run("action", feed, parameters or {}, len(goals))

    def chances(self, actions: ArrayLike, parameters: Mapping[str, ArrayLike]) -> Array:
        """[B] probabilities that actions [B, A] (units of similarity) are enough, of the method
        ``chance``; parameters and errors as of `actions`."""
        actions = np.asarray(actions, dtype=float)
        feed = {c.name: actions[:, k] for k, c in enumerate(self.description.outputs)}
        return self._run("chance", feed, parameters, len(actions))[:, 0]

    def _chances_of_candidates(self, parameters: Mapping[str, ArrayLike], count: int) -> Array:
        """[count, K] of all candidates, with each of so many objects."""
        known = np.array(self.description.candidates)
        every = {n: np.repeat(np.broadcast_to(v, count), len(known)) for n, v in parameters.items()}
        return self.chances(np.tile(known, (count, 1)), every).reshape(count, -1)

    def _run(
        self, output: str, feed: dict[str, Array], given: Mapping[str, ArrayLike], count: int
    ) -> Array:
        """An output of the network for `count` rows of inputs and parameters."""
        for name in self.description.conditioned_on:
            fix = "give it, or use a policy without parameters"
            what, known = f"the policy needs {name}", name in given
            require(known, what, where=self.where, fix=fix, error=PolicyError)
            low, high = self.description.parameters[name]
            value = np.broadcast_to(np.asarray(given[name], dtype=float), count)
            feed[name] = np.clip(value, low, high)
        for name, value in feed.items():
            what, finite = f"{name} must be finite", np.isfinite(value).all()
            require(finite, what, where=self.where, error=PolicyError)
        columns = {
            self._graph_names.get(name, name): value.astype(np.float32)[:, None]
            for name, value in feed.items()
        }
        return self._session.run([output], columns)[0].astype(float)

    def goal_range(self, item: Item | None = None) -> Array:
        """[G, 2] smallest and largest goals that `act` accepts.

        Args:
            item: For this object, in SI units. Without it the range of all demonstrations, in units
                of similarity.
        """
        if item is None:
            return self.description.goals(None)
        E = None
        if "bending_ratio" in self.description.conditioned_on:
            low, high = self.description.parameters["bending_ratio"]
            E = float(np.clip(dimensionless_parameters(item)["bending_ratio"], low, high))
        return self.description.goals(E) * self.task().goal_units(item)[:, None]

    def act(
        self, goal: ArrayLike, item: Item, *, likely: Sequence[Item] = (), force: bool = False
    ) -> Action:
        """The action that reaches a goal with a given object, of any size.

        Args:
            goal: [G] in SI units and the task's frame.
            item: The object; parameters that the policy does not see do not matter. Those outside
                the training range are clipped to it.
            likely: Objects drawn from what is known of it, for which the method ``chance`` chooses
                (default: the object alone).
            force: Whether goals and parameters that the policy was not trained on are clipped to
                what it was, and not refused; parameters less than `RANGE_TOLERANCE` outside are
                always.

        Returns:
            The action, with warnings where something was clipped (they are also logged).

        Raises:
            PolicyError: The goal is not what the policy's task has, cannot have been given in its
                unit (even if forced), or something lies outside of what was trained, which the
                message names.
            ParameterError: The object is of another kind.
        """
        task, about = self.task(), self.description
        wanted = self._check_goal(goal, item)
        used, warnings, beyond = self._clipped(wanted, item)
        if beyond and not force:
            fix = f"{', '.join(dict.fromkeys(beyond.values()))}, or force it (--force)"
            raise PolicyError(", ".join(beyond), where=self.where, fix=fix)
        inputs = {name: used[name] for name in about.conditioned_on}
        aim = np.array([used[GOAL + name] for name in about.goal_names])
        units = task.action_units(item)
        asked, chance = self._asked(aim / task.goal_units(item), inputs, likely)
        middle = np.array([column.mean for column in about.outputs])
        values = task.nearest(item, asked * units, middle * units)
        moved = float(np.linalg.norm(values / units - asked))
        if moved > NOTABLE_MOVE:
            warnings.append(
                f"the action was moved by {moved:.3g} of the {task.kind}'s size into the task's "
                "limits; the goal may be missed"
            )
        warnings += self._other_thickness(task, item)
        for line in warnings:
            _log.warning("%s", line)
        return Action(
            goal=dict(zip(about.goal_names, map(float, wanted), strict=True)),
            action={q.name: float(v) for q, v in zip(task.actions, values, strict=True)},
            network_input=inputs,
            chance=chance,
            warnings=tuple(warnings),
        )

    def _other_thickness(self, task: Task, item: Item) -> list[str]:
        """What to say of a rope that is thicker or thinner than those of the training, of a policy
        that does not see it. Of cloths hardly more than their bending counts."""
        name, ratio = "thickness_ratio", dimensionless_parameters(item)["thickness_ratio"]
        own = dimensionless_parameters(task.item)[name]
        low, high = self.description.parameters.get(name, (own, own))
        far = not low / (1.0 + UNLIKE_THICKNESS) <= ratio <= high * (1.0 + UNLIKE_THICKNESS)
        if task.kind != "rope" or name in self.description.conditioned_on or not far:
            return []
        return [
            f"{name} ({PARAMETERS[name].meaning}) is {ratio:.3g}, the policy was trained with "
            f"{low:.3g} to {high:.3g} and does not see it: the goal may be missed; use --polish, "
            "or a policy that sees it"
        ]

    def _asked(
        self, goal: Array, inputs: Mapping[str, float], likely: Sequence[Item]
    ) -> tuple[Array, float | None]:
        """[A] the action for a goal [G], in units of similarity, and its chance."""
        known = self.description.candidates
        if not known:
            return self.actions(goal[None], inputs)[0], None
        alike = [dimensionless_parameters(item) for item in likely] or [inputs]
        given = {name: np.array([one[name] for one in alike]) for name in inputs}
        chances = self._chances_of_candidates(given, len(alike)).mean(axis=0)
        k = int(_least(chances))
        return np.array(known[k]), float(chances[k])

    def _check_goal(self, goal: ArrayLike, item: Item) -> Array:
        """The goal [G], if such an object can have one like it."""
        task = self.task()
        require(item.kind == task.kind, f"{task.name} takes a {task.kind}, not a {item.kind}")
        wanted = np.atleast_1d(np.asarray(goal, dtype=float))
        names = self.description.goal_names
        many = f"{len(names)} finite number{'s' * (len(names) != 1)}: {', '.join(names)}"
        fix, what = f"give {many if names else 'no goal'}", f"goal is {wanted.tolist()}"
        fits = wanted.shape == (len(names),) and np.isfinite(wanted).all()
        require(fits, what, where=task.name, fix=fix, error=PolicyError)
        ends, sizes = self.goal_range(item), task.goal_units(item)
        for quantity, value, (low, high), size in zip(task.goals, wanted, ends, sizes, strict=True):
            times = abs(value) / max(abs(low), abs(high), size)
            unit = "" if quantity.unit == "1" else f" {quantity.unit}"
            what = f"goal {quantity.name} is {value:g}{unit}, {times:.0f} times as far as such a "
            what += f"{task.kind} can reach"
            fix = f"choose one between {low:.4g} and {high:.4g}{unit}"
            plausible = times <= UNIT_ERROR_FACTOR
            require(plausible, what, where=task.name, fix=fix, error=PolicyError)
        return wanted

    def _clipped(
        self, wanted: Array, item: Item
    ) -> tuple[dict[str, float], list[str], dict[str, str]]:
        """Goals and parameters in the range of the demonstrations, by inputs' names; what to say of
        those that lie outside, and of which one must be forced, each with its fix."""
        about, alike = self.description, dimensionless_parameters(item)
        names = (GOAL + n for n in about.goal_names)
        goals = zip(names, wanted, self.goal_range(item), strict=True)
        seen = ((n, alike[n], about.parameters[n]) for n in about.conditioned_on)
        used, said, beyond = {}, [], {}
        for name, value, (low, high) in (*goals, *seen):
            nearest = used[name] = float(min(max(value, low), high))
            if nearest == value:
                continue
            share = abs(value - nearest) / abs(nearest) if nearest else math.inf
            if name.startswith(GOAL):
                what = f"goal {name[len(GOAL) :]} {value:.4g} lies outside what the policy was "
                what += f"trained to reach with such a {item.kind}"
                fix = f"choose one between {low:.4g} and {high:.4g}"
            else:
                side = "below" if value < low else "above"
                what = f"{name} ({PARAMETERS[name].meaning}) {value:.4g} is {100.0 * share:.3g} % "
                what += f"{side} the range {low:.4g} to {high:.4g} that the policy was trained on"
                fix = "check the object's numbers"
            said.append(f"{what}; it uses {nearest:.4g}")
            if name.startswith(GOAL) or share > RANGE_TOLERANCE:
                beyond[what] = fix
        return used, said, beyond


def _least(chances: Array) -> Array:
    """[...] the first of actions whose chances [..., K] are nearly the best."""
    return np.argmax(chances >= chances.max(axis=-1, keepdims=True) - MARGIN, axis=-1)


def _asset(task: str, parameters: bool) -> str:
    return f"{task}.onnx" if parameters else f"{task}-no-parameters.onnx"
