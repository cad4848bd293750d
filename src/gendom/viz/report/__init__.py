"""One HTML file about a recording: the lift, the estimate, the action.

Everything is inside the file: it opens without a network, prints, and can be sent by mail.
`summary` reads an estimate's record, `lift`, `estimate`, `search` and `action` make sections of
what they are given, and `content` puts them in order.
"""

from gendom.viz.report.action import ActionSummary, PolicyRun, ReachOutcome
from gendom.viz.report.content import (
    SUMMARY,
    CameraViews,
    NextStep,
    Provenance,
    ReportContent,
    provenance_section,
    render_report,
    write_report,
)
from gendom.viz.report.lift import LiftPictures
from gendom.viz.report.markup import Section, render_page
from gendom.viz.report.summary import EstimateSummary

__all__ = [
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
    "provenance_section",
    "render_page",
    "render_report",
    "write_report",
]
