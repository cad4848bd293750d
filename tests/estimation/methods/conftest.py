"""A short lift with exact clouds, made by the simulator itself."""

from typing import Literal

import pytest

from experiments.sim2sim import scene_settings, sim2sim_problem, sim2sim_recording

TRUTH = (4000.0, 0.3)
"""E in the paper's units, and nu."""


@pytest.fixture(scope="session")
def short_lift():
    """Makes the problem of a lift of 0.2 m in 20 frames, of the MPM of 0.05 m in 5; keyword
    arguments go to the settings."""
    recordings = {}

    def make(engine: Literal["thin", "mpm"] = "thin", markers=True, shows="all", **other):
        settings, frames = scene_settings(engine, fast_frames=20), 20 if engine == "thin" else 5
        key = engine, markers, shows
        if key not in recordings:
            how = {"frames": frames, "rise": 0.01 * frames, "markers": markers, "shows": shows}
            recordings[key] = sim2sim_recording(*TRUTH, settings=settings, **how)
        return sim2sim_problem(recordings[key], settings=settings, starts=1, **other)

    return make
