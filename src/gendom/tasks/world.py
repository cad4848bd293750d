"""Our simulator as a world that carries out tasks; another is `gendom.reality.RealWorld`."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.arrays import Array, distinct, of_each
from gendom.materials import AIR_DENSITY, Item, Items, Rope
from gendom.materials.parameters import unchecked
from gendom.robot.path import GripperEvent, TcpPaths
from gendom.sim import Body, Gripper, Grippers, Physics, Solver, Table, Variation, cloth, rope
from gendom.sim.bodies import CELLS_ACROSS
from gendom.tasks.task import Observed, Outcome, Scene, Task

if TYPE_CHECKING:
    from gendom.sim import Simulator

_log = logging.getLogger(__name__)

EARLIER_FRAMES = 100
"""Times, before those of the task, at which everything is looked at."""

BATCH = 8192
"""Objects simulated at once at the most."""

MANY = 12
"""Ropes from which on it pays to interleave them in the lanes of a CPU."""

POINTS = 25
"""Of a rod's centre line, however thin: twice as many move what is reached by 0.001 lengths, and
take four times as long."""


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """Our simulator, all objects of one size side by side."""

    engine: str = "thin"
    """``thin``: ropes as rods, cloths as shells; ``mpm``: particles on a grid."""
    device: str = "cpu"
    """``cpu``, ``cuda`` or ``cuda:0`` and so on."""
    dtype: str | None = None
    """``float32`` or ``float64``; by default the engine's."""
    threads: int | None = None
    """Objects simulated side by side on the CPU (default: one a core)."""
    cells_across: float = 1.5
    """Grid cells across a rope's diameter, or in a fifteenth of a cloth's side; of the MPM."""
    air_density: float = AIR_DENSITY
    """[kg/m^3]."""
    interleaved: bool | None = None
    """As of `Solver`. None: of `MANY` objects and more. Data sets, which are simulated in parts,
    always are: an object's rounding does not depend on those beside it."""
    everything: bool = False
    """Whether to look at all points from when the tool moves, not only at what a task watches."""

    def __post_init__(self) -> None:
        low, high = CELLS_ACROSS
        what = f"cells_across must lie between {low:g} and {high:g}, got {self.cells_across:g}"
        require(low <= self.cells_across <= high, what)

    def carry_out(
        self,
        task: Task,
        items: Sequence[Item],
        actions: ArrayLike,
        *,
        keep: bool = False,
        on_frame: Callable[[int], None] | None = None,
    ) -> list[Outcome]:
        """As `World.carry_out`.

        Raises:
            DeviceError: The device is not there.
        """
        wanted = check_actions(task, items, actions)
        found: list[Outcome] = [Outcome(values={}, fault="not simulated")] * len(items)
        if not found:
            return found
        items = Items.of(items)
        groups, tries = self._groups(task, items), task.tries if self.engine == "thin" else 1
        if self.engine == "mpm" and any(task.scene(items[g[0]]).self_contact for g in groups):
            what = "layers of cloth that touch stick to each other in the MPM; engine 'thin' keeps"
            _log.warning("%s: %s them apart", task.name, what)
        parts = [some for g in groups for some in np.split(g, range(BATCH, len(g), BATCH))]
        while parts:
            some = parts.pop(0)
            try:
                made = self._side_by_side(
                    task, items.some(some), wanted[some], keep, on_frame, tries
                )
            except RuntimeError as error:  # Warp's own
                if "allocate" not in str(error) or len(some) == 1:
                    raise
                what = f"{self.device} has no memory for {len(some)} objects at once"
                _log.warning("%s; simulating smaller batches", what)
                parts[:0] = np.split(some, [len(some) // 2])
                continue
            for w, outcome in zip(some, made, strict=True):
                found[w] = outcome
        return found

    def on(self, device: str) -> Simulation:
        """As `World.on`."""
        return replace(self, device=device)

    def settings(self) -> dict[str, Any]:
        """As `World.settings`."""
        names = ("engine", "dtype", "cells_across", "air_density")
        return {name: getattr(self, name) for name in names}

    def simulator(
        self, task: Task, items: Sequence[Item], paths: TcpPaths, begin: float
    ) -> tuple[Simulator, Body]:
        """W objects of one size, held by tools on W paths, at rest at the time `begin` [s]; and
        their body.

        Raises:
            ParameterError: Tools do not close equally often.
        """
        from gendom.sim import Simulator  # Warp, which takes long to import

        scene = task.scene(items[0])
        body, x = self.body(task, items[0])
        items = Items.of(items)
        friction, thick = (items.columns[name] for name in ("friction", items[0].sizes[1]))
        simulator = Simulator(
            body,
            items.materials,
            grippers=grippers(scene, paths, begin),
            table=None if scene.table is None else Table(height=scene.table, friction=friction),
            positions=x,
            start_time=begin,
            variation=Variation(diameter=thick if thick.min() < thick.max() else None),
            physics=Physics(
                air_density=self.air_density,
                self_contact=scene.self_contact and self.engine == "thin",
                self_friction=friction,
            ),
            solver=Solver(
                engine=self.engine,
                dtype=self.dtype,
                device=self.device,
                threads=self.threads,
                interleaved=len(items) >= MANY if self.interleaved is None else self.interleaved,
            ),
        )
        return simulator, body

    def body(self, task: Task, item: Item) -> tuple[Body, Array]:
        """An object and where its particles or points [N, 3] are at first [m]."""
        scene = task.scene(item)
        along, across = (np.asarray(a, dtype=float) for a in (scene.along, scene.across))
        origin = np.asarray(scene.origin, dtype=float)
        if isinstance(item, Rope):
            body = rope(
                diameter=item.diameter, length=item.length, start=origin, direction=along,
                cells_across=self.cells_across, points=POINTS,
            )  # fmt: skip
            x = body.points if self.engine == "thin" else body.x
            # elementwise: a matrix product may round differently from call to call, and an
            # unstable rope shows it
            s = np.sum((x - origin) * along, axis=1) / item.length
            return body, x + scene.bow * (np.sin(np.pi * s) ** 2)[:, None] * across
        dx = item.side / (15.0 * self.cells_across)
        body = cloth(width=item.side, height=item.side, thickness=item.thickness, dx=dx)
        x = body.points if self.engine == "thin" else body.x
        axes = (along, across, np.cross(along, across))
        return body, origin + sum(x[:, k, None] * axis for k, axis in enumerate(axes))

    def _groups(self, task: Task, items: Items) -> list[NDArray[np.intp]]:
        """Indices of objects that can be simulated side by side: of one size, and of one thickness
        unless they are rods that meet nothing. Those of like stiffness stand beside each other: a
        batch takes as long as its stiffest."""
        scene, of = task.scene(items[0]), items.columns
        meets = scene.table is not None or scene.self_contact
        alone = self.engine == "thin" and task.kind == "rope" and not meets
        size, thick = (of[name] for name in items[0].sizes)
        keys = np.stack([size, thick * (not alone)], axis=1)
        stiff = of["E"] / of["density"]
        ways, which = distinct(keys)
        groups = [np.flatnonzero(which == way) for way in range(len(ways))]
        return [group[np.argsort(-stiff[group], kind="stable")] for group in groups]

    def _side_by_side(
        self,
        task: Task,
        items: Items,
        actions: Array,
        keep: bool,
        on_frame: Callable[[int], None] | None,
        tries: int,
        lying: Sequence[Observed] = (),
    ) -> list[Outcome]:
        """Simulate objects of one size, up to some tries, the first as they were seen last."""
        paths = task.tool_paths(items, actions)
        if lying:
            ends = zip(items, lying, strict=True)
            paths = TcpPaths([task.next_path(i, s.points[-1], s.hand[-1]) for i, s in ends])
        begin, times = float(paths.moves.min()), task.times(items[0])
        if self.everything:
            before = np.linspace(begin, times[0], EARLIER_FRAMES, endpoint=False)
            times = np.concatenate([before, times])
        simulator, body = self.simulator(task, items, paths, begin)
        if lying:
            simulator.set_positions([seen.points[-1] for seen in lying])
        all_points = self.everything or task.watches == "all"
        if self.engine == "thin":
            tip = np.array([len(body.points) - 1])
        else:  # the last section
            along = body.material_coordinates[:, 0]
            tip = np.flatnonzero(along == along.max())
        seen = None if all_points else tip
        recorded = simulator.run(times, on_frame=on_frame, particles=seen, keep_going=True)
        hands, opens = paths.position_at(times), of_each(paths.events, opening)
        keep = keep or tries > 1
        found = judged(task, items, simulator, body, times, recorded, hands, opens, keep=keep)
        left = {w: o.seen for w, o in enumerate(found)
                if tries > 1 and o.seen and not task.within_risk(items[w], o.values)}  # fmt: skip
        if left:
            which, lying = np.array(list(left)), list(left.values())
            more = self._side_by_side(
                task, items.some(which), actions[which], keep, on_frame, tries - 1, lying
            )
            for w, outcome in zip(left, more, strict=True):
                found[w] = replace(outcome, tries=outcome.tries + 1)
        return found


def judged(
    task: Task,
    items: Sequence[Item],
    simulator: Simulator,
    body: Body,
    times: Array,
    x: Array,
    hands: Array,
    opens: Array,
    *,
    keep: bool = False,
) -> list[Outcome]:
    """Outcomes of W objects whose points were at x [T, W, N, 3] at `times` [T], and the tools at
    `hands` [W, T, 3] [m]; these opened at `opens` [W] [s]."""
    lattice = _lattice(body, simulator.num_points) if task.kind == "cloth" else (0, 0)
    points = middle_of(body, np.ascontiguousarray(np.swapaxes(x, 0, 1), dtype=float))
    seen = Observed(times=times, points=points, hand=hands, opens=opens, lattice=lattice)
    whole = np.setdiff1d(np.arange(len(items)), list(simulator.failures))
    some, own = seen, Items.of(items)
    if len(whole) < len(items):
        some, own = seen[whole], own.some(whole)
    found = task.outcomes_of(own, some) if len(whole) else {}
    rows = zip(*(values.tolist() for values in found.values()), strict=True)
    outcomes = [Outcome(values={})] * len(items)
    for w, row in zip(whole, rows, strict=True):
        values = dict(zip(found, row, strict=True))
        own = {"values": values, "fault": None, "seen": seen[w] if keep else None}
        outcomes[w] = unchecked(Outcome, own)
    for w, error in simulator.failures.items():
        when = "" if error.time is None else f" at {error.time:.4f} s"
        outcomes[w] = Outcome(values={}, fault=error.what + when)
    return outcomes


def check_actions(task: Task, items: Sequence[Item], actions: ArrayLike) -> Array:
    """[W, A] actions, each within the limits for its object.

    Raises:
        ParameterError: One is not, or there are more or fewer than objects.
    """
    wanted = np.asarray(actions, dtype=float).reshape(-1, len(task.actions))
    what, fits = f"are of shape {np.shape(actions)} for {len(items)} objects", len(wanted)
    require(fits == len(items), what, where="actions", fix="give one for each object")
    if len(items):
        low, high = np.moveaxis(task.limits_of(items), 2, 0)
        within = np.all((wanted >= low) & (wanted <= high), axis=1)
        for w in np.flatnonzero(~(within & (task.margins(items, wanted) >= 0.0))).tolist():
            task.check_action(items[w], wanted[w])
    return wanted


def opening(events: Sequence[GripperEvent]) -> float:
    """When the hand opens [s]; infinite: never."""
    return next((e.time for e in events if not e.closed), math.inf)


def grippers(scene: Scene, paths: TcpPaths, begin: float) -> Grippers:
    """The stand, if there is one, and the tool, in W worlds that begin at `begin` [s]; what closed
    before holds from there.

    Raises:
        ParameterError: Tools do not close equally often.
    """
    often = set(of_each(paths.events, lambda events: sum(e.closed for e in events)).tolist())
    require(len(often) == 1, f"the tool must close equally often in all worlds, got {often}")
    time, position, _ = paths.sampled()
    W, K = time.shape
    holds = of_each(paths.events, lambda events: _holds(events, begin)).reshape(W, -1, 2)
    hold_from, hold_until = np.moveaxis(holds, 2, 0)
    tools = hold_from.shape[1]
    arrays = {
        "time": np.repeat(time[:, None], tools, axis=1),
        "position": np.repeat(position[:, None], tools, axis=1),
        "hold_from": hold_from,
        "hold_until": hold_until,
        "radius": np.full((W, tools), scene.grip),
    }
    if scene.stand > 0.0:
        still = Gripper.still(np.asarray(scene.origin, dtype=float), radius=scene.stand)
        for name, values in Grippers.of([[still]], knots=K).arrays.items():
            if name in arrays:
                stand = np.repeat(values, W, axis=0)
                arrays[name] = np.concatenate([stand, arrays[name]], axis=1)
    return Grippers(arrays)


def _holds(events: tuple[GripperEvent, ...], begin: float) -> list[tuple[float, float]]:
    """When the tool closes and opens again, each time that it closes [s]."""
    found = []
    for event in events:
        if event.closed:
            opens = [e.time for e in events if not e.closed and e.time > event.time]
            since = -math.inf if event.time <= begin else event.time
            found.append((since, min(opens, default=math.inf)))
    return found


def middle_of(body: Body, x: Array) -> Array:
    """[..., n, 3] a rope's centre line, or a cloth's middle surface, from all positions [..., N, 3]
    of particles or points, or from a section's alone [m]."""
    if x.shape[-2] in (1, len(body.points)):
        return x
    layers = body.section if body.kind == "rope" else _count_along(body, 2)
    return x.reshape(*x.shape[:-2], -1, layers, 3).mean(axis=-2)


def _lattice(body: Body, points: int) -> tuple[int, int]:
    """Rows and points in a row of a cloth's points, or of the columns of its particles."""
    if points == len(body.points):
        return body.shape[0], body.shape[1]
    return _count_along(body, 0), _count_along(body, 1)


def _count_along(body: Body, axis: int) -> int:
    return np.unique(body.material_coordinates[:, axis]).size
