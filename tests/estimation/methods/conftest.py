"""A short lift with exact clouds, made by the simulator itself."""

import pytest

from experiments.sim2sim import scene_settings, sim2sim_problem, sim2sim_recording

TRUTH = (4000.0, 0.3)
"""E in the paper's units, and nu."""


@pytest.fixture(scope="session")
def short_lift():
    """Makes the problem of a lift of 0.2 m in 20 frames; keyword arguments go to the settings."""
    recordings = {}

    def make(engine="thin", markers=True, shows="all", **other):
        settings = scene_settings(engine, fast_frames=20)
        key = engine, markers, shows
        if key not in recordings:
            recordings[key] = sim2sim_recording(
                *TRUTH, settings=settings, frames=20, rise=0.2, markers=markers, shows=shows
            )
        return sim2sim_problem(recordings[key], settings=settings, starts=1, **other)

    return make
