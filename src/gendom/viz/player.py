"""A player of an animation inside a page: `player.js` brings it to life. Reports and notebooks have
it, and the page that plays by itself."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.viz.animation import Animation, Layer
from gendom.viz.markup import escaped, render_page
from gendom.viz.palette import GRIPPER_COLOR

_POINTS = 40_000
"""Of all frames, about; two players then fit into a report of 2 MB."""

_FRAMES = 60
"""With more frames than these, evenly spaced ones are shown."""

_SPEEDS = (("1", "real time"), ("0.5", "half speed"), ("0.25", "quarter speed"))


def player(shown: Animation, *, name: str, subject: str) -> str:
    """HTML, hidden until the script runs, so that a page without scripts has no dead buttons.

    Args:
        shown: What is played.
        name: Of this player in the page, a word.
        subject: What is seen; plain text.

    Raises:
        GendomError: There are no points.
    """
    speeds = "".join(f'<option value="{value}">{said}</option>' for value, said in _SPEEDS)
    options = "".join(
        f'<label><input type="checkbox" data-layer="{escaped(layer.name)}" checked>'
        f'<i class="key dot" style="--c: {layer.color}"></i>{escaped(layer.name)}</label>'
        for layer in shown.layers
    )
    return (
        f'<div class="viewer" id="{name}" data-scene="{name}-scene" hidden>'
        f'<figure><canvas tabindex="0" role="img" aria-label="{escaped(subject)}; drag or use the '
        'arrow keys to turn it"></canvas>'
        "<figcaption>Drag it, or use the arrow keys, to turn it</figcaption></figure>"
        '<div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" class="time" min="0" value="0" aria-label="Time"><output></output>'
        f'<select class="speed" aria-label="Speed">{speeds}</select></div>'
        f'<div class="options">{options}</div></div>'
        f'<script type="application/json" id="{name}-scene">'
        f"{encode_animation(shown)}</script>"
    )


def encode_page(shown: Animation, title: str) -> str:
    """A whole page that plays an animation.

    Raises:
        GendomError: There are no points.
    """
    facts = "; ".join(f"{name} {value}" for name, value in shown.facts)
    return render_page(
        title, f"{player(shown, name='motion', subject=title)}<p>{escaped(facts)}</p>"
    )


def encode_animation(shown: Animation) -> str:
    """What `player.js` draws, as JSON that is safe inside a script element: dots are thinned, and
    frames left out, to some hundred kilobytes.

    Raises:
        GendomError: There are no points.
    """
    skins = sum(len(layer.at(0)) for layer in shown.layers if layer.kind == "surface")
    count = min(_FRAMES, max(_POINTS // (skins + 1), 10), shown.num_frames)
    chosen = np.linspace(0, shown.num_frames - 1, count).round().astype(int).tolist()
    known, z, (turn, tilt) = shown.distance, shown.table_height, shown.view
    (a, b), (c, d) = shown.table_ends
    table = [] if z is None else [(a, b, z), (c, b, z), (c, d, z), (a, d, z)]
    found = {
        "times": np.asarray(shown.times)[chosen].round(5).tolist(),
        "frames": [t + 1 for t in chosen],
        "of": shown.num_frames,
        "distance": known and [known[0], np.asarray(known[1])[chosen].tolist()],
        "box": _tenths(shown.corners),
        "table": _tenths(table),
        "view": {"turn": turn, "tilt": tilt},
        "layers": [_layer(layer, chosen) for layer in shown.layers],
    }
    return json.dumps(found, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _layer(layer: Layer, chosen: list[int]) -> dict[str, Any]:
    frames = [layer.at(t) for t in (chosen if len(layer.points) > 1 else [0])]
    radius = np.asarray(layer.radius, dtype=float)
    if layer.kind == "dots":
        most = _POINTS // (2 * len(frames))
        frames = [_thinned(x, most) for x in frames]
    elif layer.kind == "lines":
        radius = np.broadcast_to(radius, len(frames[0]))
    return {
        "kind": layer.kind,
        "color": "" if layer.color == GRIPPER_COLOR else layer.color,  # that of text
        "opacity": layer.opacity,
        "closed": layer.closed,
        "radius": (1e4 * np.atleast_1d(radius)).round(2).tolist(),
        "faces": layer.faces.ravel().tolist(),
        "frames": [_tenths(x.ravel()) for x in frames],
    }


def _tenths(points: Any) -> list[Any]:
    """Points in tenths of a millimetre."""
    return (1e4 * np.asarray(points, dtype=float)).round().astype(int).tolist()


def _thinned(points: Array, most: int) -> Array:
    """At most so many of the points, the same ones for the same number of points."""
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:most])]
