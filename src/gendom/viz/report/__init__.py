"""One HTML file about a recording: the lift, the estimate, the action.

Everything is inside the file: it opens without a network, prints, and can be sent by mail. Each
module holds what one section is given (a dataclass) and the function that makes the section of it;
`ReportContent` puts them in order.
"""

from gendom.viz.report.action import ActionSummary, PolicyRun, ReachOutcome
from gendom.viz.report.cameras import CameraViews
from gendom.viz.report.content import SUMMARY, ReportContent, render_report, write_report
from gendom.viz.report.lift import LiftPictures
from gendom.viz.report.next_steps import NextStep
from gendom.viz.report.page import Section, render_page
from gendom.viz.report.provenance import Provenance, provenance_section
from gendom.viz.report.summary import ESTIMATE_FORMAT, EstimateSummary
from gendom.viz.report.tables import curves_section, ranks_section, table_section

__all__ = [
    "ESTIMATE_FORMAT",
    "SUMMARY",
    "ActionSummary",
    "CameraViews",
    "EstimateSummary",
    "LiftPictures",
    "NextStep",
    "PolicyRun",
    "Provenance",
    "ReachOutcome",
    "ReportContent",
    "Section",
    "curves_section",
    "provenance_section",
    "ranks_section",
    "render_page",
    "render_report",
    "table_section",
    "write_report",
]
