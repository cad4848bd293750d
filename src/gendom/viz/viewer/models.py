"""Recordings and demonstrations for the viewer: shown, and simulated with any parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gendom.datasets import Recording
from gendom.errors import DatasetError, SimulationError
from gendom.estimation import UNKNOWNS, LiftScene, Theta, chamfers, replay
from gendom.estimation.replayed import of_all_frames
from gendom.materials import PARAMETERS, Item, from_columns, size_of, to_columns
from gendom.reading import record_of
from gendom.tasks import Observed, Task, rebuild
from gendom.tasks.world import Simulation
from gendom.viz.animation import Animation, Layer
from gendom.viz.layers import goal_layer, gripper_layer, lift_animation, observed_layer
from gendom.viz.quantities import length_text, quantity_text
from gendom.viz.viewer.sliders import ACTION, MATERIAL, SETUP, SliderParameter, ViewerModel

FRAMES = 160
"""Most frames shown of a demonstration."""


class RecordingModel(ViewerModel):
    """A recording that is replayed with the parameters of sliders.

    Args:
        scene: What was recorded, with all frames that are shown.
        theta: Parameters at first.
        title: One line.
    """

    cases = ("recording", 1)

    def __init__(self, scene: LiftScene, theta: Theta, title: str):
        self.scene, self.theta, self.title = scene, theta, title
        self.notes = scene.notes
        self.initial = lift_animation(scene)
        self._parameters = _parameters(scene, theta)

    @classmethod
    def of(cls, recording: Recording, title: str) -> RecordingModel:
        """With the middle of the priors of an unknown object's parameters.

        Raises:
            RecordingError: The recording shows too little to place the object.
        """
        scene = LiftScene.of(recording)
        theta = scene.prior()[1].with_values(scene.guesses[len(scene.guesses) // 2])
        return cls(of_all_frames(scene, recording), theta, title)

    def parameters(self, case: int) -> tuple[SliderParameter, ...]:
        """The object's parameters, and those of how it is held."""
        return self._parameters

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[Animation]:
        """The simulated object, then with its distance from the clouds."""
        scene, theta = self.scene, self.theta.with_values(values)
        x = replay(scene, [theta], on_frame=lambda _: go_on())[:, 0]
        facts = _facts(scene, theta)
        yield lift_animation(scene, x, theta, facts=facts)
        distance = "Chamfer", chamfers(scene, x, theta)[0]
        yield lift_animation(scene, x, theta, facts=facts, distance=distance)


def _parameters(scene: LiftScene, theta: Theta) -> tuple[SliderParameter, ...]:
    """Unknowns of the object, those that are searched, and those that have other values than usual,
    within the ranges that are searched."""
    searched = scene.prior()[0].names
    names = [
        u.name
        for u in UNKNOWNS.values()
        if scene.kind in u.kinds and (u.material or u.name in searched or theta[u.name] != u.usual)
    ]
    if scene.recording.table_height is None:
        names.remove("friction")
    prior = scene.prior(tuple(names))[0]
    ranges = zip(prior.unknowns, prior.low, prior.high, strict=True)
    return tuple(
        SliderParameter(
            name=u.name,
            label=u.symbol,
            unit=u.unit,
            meaning=u.meaning,
            group=MATERIAL if u.material else SETUP,
            ends=(u.value(low), u.value(high)),
            value=theta[u.name],
            log=u.log,
        )
        for u, low, high in ranges
    )


def _facts(scene: LiftScene, theta: Theta) -> tuple[tuple[str, str], ...]:
    modulus = theta.E_over_rho
    bending = scene.bending_length(modulus, theta.thickness)
    facts = [("bending length", length_text(bending))]
    if scene.recording.object.mass is not None:
        facts.insert(0, ("E", quantity_text("E", modulus * scene.density_of(theta))))
    return tuple(facts)


class DatasetModel(ViewerModel):
    """Demonstrations of a set, one at a time, with other actions and parameters on request.

    Args:
        folder: Written by ``gendom dataset``; it need not be finished.

    Raises:
        DatasetError: There is none, or it comes from a world that is not our simulator.
        ParameterError: Its task is unknown here.
    """

    def __init__(self, folder: Path):
        from gendom.datasets.demonstrations import load, read_description

        about = read_description(folder)
        made = about.get("simulation")
        if isinstance(made, dict) and made.get("world") is not None:
            raise DatasetError(
                "was not made by the simulator, which alone can be viewed",
                where=str(folder),
                fix="give a set that gendom dataset made without --world reality",
            )
        where, fix = f"{folder}: simulation", "make the set again with gendom dataset"
        world = record_of(Simulation, made, where=where, fix=fix, error=DatasetError)
        self._world = replace(world, everything=True)
        self.task: Task = rebuild(about["task"])
        self._rows = load(folder, part=True).to_pylist()
        self.title = f"{folder.name or folder}: {self.task.name}"
        self.cases = ("demonstration", len(self._rows))

    def parameters(self, case: int) -> tuple[SliderParameter, ...]:
        """The action within its limits, and the object's parameters within those drawn."""
        row, ranges = self._rows[case], self.task.ranges
        actions = zip(self.task.actions, self.task.limits(self._item(case)), strict=True)
        made = [
            SliderParameter(
                name=q.name,
                label=q.name.replace("_", " "),
                unit=q.unit,
                meaning=q.meaning or "a number of the action",
                group=ACTION,
                ends=(float(low), float(high)),
                value=float(row[q.name]),
            )
            for q, (low, high) in actions
        ]
        made += [
            SliderParameter(
                name=p.column,
                label="E / density" if p.column == "E_over_rho" else p.name,
                unit=p.unit,
                meaning=p.column.replace("_", " "),
                group=MATERIAL,
                ends=ranges[p.column],
                value=float(row[p.column]),
                log=p.log,
            )
            for p in PARAMETERS.values()
            if p.column in ranges
        ]
        return tuple(made)

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[Animation]:
        """The object under that action."""
        task, item = self.task, self._item(case, values)
        asked = np.array([values[q.name] for q in task.actions])
        action = task.nearest(item, asked)
        (outcome,) = self._world.carry_out(
            task, [item], [action], keep=True, on_frame=lambda _: go_on()
        )
        if outcome.fault is not None or outcome.seen is None:
            raise SimulationError(
                f"this object cannot be simulated with this action ({outcome.fault})",
                fix="move a slider back",
            )
        seen = outcome.seen
        k = np.unique(seen.times, return_index=True)[1]  # some are there twice
        k = k[np.linspace(0, len(k) - 1, min(len(k), FRAMES)).round().astype(int)]
        seen = replace(seen, times=seen.times[k], points=seen.points[k], hand=seen.hand[k])
        facts = self._facts(case, item, outcome.values)
        if not np.allclose(action, asked):
            numbers = ", ".join(f"{a:.4g}" for a in action)
            facts.append(("action", f"{numbers}: the nearest that is allowed"))
        yield Animation(
            times=seen.times - seen.times[0],
            layers=self._layers(case, item, seen),
            table_height=task.scene(item).table,
            facts=tuple(facts),
        )

    def _item(self, case: int, values: Mapping[str, float] | None = None) -> Item:
        """A demonstration's object, with other parameters."""
        columns = {**self._rows[case], **(values or {})}
        columns["E"] = columns["E_over_rho"] * columns["density"]
        names = to_columns(self.task.item)
        return from_columns(self.task.kind, {name: float(columns[name]) for name in names})

    def _goal(self, case: int) -> NDArray[np.float64] | None:
        """[G] what that demonstration reached; None: it failed, or there are no goals."""
        from gendom.datasets.demonstrations import GOAL

        values = [self._rows[case].get(GOAL + q.name) for q in self.task.goals]
        return None if not values or None in values else np.array(values, dtype=float)

    def _facts(self, case: int, item: Item, values: Mapping[str, float]) -> list[tuple[str, str]]:
        units = {q.name: "" if q.unit == "1" else f" {q.unit}" for q in self.task.goals}
        facts = [("E", quantity_text("E", item.material.E))]
        facts += [(n.replace("_", " "), f"{v:.4g}{units.get(n, '')}") for n, v in values.items()]
        if (goal := self._goal(case)) is not None:
            numbers = ", ".join(f"{g:.4g}" for g in goal)
            off, unit = self.task.error(item, goal, values), self.task.goals[0].unit
            facts.append(("goal", f"{numbers} {unit}, missed by {off:.3g} {unit}"))
        return facts

    def _layers(self, case: int, item: Item, seen: Observed) -> tuple[Layer, ...]:
        layers: list[Layer] = [
            observed_layer("object", item, seen),
            gripper_layer(seen.hand[:, None], size_of(item)),
        ]
        goal = self._goal(case)
        if goal is not None:
            layers.append(goal_layer(goal, seen, item))
        return tuple(layers)
