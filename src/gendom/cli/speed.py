"""How fast the simulator runs here: whole rollouts of the rope-reaching task, and their gradients.

A particle-step is one particle taken through one substep. Gripper paths, grid columns, boundary
handling and recording are included; compiling kernels is not.
"""

import math
import statistics
import time
from dataclasses import dataclass

import numpy as np
import warp as wp

from gendom.materials import Material
from gendom.robot import TcpPaths
from gendom.sim import Rollout, Simulator, Solver, open_device
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers

STATE_REALS = 15
"""Numbers that a particle of an elastic body carries from substep to substep: x, v and C."""

COPIED = 1 << 28
"""Numbers copied to find a device's memory bandwidth."""


@dataclass(frozen=True, kw_only=True)
class Speed:
    """One measurement; times are medians over its runs."""

    device: str
    dtype: str
    worlds: int
    threads: int
    """Worlds simulated side by side (CPU)."""
    particles: int
    """In one world."""
    substeps: int
    """Of one world."""
    seconds: float
    """Wall time of a forward rollout [s]."""
    particle_steps_per_second: float
    substep_us: float
    """Wall time by substeps of one world [us]."""
    roofline_share: float | None
    """Share of the measured memory bandwidth that reading and writing every particle's state
    once a substep would take (CUDA); None on the CPU, where states stay in cache."""
    gradient_seconds: float | None
    """Wall time of forward and backward together [s], if measured."""
    gradient_cost: float | None
    """That, in forward rollouts."""


def measure_speed(
    *,
    device: str = "cpu",
    dtype: str = "float32",
    worlds: int = 1,
    threads: int | None = 1,
    seconds: float = 0.5,
    runs: int = 5,
    gradient: bool = False,
    seed: int = 0,
) -> Speed:
    """Time rollouts of ropes that are carried to random points.

    Args:
        device: Where.
        dtype: ``float32`` or ``float64``.
        worlds: Ropes at once.
        threads: Worlds side by side on the CPU (None: all cores).
        seconds: Simulated time [s].
        runs: Rollouts timed after one that compiles.
        gradient: Also time the reverse mode.
        seed: Of the carried-to points.

    Raises:
        DeviceError: If the device is not there.
        ParameterError: If numbers do not fit.
    """
    task, world = RopeReaching(), Simulation(engine="mpm", cells_across=2.0)
    body, _ = world.body(task, task.item)
    scene = task.scene(task.item)
    material = Material(E=1.0e6, nu=0.3, density=1000.0)
    actions = task.sample_actions(task.item, np.random.default_rng(seed), worlds)
    paths = TcpPaths([task.tool_path(task.item, a) for a in actions])
    hands = grippers(scene, paths, 0.0)

    def simulator() -> Simulator:
        return Simulator(
            body,
            [material] * worlds,
            grippers=hands,
            solver=Solver(engine="mpm", dtype=dtype, device=device, threads=threads),
        )

    forward: list[float] = []
    both: list[float] = []
    for _ in range(runs + 1):
        s = simulator()
        began = time.perf_counter()
        s.run([seconds])
        forward.append(time.perf_counter() - began)
        if gradient:
            rollout = Rollout(simulator())
            began = time.perf_counter()
            x = rollout.forward([seconds])
            rollout.backward(np.ones_like(x))
            both.append(time.perf_counter() - began)
    substeps = math.ceil(seconds / s.substep[0])
    median = statistics.median(forward[1:])
    rate = worlds * body.num_particles * substeps / median
    share = None
    if s.device.is_cuda:
        bytes_a_step = 2 * STATE_REALS * np.dtype(dtype).itemsize
        share = rate * bytes_a_step / memory_bandwidth(device)
    gradient_seconds = statistics.median(both[1:]) if gradient else None
    return Speed(
        device=str(s.device),
        dtype=dtype,
        worlds=worlds,
        threads=s.threads,
        particles=body.num_particles,
        substeps=substeps,
        seconds=median,
        particle_steps_per_second=rate,
        substep_us=1e6 * median / substeps,
        roofline_share=share,
        gradient_seconds=gradient_seconds,
        gradient_cost=gradient_seconds / median if gradient_seconds else None,
    )


def memory_bandwidth(device: str) -> float:
    """Bytes read and written per second by copying a large array [bytes/s]."""
    where = open_device(device)
    a = wp.zeros(COPIED, dtype=wp.float32, device=where)
    b = wp.zeros(COPIED, dtype=wp.float32, device=where)
    wp.copy(b, a)
    taken = []
    for _ in range(5):
        wp.synchronize_device(where)
        began = time.perf_counter()
        wp.copy(b, a)
        wp.synchronize_device(where)
        taken.append(time.perf_counter() - began)
    return 2.0 * 4.0 * COPIED / statistics.median(taken)
