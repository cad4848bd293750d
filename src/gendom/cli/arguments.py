"""Arguments and progress bars that several commands share."""

from __future__ import annotations

from typing import Annotated, Any

import tyro

TASKS_HELP = "rope-reaching|rope-casting|rope-casting-at-speed|cloth-spreading|FILE.py"


def _known(words: list[str]) -> str:
    from gendom.errors import GendomError
    from gendom.tasks import find_task

    try:
        return find_task(words[0]).name
    except GendomError as error:
        raise ValueError(f"{error.what}; {error.fix}") from None


TaskName = Annotated[
    str,
    tyro.constructors.PrimitiveConstructorSpec[Any](
        nargs=1,
        metavar=TASKS_HELP,
        instance_from_str=_known,
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda value: [value],
    ),
]
"""The name of a task, those of other packages included, or a Python file that defines one."""

PERCENT_BAR = "{l_bar}{bar}| {elapsed}, {remaining} left"
"""Format of a `tqdm` bar that counts percent: a rate would be percent a second."""
