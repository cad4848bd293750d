"""What both engines have in common: W worlds of one body on a device."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.sim.setting import Setting, spread


class Engine:
    """W worlds of one body on a device."""

    steps: Any = None
    """Those of grippers that somebody leads, if any."""
    used = False
    """Whether it has been run."""

    def __init__(self, setting: Setting):
        self.setting, self.num_worlds = setting, len(setting.materials)
        self.real = wp.float32 if setting.dtype == "float32" else wp.float64
        self.origin = np.array([0.0, 0.0, setting.table.height if setting.table else 0.0])
        """Heights are counted from the table: near 0 float32 resolves what presses on it."""
        self.stacked = dict(setting.grippers.arrays)
        """Arrays of the grippers, from the origin on."""
        self.stacked["position"] = self.stacked["position"] - self.origin
        self.failures: dict[int, SimulationError] = {}

    def first_positions(self, points: int) -> Array:
        """[W, points, 3] where worlds begin, from the origin on [m]."""
        x = np.asarray(self.setting.positions, dtype=float) - self.origin
        return spread(x, (self.num_worlds, points, 3), "positions")

    def array(self, values: Any, dtype: Any = None) -> wp.array:
        """An array on the device, of the simulation's scalar type unless told otherwise."""
        given, device = np.ascontiguousarray(values), self.setting.device
        return wp.array(given, dtype=dtype or self.real, device=device)

    def zeros(self, shape: Any, dtype: Any = None) -> wp.array:
        return wp.zeros(shape, dtype=dtype or self.real, device=self.setting.device)

    def filled(self, struct: Any, **values: Any) -> Any:
        """A struct of these numbers and arrays."""
        made = struct()
        for name, value in values.items():
            kind = struct.vars[name].type
            is_array = isinstance(kind, wp.array)
            setattr(made, name, self.array(value, kind.dtype) if is_array else value)
        return made

    def allocate(self, struct: Any, make: Any = wp.zeros, **shapes: Any) -> Any:
        """A struct of arrays of these shapes; ``make`` fills them."""
        made = struct()
        for name, shape in shapes.items():
            dtype = struct.vars[name].type.dtype
            setattr(made, name, make(shape, dtype=dtype, device=self.setting.device))
        return made

    def in_threads(self, job: Callable[[Any], None], groups: Iterable[Any]) -> None:
        """Do a job for each group of worlds, in threads; after one that raises none begins."""
        every = list(groups)
        if len(every) == 1:
            job(every[0])
        else:
            list(self._pool.map(job, every))

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(max_workers=self.setting.threads)

    def raise_failures(self, *, keep_going: bool) -> None:
        """Raise the first world's error, if any, unless runs keep going."""
        if self.failures and not keep_going:
            raise self.failures[min(self.failures)]
