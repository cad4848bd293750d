"""Recordings and sets of demonstrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gendom.lazy import imported_later

if TYPE_CHECKING:
    from gendom.datasets.clouds import read_pcd, read_ply
    from gendom.datasets.demonstrations import generate
    from gendom.datasets.recording import Recording
    from gendom.datasets.recording_form import Fault, ObjectDescription

__all__ = ["Fault", "ObjectDescription", "Recording", "generate", "read_pcd", "read_ply"]

__getattr__ = imported_later(__name__)
