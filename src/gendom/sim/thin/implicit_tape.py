"""Reverse mode of rods that move in implicit steps."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.errors import ParameterError
from gendom.sim.device import making
from gendom.sim.gradients import Gradients
from gendom.sim.setting import Frames
from gendom.sim.thin.implicit import ImplicitRods
from gendom.sim.thin.run import Round
from gendom.sim.thin.schedule import Schedule
from gendom.sim.thin.tape import RodTape

HALVED = 2
"""Steps that are recorded at most, over those of a run without halving."""

LARGEST = 2**31
"""Largest of the three arrays of states that are recorded [bytes]."""


class ImplicitTape(RodTape):
    """Tape that records where each step begins and its stages end."""

    engine: ImplicitRods

    def record(self, frames: Frames) -> Schedule:
        e, W = self.engine, self.engine.num_worlds
        steps = int(e.schedule(frames, None).steps.sum(axis=1).max())
        most = HALVED * steps + len(frames.times) + 16
        size = most * W * e.state_rows * e.row_length * 8
        if size > LARGEST:
            raise ParameterError(
                f"the steps of {W} worlds would be recorded in {3e-9 * size:.3g} GB, at most "
                f"{3e-9 * LARGEST:.2g} are",
                fix="fewer worlds at a time, a longer substep, or integrator='explicit'",
            )
        e.record = e.recorded(most)
        with making:
            wp.load_module(e.implicit.reverse.module, device=e.setting.device, block_dim=e.block)
        done = np.zeros(W, dtype=np.int32)

        def after(group: slice, round: Round) -> None:
            now = e.record.count.numpy()[group].copy()
            round = self._with_held(group, round)
            round.steps = np.stack([done[group], now], axis=1)
            done[group] = now
            self.rounds.append((group, round))

        return e.run_rounds(frames, after)

    def backward(self, bar: NDArray[np.floating]) -> Gradients:
        e = self.engine
        W, P = e.num_worlds, e.row_length
        self.begun = e.zeros((W, e.state_rows, P))
        self.base_bars, self.start_bars = e.zeros((W, 18, P)), e.zeros((W, 18, P))
        return super().backward(bar)

    def reverse_steps(self, group: slice, round: Round) -> None:
        e = self.engine
        steps = np.zeros((e.num_worlds, 2), dtype=np.int32)
        steps[group] = round.steps
        e.launch(
            e.implicit.reverse,
            group,
            [
                e.body, e.paths, e.record, e.array(steps, wp.int32), self.begun, e.base, e.ahead,
                e.work, e.touches, self.base_bars, self.start_bars, self.frames_bar, self.bars,
            ],
        )  # fmt: skip
