"""A film and a view that turns, driven by one slider; `viewer.js` brings them to life."""

from __future__ import annotations

from gendom.viz.clouds import CloudSequence
from gendom.viz.playable import encode_scene
from gendom.viz.report.markup import escaped

_UNHURRIED = 3.0  # seconds; a shorter motion is played slowly at first
_SPEEDS = (("1", "real time"), ("0.5", "half speed"), ("0.25", "quarter speed"))


def scene_id(name: str) -> str:
    """Id of the data of the viewer with this name, by which charts follow its time."""
    return f"{name}-scene"


def viewer(clouds: CloudSequence, *, name: str, subject: str, view: str = "auto") -> str:
    """Hidden until the script runs, so that a page without scripts has no dead buttons.

    Args:
        clouds: What is played.
        name: Of this viewer in the page, a word.
        subject: What is seen; plain text.
        view: From where the film looks, one of `gendom.viz.views.VIEWS`.

    Raises:
        GendomError: The clouds have no points, or the view is unknown.
    """
    duration = float(clouds.times[-1] - clouds.times[0])
    first = next((v for v, _ in _SPEEDS if duration / float(v) >= _UNHURRIED), _SPEEDS[-1][0])
    speeds = "".join(
        f'<option value="{value}"{" selected" if value == first else ""}>{said}</option>'
        for value, said in _SPEEDS
    )
    layers = [("recorded", clouds.labels[0], "dot")]
    if clouds.simulated is not None:
        layers.append(("simulated", clouds.labels[1], "dot"))
    if clouds.arm is not None:
        layers.append(("arm", "arm", "area"))
    if clouds.goal is not None:
        layers.append(("goal", "goal", "ring"))
    toggles = "".join(
        f'<label><input type="checkbox" data-layer="{kind}" checked>'
        f'<i class="{kind} key {shape}"></i>{escaped(label)}</label>'
        for kind, label, shape in layers
    )
    both = ""
    if clouds.simulated is not None:
        recorded, simulated = map(escaped, clouds.labels)
        both = (
            f'<label>{recorded} <input type="range" class="fade" min="-1" max="1" step="0.05" '
            f'value="0" aria-label="Fade from {recorded} to {simulated}"> {simulated}</label>'
            '<label>Clouds <select class="layout"><option value="over">overlaid</option>'
            '<option value="beside">side by side</option></select></label>'
        )
    where = "from above at an angle" if view == "oblique" else "from the side"
    said = escaped(subject)
    kind = "viewer" if clouds.num_frames > 1 else "viewer still"
    return (
        f'<div class="{kind}" id="{name}" data-scene="{scene_id(name)}" hidden>'
        '<div class="screens">'
        f'<figure><canvas class="film" role="img" aria-label="{said}, {where}"></canvas>'
        f"<figcaption>Film {where}</figcaption></figure>"
        f'<figure><canvas class="turning" tabindex="0" role="img" aria-label="{said}; drag or use '
        'the arrow keys to turn it"></canvas>'
        "<figcaption>3D view: drag it, or use the arrow keys, to turn it</figcaption></figure>"
        '</div><div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" class="time" min="0" value="0" aria-label="Time"><output></output>'
        f'<select class="speed" aria-label="Speed">{speeds}</select></div>'
        f'<div class="options"><div class="layers">{toggles}</div>{both}</div></div>'
        f'<script type="application/json" id="{scene_id(name)}">'
        f"{encode_scene(clouds, view=view)}</script>"
    )
