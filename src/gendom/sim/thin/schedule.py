"""When worlds do what: pieces of equal steps between frames and the moments of grippers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.sim.setting import Frames


@dataclass
class Schedule:
    """Pieces of equal steps of W worlds, S at most."""

    begins: NDArray[np.float64]
    """[W, S] when the interval that it is a part of begins [s]."""
    done: NDArray[np.int32]
    """[W, S] steps of that interval before it."""
    steps: NDArray[np.int32]
    """[W, S]."""
    dt: NDArray[np.float64]
    """[W, S] [s]."""
    before: NDArray[np.float64]
    """[W, S] length of the step before a piece, 0 where velocities are those of its begin [s]."""
    frame: NDArray[np.int32]
    """[W, S] which is recorded at a piece's end; -1: none."""
    due: NDArray[np.bool_]
    """[W, S + 1] whether a piece begins when a gripper closes or opens."""
    count: NDArray[np.int64]
    """[W] pieces."""

    def time(self, w: Any, s: Any) -> NDArray[np.float64]:
        """When pieces s of worlds w begin [s]."""
        return self.begins[w, s] + self.done[w, s] * self.dt[w, s]

    def until(self, worlds: slice, at: NDArray[np.int64]) -> NDArray[np.int64]:
        """[k] the next pieces after ``at`` [k] that begin with grippers, or the end."""
        index, count = np.arange(self.due.shape[1]), self.count[worlds]
        later = self.due[worlds] & (index > at[:, None]) & (index < count[:, None])
        return np.where(later.any(axis=1), later.argmax(axis=1), count)


def make_schedule(
    frames: Frames,
    switches: NDArray[np.floating],
    substep: NDArray[np.floating],
    most_steps: int | None,
    before: NDArray[np.floating],
) -> Schedule:
    """What worlds do until the last frame.

    Args:
        frames: To be recorded.
        switches: [W, M] times at which grippers close and open [s].
        substep: [W] longest steps [s].
        most_steps: Of a piece, or None.
        before: [W] length of the step that was the last one, 0 at a start [s].
    """
    W, T, last = len(substep), len(frames.times), frames.times[-1]
    # worlds whose grippers switch alike have the same pieces, but for their steps
    alike, which = np.unique(switches, axis=0, return_inverse=True)
    blocks = []
    for k, row in enumerate(alike):
        inside = row[(row > frames.began) & (row < last)]
        times = np.concatenate([[frames.began], frames.times, inside])
        frame = np.concatenate([[-1], np.arange(T), np.full(len(inside), -1)])
        order = np.lexsort((frame, times))
        times, frame = times[order], frame[order]
        due = np.isin(times, row)
        worlds = np.flatnonzero(which.reshape(-1) == k)
        if most_steps is None:
            blocks.append((worlds, _pieces(times, frame, due, substep[worlds])))
        else:
            for w in worlds[:, None]:
                blocks.append((w, _short(_pieces(times, frame, due, substep[w]), most_steps)))
    S = max(of["steps"].shape[1] for _, of in blocks)
    plan = Schedule(
        begins=np.zeros((W, S)),
        done=np.zeros((W, S), dtype=np.int32),
        steps=np.zeros((W, S), dtype=np.int32),
        dt=np.ones((W, S)),
        before=np.zeros((W, S)),
        frame=np.full((W, S), -1, dtype=np.int32),
        due=np.zeros((W, S + 1), dtype=bool),
        count=np.zeros(W, dtype=int),
    )
    for worlds, of in blocks:
        count = of["steps"].shape[1]
        plan.count[worlds] = count
        for name in ("begins", "done", "steps", "dt", "frame"):
            getattr(plan, name)[worlds, :count] = of[name]
        plan.due[worlds, 1 : count + 1] = of["due"]
    last_dt = before.astype(float).copy()
    for k in range(S):
        plan.before[:, k] = last_dt
        last_dt = np.where(plan.steps[:, k] > 0, plan.dt[:, k], last_dt)
    return plan


def _pieces(
    times: NDArray[np.float64],
    frame: NDArray[np.integer],
    due: NDArray[np.bool_],
    substep: NDArray[np.floating],
) -> dict[str, NDArray[Any]]:
    """[k, S] pieces between times, of equal steps no longer than substeps [k]."""
    span = np.diff(times)
    n = np.ceil(span / substep[:, None] - 1e-9)
    n = np.where(span > 0.0, np.maximum(1, n), 0).astype(int)
    dt = np.where(n > 0, span / np.maximum(n, 1), 1.0)
    return {
        "begins": times[:-1],
        "done": np.zeros_like(n),
        "steps": n,
        "dt": dt,
        "frame": frame[1:],
        "due": due[1:],
    }


def _short(pieces: dict[str, NDArray[Any]], most_steps: int) -> dict[str, NDArray[Any]]:
    """One world's pieces cut into such of at most so many steps."""
    n, dt = pieces["steps"][0], pieces["dt"][0]
    parts = np.maximum(1, -(-n // most_steps))
    of = np.repeat(np.arange(len(n)), parts)
    part = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    last = part == parts[of] - 1
    return {
        "begins": pieces["begins"][of],
        "done": part * most_steps,
        "steps": np.where(last, n[of] - part * most_steps, most_steps)[None],
        "dt": dt[of],
        "frame": np.where(last, pieces["frame"][of], -1),
        "due": last & pieces["due"][of],
    }
