"""Tasks: one file each, and the worlds that carry them out.

Other packages add tasks by an entry point of the group ``gendom.tasks`` whose object is a class
made from `Task`.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gendom.arguments import require
from gendom.errors import ParameterError
from gendom.lazy import imported_later
from gendom.plugins import plugins
from gendom.tasks.cloth_dragging import ClothDragging
from gendom.tasks.cloth_spreading import ClothSpreading
from gendom.tasks.rope_casting import RopeCasting
from gendom.tasks.rope_reaching import RopeReaching
from gendom.tasks.task import Observed, Outcome, Quantity, Scene, Task, World

if TYPE_CHECKING:
    from gendom.tasks.cases import draw_cases
    from gendom.tasks.demonstrator import Demonstrator
    from gendom.tasks.world import Simulation

_registered: dict[str, type[Task]] = {}


def register(task: type[Task]) -> type[Task]:
    """Register a task under its name; also usable as a decorator.

    Raises:
        ParameterError: Another task has this name.
    """
    known = _registered.setdefault(task.name, task)
    if known is not task and known.__qualname__ != task.__qualname__:
        raise ParameterError(f"there is a task {task.name!r} already", where=task.__qualname__)
    _registered[task.name] = task
    return task


for _task in (RopeReaching, RopeCasting, ClothSpreading, ClothDragging):
    register(_task)


def _register_plugin(task: Any) -> None:
    what = "it is no subclass of Task"
    require(isinstance(task, type) and issubclass(task, Task), what)
    register(task)


def task_names() -> list[str]:
    """Names of all tasks, those of other packages included."""
    plugins("tasks", _register_plugin)
    return list(_registered)


def find_task(name: str) -> type[Task]:
    """The class of a registered task. Names from files of data sets and policies end here: none is
    ever a path whose code would run.

    Raises:
        ParameterError: There is none of that name.
    """
    names = task_names()
    fix = f"choose {', '.join(names)}, or give the .py file that defines it"
    require(name in names, f"there is no task {name!r}", where="task", fix=fix)
    return _registered[name]


def load_task(word: str) -> type[Task]:
    """The class of a task that a person named, or whose Python file a person gave.

    Args:
        word: A task's name, or the path of a Python file (``.py``) that defines one task. The file
            is executed, and its task is then known by its name.

    Raises:
        ParameterError: There is none of that name, or the file cannot be read or does not define
            one task.
    """
    return register(_read(Path(word))) if word.endswith(".py") else find_task(word)


def _read(path: Path) -> type[Task]:
    """The one task that a file defines."""
    require(path.is_file(), "no such file", where=str(path), fix="check the path")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where dataclasses look for their annotations
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a file of someone else raises
        what = f"cannot be imported ({type(error).__name__}: {error})"
        raise ParameterError(what, where=str(path)) from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Task) and value.__module__ == path.stem
    ]
    fix = "define one class made from Task"
    require(len(found) == 1, f"defines {len(found)} tasks", where=str(path), fix=fix)
    return found[0]


def rebuild(description: Mapping[str, Any]) -> Task:
    """The task of `name` and settings, as data sets and policies keep it.

    Raises:
        ParameterError: The task or one of its settings is unknown here.
    """
    settings = dict(description)
    name = settings.pop("name", None)
    try:
        return find_task(name).from_settings(settings)
    except (KeyError, TypeError) as error:
        said = f"{type(error).__name__} {error}"
        what = f"its task {name!r} has settings that are unknown here ({said})"
        raise ParameterError(what, fix="use this version of gendom to make it again") from error


__getattr__ = imported_later(__name__)

__all__ = [
    "ClothDragging", "ClothSpreading", "Demonstrator", "Observed", "Outcome", "Quantity",
    "RopeCasting", "RopeReaching", "Scene", "Simulation", "Task", "World", "draw_cases",
    "find_task", "load_task", "rebuild", "register", "task_names",
]  # fmt: skip
