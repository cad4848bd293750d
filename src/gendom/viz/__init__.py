"""Pictures of lifts and of what followed from them: images, animations, one HTML report.

Takes plain arrays and dictionaries, so it needs neither estimation nor policies.
"""

from gendom.viz.animation import encode_gif, write_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.filmstrip import encode_filmstrip, write_filmstrip
from gendom.viz.report import (
    ActionSummary,
    CameraViews,
    EstimateSummary,
    LiftPictures,
    NextStep,
    PolicyRun,
    Provenance,
    ReachOutcome,
    ReportContent,
    write_report,
)
from gendom.viz.sights import encode_sights

__all__ = [
    "ActionSummary",
    "CameraViews",
    "CloudSequence",
    "EstimateSummary",
    "LiftPictures",
    "NextStep",
    "PolicyRun",
    "Provenance",
    "ReachOutcome",
    "ReportContent",
    "encode_filmstrip",
    "encode_gif",
    "encode_sights",
    "write_filmstrip",
    "write_gif",
    "write_report",
]
