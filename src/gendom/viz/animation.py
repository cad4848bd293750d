"""Animations of a recorded and a simulated cloud, drawn over each other frame by frame."""

from __future__ import annotations

import io
import math
import os

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gendom.files import atomic_path
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import (
    GOAL_COLOR,
    INK,
    RECORDED_COLOR,
    RECORDED_OPACITY,
    SIMULATED_COLOR,
    SIMULATED_OPACITY,
    SOFT_INK,
    TABLE_FILL,
    TABLE_LINE,
    nice_step,
    rgb,
)

WIDTH = 640
"""Of the picture [pixels]; its height follows from the object."""

FRAMES = 60
"""With more frames than these, evenly spaced ones are shown."""

FRAME_TIME = 80
"""How long a frame is shown [ms]; the last is shown for a second more."""

_COLORS = 64
"""Colours of an animation; all its frames have the same, or they would flicker."""

_SMOOTH = 2
"""Pixels that are drawn along one of the picture, so that edges are smooth."""

_TOP, _BOTTOM, _SIDE = 34, 44, 24
"""What is left free around the drawing [pixels]."""


def write_gif(path: str | os.PathLike, clouds: CloudSequence) -> None:
    """Write both clouds over each other, frame by frame, as a GIF that repeats for ever.

    The file appears whole or not at all.

    Raises:
        GendomError: As `gendom.files.atomic_path`; or there are no points.
    """
    painter = FramePainter(clouds)
    images = [painter.draw(t) for t in clouds.spread(FRAMES)]
    # Of some frames, since a colour may be hidden in the first one.
    some = [images[k] for k in np.linspace(0, len(images) - 1, 4).astype(int)]
    sheet = Image.fromarray(np.concatenate([np.asarray(image) for image in some]))
    colors = sheet.quantize(_COLORS, Image.Quantize.MAXCOVERAGE)
    images = [image.quantize(palette=colors, dither=Image.Dither.NONE) for image in images]
    buffer = io.BytesIO()
    # Left in place, a frame stores only the rectangle that changes.
    images[0].save(
        buffer,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=[FRAME_TIME] * (len(images) - 1) + [FRAME_TIME + 1000],
        loop=0,
        disposal=1,
        optimize=False,
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


class FramePainter:
    """Draws the frames of one sequence, all with the same limits.

    Raises:
        ParameterError: The sequence has no points.
    """

    def __init__(self, sequence: CloudSequence):
        self.sequence = sequence
        self.view = sequence.projection()
        box, height = sequence.box(), sequence.table_height
        shown = np.array([box[[i, j, k], range(3)] for i, j, k in np.ndindex(2, 2, 2)])
        self._table = np.empty((0, 3))
        if height is not None:
            margin = 0.08 * float(np.ptp(box[:, :2], axis=0).max()) * np.array([[-1.0], [1.0]])
            (x0, y0), (x1, y1) = (box[:, :2] + margin).tolist()
            self._table = np.array(
                [[x, y, height] for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
            )
        flat = self.view.project(np.concatenate([shown, self._table]))
        low, high = flat.min(axis=0), flat.max(axis=0)
        span = np.maximum(high - low, 1e-3)
        inner = WIDTH - 2 * _SIDE
        tall = round(inner * min(max(span[1] / span[0], 0.4), 0.85))
        self._size = WIDTH, _TOP + tall + _BOTTOM
        self._scale = float(min(inner / span[0], tall / span[1]))
        self._middle = 0.5 * (low + high)
        self._centre = np.array([0.5 * WIDTH, _TOP + 0.5 * tall])
        self._background = self._draw_background()

    def draw(self, t: int) -> Image.Image:
        """Frame t as an RGB image."""
        sequence = self.sequence
        image = self._background.copy()
        pen = ImageDraw.Draw(image)
        grippers = () if sequence.gripper is None else sequence.gripper[t]
        if sequence.table_height is not None:
            for position in grippers:
                foot = np.array([*position[:2], sequence.table_height])
                pen.line(self._pixels(np.stack([position, foot])), TABLE_LINE, _SMOOTH)
        self._dots(image, sequence.simulated[t], 2.2, SIMULATED_COLOR, SIMULATED_OPACITY)
        recorded = sequence.recorded[t]
        # Smaller dots in a dense cloud, through which the simulated one remains visible.
        radius = min(max(2.4 * math.sqrt(500.0 / max(len(recorded), 1)), 0.7), 2.4)
        self._dots(image, recorded, radius, RECORDED_COLOR, RECORDED_OPACITY)
        if sequence.goal is not None:
            places = self._pixels(sequence.goal)
            pen.line([*places, *places[-1:]], GOAL_COLOR, 2 * _SMOOTH)
            for x, y in places[-1:]:
                r = 6 * _SMOOTH
                pen.ellipse((x - r, y - r, x + r, y + r), outline=GOAL_COLOR, width=2 * _SMOOTH)
        for position in grippers:  # a cross with a white rim
            (x, y), r = self._pixels(position[None])[0], 6 * _SMOOTH
            for width, color in ((5 * _SMOOTH, "white"), (2 * _SMOOTH, INK)):
                for sign in (1, -1):
                    pen.line((x - r, y - sign * r, x + r, y + sign * r), color, width)
        image = image.reduce(_SMOOTH)
        self._letter(ImageDraw.Draw(image), t)
        return image

    def _pixels(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Where points [n, 3] [m] are in the picture that is drawn, y downwards."""
        flat = (self.view.project(points) - self._middle) * self._scale * [1.0, -1.0]
        return list(map(tuple, (_SMOOTH * (self._centre + flat)).tolist()))

    def _draw_background(self) -> Image.Image:
        """The table, and a bar of a round length."""
        image = Image.new("RGB", (_SMOOTH * self._size[0], _SMOOTH * self._size[1]), "white")
        pen = ImageDraw.Draw(image)
        if len(self._table):
            corners = self._pixels(self._table)
            pen.polygon(corners, TABLE_FILL, TABLE_LINE, _SMOOTH)
        self._bar = nice_step(50.0 / self._scale)
        x, y = _SMOOTH * _SIDE, _SMOOTH * (self._size[1] - 14)
        pen.line((x, y, x + _SMOOTH * self._bar * self._scale, y), SOFT_INK, 2 * _SMOOTH)
        return image

    def _dots(
        self, image: Image.Image, points: np.ndarray, radius: float, color: str, opacity: float
    ) -> None:
        """Dots at points [n, 3] [m]: their union, so that a dense cloud is no darker than a thin
        one."""
        mask, r = Image.new("L", image.size), _SMOOTH * radius
        pen = ImageDraw.Draw(mask)
        for x, y in self._pixels(points):
            pen.ellipse((x - r, y - r, x + r, y + r), fill=round(255 * opacity))
        if box := mask.getbbox():
            image.paste(rgb(color), box, mask.crop(box))

    def _letter(self, pen: ImageDraw.ImageDraw, t: int) -> None:
        """Time, frame and distance above the picture, the legend beside them, and the bar's
        length."""
        sequence, font = self.sequence, ImageFont.load_default(12)
        # The frame's number also keeps two equal frames from being merged into one.
        text = f"{sequence.times[t]:.2f} s   frame {t + 1} of {sequence.num_frames}"
        if sequence.chamfer is not None:
            text += f"   Chamfer {1e3 * sequence.chamfer[t]:.1f} mm"
        pen.text((_SIDE, 19), text, fill=INK, font=font, anchor="lm")
        length = f"{1e3 * self._bar:g} mm" if self._bar < 1.0 else f"{self._bar:g} m"
        pen.text((_SIDE, self._size[1] - 19), length, fill=SOFT_INK, font=font, anchor="lb")
        x, (recorded, simulated) = WIDTH - _SIDE, sequence.labels
        for label, color in ((simulated, SIMULATED_COLOR), (recorded, RECORDED_COLOR)):
            pen.text((x, 19), label, fill=INK, font=font, anchor="rm")
            x -= pen.textlength(label, font=font) + 10
            pen.ellipse((x - 4, 15, x + 4, 23), fill=color)
            x -= 18
