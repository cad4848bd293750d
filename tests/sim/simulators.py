"""Simulators whose settings tests vary one at a time."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from gendom.materials import Material
from gendom.sim import Body, Physics, Simulator, Solver


def flat_simulator(body: Body, materials: Sequence[Material], **options: Any) -> Simulator:
    """A simulator; options are its own and those of ``Physics`` and ``Solver``."""

    def taken(kind: type) -> dict[str, Any]:
        return {f.name: options.pop(f.name) for f in fields(kind) if f.name in options}

    physics, solver = Physics(**taken(Physics)), Solver(**taken(Solver))
    return Simulator(body, materials, physics=physics, solver=solver, **options)
