"""Pictures and films of animations."""

import io
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from gendom.arrays import Array
from gendom.errors import DeviceError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.viz.animation import Animation, Layer, axes_of
from gendom.viz.palette import INK, TABLE_FILL, TABLE_LINE, nice_step

SIZE = (640, 480)
"""Of a picture [pixels]."""

FRAMES, FRAME_TIME = 120, 40
"""Most frames of a film, and how long one of them is shown at least [ms]."""

_COLORS = 128
"""Colours of a GIF; all its frames have the same, or they would flicker."""

_SMOOTH = 2
"""Pixels that are drawn along one of the picture, so that edges are smooth."""

_TOP, _SIDE = 19, 24
"""Middle of the line of text, and what is left free beside it [pixels]."""

_LIGHT = np.array([0.3, -0.5, 0.8]) / math.sqrt(0.98)
"""Where the light comes from."""


class Stage:
    """Draws frames of an animation in parallel projection: near things over far ones, then dots.

    Args:
        animation: What is drawn.
        view: From where, as of `axes_of`; by default the animation's.
        size: Of a picture [pixels].
        title: Written above in place of time and distance.

    Raises:
        ParameterError: The animation has no points.
    """

    def __init__(
        self,
        animation: Animation,
        view: tuple[float, float] | None = None,
        size: tuple[int, int] = SIZE,
        title: str = "",
    ):
        self.animation, self.size, self.title = animation, size, title
        self._axes = axes_of(*(view or animation.view))
        flat = animation.corners @ self._axes[:2].T
        room = np.array(size) - [2 * _SIDE, 2 * _SIDE + 2 * _TOP]
        self._scale = _SMOOTH * float((room / np.maximum(np.ptp(flat, axis=0), 1e-9)).min())
        middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0)) * [1.0, -1.0]
        self._shift = 0.5 * _SMOOTH * np.array(size) + [0, _SMOOTH * _TOP] - self._scale * middle

    def draw(self, frame: int) -> Image.Image:
        """A frame as an RGB image."""
        image = Image.new("RGB", (_SMOOTH * self.size[0], _SMOOTH * self.size[1]), "white")
        pen, layers = ImageDraw.Draw(image), self.animation.layers
        self._table(pen)
        shapes = [shape for layer in layers for shape in self._shapes(layer, frame)]
        for _, corners, color, width in sorted(shapes, key=lambda shape: -shape[0]):
            places = [(x, y) for x, y in corners]
            if not width:
                pen.polygon(places, color)
                continue
            pen.line(places, color, max(round(width), 1))
            for x, y in places:  # round ends
                r = 0.5 * width
                pen.ellipse((x - r, y - r, x + r, y + r), color)
        for layer in layers:
            if layer.kind == "dots":
                self._dots(image, layer, frame)
        image = image.reduce(_SMOOTH)
        self._letter(ImageDraw.Draw(image), frame)
        return image

    def at(self, x: Array) -> Array:
        """Where places [..., 3] [m] are in its pictures [..., 2] [pixels]."""
        return self._seen(x)[0] / _SMOOTH

    def _seen(self, x: Array) -> tuple[Array, Array]:
        """Where places [..., 3] [m] are in the picture, y downwards [..., 2] [pixels], and how far
        away [...] [m]."""
        at = np.asarray(x, dtype=float) @ self._axes.T
        return self._scale * at[..., :2] * [1.0, -1.0] + self._shift, at[..., 2]

    def _table(self, pen: ImageDraw.ImageDraw) -> None:
        z, (low, high) = self.animation.table_height, self.animation.table_ends
        if z is None:
            return
        (a, b), (c, d) = low, high
        ends = np.array([(a, b, z), (c, b, z), (c, d, z), (a, d, z)])
        pen.polygon([(x, y) for x, y in self._seen(ends)[0]], TABLE_FILL, TABLE_LINE)
        for axis in (0, 1):
            for at in np.arange(low[axis], high[axis], self.animation.square):
                line = np.array([[*low, z], [*high, z]])
                line[:, axis] = at
                pen.line([(x, y) for x, y in self._seen(line)[0]], TABLE_LINE)

    def _shapes(self, layer: Layer, frame: int) -> list[tuple[float, Any, Any, float]]:
        """Distances, corners, colours and widths (0: filled) of a layer's triangles and lines."""
        if layer.kind == "dots":
            return []
        points, color = layer.at(frame), np.array(ImageColor.getrgb(layer.color))
        seen, away = self._seen(points)
        if layer.kind == "lines":
            widths = np.broadcast_to(2.0 * self._scale * np.asarray(layer.radius), len(points))
            fills = [layer.color] * len(points)
            far = away.mean(axis=1)
        else:
            corners = points[layer.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            light = np.abs(normal @ _LIGHT) / np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
            # of what is closed, the back is hidden
            shown = (normal @ self._axes[2] < 0.0) | (not layer.closed)
            # a sheet lies over the solid that it touches
            far = (np.max if layer.closed else np.min)(away[layer.faces[shown]], axis=1)
            seen = seen[layer.faces[shown]]
            shades = ((0.55 + 0.45 * light[shown, None]) * color).astype(int)
            fills, widths = list(map(tuple, shades.tolist())), np.zeros(len(seen))
        return list(zip(far.tolist(), seen.tolist(), fills, widths.tolist(), strict=True))

    def _dots(self, image: Image.Image, layer: Layer, frame: int) -> None:
        """The union of a layer's dots, so that a dense cloud is no darker than a thin one."""
        mask = Image.new("L", image.size)
        pen, fill = ImageDraw.Draw(mask), round(255 * layer.opacity)
        r = max(self._scale * float(np.max(layer.radius)), 0.7 * _SMOOTH)
        for x, y in self._seen(layer.at(frame))[0].tolist():
            pen.ellipse((x - r, y - r, x + r, y + r), fill=fill)
        if box := mask.getbbox():
            image.paste(layer.color, box, mask.crop(box))

    def _letter(self, pen: ImageDraw.ImageDraw, frame: int) -> None:
        """Time and distance above the picture, the legend beside them, and below a bar of a round
        length."""
        shown, font, (width, height) = self.animation, ImageFont.load_default(12), self.size
        # The frame's number also keeps two equal frames from being merged into one.
        text = self.title or f"{shown.times[frame]:.2f} s   frame {frame + 1} of {shown.num_frames}"
        if shown.distance is not None and not self.title:
            text += f"   {shown.distance[0]} {1e3 * shown.distance[1][frame]:.1f} mm"
        pen.text((_SIDE, _TOP), text, fill=INK, font=font, anchor="lm")
        x = width - _SIDE
        for layer in filter(lambda of: of.name, reversed(shown.layers)):
            pen.text((x, _TOP), layer.name, fill=INK, font=font, anchor="rm")
            x -= pen.textlength(layer.name, font=font) + 10
            pen.ellipse((x - 4, _TOP - 4, x + 4, _TOP + 4), fill=layer.color)
            x -= 18
        length = nice_step(60 * _SMOOTH / self._scale)
        end = 12 + self._scale * length / _SMOOTH
        pen.line([(12, height - 14), (end, height - 14)], fill=INK, width=2)
        pen.text((12, height - 30), f"{length:g} m", fill=INK, font=font)


def write_film(path: str | os.PathLike, animation: Animation) -> None:
    """Write an animation as .gif, which repeats for ever, or .mp4, in true time.

    The file appears whole or not at all.

    Raises:
        DeviceError: OpenCV is not installed, or cannot write .mp4.
        GendomError: As `gendom.files.atomic_path`; or there are no points.
    """
    times = 1e3 * np.asarray(animation.times)
    lasts = float(times[-1] - times[0])
    apart = float(np.diff(times).min()) if len(times) > 1 else 0.0
    step = max(FRAME_TIME, round(lasts / FRAMES), round(apart))
    moments = times[0] + step * np.arange(int(lasts / step + 0.5) + 1)
    stage = Stage(animation)
    last = np.searchsorted(times, moments + 0.5 * step, side="right") - 1  # not after that
    images = [stage.draw(int(frame)) for frame in last]
    with atomic_path(path) as temporary:
        if Path(path).suffix.lower() == ".mp4":
            _write_mp4(temporary, images, 1e3 / step)
        else:
            temporary.write_bytes(_encode_gif(images, step))


def _encode_gif(images: Sequence[Image.Image], step: int) -> bytes:
    """Each is shown so long [ms], the last for a second more."""
    some = [images[k] for k in (0, len(images) // 2, -1)]
    colors = Image.fromarray(np.concatenate([np.asarray(image) for image in some]))
    colors = colors.quantize(_COLORS, Image.Quantize.MAXCOVERAGE)
    images = [image.quantize(palette=colors, dither=Image.Dither.NONE) for image in images]
    buffer, lasts = io.BytesIO(), [step] * (len(images) - 1) + [step + 1000]
    # Left in place, a frame stores only the rectangle that changes.
    images[0].save(
        buffer, "GIF", save_all=True, append_images=images[1:], duration=lasts, loop=0, disposal=1,
        optimize=False,
    )  # fmt: skip
    return buffer.getvalue()


def _write_mp4(path: Path, images: Sequence[Image.Image], rate: float) -> None:
    try:
        import cv2
    except ImportError:
        fix = f"{how_to_install('camera')}, or save a .gif"
        raise DeviceError("films need OpenCV", where=".mp4", fix=fix) from None
    named = path.with_suffix(".mp4")  # OpenCV goes by the name
    film = cv2.VideoWriter(str(named), cv2.VideoWriter.fourcc(*"mp4v"), rate, SIZE)
    if not film.isOpened():
        raise DeviceError("this OpenCV writes no films", where=".mp4", fix="save a .gif")
    for image in images:
        film.write(np.asarray(image)[..., ::-1])
    film.release()
    named.replace(path)
