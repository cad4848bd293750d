"""Derivatives of whole simulations, by reverse mode with recorded or recomputed substeps."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import check_numbers, check_type
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.sim.gradients import Gradients
from gendom.sim.mpm.tape import Tape
from gendom.sim.simulator import Simulator
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.tape import ThinTape


class Rollout:
    """A recorded simulation that can be differentiated.

    ``forward`` runs it; ``backward`` takes the derivative of any loss with respect to the recorded
    positions and returns its derivatives with respect to all inputs. States are stored every few
    steps, and the steps between them are recomputed (checkpointing): rods and shells store about
    twice the square root of their number of steps, the MPM one in 64 on the CPU, or everything of a
    short rollout.

    Args:
        simulator: A simulator that has not been run.

    Raises:
        ParameterError: If the simulator is none or has been run.
    """

    def __init__(self, simulator: Simulator):
        check_type("simulator", simulator, Simulator)
        if simulator.engine.used:
            raise ParameterError("a rollout starts from a simulator that has not been run")
        self.simulator, engine = simulator, simulator.engine
        self._tape = ThinTape(engine) if isinstance(engine, ThinEngine) else Tape(engine)
        self._times: Array | None = None

    def forward(self, times: ArrayLike) -> Array:
        """Simulate to each of the given times, as ``Simulator.run`` does.

        Returns:
            [T, W, N, 3] positions [m].

        Raises:
            ParameterError: If the times decrease, or if called twice.
            SimulationError: If a world diverges.
        """
        if self._times is not None:
            raise ParameterError("a rollout runs forward once; make another one")
        self._times = self.simulator.checked(times)
        frames = self._tape.forward(self._times, self.simulator.time)
        self.simulator.time = float(self._times[-1])
        return frames

    def backward(self, positions_bar: ArrayLike) -> Gradients:
        """Compute derivatives of a loss with respect to all inputs of the simulation.

        Args:
            positions_bar: [T, W, N, 3] derivative of the loss with respect to each recorded
                position [1/m].

        Raises:
            ParameterError: If shapes do not fit, a number is not finite or ``forward`` was not
                called.
            SimulationError: If a derivative is not finite; the error names world and input.
        """
        if self._times is None:
            raise ParameterError("call forward before backward")
        s = self.simulator
        W, N = s.num_worlds, s.num_points
        bar = check_numbers("positions_bar", positions_bar, (len(self._times), W, N, 3))
        found, hands = self._tape.backward(bar), s.engine.setting.grippers
        for name, values in vars(found).items():
            if values is not None and not np.isfinite(values).all():
                raise s.engine.setting.error(
                    int(np.argwhere(~np.isfinite(values))[0][0]),
                    s.time,
                    f"the derivative by {name} is not finite",
                    where=s.dtype,
                    fix="use float64, a shorter rollout, or more damping",
                )
        return replace(
            found,
            gripper_positions=hands.at_own_knots(found.gripper_positions),
            gripper_rotations=hands.at_own_knots(found.gripper_rotations),
        )
