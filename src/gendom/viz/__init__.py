"""Pictures of simulations, of lifts and of what followed from them: viewer, meshes, films, one HTML
report."""

from typing import TYPE_CHECKING

from gendom.lazy import imported_later
from gendom.viz.animation import Animation, Layer
from gendom.viz.films import write_film
from gendom.viz.report.content import ReportContent, write_report
from gendom.viz.report.motion import ActionSummary, PolicyRun, ReachOutcome

if TYPE_CHECKING:
    from gendom.viz.layers import object_layer
    from gendom.viz.simulation import save, show

# these import bodies and tasks
__getattr__ = imported_later(__name__)

__all__ = [
    "ActionSummary", "Animation", "Layer", "PolicyRun", "ReachOutcome", "ReportContent",
    "object_layer", "save", "show", "write_film", "write_report",
]  # fmt: skip
