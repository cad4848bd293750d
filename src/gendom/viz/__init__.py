"""Pictures of simulations, of lifts and of what followed from them: viewer, meshes, films, one HTML
report."""

from typing import TYPE_CHECKING

from gendom.lazy import imported_later
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import encode_camera_views
from gendom.viz.report.content import ReportContent, write_report
from gendom.viz.report.motion import ActionSummary, PolicyRun, ReachOutcome

if TYPE_CHECKING:
    from gendom.viz.simulation import save, show
    from gendom.viz.stage import write_gif

# these import bodies and tasks
_LATER = {"save": "simulation", "show": "simulation", "write_gif": "stage"}
__getattr__ = imported_later(__name__, _LATER)

__all__ = [
    "ActionSummary",
    "CloudSequence",
    "PolicyRun",
    "ReachOutcome",
    "ReportContent",
    "encode_camera_views",
    "save",
    "show",
    "write_gif",
    "write_report",
]
