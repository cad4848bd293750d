"""Objects of the second reality, as one recorded lift shows them."""

from __future__ import annotations

from tempfile import TemporaryDirectory
from typing import Any

from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.evaluation.tables.workbench import Workbench
from gendom.materials import PARAMETERS, to_columns
from gendom.policies.belief import Belief
from gendom.policies.estimates import believed
from gendom.tasks import Task

FRAME_RATE = 30.0
"""Of the lift's cameras [1/s]."""

ENDS = {"rope": "swing", "cloth": "hold"}
"""How lifts end, by kind: a swing shows a rope's damping."""


def lifted(bench: Workbench, name: str, task: Task) -> Belief:
    """What one lift before two noisy cameras tells of an object that counts for a task.

    Raises:
        GendomError: The estimate is not usable.
    """
    from gendom.estimation import EstimateSettings, estimate
    from gendom.reality import find_object
    from gendom.reality.chain import record_and_perceive

    item = find_object(name)

    def make() -> dict[str, Any]:
        bench.folder.mkdir(parents=True, exist_ok=True)
        path = bench.folder / f"lift-{name}.npz"
        if not path.exists():
            with TemporaryDirectory(dir=bench.folder) as pictures:
                recording, _ = record_and_perceive(
                    item, pictures, frame_rate=FRAME_RATE, seed=bench.seed, end=ENDS[item.kind]
                )
            recording.write(path)
        settings = EstimateSettings(starts=3, seed=bench.seed)
        return estimate(Recording.read(path), settings).record

    record = bench.kept(f"estimate-{name}", make)
    if not record["verdict"]["usable"]:
        raise GendomError(", ".join(record["verdict"]["reasons"]), where=f"the lift of {name}")
    return believed(record, task, f"the lift of {name}")


def stated(belief: Belief) -> dict[str, Any]:
    """Means and 90 % intervals by parameter, for JSON."""
    columns = to_columns(belief.most_likely)
    return {
        name: {"mean": columns[PARAMETERS[name].column], "interval_90": belief.interval(name)}
        for name in belief.names
    }
