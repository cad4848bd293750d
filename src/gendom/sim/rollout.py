"""Derivatives through whole simulations, by reverse mode with recorded or repeated substeps."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError
from gendom.sim.gradients import Gradients
from gendom.sim.simulator import Simulator

MEMORY = {"cpu": 64 << 20, "cuda": 8 << 30}
"""Default bounds on what a rollout keeps for its reverse [bytes]."""


class Rollout:
    """A simulation that is recorded, to be differentiated.

    ``forward`` runs it; ``backward`` takes the derivative of any loss by the recorded positions
    and returns that by everything that went in. Where recording every substep would need more
    than ``memory``, states are kept every few substeps and the stretches between are run again;
    rods and shells always do so, and keep about twice the square root of their steps.

    Args:
        simulator: Not run before.
        memory: Bound on what is kept [bytes] (default: ``MEMORY`` of the device).

    Raises:
        ParameterError: If the simulator has been run.
    """

    def __init__(self, simulator: Simulator, *, memory: float | None = None):
        if simulator.engine.used:
            raise ParameterError("a rollout starts from a simulator that has not been run")
        self.simulator = simulator
        cuda = simulator.device.is_cuda
        if memory is None:
            memory = MEMORY["cuda" if cuda else "cpu"]
        self._tape = simulator.engine.tape(memory)
        self._times: NDArray[np.float64] | None = None

    def forward(self, times: ArrayLike) -> NDArray[np.floating]:
        """Simulate to each of the given times, as ``Simulator.run`` does.

        Returns:
            [T, W, N, 3] positions [m].

        Raises:
            ParameterError: If the times run backwards, or if called twice.
            SimulationError: If a world diverges.
        """
        if self._times is not None:
            raise ParameterError("a rollout runs forward once; make another one")
        self._times = self.simulator.checked(times)
        frames = self._tape.forward(self._times, self.simulator.time)
        self.simulator.time = float(self._times[-1])
        return frames

    def backward(self, positions_bar: ArrayLike) -> Gradients:
        """Derivatives of a loss from its derivative by the positions of ``forward``.

        Args:
            positions_bar: [T, W, N, 3] derivative of the loss by each recorded position [1/m].

        Raises:
            ParameterError: If shapes do not fit or ``forward`` was not called.
            SimulationError: If a derivative is not finite: names particle, time and cause.
        """
        if self._times is None:
            raise ParameterError("call forward before backward")
        s = self.simulator
        W, N = s.num_worlds, s.num_points
        bar = np.asarray(positions_bar, dtype=float)
        if bar.shape != (len(self._times), W, N, 3):
            raise ParameterError(
                f"positions_bar must be {(len(self._times), W, N, 3)}, got {bar.shape}"
            )
        if not np.isfinite(bar).all():
            raise ParameterError("positions_bar holds numbers that are not finite")
        return self._tape.backward(bar)
