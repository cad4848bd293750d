"""Pictures of lifts and of what followed from them: images, animations, one HTML report.

Takes plain arrays and an `Estimate`, so it needs neither estimation nor policies.
"""

from gendom.viz.animation import write_gif
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import encode_camera_views
from gendom.viz.report.content import ReportContent, write_report
from gendom.viz.report.motion import ActionSummary, PolicyRun, ReachOutcome

__all__ = [
    "ActionSummary",
    "CloudSequence",
    "PolicyRun",
    "ReachOutcome",
    "ReportContent",
    "encode_camera_views",
    "write_gif",
    "write_report",
]
