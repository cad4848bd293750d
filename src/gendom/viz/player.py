"""A player of an animation inside a page: `player.js` brings it to life. Reports and notebooks have
it, and the page that plays by itself."""

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

_LESS = "\\u003c"
""""<" inside a script element."""

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
    scene = json.dumps(animation_data(shown), separators=(",", ":"), allow_nan=False)
    return (
        f'<div class="viewer" id="{name}" data-scene="{name}-scene" hidden>'
        f'<figure><canvas tabindex="0" role="img" aria-label="{escaped(subject)}; drag or use the '
        'arrow keys to turn it, + and - to come nearer and go away"></canvas>'
        "<figcaption>Drag it, or use the arrow keys, to turn it</figcaption></figure>"
        '<div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" class="time" min="0" value="0" aria-label="Time"><output></output>'
        f'<select class="speed" aria-label="Speed">{speeds}</select></div>'
        '<div class="options"></div></div>'
        f'<script type="application/json" id="{name}-scene">'
        f"{scene.replace('<', _LESS)}</script>"
    )


def encode_page(shown: Animation, title: str, more: str = "") -> str:
    """A whole page that plays an animation.

    Args:
        shown: What is played.
        title: Plain text.
        more: HTML below.

    Raises:
        GendomError: There are no points.
    """
    motion = player(shown, name="motion", subject=title)
    return render_page(title, f'{motion}<p class="said">{escaped(facts_text(shown))}</p>{more}')


def facts_text(shown: Animation) -> str:
    """What an animation states, in one line."""
    return "; ".join(f"{name} {value}" for name, value in shown.facts)


def animation_data(shown: Animation) -> dict[str, Any]:
    """What `player.js` draws, ready for JSON: dots are thinned, and frames left out, to some
    hundred kilobytes.

    Raises:
        GendomError: There are no points.
    """
    skins = sum(len(layer.at(0)) for layer in shown.layers if layer.kind == "surface")
    count = min(_FRAMES, max(_POINTS // (skins + 1), 10), shown.num_frames)
    chosen = np.linspace(0, shown.num_frames - 1, count).round().astype(int).tolist()
    known, z, (turn, tilt) = shown.distance, shown.table_height, shown.view
    (a, b), (c, d) = shown.table_ends
    table = [] if z is None else [(a, b, z), (c, b, z), (c, d, z), (a, d, z)]
    return {
        "times": np.asarray(shown.times)[chosen].round(5).tolist(),
        "frames": [t + 1 for t in chosen],
        "of": shown.num_frames,
        "distance": known and [known[0], np.asarray(known[1])[chosen].tolist()],
        "box": _tenths(shown.corners),
        "table": _tenths(table),
        "view": {"turn": turn, "tilt": tilt},
        "layers": [_layer(layer, chosen) for layer in shown.layers],
    }


def _layer(layer: Layer, chosen: list[int]) -> dict[str, Any]:
    frames = [layer.at(t) for t in (chosen if len(layer.points) > 1 else [0])]
    radius = np.asarray(layer.radius, dtype=float)
    if layer.kind == "dots":
        most = _POINTS // (2 * len(frames))
        frames = [_thinned(x, most) for x in frames]
    elif layer.kind == "lines":
        radius = np.broadcast_to(radius, len(frames[0]))
    return {
        "name": layer.name,
        "kind": layer.kind,
        "color": layer.color,
        "ink": layer.color == GRIPPER_COLOR,  # that of text
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
