"""Speed of this simulator beside that of others, on one rope, in one run.

Each simulator runs in a process and an environment of its own (see the Makefile) and reads the
rope from one file. All are started and compiled first; then they take turns, so that whatever
else the computer does meets all of them alike. Ratios are taken turn by turn.
"""

import json
import math
import os
import platform
import select
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import tyro
from gendom_rope import make_scene
from scene import Scene

HERE = Path(__file__).parent
SCRIPTS = {
    "gendom": ["gendom_rope.py"],
    "gendom-recorded": ["gendom_rope.py", "--recorded"],
    "taichi": ["taichi_rope.py"],
    "genesis": ["genesis_rope.py"],
}
NAMES = {
    "gendom": "GenDOM",
    "gendom-recorded": "GenDOM, `memory=1e9`",
    "taichi": "dense-grid MLS-MPM in Taichi",
    "genesis": "Genesis",
}

TARGET_SECONDS, TARGET_RSS = 0.8, 0.5e9
"""What the gradient of the lift may take [s] and [bytes]."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One simulator in one setting; times are medians over the rounds."""

    peer: str
    measures: str
    """``forward`` or ``gradient``."""
    version: str | None
    device: str
    dtype: str
    threads: int
    particles: int
    substeps: int
    particle_steps_per_second: float | None
    """Forward, without gradients."""
    gradient_seconds: float | None
    """Forward and backward together [s]."""
    ratio: float | None
    """Time of this row by that of GenDOM's of the same dtype, median over the rounds."""
    ratio_range: tuple[float, float] | None
    first_seconds: float | None
    """Building, compiling and the first run [s]."""
    first_peak_rss: int | None
    """Largest memory of the whole process up to the end of its first run [bytes]."""
    peak_rss: int | None
    """The same at the end of all runs [bytes]."""
    figures: dict[str, float]
    """What came out: the tip's rise [m] and, of gradients, the derivative of the mean height by
    log E [m], by reverse mode and by central differences."""
    status: str
    """``ok``, or why there are no numbers."""


@dataclass(kw_only=True)
class Turn:
    """A simulator's process, its answers so far, and what went wrong."""

    peer: str
    dtype: str
    threads: int
    gradient: bool
    rounds: int
    process: subprocess.Popen[bytes] | None = None
    log: Path = Path()
    ready: dict[str, Any] = field(default_factory=dict)
    answers: list[dict[str, Any]] = field(default_factory=list)
    status: str = "ok"

    def start(self, scene: Path, timeout: float) -> None:
        """Start the process and wait until it has compiled and run once."""
        python = sys.executable
        if not self.peer.startswith("gendom"):
            home = HERE / ".envs" / self.peer
            python = str(home / "bin" / "python")
            if not (home / "ready").exists():
                self.status = "not installed" + _last_line(home / "failed")
                return
        script, *more = SCRIPTS[self.peer]
        command = [python, str(HERE / script), str(scene), "--dtype", self.dtype]
        command += ["--threads", str(self.threads), *more]
        command += ["--gradient"] if self.gradient else []
        number = str(self.threads)
        variables = {f"{name}_NUM_THREADS": number for name in ("OMP", "MKL", "OPENBLAS")}
        name = f"{self.peer}-{self.dtype}-{self.threads}-{self.gradient}"
        self.log = scene.parent / f"{name}.log"
        # everybody compiles: no cache of an earlier run is read
        variables |= {"WARP_CACHE_PATH": str(scene.parent / name), "QD_OFFLINE_CACHE": "0"}
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=os.environ | variables,
            )
        self.ready = self._read(timeout) or {}

    def take(self, timeout: float) -> None:
        """One timed run."""
        assert self.process is not None and self.process.stdin is not None
        try:
            self.process.stdin.write(b"\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # seen by reading
        answer = self._read(timeout)
        if answer is None:
            return
        self.answers.append(answer)
        for name, value in answer.items():
            if not math.isfinite(value):
                self.status = f"{name} is not finite"

    def _read(self, timeout: float) -> dict[str, Any] | None:
        assert self.process is not None and self.process.stdout is not None
        line = b""
        if select.select([self.process.stdout], [], [], timeout)[0]:
            line = self.process.stdout.readline()
        if line.startswith(b"{"):
            return json.loads(line)
        if line:
            self.status = f"answered {line[:80]!r}"
            self.stop()
            return None
        if self.process.poll() is None and not select.select([self.process.stdout], [], [], 0)[0]:
            self.status = f"no answer within {timeout:.0f} s"
        else:
            self.status = "failed" + _last_line(self.log)
        self.stop()
        return None

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


@dataclass(frozen=True, kw_only=True)
class Command:
    """Compare the simulators: a table, and rows for programs.

    One thread each unless said; GenDOM runs one world on one thread.
    """

    rounds: int = 5
    """Timed forward runs of each simulator; 0 leaves them out."""
    gradient_rounds: int = 3
    """Timed gradients of each simulator; 0 leaves them out."""
    slow_gradients: bool = True
    """Also gradients that take minutes to compile and to run (Taichi's float32, Genesis'); what
    takes minutes to run is timed once."""
    peers: tuple[str, ...] = ("taichi", "genesis")
    """Which peers."""
    all_threads: bool = True
    """Peers also on all cores."""
    timeout: float = 600.0
    """Longest wait for one answer [s]."""
    out: Path | None = None
    """File for the rows (JSON)."""

    def run(self) -> int:
        scene = make_scene()
        rows: list[Row] = []
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "scene.npz"
            scene.save(file)
            for gradient in (False, True):
                turns = self._turns(gradient)
                self._race(turns, file)
                rows += [_row(turn, turns, scene) for turn in turns]
        print(_report(rows, scene))
        if self.out is not None:
            text = json.dumps([asdict(row) for row in rows], indent=1)
            self.out.write_text(text + "\n")
        return 0

    def _turns(self, gradient: bool) -> list[Turn]:
        rounds = self.gradient_rounds if gradient else self.rounds
        if rounds < 1:
            return []
        cores = len(os.sched_getaffinity(0))
        turns: list[Turn] = []
        recorded = ("gendom-recorded",) if gradient else ()
        for peer in ("gendom", *recorded, *self.peers):
            for threads in sorted({1, cores if self.all_threads else 1}):
                if threads > 1 and (peer.startswith("gendom") or gradient):
                    continue
                for dtype in ("float32", "float64"):
                    if gradient and peer == "genesis" and dtype == "float32":
                        continue
                    slow = (peer, dtype) in (("genesis", "float64"), ("taichi", "float32"))
                    if gradient and slow and not self.slow_gradients:
                        continue
                    times = 1 if gradient and peer == "genesis" else rounds
                    turns.append(
                        Turn(
                            peer=peer,
                            dtype=dtype,
                            threads=threads,
                            gradient=gradient,
                            rounds=times,
                        )
                    )
        return turns

    def _race(self, turns: list[Turn], scene: Path) -> None:
        try:
            for turn in turns:
                print(f"starting {_title(turn)} ...", file=sys.stderr, flush=True)
                turn.start(scene, self.timeout)
            for number in range(max((turn.rounds for turn in turns), default=0)):
                for turn in turns:
                    if turn.status == "ok" and number < turn.rounds:
                        turn.take(self.timeout)
        finally:
            for turn in turns:
                turn.stop()


def _title(turn: Turn) -> str:
    what = "gradient" if turn.gradient else "forward"
    return f"{turn.peer}, {turn.dtype}, {turn.threads} threads, {what}"


def _last_line(file: Path) -> str:
    """The last line of a file after a colon, or nothing."""
    text = file.read_text(errors="replace").strip() if file.exists() else ""
    return ": " + text.splitlines()[-1].strip()[:120].replace("|", "/") if text else ""


def _row(turn: Turn, turns: list[Turn], scene: Scene) -> Row:
    ok = turn.status == "ok"
    seconds = [a["seconds"] for a in turn.answers]
    median = statistics.median(seconds) if ok else None
    ours = next(t for t in turns if t.peer == "gendom" and t.dtype == turn.dtype)
    ratios = [a["seconds"] / b["seconds"] for a, b in zip(turn.answers, ours.answers, strict=False)]
    ok_ratio = ok and bool(ratios)
    steps = len(scene.x) * scene.substeps
    last = dict(turn.answers[-1]) if ok else {}
    last.pop("seconds", None)
    return Row(
        peer=turn.peer,
        measures="gradient" if turn.gradient else "forward",
        version=turn.ready.get("version"),
        device="cpu",
        dtype=turn.dtype,
        threads=turn.threads,
        particles=len(scene.x),
        substeps=scene.substeps,
        particle_steps_per_second=None if turn.gradient or median is None else steps / median,
        gradient_seconds=median if turn.gradient else None,
        ratio=statistics.median(ratios) if ok_ratio else None,
        ratio_range=(min(ratios), max(ratios)) if ok_ratio else None,
        first_seconds=turn.ready.get("first_seconds"),
        first_peak_rss=turn.ready.get("peak_rss"),
        peak_rss=last.pop("peak_rss", None),
        figures=last,
        status=turn.status,
    )


def _report(rows: list[Row], scene: Scene) -> str:
    load = ", ".join(f"{number:.1f}" for number in os.getloadavg())
    lines = [
        f"{date.today()}, {_cpu()}, {len(os.sched_getaffinity(0))} cores, load {load}",
        f"{len(scene.x)} particles, {scene.substeps} substeps",
        "",
        "| forward | version | dtype | threads | M particle-steps/s | GenDOM is faster by "
        "| first run | peak RSS, first / all runs | tip rises |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    forward = [r for r in rows if r.measures == "forward"]
    gradients = [r for r in rows if r.measures == "gradient"]
    lines = lines + [_line(r, _rate(r)) for r in forward] if forward else lines[:2]
    if gradients:
        lines += [
            "",
            "| gradient | version | dtype | threads | seconds | GenDOM is faster by | first run "
            "| peak RSS, first / all runs | derivative, by differences |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        lines += [_line(r, f"{r.gradient_seconds or 0.0:.2f}") for r in gradients]
        lines.append("")
        for r in gradients:
            if r.peer.startswith("gendom") and r.gradient_seconds and r.peak_rss:
                time_met = "met" if r.gradient_seconds <= TARGET_SECONDS else "MISSED"
                rss_met = "met" if r.peak_rss <= TARGET_RSS else "MISSED"
                lines.append(
                    f"{NAMES[r.peer]}, {r.dtype}: "
                    f"{r.gradient_seconds:.2f} s against {TARGET_SECONDS} s {time_met}, "
                    f"{r.peak_rss / 1e9:.2f} GB against {TARGET_RSS / 1e9} GB {rss_met}"
                )
    return "\n".join(lines)


def _rate(r: Row) -> str:
    rate = r.particle_steps_per_second
    return "" if rate is None else f"{rate / 1e6:.2f}"


def _line(r: Row, speed: str) -> str:
    head = f"| {NAMES[r.peer]} | {r.version or ''} | {r.dtype} | {r.threads} |"
    if r.status != "ok" or r.peak_rss is None:
        return f"{head} {r.status} | | | | |"
    ratio = ""
    if r.ratio is not None and r.ratio_range is not None and r.peer != "gendom":
        ratio = f"{r.ratio:.1f} x ({r.ratio_range[0]:.1f} to {r.ratio_range[1]:.1f})"
    f = r.figures
    if r.measures == "forward":
        found = f"{1e3 * f['tip']:.2f} mm"
    elif "loss_by_log_E" in f:
        by_log_E, differences = f["loss_by_log_E"], f["loss_by_log_E_differences"]
        found = f"by log E {1e3 * by_log_E:.4f}, {1e3 * differences:.4f} mm"
    else:
        found = f"by speed {f['loss_by_speed']:.4f}, {f['loss_by_speed_differences']:.4f} s"
    first, all_runs = (r.first_peak_rss or 0) / 1e9, r.peak_rss / 1e9
    return (
        f"{head} {speed} | {ratio} | {r.first_seconds:.1f} s "
        f"| {first:.2f} / {all_runs:.2f} GB | {found} |"
    )


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.exists() else []:
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    began = time.perf_counter()
    code = tyro.cli(Command, description=Command.__doc__).run()
    print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr)
    sys.exit(code)
