"""A trained policy: one ONNX file that carries its own description.

The graph takes and gives numbers in units that do not depend on the rope's size:

    goal              float32 [B, 1]  in units of rope length
    specific_modulus  float32 [B, 1]  E / density [m^2/s^2] of the training task's rope
    poissons_ratio    float32 [B, 1]  [-]
    action            float32 [B, A]  in units of rope length

The two parameters are inputs only of a policy that is conditioned on them. Standardisation is
part of the graph. Under the key `gendom-policy` of the file's metadata lies one JSON object, see
`Description`.
"""

from __future__ import annotations

import json
import logging
import math
import os
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, PolicyError

if TYPE_CHECKING:
    from gendom.tasks import RopeReaching

FORMAT = "gendom-policy/1"
METADATA_KEY = "gendom-policy"
METHODS = ("distal", "inverse")
PARAMETERS = ("specific_modulus", "poissons_ratio")
"""What a policy can be conditioned on, in the order of its inputs."""

NOTABLE_MOVE = 0.01
"""An action moved into the task's limits by more than this is worth a warning [rope lengths]."""

_HALVINGS = 20

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Column:
    """One input or output of a network, and how it is standardised: (value - mean) / scale."""

    name: str
    unit: str
    mean: float
    scale: float
    log: bool = False
    """Whether the natural logarithm of the value is standardised, not the value."""


@dataclass(frozen=True, kw_only=True)
class GoalRange:
    """Goals that demonstrations reached, as a function of the specific modulus.

    `low` and `high` are outer quantiles of the goals in bins of log specific modulus, `at` the
    bins' middles. Between middles the range is interpolated in log specific modulus.
    """

    at: tuple[float, ...]
    """Middles of the bins, ascending [m^2/s^2]."""
    low: tuple[float, ...]
    """Smallest goals [rope lengths]."""
    high: tuple[float, ...]
    """Largest goals [rope lengths]."""

    def __call__(self, specific_modulus: float | None) -> tuple[float, float]:
        """The range [rope lengths] for a specific modulus [m^2/s^2], or of all if None."""
        if specific_modulus is None:
            return min(self.low), max(self.high)
        at, x = np.log(self.at), math.log(specific_modulus)
        return float(np.interp(x, at, self.low)), float(np.interp(x, at, self.high))


@dataclass(frozen=True, kw_only=True)
class Description:
    """What a policy file says about itself."""

    task: dict[str, Any]
    """`name` and settings of the training task: length [m], diameter [m], gravity [m/s^2]."""
    method: str
    """"distal" or "inverse"."""
    conditioned_on: tuple[str, ...]
    """The parameters that the policy sees, a selection of `PARAMETERS`."""
    inputs: tuple[Column, ...]
    outputs: tuple[Column, ...]
    goals: GoalRange
    """Goals seen in training."""
    parameters: dict[str, tuple[float, float]]
    """Smallest and largest value of each of `PARAMETERS` in training."""
    training: dict[str, Any] = field(default_factory=dict)
    """Figures of the training run: size, seed, epochs, errors, seconds, versions."""

    def to_json(self) -> str:
        """The text that goes into the file."""
        return json.dumps({"format": FORMAT, **asdict(self)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str, *, where: str) -> Description:
        """Read the text back.

        Raises:
            PolicyError: Another format, or fields are missing or of the wrong kind.
        """
        try:
            value = json.loads(text)
            found = value.pop("format", None)
        except (json.JSONDecodeError, AttributeError) as error:
            raise PolicyError(
                f"its {METADATA_KEY} entry is no JSON object", where=where, fix="train it again"
            ) from error
        if found != FORMAT:
            raise PolicyError(
                f"has format {found!r}, this version of gendom reads {FORMAT!r}",
                where=where,
                fix="train it again, or use the version of gendom that wrote it",
            )
        try:
            description = cls(
                task=dict(value["task"]),
                method=value["method"],
                conditioned_on=tuple(value["conditioned_on"]),
                inputs=tuple(Column(**c) for c in value["inputs"]),
                outputs=tuple(Column(**c) for c in value["outputs"]),
                goals=GoalRange(**{k: tuple(v) for k, v in value["goals"].items()}),
                parameters={k: (float(v[0]), float(v[1])) for k, v in value["parameters"].items()},
                training=dict(value["training"]),
            )
            # what acting needs; a file that lacks it must not fail later
            for name in ("name", "length", "diameter", "gravity"):
                description.task[name]
            for name in PARAMETERS:
                description.parameters[name]
        except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
            raise PolicyError(
                f"its description is incomplete or broken ({type(error).__name__}: {error})",
                where=where,
                fix="train it again",
            ) from error
        return description


@dataclass(frozen=True, kw_only=True)
class Action:
    """What the robot shall do to reach a goal with one rope."""

    goal: float
    """What was asked for [m]."""
    names: tuple[str, ...]
    """Names of the values."""
    values: tuple[float, ...]
    """The action for this rope [m]."""
    length: float
    """The rope's length [m]."""
    diameter: float
    """The rope's diameter [m]."""
    specific_modulus: float | None
    """E / density [m^2/s^2] that the network saw, of the training task's rope; None: unseen."""
    poissons_ratio: float | None
    """Poisson's ratio that the network saw [-]; None: unseen."""
    warnings: tuple[str, ...] = ()
    """Parameters outside the training range, an action at its limits; one line each."""

    def as_dict(self) -> dict[str, float]:
        """The values by name [m]."""
        return dict(zip(self.names, self.values, strict=True))


class Policy:
    """A trained policy, run by onnxruntime on the CPU.

    Make one with `Policy.read` or `Policy.pretrained`.
    """

    def __init__(self, session: Any, description: Description, *, where: str):
        self._session = session
        self.description = description
        self.where = where

    @classmethod
    def read(cls, path: str | os.PathLike) -> Policy:
        """Read a policy file.

        Raises:
            PolicyError: The file is missing, is not ONNX, or does not describe itself.
        """
        import onnxruntime

        where = str(path)
        try:
            content = Path(path).read_bytes()
        except FileNotFoundError:
            raise PolicyError("no such file", where=where, fix="check the path") from None
        except OSError as error:
            raise PolicyError(
                f"cannot be read ({error.strerror})", where=where, fix="check the path"
            ) from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # the network is too small for more
        options.log_severity_level = 4
        try:
            session = onnxruntime.InferenceSession(
                content, sess_options=options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's own exceptions share no public base class
            raise PolicyError(
                "is not an ONNX file that onnxruntime can run",
                where=where,
                fix="check that it is a policy written by gendom train",
            ) from error
        text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        if text is None:
            raise PolicyError(
                f"is an ONNX file without {METADATA_KEY!r} metadata",
                where=where,
                fix="use a policy written by gendom train",
            )
        description = Description.from_json(text, where=where)
        inputs = {i.name for i in session.get_inputs()}
        if inputs != {"goal", *description.conditioned_on}:
            raise PolicyError(
                f"its graph takes {sorted(inputs)}, which its description does not say",
                where=where,
                fix="train it again",
            )
        return cls(session, description, where=where)

    @classmethod
    def pretrained(cls, task: str = "rope-reaching", *, parameters: bool = True) -> Policy:
        """The policy that comes with the package.

        Args:
            task: Name of the task.
            parameters: Whether the policy sees the object's parameters; without them it is the
                baseline that the method is compared with.

        Raises:
            PolicyError: The package holds no such policy.
        """
        name = f"{task}.onnx" if parameters else f"{task}-no-parameters.onnx"
        asset = resources.files("gendom") / "assets" / name
        with resources.as_file(asset) as path:
            if not path.is_file():
                raise PolicyError(
                    f"no pretrained policy {name!r} comes with this package",
                    fix=f"train one with gendom train {task}, and name the file",
                )
            return cls.read(path)

    @property
    def length(self) -> float:
        """Length of the training task's rope [m]."""
        return float(self.description.task["length"])

    def task(self) -> RopeReaching:
        """The task that the policy was trained on.

        Raises:
            PolicyError: This version of gendom does not know the task or one of its settings.
        """
        from gendom.tasks import TASKS  # brings the simulator, which the network does not need

        settings = dict(self.description.task)
        name = settings.pop("name")
        try:
            return TASKS[name](**settings)
        except (KeyError, TypeError, ParameterError) as error:
            raise PolicyError(
                f"its task {name!r} with {settings} is unknown here",
                where=self.where,
                fix=f"use a policy for {' or '.join(TASKS)} of this version of gendom",
            ) from error

    def actions(
        self,
        goals: ArrayLike,
        specific_modulus: ArrayLike | None = None,
        poissons_ratio: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """Actions for many goals, in the training task's own units and without range checks.

        Parameters beyond the training range are clipped to it; those that the policy does not
        see may be left out.

        Args:
            goals: [B] in units of rope length.
            specific_modulus: [B] or one number, E / density of the training task's rope
                [m^2/s^2] (see `RopeReaching.conditioned_on`).
            poissons_ratio: [B] or one number [-].

        Returns:
            [B, A] in units of rope length.

        Raises:
            PolicyError: A parameter that the policy needs is missing, or a number is not finite.
        """
        goals = np.atleast_1d(np.asarray(goals, dtype=float))
        given = {"specific_modulus": specific_modulus, "poissons_ratio": poissons_ratio}
        feed = {"goal": goals}
        for name in self.description.conditioned_on:
            value = given[name]
            if value is None:
                raise PolicyError(
                    f"the policy needs {name}",
                    where=self.where,
                    fix="give it, or use a policy without parameters",
                )
            low, high = self.description.parameters[name]
            value = np.broadcast_to(np.asarray(value, dtype=float), goals.shape)
            feed[name] = np.clip(value, low, high)
        for name, value in feed.items():
            if not np.isfinite(value).all():
                raise PolicyError(f"{name} must be finite", where=self.where)
        columns = {name: value.astype(np.float32)[:, None] for name, value in feed.items()}
        return self._session.run(["action"], columns)[0].astype(float)

    def goal_range(self, specific_modulus: float | None = None) -> tuple[float, float]:
        """Smallest and largest goal [rope lengths] that `act` accepts.

        Args:
            specific_modulus: E / density of the training task's rope [m^2/s^2]. Without it, or
                for a policy that does not see it, the range of all demonstrations.
        """
        if "specific_modulus" not in self.description.conditioned_on:
            specific_modulus = None
        return self.description.goals(specific_modulus)

    def into_limits(self, actions: ArrayLike) -> NDArray[np.float64]:
        """Actions [B, A] that the task allows [rope lengths]; allowed ones stay as they are.

        Near the ends of the goals a network may point a little beyond the limits. Such an action
        is moved towards the middle of the demonstrated ones, no farther than needed.

        Raises:
            PolicyError: The policy's task is unknown here.
        """
        task = self.task()
        middle = np.array([column.mean for column in self.description.outputs])

        def allowed(action: NDArray[np.float64]) -> bool:
            try:
                task.check_action(action * self.length)
            except ParameterError:
                return False
            return True

        limited = np.array(actions, dtype=float)
        for i, action in enumerate(limited):
            if not allowed(action):
                kept, refused = 0.0, 1.0  # shares of the way from the middle
                for _ in range(_HALVINGS):
                    share = 0.5 * (kept + refused)
                    if allowed(middle + share * (action - middle)):
                        kept = share
                    else:
                        refused = share
                limited[i] = middle + kept * (action - middle)
        return limited

    def act(
        self,
        goal: float,
        specific_modulus: float | None = None,
        poissons_ratio: float | None = None,
        *,
        length: float,
        diameter: float,
    ) -> Action:
        """The action that reaches a goal with a given rope.

        A rope of another size is brought to the size of the training task's rope: lengths are
        counted in rope lengths, and the specific modulus is replaced by the one that gives the
        same ratio of bending length to length.

        Args:
            goal: How far the tip shall swing [m], in the same frame as `RopeReaching`'s goals.
            specific_modulus: The rope's E / density [m^2/s^2]; not needed by a policy that does
                not see it.
            poissons_ratio: [-]; the same.
            length: The rope's length [m].
            diameter: The rope's diameter [m].

        Returns:
            The action [m], with warnings where parameters lie outside the training range (they
            are also logged).

        Raises:
            PolicyError: The goal lies outside what demonstrations reached with such a rope, a
                number is missing or not positive.
        """
        for name, value in (
            ("goal", goal),
            ("specific_modulus", specific_modulus),
            ("length", length),
            ("diameter", diameter),
        ):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise PolicyError(f"{name} must be positive and finite, got {value}")
        sees = self.description.conditioned_on
        given: dict[str, float | None] = dict.fromkeys(PARAMETERS)
        if "specific_modulus" in sees and specific_modulus is not None:
            given["specific_modulus"] = self.task().conditioned_on(
                specific_modulus, length=length, diameter=diameter
            )
        if "poissons_ratio" in sees:
            given["poissons_ratio"] = poissons_ratio
        seen, warnings = {}, []
        for name, value in given.items():
            seen[name] = value
            if value is not None:
                low, high = self.description.parameters[name]
                seen[name] = min(max(value, low), high)
                if seen[name] != value:
                    warnings.append(_outside(name, value, low, high))
        reach = goal / length
        low, high = self.goal_range(seen["specific_modulus"])
        if not low <= reach <= high:
            raise PolicyError(
                f"goal {goal:.4g} m lies outside what the policy was trained to reach with such "
                "a rope",
                where=self.where,
                fix=f"choose one between {low * length:.4g} and {high * length:.4g} m",
            )
        wanted = self.actions([reach], **seen)
        limited = self.into_limits(wanted)
        moved = float(np.linalg.norm(limited - wanted))
        if moved > NOTABLE_MOVE:
            warnings.append(
                f"the action was moved by {moved * length:.3g} m into the task's limits; "
                "the goal may be missed"
            )
        values = limited[0] * length
        for line in warnings:
            _log.warning("%s", line)
        return Action(
            goal=goal,
            names=tuple(column.name for column in self.description.outputs),
            values=tuple(float(v) for v in values),
            length=length,
            diameter=diameter,
            specific_modulus=seen["specific_modulus"],
            poissons_ratio=seen["poissons_ratio"],
            warnings=tuple(warnings),
        )


def _outside(name: str, value: float, low: float, high: float) -> str:
    edge, side = (low, "below") if value < low else (high, "above")
    percent = 100.0 * abs(value - edge) / edge
    scaled = " (at the size of the training rope)" if name == "specific_modulus" else ""
    return (
        f"{name} {value:.4g}{scaled} is {percent:.3g} % {side} the range {low:.4g} to {high:.4g} "
        f"that the policy was trained on; it uses {edge:.4g}"
    )
