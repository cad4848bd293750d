"""Objects of the MuJoCo test scene, recorded and estimated from one lift."""

from __future__ import annotations

from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.evaluation.tables.workbench import Workbench
from gendom.materials import to_columns
from gendom.materials.estimate import Estimate
from gendom.policies.belief import believed
from gendom.tasks import Task

if TYPE_CHECKING:
    from gendom.reality import RealObject
    from gendom.robot import LiftMotion

FRAME_RATE = {"rope": 30.0, "cloth": 10.0}
"""Of the lift's cameras by kind [1/s]."""

STARTS = {"rope": 3, "cloth": 1}
"""Of the estimate by kind; one of a cloth takes minutes."""

ENDS = {"rope": "swing", "cloth": "hold"}
"""How lifts end, by kind: a swing shows a rope's damping."""


def recorded(
    bench: Workbench, label: str, item: RealObject, *, frame_rate: float, motion: LiftMotion
) -> Recording:
    """A lift before two noisy cameras, recorded unless it is there.

    Args:
        bench: Keeps it.
        label: Name of its file.
        item: What is lifted.
        frame_rate: [1/s].
        motion: How.
    """
    from gendom.reality.chain import record_and_perceive

    bench.folder.mkdir(parents=True, exist_ok=True)
    path = bench.folder / f"{label}.npz"
    if not path.exists():
        with TemporaryDirectory(dir=bench.folder) as pictures:
            recording, _ = record_and_perceive(
                item, pictures, frame_rate=frame_rate, seed=bench.seed, motion=motion
            )
        recording.write(path)
    return Recording.read(path)


def lifted(bench: Workbench, name: str, task: Task) -> Estimate:
    """Distribution of an object's parameters for a task, after one lift seen by two noisy cameras.

    Raises:
        GendomError: The estimate is not usable.
    """
    from gendom.estimation import EstimateSettings, estimate
    from gendom.reality import find_object, predefined_lift

    item = find_object(name)

    def make() -> dict[str, Any]:
        motion = predefined_lift(item.kind, ENDS[item.kind])
        rate = FRAME_RATE[item.kind]
        recording = recorded(bench, f"lift-{name}", item, frame_rate=rate, motion=motion)
        return estimate(
            recording, EstimateSettings(starts=STARTS[item.kind], seed=bench.seed)
        ).record

    record = bench.kept(f"estimate-{name}", make)
    if not record["verdict"]["usable"]:
        raise GendomError(", ".join(record["verdict"]["reasons"]), where=f"the lift of {name}")
    where = f"the lift of {name}"
    return believed(Estimate.from_dict(record, where), task, where)


def stated(belief: Estimate) -> dict[str, Any]:
    """Means and 90 % intervals by parameter, for JSON."""
    columns = to_columns(belief.most_likely)
    return {
        name: {"mean": columns[name], "interval_90": belief.posterior.interval(name, 0.9)}
        for name in belief.names
    }
