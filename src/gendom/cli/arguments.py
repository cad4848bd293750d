"""Flags that several commands share, with their help."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from gendom.arguments import require
from gendom.progress import bar

if TYPE_CHECKING:
    from gendom.estimation import Progress
    from gendom.materials import Item
    from gendom.perception import RosSettings
    from gendom.policies import Policy
    from gendom.tasks.task import World

Json = Annotated[bool, tyro.conf.arg(help="Print JSON.")]

Device = Annotated[str, tyro.conf.arg(help="cpu, cuda or cuda:0 and so on.")]

Seed = Annotated[int, tyro.conf.arg(help="Seed of all random draws.")]

Engine = Annotated[
    Literal["thin", "mpm"],
    tyro.conf.arg(
        help="Engine of the simulator. thin: ropes as rods, cloths as shells. mpm: material "
        "points, slower."
    ),
]

Recorded = Annotated[
    tyro.conf.Positional[Path],
    tyro.conf.arg(
        metavar="RECORDING",
        help="A gendom-recording/1 file (.npz), or a folder: clouds (.ply, .pcd, .npz), "
        "gripper.csv and object.toml (docs/data.md).",
    ),
]

ObjectFile = Annotated[
    Path | None,
    tyro.conf.arg(
        help="Of a bag: what is held, a TOML file; by default object.toml in its folder."
    ),
]


def beside_bag(bag: Path, held: Path | None, settings: RosSettings) -> Path:
    """The object's file of a bag of which enough is said; ParameterError: the gripper is not."""
    fix = f"name a frame of TF, or a topic of poses: gendom doctor {bag} lists them"
    require(settings.gripper, "is missing", where="--gripper", fix=fix)
    return held or (bag if bag.is_dir() else bag.parent) / "object.toml"


def refuse_bag_flags(source: Path, settings: RosSettings, **others: Any) -> None:
    """Refuse flags of bags where the source is none."""
    given = [f"--{flag}" for flag, value in {**vars(settings), **others}.items() if value]
    what, where = f"{source} is no ROS bag", next(iter(given), None)
    require(not given, what, where=where, fix="leave it out")


def refuse_sizes(kind: str, given: Iterable[str]) -> None:
    """Refuse flags of sizes that objects of a kind do not have."""
    from gendom.materials import KINDS

    own = KINDS[kind].sizes
    others = sorted({name for of in KINDS.values() for name in of.sizes} & {*given} - {*own})
    what, fix = f"a {kind} has no {' and no '.join(others)}", f"give --{own[0]} and --{own[1]}"
    require(not others, what, where=f"--{', --'.join(others)}", fix=fix)


def policy_for(task: str, path: Path | None) -> Policy:
    """The policy in a file, by default the shipped one, for a task.

    Raises:
        GendomError: There is none, or it is for another task.
    """
    from gendom.policies import Policy

    policy = Policy.pretrained(task, parameters=True) if path is None else Policy.read(path)
    own = policy.task().name
    require(own == task, f"is for {own}", policy.where, f"use a policy for {task}, or give {own}")
    return policy


def _tasks() -> str:
    """Names of all tasks; those of other packages cost their import."""
    if not metadata.entry_points(group="gendom.tasks"):
        return "rope-reaching|rope-casting|cloth-spreading|cloth-dragging"
    from gendom.tasks import task_names

    return "|".join(task_names())


def _task(words: list[str]) -> str:
    from gendom.tasks import load_task

    return load_task(words[0]).name


TaskName = Annotated[
    tyro.conf.Positional[str],
    tyro.constructors.PrimitiveConstructorSpec[Any](
        nargs=1,
        metavar=f"{_tasks()}|FILE.py",
        instance_from_str=_task,
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda value: [value],
    ),
    tyro.conf.arg(help="The task."),
]
"""The name of a task, those of other packages included, or a Python file that defines one."""


@dataclass(frozen=True, kw_only=True)
class Where:
    """Flags that say where and with which objects something is done."""

    world: Literal["simulation", "reality"] = "simulation"
    """GenDOM's simulator, or the MuJoCo test scene (the second reality, docs/reality.md)."""
    objects: tuple[str, ...] = ()
    """Objects of the MuJoCo test scene (names or TOML files), in place of random ones."""
    jobs: int = 1
    """Processes that carry out trials in the MuJoCo test scene."""

    def world_and_items(self, simulation: World) -> tuple[World, tuple[Item, ...]]:
        """The simulation or the test scene, and the objects that are named."""
        if self.world == "simulation" and not self.objects:
            return simulation, ()
        from gendom.reality import RealWorld, find_object

        items = tuple(find_object(name) for name in self.objects)
        return RealWorld(jobs=self.jobs) if self.world == "reality" else simulation, items


@contextmanager
def iterations_shown() -> Iterator[Callable[[Progress], None]]:
    """A bar of an estimation's progress."""
    with bar("estimating", 1, "iteration") as show:

        def told(progress: Progress) -> None:
            note = f"E/rho {progress.best.E_over_rho:.3g} m^2/s^2"
            if math.isfinite(progress.rms):
                note += f", {1e3 * progress.rms:.1f} mm off"
            show(progress.iteration, progress.most, note)

        yield told
