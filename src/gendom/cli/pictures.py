"""What reports and animations are given of a lift, its replay and its estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gendom.estimation import Estimate, Scene
    from gendom.viz import CloudSequence, EstimateSummary


def clouds_of(
    scene: Scene, x: NDArray[np.floating], chamfer: NDArray[np.floating] | None
) -> CloudSequence:
    """Recorded clouds and simulated skins.

    Args:
        scene: What was recorded.
        x: [T, N, 3] positions at its frames [m].
        chamfer: [T] distance of both [m].
    """
    from gendom.viz import CloudSequence

    recording, frames = scene.recording, list(scene.frames)
    return CloudSequence(
        recorded=recording.frames(frames),
        simulated=list(scene.body.surface(x)),
        times=recording.time[frames],
        table_height=recording.table_height,
        gripper=recording.gripper_position[frames],
        chamfer=chamfer,
    )


def view_of(scene: Scene) -> str:
    """From where a lift of this object is looked at: one of `gendom.viz.views.VIEWS`."""
    return "oblique" if scene.kind == "cloth" else "auto"


def summary_of(found: Estimate, truth: Mapping[str, float] | None = None) -> EstimateSummary:
    """An estimate for a report.

    Args:
        found: The estimate.
        truth: True values under the keys of its record, as far as known.
    """
    from gendom.estimation import UNKNOWNS
    from gendom.viz import EstimateSummary

    units = {u.name: u.unit for u in UNKNOWNS.values()}
    return EstimateSummary(values=found.record, truth=truth, units=units)
