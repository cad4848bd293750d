"""Pictures of lifts and of what followed from them: images, animations, one HTML report.

Takes plain arrays and dictionaries, so it needs neither estimation nor policies.
"""

from gendom.viz.animation import encode_gif, write_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.filmstrip import encode_filmstrip, write_filmstrip
from gendom.viz.report import (
    ActionSummary,
    EstimateSummary,
    LiftPictures,
    PolicyRun,
    Provenance,
    ReachOutcome,
    ReportContent,
    write_report,
)

__all__ = [
    "ActionSummary",
    "CloudSequence",
    "EstimateSummary",
    "LiftPictures",
    "PolicyRun",
    "Provenance",
    "ReachOutcome",
    "ReportContent",
    "encode_filmstrip",
    "encode_gif",
    "write_filmstrip",
    "write_gif",
    "write_report",
]
