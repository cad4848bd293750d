"""The same worlds in float64 and float32."""

from dataclasses import replace

import numpy as np
import warp as wp

from gendom.sim.thin.engine import ThinEngine


def doubled(engine: ThinEngine) -> ThinEngine:
    """Return an engine of the same worlds and state in float64; the same engine if it is already
    in float64."""
    if engine.real == wp.float64:
        return engine
    twin = type(engine)(replace(engine.setting, dtype="float64"), substep=None, cfl=None)
    take_state(twin, engine)
    return twin


def take_state(engine: ThinEngine, other: ThinEngine) -> None:
    """Copy the state of another engine of the same worlds, of either precision."""
    dtype = np.float64 if engine.real == wp.float64 else np.float32
    for name in ("state", "kept_state"):
        getattr(engine, name).assign(getattr(other, name).numpy().astype(dtype))
    engine.body.place.assign(other.body.place.numpy().astype(dtype))
    for name in ("closed", "holds", "stiffer", "kept_time", "last_dt"):
        setattr(engine, name, getattr(other, name).copy())
    engine.failures |= other.failures
    engine.torn = dict(other.torn)
    engine.hold(np.arange(engine.num_worlds))
