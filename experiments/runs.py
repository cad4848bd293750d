"""What tables share: lifts, demonstrations and policies kept in a folder, and printing."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gendom.cli.outputs import columns, tell_written
from gendom.datasets import Recording
from gendom.datasets.demonstrations import generate
from gendom.errors import GendomError, PolicyError
from gendom.files import atomic_path, to_json, write_json
from gendom.installation import version
from gendom.materials import to_columns
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapting
from gendom.policies.belief import believed
from gendom.policies.demonstrations import Demonstrations
from gendom.policies.evaluation import judge
from gendom.policies.polishing import polishing
from gendom.policies.rollouts import side_by_side
from gendom.progress import bar
from gendom.reading import read_json
from gendom.robot import LiftMotion, predefined_lift
from gendom.robot.motions import LIFT_FRAME_RATE
from gendom.tasks import Task
from gendom.tasks.cases import Cases
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

if TYPE_CHECKING:
    from gendom.policies.fitting import Training
    from gendom.reality import RealObject, TrialRun

_log = logging.getLogger(__name__)

FEW = 1000
"""Sets of demonstrations below this are trained on in batches of `SMALL_BATCH`."""

SMALL_BATCH = 32

STARTS = {"rope": 3, "cloth": 1}
"""Of the estimate that a policy is given, by kind; one of a cloth takes minutes."""

ENDS = {"rope": "swing", "cloth": "hold"}
"""How its lift ends, by kind: a swing shows a rope's damping."""

Array = NDArray[np.float64]

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class TrainingJob:
    """A policy to be trained."""

    demonstrations: Demonstrations
    training: Training
    finetune: Demonstrations | None = None
    world: World | None = None
    """Where a policy that is refined acts (default: our simulator)."""

    @classmethod
    def of_steps(
        cls, demonstrations: Demonstrations, training: Training, steps: int, **other: Any
    ) -> TrainingJob:
        """With batches for the number of demonstrations, and as many more passes over them as
        `steps` of the optimiser need; `other` are further fields."""
        from gendom.policies.fitting import VALIDATION_SHARE

        size = SMALL_BATCH if len(demonstrations) < FEW else training.batch_size
        fitted = (1.0 - VALIDATION_SHARE) * len(demonstrations)
        epochs = max(training.epochs, math.ceil(steps / max(fitted / size, 1.0)))
        training = replace(training, batch_size=size, epochs=epochs)
        return cls(demonstrations=demonstrations, training=training, **other)

    def train(self, path: str, device: str) -> None:
        """Train it on a device and write its file."""
        from gendom.policies.training import train

        train(self.demonstrations, path, self.training, finetune=self.finetune, world=self.world,
              device=device)  # fmt: skip

    def trained(self, path: Path) -> Policy | None:
        """The policy in a file if it was trained in this way."""
        try:
            policy = Policy.read(path)
        except PolicyError:
            return None
        about = policy.description.training
        own = {
            **asdict(self.training),
            "demonstrations": len(self.demonstrations),
            "finetuned_on": len(self.finetune) if self.finetune else 0,
        }
        own = {k: list(v) if isinstance(v, tuple) else v for k, v in own.items()}
        return policy if all(about.get(k) == v for k, v in own.items()) else None


@dataclass(frozen=True, kw_only=True)
class Runs:
    """A folder that keeps everything a table is made from, so that an interrupted one continues.

    Results have readable names; file names follow from them.
    """

    folder: Path
    device: str = "cpu"
    """Of our simulator and of training."""
    jobs: int = 1
    """Processes of the second reality, and trainings side by side."""
    seed: int = 0

    def training_world(self, engine: str = "thin") -> World:
        """Where policies are refined, which are trained side by side."""
        threads = 1 if self.jobs > 1 else None
        return Simulation(engine=engine, device=self.device, threads=threads)

    def each(self, work: Callable[[T], R], inputs: Sequence[T], label: str) -> Iterator[R]:
        """What a function, which can be pickled, gives for inputs, by processes side by side."""
        with bar(label, len(inputs), "run") as show:
            jobs = min(self.jobs, len(inputs))
            if jobs == 1:
                for done, given in enumerate(inputs, 1):
                    yield work(given)
                    show(done)
                return
            with get_context("spawn").Pool(jobs) as pool:
                for done, found in enumerate(pool.imap(work, inputs), 1):
                    yield found
                    show(done)

    def kept(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The content of a JSON file, made if it is missing."""
        path = self._path(name, ".json")
        if not path.exists():
            _log.info(name)
            self.folder.mkdir(parents=True, exist_ok=True)
            write_json(path, make())
        return read_json(path)

    def demonstrations(
        self, name: str, source: Demonstrator, size: int, *, device: str | None = None
    ) -> Demonstrations:
        """A set, simulated as far as it is missing."""
        _log.info("%s: %d demonstrations", name, size)
        folder = self._path(name)
        generate(source, size, folder, seed=self.seed, device=device or self.device)
        return Demonstrations.read(folder)

    def policies(self, jobs: Mapping[str, TrainingJob], *, prefix: str = "") -> dict[str, Policy]:
        """Policies by name, trained side by side unless they are there.

        Args:
            jobs: By name.
            prefix: Of their files' names.
        """
        paths = {name: self._path(f"{prefix}{name}", ".onnx") for name in jobs}
        found = {name: job.trained(paths[name]) for name, job in jobs.items()}
        if missing := [name for name, policy in found.items() if policy is None]:
            _log.info("training %s", ", ".join(missing))
            # a core takes small batches as fast as a GPU, which many trainings share
            many = {name: len(jobs[name].demonstrations) >= FEW for name in missing}
            work = [(jobs[name], str(paths[name]), self.device if many[name] else "cpu")
                    for name in missing]  # fmt: skip
            for _ in self.each(_train, work, "training"):
                pass
        return {name: found[name] or Policy.read(paths[name]) for name in jobs}

    def recorded(
        self,
        label: str,
        item: RealObject,
        motion: LiftMotion,
        most: int | None = None,
        prepare: Callable[[TrialRun], None] = lambda _: None,
    ) -> Recording:
        """A lift before two noisy cameras, recorded unless it is there.

        Args:
            label: Name of its file.
            item: What is lifted.
            motion: How.
            most: Points of a frame that are kept; None: all.
            prepare: Changes the trial before it begins.

        Raises:
            DeviceError: The second reality cannot be simulated or rendered here.
        """
        from gendom.perception import PerceptionSettings, perceive, read_cameras
        from gendom.reality import TrialRun, lift, lift_cameras, record

        path = self._path(label, ".npz")
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            rate = LIFT_FRAME_RATE[motion.end]
            with TemporaryDirectory(dir=self.folder) as pictures:
                run = TrialRun(lift(item, motion), cameras=lift_cameras(item))
                prepare(run)
                run.step_to(run.closes)
                with run.world:
                    record(run, pictures, frame_rate=rate, seed=self.seed)
                by_colour = PerceptionSettings(colour=item.colour)
                recording = perceive(read_cameras(pictures), by_colour).recording
            if most is not None:
                recording = _thinned(recording, most, self.seed)
            recording.write(path)
        return Recording.read(path, on_warning=lambda _: None)

    def lifted(self, name: str, task: Task, item: RealObject | None = None) -> Estimate:
        """Distribution of an object's parameters for a task, after one lift seen by two cameras;
        by default the object is the one of that name.

        Raises:
            GendomError: The estimate is not usable.
        """
        from gendom.estimation import EstimateSettings, SceneSettings, estimate
        from gendom.reality import find_object

        item = item or find_object(name)

        def make() -> dict[str, Any]:
            motion = predefined_lift(item.kind, ENDS[item.kind])
            recording = self.recorded(f"lift-{name}", item, motion)
            scene = SceneSettings(threads=1 if self.jobs > 1 else None)
            settings = EstimateSettings(starts=STARTS[item.kind], seed=self.seed, scene=scene)
            return estimate(recording, settings).record

        record = self.kept(f"estimate-{name}", make)
        if not record["verdict"]["usable"]:
            raise GendomError(", ".join(record["verdict"]["reasons"]), where=f"the lift of {name}")
        where = f"the lift of {name}"
        return believed(Estimate.from_dict(record, where), task, where)

    def publish(
        self,
        result: Result,
        about: dict[str, Any],
        took: dict[str, Any],
        *,
        command: str,
        json: bool,
    ) -> None:
        """Print a table, and write it as JSON, as text and, where it has charts, as a picture.

        Args:
            result: The table.
            about, took: First and last entries of the JSON.
            command: That made it.
            json: Whether JSON is printed in place of the text.
        """
        figures = {**about, **result.figures, **took}
        text = "\n\n".join([str(s) for s in result.shown if isinstance(s, Table)] + result.notes)
        print(to_json(figures) if json else text)
        path = self._path(result.name, ".json")
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(path, figures)
        made = f"{command}\ngendom {version()}, {took['seconds']:.3g} s"
        with atomic_path(path.with_suffix(".txt")) as temporary:
            temporary.write_text(f"{text}\n\n{made}\n", encoding="utf-8")
        written = [path, path.with_suffix(".txt")]
        if charts := [s for s in result.shown if isinstance(s, Chart)]:
            written.append(path.with_suffix(".png"))
            _draw(charts, written[-1])
        for one in written:
            tell_written(one, json=json)

    def _path(self, name: str, suffix: str = "") -> Path:
        slug = name.lower().replace(", ", "-").replace(" ", "-").replace("+", "-and-")
        return self.folder / f"{slug}{suffix}"


def _train(work: tuple[TrainingJob, str, str]) -> None:
    job, *where = work
    job.train(*where)


def _thinned(recording: Recording, most: int, seed: int) -> Recording:
    """The recording with at most so many points a frame."""
    rng, kept = np.random.default_rng(seed), []
    for first, last in pairwise(recording.offsets):
        size = int(last - first)
        chosen = rng.choice(size, most, replace=False) if size > most else np.arange(size)
        kept.append(first + np.sort(chosen))
    every, by = np.concatenate(kept), recording.seen_by
    return replace(
        recording,
        points=recording.points[every],
        offsets=np.cumsum([0, *map(len, kept)]),
        seen_by=None if by is None else by[every],
    )


def polished(
    cases: Cases,
    beliefs: Sequence[Estimate],
    start: Array,
    world: World,
    *,
    discrepancies: Sequence[Any] | None = None,
) -> Array:
    """[W, A] actions polished without a limit of time.

    Args:
        cases: Goals.
        beliefs: [W] what is known of each object.
        start: [W, A], moved into the task's limits.
        world: Where they are simulated.
        discrepancies: [W] between world and simulation, as `adapting` finds them.
    """
    searches = [
        polishing(
            cases.task,
            goal,
            beliefs[w],
            cases.task.nearest(beliefs[w].most_likely, start[w]),
            seconds=math.inf,
            discrepancy=None if discrepancies is None else discrepancies[w],
        )
        for w, goal in enumerate(cases.goal)
    ]
    return np.array([found.action for found in side_by_side(cases.task, world, searches)])


def adapted(
    cases: Cases,
    beliefs: Sequence[Estimate],
    seen: Sequence[Sequence[Execution]],
    start: Array,
    world: World,
) -> Array:
    """[W, A] actions `polished` with what executions of each goal showed."""
    pairs = zip(beliefs, seen, strict=True)
    found = side_by_side(cases.task, world, [adapting(cases.task, b, list(e)) for b, e in pairs])
    known, off = [a.belief for a in found], [a.discrepancy for a in found]
    return polished(cases, known, start, world, discrepancies=off)


@dataclass(frozen=True, kw_only=True)
class Misses:
    """Rows of a table: what goals were missed by. Each is kept."""

    runs: Runs
    title: str
    """Part of the names of files."""
    errors: dict[str, list[float | None]] = field(default_factory=dict)
    """[W] of every row [m], None where it failed."""

    def row(
        self, name: str, cases: Cases, world: World, act: Callable[[], Array]
    ) -> tuple[Array, Array]:
        """[W, A] actions, carried out in a world, and [W, G] what they reached."""

        def make() -> dict[str, Any]:
            action = act()
            found = judge(cases, action, world=world)
            return {"action": action.tolist(), "reached": _plain(found.reached),
                    "error": _plain(found.error)}  # fmt: skip

        row = self.runs.kept(f"{self.title}-{name}", make)
        self.errors[name] = row["error"]
        return np.array(row["action"], dtype=float), np.array(row["reached"], dtype=float)

    def shown(self, title: str) -> list[Table]:
        """A table for each world of rows "way, world"."""
        worlds = dict.fromkeys(name.rpartition(", ")[2] for name in self.errors)
        return [
            misses(f"{title}, {world}", {n: e for n, e in self.errors.items() if n.endswith(world)})
            for world in worlds
        ]


def misses(title: str, errors: Mapping[str, Sequence[float | None]]) -> Table:
    """What goals were missed by [m], by row, and how much more than in the first row, goal by goal,
    with the standard error of that."""
    rows = {}
    first = np.array(next(iter(errors.values())), dtype=float)
    for row, error in errors.items():
        e = 1e3 * np.array(error, dtype=float)
        more = e - 1e3 * first[: len(e)]
        e, more = e[np.isfinite(e)], more[np.isfinite(more)]
        figures = (e.mean(), np.median(e), np.quantile(e, 0.95), e.max()) if len(e) else ()
        texts = *(f"{x:.2f}" for x in figures), *[""] * (4 - len(figures))
        off = more.std(ddof=1) / math.sqrt(len(more)) if len(more) > 1 else math.nan
        beside = f"{more.mean():+.2f} +- {off:.2f}" if len(more) else ""
        rows[row] = (*texts, beside, f"{len(error)}, {len(error) - len(e)}")
    head = ("mean", "median", "95 %", "worst", "more than first", "goals, failed")
    return Table(title=f"{title}, missed by [mm]", head=head, rows=rows)


def _plain(values: Array) -> list[Any]:
    """For JSON, None where a number is not finite."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(x) if np.isfinite(x) else None for x in values]


def stated(belief: Estimate) -> dict[str, Any]:
    """Means and 90 % intervals by parameter, for JSON."""
    columns = to_columns(belief.most_likely)
    return {
        name: {"mean": columns[name], "interval_90": belief.posterior.interval(name, 0.9)}
        for name in belief.names
    }


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text: names in the first column, numbers in the others."""

    title: str
    head: tuple[str, ...]
    """Of all columns but the first."""
    rows: Mapping[str, tuple[str, ...]]
    """By the text of the first column."""

    def __str__(self) -> str:
        """Columns set below each other."""
        rows = ((name, *texts) for name, texts in self.rows.items())
        return columns((self.title, *self.head), rows)


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Lines over a common axis, or a histogram of ranks between 0 and 1."""

    title: str
    x: str
    """What the axis has."""
    y: str
    log: bool = False
    """Whether both axes are logarithmic."""
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None
    """Places and values by name."""
    counts: Sequence[int] = ()
    """Heights of a histogram's bars."""
    band: tuple[int, int] | None = None
    """Between which all bars should end."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A table that was made."""

    name: str
    """Of its files."""
    figures: dict[str, Any]
    """For JSON."""
    shown: Sequence[Table | Chart]
    notes: list[str] = field(default_factory=list)
    """Printed below the tables."""


def _draw(charts: Sequence[Chart], path: Path) -> None:
    """Write charts as one picture; needs matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.0 * len(charts)), layout="constrained")
    for chart, axes in zip(charts, np.ravel(figure.subplots(len(charts))), strict=True):
        axes.set(title=chart.title, xlabel=chart.x, ylabel=chart.y)
        for name, (x, y) in (chart.lines or {}).items():
            axes.plot(x, y, marker=".", label=name)
        if chart.lines:
            axes.legend()
        if chart.log:
            axes.loglog()
        if chart.counts:
            axes.stairs(chart.counts, np.linspace(0.0, 1.0, len(chart.counts) + 1), fill=True)
        if chart.band:
            axes.axhspan(*chart.band, alpha=0.2, color="grey")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
