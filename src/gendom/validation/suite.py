"""All cases, by name, and how one is run."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gendom.errors import ParameterError, SimulationError
from gendom.validation import (
    air,
    bars,
    beams,
    chain,
    consistency,
    convergence,
    damping,
    energy,
    fabrics,
    free_motion,
    friction,
    grip,
    layers,
    master_curves,
    outlines,
    plates,
    resting,
    rods,
    shells,
    stability,
    torsion,
)
from gendom.validation.check import Case, Check, Settings

CASES = {
    case.name: case
    for case in (
        Case(name="free-fall", title="a thrown block", run=free_motion.free_fall),
        Case(name="free-flight", title="a spinning block", run=free_motion.free_flight),
        Case(name="objectivity", title="a turned problem", run=free_motion.objectivity),
        Case(name="cantilever", title="a strip's small sag", run=beams.cantilever),
        Case(name="elastica", title="a strip's large sag", run=beams.elastica),
        Case(name="grip", title="a rope held by a sphere", run=grip.grip),
        Case(name="torsion", title="a twisted rope", run=torsion.torsion),
        Case(name="axial-vibration", title="a clamped bar", run=bars.axial_vibration),
        Case(name="tension", title="a bar under its own weight", run=bars.tension),
        Case(name="hanging-chain", title="a soft rope's swing", run=chain.hanging_chain),
        Case(name="ring-down", title="a rope with material damping", run=damping.ring_down),
        Case(name="damped-sag", title="a sag with and without damping", run=damping.damped_sag),
        Case(name="terminal-speed", title="falls through air", run=air.terminal_speed),
        Case(name="resting", title="what lies on the table", run=resting.resting),
        Case(name="sliding", title="a block pushed along the table", run=friction.sliding),
        Case(name="sticking", title="what lies on a slope", run=friction.sticking),
        Case(name="layers", title="sheets that slide without touching", run=layers.sliding_layers),
        Case(name="order", title="orders of convergence", run=convergence.order),
        Case(name="energy", title="energy without work", run=energy.energy),
        Case(name="batch", title="worlds together and alone", run=consistency.batch),
        Case(name="precision", title="single and double precision", run=consistency.precision),
        Case(name="stability", title="random worlds", run=stability.stability),
        *(
            Case(name=name, title=title, run=run, engine="thin")
            for name, title, run in (
                ("rod-held", "ropes in grippers", rods.held),
                ("rod-elastica", "a rope's large sag", rods.elastica),
                ("rod-ring-down", "a rope with material damping", rods.ring_down),
                ("rod-hanging", "a soft rope's swing", rods.hanging),
                ("rod-twist", "a twisted rope", rods.twist),
                ("rod-buckling", "ropes pushed and twisted", rods.buckling),
                ("rod-catenary", "a rope between two hands", rods.catenary),
                ("rod-table", "ropes on the table", rods.on_the_table),
                ("rod-free-flight", "a rope in space", rods.free_flight),
                ("rod-precision", "single and double precision", rods.precision),
                ("rod-order", "finer and finer ropes", convergence.rods_sag),
                ("rod-batch", "ropes together and alone", consistency.rods_together),
                ("rod-falls", "a rope in air", air.rope_falls),
                ("rod-swing", "a swing's energy", energy.rod_swings),
                ("rod-graded", "ropes stiffer or softer at their tip", rods.graded),
                ("rod-layers", "a doubled rope that rubs", layers.rope_on_itself),
                ("rod-cantilever", "ropes' sags over four decades", master_curves.rods_sag),
                ("rod-bend-twist", "curls that leave their plane", master_curves.curls_leave_plane),
                ("rod-stick-slip", "tips on the table", master_curves.tips_slip),
                ("rod-ring", "a twisted ring", master_curves.ring_writhes),
                ("shell-strips", "strips' sags", shells.strips),
                ("shell-cylinders", "rolled sheets", shells.cylinders),
                ("shell-stretched", "stretched and sheared sheets", shells.stretched),
                ("shell-ring-down", "a strip with material damping", shells.ring_down),
                ("shell-falls", "sheets in air and on the table", shells.falls),
                ("shell-free-flight", "a sheet in space", shells.free_flight),
                ("shell-precision", "single and double precision", consistency.shells_precision),
                ("shell-order", "finer and finer strips", convergence.strips_sag),
                ("shell-batch", "cloths together and alone", consistency.shells_together),
                ("shell-swing", "a swing's energy", energy.sheet_swings),
                ("shell-layers", "a folded cloth that rubs", layers.cloth_on_itself),
                ("shell-plates", "strips and squares that bend two ways", plates.plates),
                ("shell-weave", "strips of a weave", fabrics.weave),
                ("shell-cantilever", "strips' sags over decades", master_curves.strips_sag),
                ("shell-lateral", "a strip on its edge", master_curves.strip_falls_over),
                ("shell-discs", "discs cut out of a lattice", outlines.discs),
            )
        ),
    )
}
"""Every case by its name, in the order in which they run."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of a case."""

    case: Case
    checks: list[Check]
    failure: str | None
    """Why the simulation stopped, or None."""
    seconds: float

    @property
    def passed(self) -> bool:
        return self.failure is None and all(check.passed for check in self.checks)


def choose(names: Sequence[str], engine: str | None = None) -> list[Case]:
    """The cases of these names, in the suite's order; all for no names, or all of an engine.

    Raises:
        ParameterError: If there is no case of a name.
    """
    for name in names:
        if name not in CASES:
            raise ParameterError(
                f"there is no case {name!r}", where="--only", fix=f"choose from {', '.join(CASES)}"
            )
    return [
        case
        for name, case in CASES.items()
        if (name in names or not names) and engine in (None, case.engine)
    ]


def run_cases(cases: Sequence[Case], settings: Settings) -> Iterator[Result]:
    """Run cases one after the other. A simulation that fails ends its case, not the suite.

    Raises:
        ParameterError, DeviceError: If the settings do not make a simulator.
    """
    for case in cases:
        began = time.monotonic()
        checks, failure = [], None
        try:
            checks = case.run(settings)
        except SimulationError as error:
            failure = str(error)
        yield Result(case=case, checks=checks, failure=failure, seconds=time.monotonic() - began)
