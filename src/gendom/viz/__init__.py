"""Pictures of lifts and of what followed from them: images, animations, one HTML report.

Takes plain arrays and dictionaries, so it needs neither estimation nor policies.
"""

from gendom.viz.animation import write_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import encode_camera_views
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
    "encode_camera_views",
    "write_gif",
    "write_report",
]
