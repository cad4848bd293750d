"""What a task is: one file that defines what is done with an object, and what is measured.

A task knows its object (`Rope` or `Cloth`), its action with limits, where the tool goes for an
action, and how what was observed is judged. It knows neither simulator nor robot: worlds
(`gendom.tasks.world`) carry it out, and data sets, policies, environments and commands are made
from what is declared here.

All points are in the task's own frame, z up; `T_world_task` places it in front of a robot. Lengths
follow the object's size and times its clock sqrt(L / g), so that one policy serves objects of any
size, see `gendom.materials.objects`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Protocol, Self, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import check_choice, require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.materials import (
    PARAMETERS,
    QUANTITIES,
    Item,
    Items,
    Material,
    Rope,
    from_columns,
    items_from_columns,
    size_of,
    thickness_of,
    to_columns,
    unit_of,
)
from gendom.materials.names import with_current_names
from gendom.reading import record_of
from gendom.robot.path import TcpPath, TcpPaths
from gendom.streams import uniform

ROPE = Rope(length=0.25, diameter=0.014, material=Material(damping=0.004))
"""The rope that demonstrations are simulated with, where a task asks for no other."""

ROPE_RANGES = {
    "E_over_rho": (200.0, 4300.0),
    "nu": (0.2, 0.4),
    "damping": (0.001, 0.02),
    "density": (500.0, 1500.0),
    "thickness_ratio": (0.01, 0.1155),
}
"""Its drawn parameters: E / density is the paper's 500 to 10500, times (9.81 * 0.25) / (12 * 0.5),
nu is the paper's."""

DRAWN = {**QUANTITIES, "thickness_ratio": PARAMETERS["thickness_ratio"]}
"""What objects are drawn by, by name."""

THICKNESSES = 16
"""Values of the thickness over the size that are drawn, for a factor of ten: objects of one size
are simulated side by side."""

DRAWS = 1000
"""Draws from the box of an action's limits before it is given up to find one that is allowed."""

SLACK = 1e-6
"""How far beyond its limits an action may be, for rounding [units of similarity]."""

_HALVINGS = 30

_MANY = {
    "limits": "limits_of", "margin": "margins", "tool_path": "tool_paths", "outcome": "outcomes_of",
}  # fmt: skip
"""Of a task: what it says of an object, and of many at once."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of an action, a goal or an outcome."""

    name: str
    unit: str
    """``m``, ``s``, ``m/s`` or ``1``; how it follows an object's size, see `unit_of`."""
    meaning: str = ""
    """For people, a few words."""
    limit: float = math.inf
    """Of an outcome that shows whether an action is one to learn from: beyond it what was reached
    depends on the smallest disturbance, or the task has failed [units of similarity]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Where an object is before the tool moves, straight or flat and at rest."""

    origin: ArrayLike
    """[3] a rope's first end, or a cloth's first corner [m]."""
    along: ArrayLike = (1.0, 0.0, 0.0)
    """[3] unit vector along a rope, or a cloth's first side."""
    across: ArrayLike = (0.0, 1.0, 0.0)
    """[3] unit vector along a cloth's second side; any at right angles to a rope."""
    bow: float = 0.0
    """How far a rope is bowed at first, towards `across` [m]: none hangs perfectly straight, and
    what is unstable shows only so."""
    stand: float = 0.0
    """How much of a rope's first end a stand holds fast [m]; 0: it is free."""
    grip: float
    """Radius of what the tool holds, about the tool point when it closes [m]."""
    table: float | None = None
    """Height of the table [m]; None: the object stays away from it."""
    self_contact: bool = False
    """Whether the object meets itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """What a world observed of one object; T is the number of times.

    Positions of a rope run along its centre line from its first end to its last; [:, -1] is its
    tip. Of a cloth they are a lattice, row by row. Of W objects at once, all but the times has
    another axis in front, [W, ...].
    """

    times: Array
    """[T] [s], on the clock of the task's path."""
    points: Array
    """[T, V, 3] [m]; only the tip (V = 1) of tasks that watch no more."""
    hand: Array
    """[T, 3] the tool point [m]."""
    opens: Any
    """When the hand opens [s]; infinite: never."""
    lattice: tuple[int, int] = (0, 0)
    """Rows and points in a row of a cloth."""

    @property
    def tip(self) -> Array:
        """[T, 3] a rope's free end [m]."""
        return self.points[..., -1, :]

    def __getitem__(self, w: Any) -> Observed:
        """Of some objects, or with None: of one as of several."""
        of = {n: np.asarray(getattr(self, n))[w] for n in ("points", "hand", "opens")}
        return replace(self, **of)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """The outcome of one action."""

    values: dict[str, float]
    """As `Task.outcome` gives them; empty where it failed."""
    fault: str | None = None
    """What went wrong; None: nothing."""
    seen: Observed | None = None
    """What it was judged by, if asked for."""
    tries: int = 1
    """How many there were, see `Task.tries`."""


def numbers_of(outcomes: Sequence[Outcome], quantities: Sequence[Quantity]) -> Array:
    """[W, Q] what came out, in SI units; NaN where it failed."""
    rows = [[o.values.get(q.name, math.nan) for q in quantities] for o in outcomes]
    return np.array(rows, dtype=float).reshape(len(outcomes), len(quantities))


class World(Protocol):
    """Where tasks are carried out."""

    def carry_out(
        self,
        task: Task,
        items: Sequence[Item],
        actions: ArrayLike,
        *,
        keep: bool = False,
        on_frame: Callable[[int], None] | None = None,
    ) -> list[Outcome]:
        """Carry out W actions with W objects. One that fails is recorded as such, others go on.

        Args:
            task: What is done.
            items: W objects.
            actions: [W, A], each within its limits.
            keep: Whether outcomes keep what was seen.
            on_frame: Called now and then; what it raises ends everything.

        Raises:
            ParameterError: An action is out of its limits, or numbers do not agree.
        """
        ...

    def on(self, device: str) -> World:
        """The same on another device.

        Raises:
            DeviceError: There is none for this world.
        """
        ...

    def settings(self) -> dict[str, Any]:
        """What outcomes depend on beyond rounding, ready for JSON."""
        ...


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """One task, with the objects that its demonstrations are drawn from.

    Raises:
        ParameterError: A range is no range, or of no parameter.
    """

    name: ClassVar[str]
    """As on the command line."""
    kind: ClassVar[str]
    """Of its objects: ``rope`` or ``cloth``."""
    actions: ClassVar[tuple[Quantity, ...]]
    """Numbers of an action."""
    goals: ClassVar[tuple[Quantity, ...]]
    """Numbers of a goal; none where a task always wants the same."""
    outcomes: ClassVar[tuple[Quantity, ...]] = ()
    """Further numbers of an outcome, beside those of the goal."""
    risk: ClassVar[Quantity | None] = None
    """What actions are to avoid: the first of `outcomes` with a limit."""
    watches: ClassVar[str] = "tip"
    """What it observes: ``tip`` or ``all`` points."""
    candidates: ClassVar[tuple[tuple[float, ...], ...]] = ()
    """[K][A] actions among which policies of a task without goals choose, those to be preferred
    first [units of similarity]; demonstrations are drawn from them."""
    tries: ClassVar[int] = 1
    """At the most, until the outcome is within the risk; after the first by `next_path`."""
    cost: ClassVar[float] = 1.0
    """About how long a demonstration takes, in those of rope reaching: long ones are written to a
    data set in smaller parts."""

    item: Item = ROPE
    """The object that demonstrations are simulated with; its parameters are drawn."""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest parameter of drawn objects, by names of `DRAWN` and in SI units; those
    that are not named stay as they are in `item`. E / density is that of an object as thick as
    `item`: one of another ``thickness_ratio`` has its bending length."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # what is said of one object anew holds for many, too
        for one, many in _MANY.items():
            if one in vars(cls) and many not in vars(cls):
                setattr(cls, many, getattr(Task, many))
        cls.risk = next((q for q in cls.outcomes if q.limit < math.inf), None)

    def __post_init__(self) -> None:
        kind = self.item.kind
        require(kind == self.kind, f"{self.name} takes a {self.kind}, not a {kind}")
        for name, (low, high) in self.ranges.items():
            check_choice("parameter", name, DRAWN, where=f"ranges of {self.name}")
            what, where = f"is {low} to {high}", f"range of {name}"
            ordered = math.isfinite(low) and math.isfinite(high) and low <= high
            require(ordered, what, where=where, fix="give two finite numbers, the lower one first")
            positive = low > 0.0 or (low == 0.0 and (high == 0.0 or not DRAWN[name].log))
            require(positive, what, where=where, fix="give positive numbers, the smaller one first")
            try:
                ends = self._columns_with({name: np.array([low, high])}, 2)
                items_from_columns(self.kind, ends, like=self.item)
            except ParameterError as error:
                raise ParameterError(error.what, where=where, fix=error.fix) from None

    # ---- what a task's file says -----------------------------------------------------------------

    @abstractmethod
    def limits(self, item: Item) -> Array:
        """[A, 2] lowest and highest value of each number of an action."""

    @abstractmethod
    def scene(self, item: Item) -> Scene:
        """Where the object is at first, and how it is held."""

    @abstractmethod
    def tool_path(self, item: Item, action: Array) -> TcpPath:
        """Where the tool goes, and when it closes and opens; the object is at rest until it moves.

        Args:
            item: The object.
            action: [A], within the limits.
        """

    @abstractmethod
    def times(self, item: Item) -> Array:
        """[T] when to look [s], the same for all actions."""

    @abstractmethod
    def outcome(self, item: Item, seen: Observed) -> dict[str, float]:
        """The outcome: all goals by name, and further figures, in SI units."""

    @abstractmethod
    def T_world_task(self, item: Item) -> Array:
        """[4, 4] the task's frame in that of a robot's base [m]."""

    def margin(self, item: Item, action: Array) -> float:
        """How far an action is within what limits alone do not say [units of similarity]; below
        0: it is not allowed."""
        return math.inf

    # the same of W objects, of one size, which a task may say faster

    def limits_of(self, items: Sequence[Item]) -> Array:
        """[W, A, 2] limits; objects may be of several sizes."""
        return np.array([self.limits(item) for item in items])

    def margins(self, items: Sequence[Item], actions: Array) -> Array:
        """[W] margins of actions [W, A]; objects may be of several sizes."""
        if type(self).margin is Task.margin:
            return np.full(len(items), math.inf)
        return np.array([self.margin(i, a) for i, a in zip(items, actions, strict=True)])

    def tool_paths(self, items: Sequence[Item], actions: Array) -> TcpPaths:
        """Paths of W actions [W, A]."""
        return TcpPaths([self.tool_path(i, a) for i, a in zip(items, actions, strict=True)])

    def outcomes_of(self, items: Sequence[Item], seen: Observed) -> dict[str, Array]:
        """[W] outcomes by name."""
        rows = [self.outcome(item, seen[w]) for w, item in enumerate(items)]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def next_path(self, item: Item, x: Array, hand: Array) -> TcpPath:
        """Where the tool goes in a further try, which ends when an action's does; by points [n, 3]
        as they are seen from above, and the hand [3] where it let go [m]."""
        raise ParameterError(f"{self.name} is tried once")

    def error(self, item: Item, goal: Array, values: Mapping[str, float]) -> float:
        """How far from a goal [G] an outcome is, in the goals' unit."""
        return float(np.linalg.norm(goal - np.array([values[q.name] for q in self.goals])))

    def within_risk(self, item: Item, values: Mapping[str, float]) -> bool:
        """Whether an outcome can be relied on."""
        risk = self.risk
        return risk is None or values[risk.name] <= risk.limit * unit_of(risk.unit, item)

    # ---- actions ---------------------------------------------------------------------------------

    @classmethod
    def action_units(cls, item: Item) -> Array:
        """[A] units of similarity of an action in SI."""
        units = {unit: unit_of(unit, item) for unit in {q.unit for q in cls.actions}}
        return np.array([units[q.unit] for q in cls.actions])

    @classmethod
    def goal_units(cls, item: Item) -> Array:
        """[G] units of similarity of a goal in SI."""
        return np.array([unit_of(q.unit, item) for q in cls.goals])

    def allows(self, item: Item, action: ArrayLike, *, slack: float = SLACK) -> bool:
        """Whether an action [A] is within all limits."""
        a, units = np.asarray(action, dtype=float), self.action_units(item)
        low, high = self.limits(item).T
        within = np.all((a >= low - slack * units) & (a <= high + slack * units))
        return bool(within) and self.margin(item, a) >= -slack

    def check_action(self, item: Item, action: ArrayLike) -> Array:
        """The action [A], if the task allows it.

        Raises:
            ParameterError: If it does not, with the limits.
        """
        names = [q.name for q in self.actions]
        a = np.atleast_1d(np.asarray(action, dtype=float))
        fits = a.shape == (len(names),) and np.isfinite(a).all()
        fix = f"give {len(names)} finite number{'s' * (len(names) > 1)}: {', '.join(names)}"
        require(fits, f"is {a.tolist()}", where="action", fix=fix)
        if not self.allows(item, a):
            limits = [
                f"{q.name} in [{low:.4g}, {high:.4g}]{'' if q.unit == '1' else ' ' + q.unit}"
                for q, (low, high) in zip(self.actions, self.limits(item), strict=True)
            ]
            note = self.limits_note(item)
            given = ", ".join(f"{n} {v:.4g}" for n, v in zip(names, a, strict=True))
            fix = f"choose {' and '.join(limits)}{', ' + note if note else ''}"
            raise ParameterError(f"{given} is out of limits", where="action", fix=fix)
        return a

    def limits_note(self, item: Item) -> str:
        """What `margin` asks for, in words."""
        return ""

    def nearest(self, item: Item, action: ArrayLike, middle: ArrayLike | None = None) -> Array:
        """An allowed action [A] near to another: clipped to the limits, and from there moved no
        farther than needed towards `middle` [A] (default: that of the limits)."""
        low, high = self.limits(item).T
        centre = 0.5 * (low + high) if middle is None else np.asarray(middle, dtype=float)
        a = np.clip(np.asarray(action, dtype=float), low, high)
        if self.allows(item, a):
            return a
        kept, refused = 0.0, 1.0  # shares of the way from the middle
        for _ in range(_HALVINGS):
            share = 0.5 * (kept + refused)
            if self.allows(item, centre + share * (a - centre)):
                kept = share
            else:
                refused = share
        return centre + kept * (a - centre)

    def sample_actions(self, item: Item, rng: np.random.Generator, count: int) -> Array:
        """[count, A] actions drawn uniformly from all that are allowed.

        Raises:
            ParameterError: None is found.
        """
        return np.concatenate([self.draw_actions([item], [rng]) for _ in range(count)])

    def draw_actions(self, items: Sequence[Item], rngs: Sequence[np.random.Generator]) -> Array:
        """[W, A] one action for each of W objects, each from its own generator: drawn uniformly
        from `candidates`, or where a task has none from all that are allowed.

        Raises:
            ParameterError: None is found.
        """
        if self.candidates:
            known, units = np.array(self.candidates), map(self.action_units, items)
            one = [known[rng.integers(len(known))] for rng in rngs]
            return np.array([a * u for a, u in zip(one, units, strict=True)])
        items, limits = Items.of(items), self.limits_of(items)
        (low, high), left = np.moveaxis(limits, 2, 0), np.arange(len(items))
        drawn = np.empty_like(low)
        for _ in range(DRAWS):
            share = uniform(rngs, low.shape[1], left)
            drawn[left] = low[left] + (high - low)[left] * share
            left = left[self.margins(items.some(left), drawn[left]) < 0.0]
            if not len(left):
                return drawn
        raise ParameterError(f"no action of {self.name} is allowed for this {self.kind}")

    # ---- demonstrations --------------------------------------------------------------------------

    def draw_items(self, rngs: Sequence[np.random.Generator]) -> Items:
        """W objects, each with parameters drawn from `ranges` by its own generator: log-uniformly
        where ratios count."""
        return items_from_columns(self.kind, self.draw_columns(rngs), like=self.item)

    def draw_columns(self, rngs: Sequence[np.random.Generator]) -> dict[str, Array]:
        """The same as columns [W], see `gendom.materials.to_columns`."""
        # in their own order, so that draws do not depend on the mapping's
        names = [name for name in DRAWN if name in self.ranges]
        shares = uniform(rngs, len(names))
        drawn = {}
        for name, share in zip(names, shares.T, strict=True):
            low, high = self.ranges[name]
            log = DRAWN[name].log and low > 0.0
            if log:
                low, high = math.log(low), math.log(high)
            numbers = low + (high - low) * share
            # NumPy's differs between processors
            drawn[name] = np.array([math.exp(x) for x in numbers.tolist()]) if log else numbers
        return self._columns_with(drawn, len(rngs))

    def of_one_size(self) -> Self:
        """The same task, all of whose drawn objects are as thick as its own."""
        ranges = {name: ends for name, ends in self.ranges.items() if name in QUANTITIES}
        return replace(self, ranges=ranges)

    def _columns_with(self, drawn: Mapping[str, Array], count: int) -> dict[str, Array]:
        """Columns [count] of the task's object with other parameters, as named in `ranges`."""
        item, own = self.item, to_columns(self.item)
        of = {name: drawn.get(name, np.full(count, value)) for name, value in own.items()}
        of["E"] = of["E_over_rho"] * of["density"]
        if (ratio := drawn.get("thickness_ratio")) is not None and ratio.all():
            steps = [round(THICKNESSES * math.log10(x)) for x in ratio.tolist()]
            thick = size_of(item) * np.array([10.0 ** (k / THICKNESSES) for k in steps])
            # of the same bending length
            of["E"] = of["E"] * (thickness_of(item) / thick) ** 2
            of[item.sizes[1]] = thick
        return of | {"E_over_rho": of["E"] / of["density"]}

    # ---- settings --------------------------------------------------------------------------------

    def settings(self) -> dict[str, Any]:
        """What rebuilds this task, ready for JSON; see `from_settings`."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        own = {n: list(v) if isinstance(v, tuple) else v for n, v in own.items()}
        own["item"] = to_columns(self.item)
        own["ranges"] = {name: list(ends) for name, ends in self.ranges.items()}
        return own

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Self:
        """The task of `settings`.

        Raises:
            KeyError, TypeError, ParameterError: They are not those of this task.
        """
        types = get_type_hints(cls) | {"item": dict[str, float]}
        given: dict[str, Any] = {
            name: record_of(types[name], with_current_names(value, kind), where=f"task.{name}",
                            fix="make it again", error=ParameterError)
            for name, value in settings.items()
            for kind in ("range" if name == "ranges" else "quantity",)
        }  # fmt: skip
        given["item"] = from_columns(cls.kind, given["item"])
        return cls(**given)
