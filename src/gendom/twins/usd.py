"""Twins as USD text: the object's geometry, moving as in our simulator's lift, its parameters as
attributes ``gendom:NAME`` with units in their documentation."""

from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.materials import Item, Rope, to_columns
from gendom.materials.catalogue import UNITS
from gendom.twins.lift import FRAME_RATE, Lift

SCRIPT = None


def written(item: Item) -> tuple[Lift, dict[str, str], Array, dict[str, Any]]:
    """The lift and text files by name, and nothing else."""
    lift = Lift(item=item)
    positions = lift.simulated()
    if isinstance(item, Rope):
        kind = "BasisCurves"
        shape = [
            'uniform token type = "linear"',
            f"int[] curveVertexCounts = [{positions.shape[1]}]",
            f'float[] widths = [{item.diameter:g}] (interpolation = "constant")',
        ]
    else:
        kind, faces = "Mesh", _faces(lift)
        shape = [
            'uniform token subdivisionScheme = "none"',
            "bool doubleSided = 1",
            f"int[] faceVertexCounts = [{', '.join(['4'] * len(faces))}]",
            f"int[] faceVertexIndices = [{', '.join(map(str, faces.ravel()))}]",
        ]
    samples = [f"            {k}: {_points(x)}," for k, x in enumerate(positions)]
    shape.append(f"point3f[] points = {_points(positions[0])}")
    shape.append("\n".join(["point3f[] points.timeSamples = {", *samples, "        }"]))
    for name, value in to_columns(item).items():
        said = f'doc = "{UNITS.get(name, "m")}"'
        shape.append(f"custom double gendom:{name} = {value!r} ({said})")
    text = _STAGE.format(
        end=len(positions) - 1, rate=f"{FRAME_RATE:g}", kind=kind, shape="\n        ".join(shape)
    )
    return lift, {"object.usda": text}, positions[0], {}


_STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
    startTimeCode = 0
    endTimeCode = {end}
    timeCodesPerSecond = {rate}
)

def Xform "World"
{{
    def {kind} "object"
    {{
        {shape}
    }}
}}
"""


def _faces(lift: Lift) -> np.ndarray:
    """[F, 4] quadrangles of a cloth's points."""
    at = np.arange(len(lift.body.points)).reshape(lift.body.shape)
    corners = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    return np.stack([c.ravel() for c in corners], axis=1)


def _points(x: Array) -> str:
    rows = (f"({a:.5f}, {b:.5f}, {c:.5f})" for a, b, c in x)
    return f"[{', '.join(rows)}]"
