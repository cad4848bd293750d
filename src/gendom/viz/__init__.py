"""Pictures of lifts and of what followed from them: images, animations, one HTML report.

Takes plain arrays and dictionaries, so it needs neither estimation nor policies.
"""

from gendom.viz.animation import write_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import encode_camera_views
from gendom.viz.report.action import ActionSummary, PolicyRun, ReachOutcome
from gendom.viz.report.content import Provenance, ReportContent, write_report
from gendom.viz.report.lift import LiftPictures
from gendom.viz.report.summary import EstimateSummary

__all__ = [
    "ActionSummary",
    "CloudSequence",
    "EstimateSummary",
    "LiftPictures",
    "PolicyRun",
    "Provenance",
    "ReachOutcome",
    "ReportContent",
    "encode_camera_views",
    "write_gif",
    "write_report",
]
