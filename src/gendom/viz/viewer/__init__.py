"""An interactive viewer: what is shown (`scene`, `model`), in a browser (`server`, on viser).

Takes plain arrays and a `Model`, so it needs neither estimation nor tasks. Nothing here imports
viser; `server` and `painter` do.
"""

from gendom.viz.viewer.meshes import capsules, tube_faces
from gendom.viz.viewer.model import ACTION, MATERIAL, SETUP, Model, Parameter
from gendom.viz.viewer.scene import Layer, MeshLayer, PointLayer, ViewerScene

__all__ = [
    "ACTION",
    "MATERIAL",
    "SETUP",
    "Layer",
    "MeshLayer",
    "Model",
    "Parameter",
    "PointLayer",
    "ViewerScene",
    "capsules",
    "tube_faces",
]
