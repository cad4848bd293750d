"""Recordings and sets of demonstrations."""

from gendom.datasets.checks import Fault
from gendom.datasets.pcd import read_pcd
from gendom.datasets.ply import read_ply, write_ply
from gendom.datasets.recording import Recording
from gendom.datasets.recording_form import ObjectDescription

__all__ = ["Fault", "ObjectDescription", "Recording", "read_pcd", "read_ply", "write_ply"]
