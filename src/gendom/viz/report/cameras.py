"""The section that shows what the cameras saw."""

from __future__ import annotations

from dataclasses import dataclass

from gendom.viz.report.markup import escaped, figure
from gendom.viz.report.page import Section


@dataclass(frozen=True, kw_only=True)
class CameraViews:
    """Both cameras' pictures of one moment of the lift."""

    picture: bytes
    """A JPEG, see `gendom.viz.encode_sights`."""
    note: str = ""
    """Text below the heading: which cameras, where, when."""


def cameras_section(views: CameraViews) -> Section:
    """Colour and depth of each camera."""
    parts = [f"<p>{escaped(views.note)}</p>"] if views.note else []
    caption = "A row for each camera: colour, and depth (yellow: near, black: none measured)."
    parts.append(figure(views.picture, "What both cameras see", caption, kind="jpeg"))
    return Section(title="What the cameras saw", body="\n".join(parts))
