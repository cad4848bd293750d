"""Animations of a recorded and a simulated cloud, drawn over each other frame by frame."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gendom.arguments import require
from gendom.files import atomic_path
from gendom.viz.clouds import OBLIQUE_TILT, CloudSequence, choose_view
from gendom.viz.palette import (
    GRID,
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

_SMOOTH = 4
"""Pixels of a mask along one of the picture, so that edges are smooth."""

_COLORS = 64
"""Colours of an animation; all its frames have the same, or they would flicker."""


def write_gif(
    path: str | os.PathLike,
    clouds: CloudSequence,
    *,
    fps: float = 12.0,
    max_frames: int = 60,
    view: str = "auto",
    width: int = 640,
) -> None:
    """Write both clouds over each other, frame by frame, as a GIF that repeats for ever.

    The file appears whole or not at all.

    Args:
        path: The file.
        clouds: What is drawn.
        fps: Frames shown in a second; GIF knows only whole hundredths of a second a frame.
        max_frames: With more frames than these, evenly spaced ones are shown.
        view: One of `gendom.viz.clouds.VIEWS`; "oblique" suits cloths.
        width: Width of the picture [pixels].

    Raises:
        ParameterError: As `gendom.viz.clouds.choose_view` and `gendom.files.atomic_path`; or there
            are no points, or `fps` is not in 1 to 50, or `max_frames` below 1.
    """
    fix = "give 1 to 50 frames a second"
    require(1.0 <= fps <= 50.0, f"is {fps:g}", where="fps", fix=fix)
    chosen = clouds.spread(max_frames)
    painter = FramePainter(clouds, view=view, width=width)
    images = [painter.draw(t) for t in chosen]
    colors = images[0].quantize(_COLORS, Image.Quantize.MAXCOVERAGE)
    images = [image.quantize(palette=colors, dither=Image.Dither.NONE) for image in images]
    durations = [10 * max(2, round(100.0 / fps))] * len(images)
    durations[-1] += 1000  # time to look at the end
    buffer = io.BytesIO()
    # Left in place, a frame stores only the rectangle that changes.
    images[0].save(
        buffer,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        disposal=1,
        optimize=False,
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


class FramePainter:
    """Draws the frames of one sequence, all with the same limits.

    Args:
        sequence: What to draw.
        view: One of `gendom.viz.clouds.VIEWS`.
        width: Width of the picture [pixels]; its height follows from the object.

    Raises:
        ParameterError: As `choose_view`; or the sequence has no points.
    """

    def __init__(self, sequence: CloudSequence, *, view: str = "auto", width: int = 640):
        self.sequence = sequence
        self.view = choose_view(sequence, view)
        self._unit = width / 640.0
        self._table = self._table_outline()
        self._lay_out(width)
        self._background = self._draw_background()

    def draw(self, t: int) -> Image.Image:
        """Frame t as an RGB image."""
        sequence, unit = self.sequence, self._unit
        image = self._background.copy()
        grippers = () if sequence.gripper is None else sequence.gripper[t]
        if self._table is not None:
            for position in grippers:
                foot = np.array([position[0], position[1], self._table[0, 2]])
                self._stroke(image, self._pixels(np.stack([position, foot])), unit, TABLE_LINE)
        if sequence.simulated is not None:
            self._dots(image, sequence.simulated[t], 2.2, SIMULATED_COLOR, SIMULATED_OPACITY)
        recorded = sequence.recorded[t]
        # Smaller dots in a dense cloud, through which the simulated one remains visible.
        radius = min(max(2.4 * math.sqrt(500.0 / max(len(recorded), 1)), 0.7), 2.4)
        self._dots(image, recorded, radius, RECORDED_COLOR, RECORDED_OPACITY)
        for position in grippers:  # a cross with a white rim
            center = self._pixels(position)
            for thickness, color in ((4.8 * unit, (255, 255, 255)), (2.4 * unit, INK)):
                for end in (6.0 * unit * np.array([1.0, sign]) for sign in (1.0, -1.0)):
                    self._stroke(image, np.stack([center - end, center + end]), thickness, color)
        self._letter(ImageDraw.Draw(image), t)
        return image

    def _table_outline(self) -> np.ndarray | None:
        """[2, 3] two opposite corners of the piece of table that an oblique view shows [m]."""
        height = self.sequence.table_height
        if height is None or self.view.names is not None:
            return None
        low, high = self.sequence.box()
        margin = 0.08 * float((high - low)[:2].max())
        return np.array(
            [
                [low[0] - margin, low[1] - margin, height],
                [high[0] + margin, high[1] + margin, height],
            ]
        )

    def _lay_out(self, width: int) -> None:
        """Margins, limits and scale."""
        unit = self._unit
        left, right, top, bottom = (round(m * unit) for m in (52, 14, 34, 40))
        flat = self.sequence.extent(self.view.axes)
        if self._table is not None:
            flat = np.concatenate([flat, self.view.project(_corners(self._table))])
        if self.view.names and self.view.names[1] == "z" and self.sequence.table_height is not None:
            flat = np.concatenate([flat, [[flat[0, 0], self.sequence.table_height]]])
        low, high = flat.min(axis=0), flat.max(axis=0)
        span = np.maximum(high - low, 1e-3)
        span = span + 0.1 * span.max()
        inner_width = width - left - right
        ratio = min(max(span[1] / span[0], 0.4), 0.85)
        inner_height = round(inner_width * ratio)
        self._frame = (left, top, left + inner_width, top + inner_height)
        self._size = (width, top + inner_height + bottom)
        self._scale = float(min(inner_width / span[0], inner_height / span[1]))
        self._middle = (low + high) / 2.0
        self._in_mm = max(inner_width, inner_height) / self._scale < 1.5
        self._factor, self._name = (1e3, "mm") if self._in_mm else (1.0, "m")
        self._tick = nice_step(inner_width / self._scale / 8.0)

    def _pixels(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] pixel coordinates, y downwards, of points [..., 3] [m]."""
        return self._place(self.view.project(points))

    def _place(self, flat: np.ndarray) -> np.ndarray:
        x0, y0, x1, y1 = self._frame
        center = np.array([(x0 + x1) / 2.0, (y0 + y1) / 2.0])
        return center + (flat - self._middle) * self._scale * np.array([1.0, -1.0])

    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest right and up [m] inside the frame."""
        x0, y0, x1, y1 = self._frame
        half = np.array([x1 - x0, y1 - y0]) / 2.0 / self._scale
        return self._middle - half, self._middle + half

    def _draw_background(self) -> Image.Image:
        """Grid, table and all that stays the same."""
        image = Image.new("RGB", self._size, "white")
        pen = ImageDraw.Draw(image)
        if self.view.names is None:
            self._draw_table_grid(pen)
        else:
            self._draw_axes(pen, self.view.names)
        self._draw_legend(pen)
        return image

    def _draw_axes(self, pen: ImageDraw.ImageDraw, names: tuple[str, str]) -> None:
        x0, y0, x1, y1 = self._frame
        unit, step = self._unit, self._tick
        low, high = self._limits()
        height = self.sequence.table_height
        shows_table = names[1] == "z" and height is not None
        if shows_table:
            table = float(self._place(np.array([0.0, height]))[1])
            pen.rectangle((x0, table, x1, y1), fill=TABLE_FILL)
        font = lettering(11 * unit)
        for axis in (0, 1):
            first, last = math.ceil(low[axis] / step), math.floor(high[axis] / step)
            for k in range(first, last + 1):
                place = self._place(np.array([k * step, k * step]))
                label = f"{k * step * self._factor:.6g}"
                if axis == 0:
                    pen.line((place[0], y0, place[0], y1), fill=GRID)
                    anchor, at = "mt", (place[0], y1 + 5 * unit)
                else:
                    pen.line((x0, place[1], x1, place[1]), fill=GRID)
                    anchor, at = "rm", (x0 - 6 * unit, place[1])
                pen.text(at, label, fill=SOFT_INK, font=font, anchor=anchor)
        if shows_table:
            pen.line((x0, table, x1, table), fill=TABLE_LINE, width=max(1, round(1.6 * unit)))
            at = (x1 - 6 * unit, min(table + 4 * unit, y1 - 14 * unit))
            pen.text(at, "table", fill=SOFT_INK, font=font, anchor="rt")
        for name, at, anchor in (
            (names[0], ((x0 + x1) / 2, y1 + 22 * unit), "mt"),
            (names[1], (x0 - 6 * unit, y0 - 8 * unit), "rs"),
        ):
            pen.text(at, f"{name} [{self._name}]", fill=SOFT_INK, font=font, anchor=anchor)

    def _draw_table_grid(self, pen: ImageDraw.ImageDraw) -> None:
        """The table of an oblique view, with squares that give the scale."""
        unit, step = self._unit, self._tick
        if self._table is not None:
            (x0, y0, z), (x1, y1, _) = self._table.tolist()
            outline = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
            corners = [tuple(p) for p in self._pixels(outline).tolist()]
            pen.polygon(corners, fill=TABLE_FILL, outline=TABLE_LINE)
            lines = [
                ((k * step, y0, z), (k * step, y1, z))
                for k in range(math.ceil(x0 / step), math.floor(x1 / step) + 1)
            ] + [
                ((x0, k * step, z), (x1, k * step, z))
                for k in range(math.ceil(y0 / step), math.floor(y1 / step) + 1)
            ]
            for line in lines:
                ends = [tuple(p) for p in self._pixels(np.array(line)).tolist()]
                pen.line(ends, fill=(222, 222, 222))
        left, _, _, bottom = self._frame
        text = f"seen from {OBLIQUE_TILT:g}° above"
        if self._table is not None:
            text += f"; squares of {step * self._factor:.6g} {self._name}"
        at = (left, bottom + 12 * unit)
        pen.text(at, text, fill=SOFT_INK, font=lettering(11 * unit), anchor="lt")

    def _draw_legend(self, pen: ImageDraw.ImageDraw) -> None:
        """From the right: gripper, simulated, recorded."""
        unit = self._unit
        font = lettering(12 * unit)
        x, y = self._frame[2], self._frame[1] - 15 * unit
        recorded, simulated = self.sequence.labels
        entries: list[tuple[str, str | None]] = [(recorded, RECORDED_COLOR)]
        if self.sequence.simulated is not None:
            entries.append((simulated, SIMULATED_COLOR))
        if self.sequence.gripper is not None:
            entries.append(("gripper", None))
        for label, color in reversed(entries):
            pen.text((x, y), label, fill=INK, font=font, anchor="rm")
            x -= pen.textlength(label, font=font) + 10 * unit
            r = 4 * unit
            if color is None:
                for sign in (1, -1):
                    ends = (x - r, y - sign * r, x + r, y + sign * r)
                    pen.line(ends, fill=INK, width=max(1, round(2 * unit)))
            else:
                pen.ellipse((x - r, y - r, x + r, y + r), fill=color)
            x -= 18 * unit

    def _dots(
        self, image: Image.Image, points: np.ndarray, radius: float, color: str, opacity: float
    ) -> None:
        """Dots at points [n, 3] [m], inside the frame only: their union, so that a dense cloud is
        no darker than a thin one."""
        x0, y0, x1, y1 = self._frame
        r = _SMOOTH * radius * self._unit

        def draw(pen: ImageDraw.ImageDraw) -> None:
            for x, y in (_SMOOTH * (self._pixels(points) - [x0, y0])).tolist():
                pen.ellipse((x - r, y - r, x + r, y + r), fill=round(255 * opacity))

        image.paste(rgb(color), (x0, y0), _mask((x1 - x0, y1 - y0), draw))

    def _stroke(
        self, image: Image.Image, ends: np.ndarray, thickness: float, color: tuple[int, int, int]
    ) -> None:
        """A smooth line between two places [2, 2] of the picture [pixels]."""
        corner = np.floor(ends.min(axis=0) - thickness).astype(int)
        size = (np.ceil(ends.max(axis=0) + thickness).astype(int) - corner).tolist()
        line = (_SMOOTH * (ends - corner)).ravel().tolist()
        width = max(1, round(_SMOOTH * thickness))
        mask = _mask((size[0], size[1]), lambda pen: pen.line(line, fill=255, width=width))
        image.paste(color, (int(corner[0]), int(corner[1])), mask)

    def _letter(self, pen: ImageDraw.ImageDraw, t: int) -> None:
        """Time, frame and distance above the picture."""
        sequence, unit = self.sequence, self._unit
        # The frame's number also keeps two equal frames from being merged into one.
        text = f"{sequence.times[t]:.2f} s   frame {t + 1} of {sequence.num_frames}"
        if sequence.chamfer is not None:
            value, decimals = sequence.chamfer[t], 1 if self._in_mm else 4
            text += f"   Chamfer {value * self._factor:.{decimals}f} {self._name}"
        at = (self._frame[0] + 12 * unit, self._frame[1] - 15 * unit)
        pen.text(at, text, fill=INK, font=lettering(12 * unit), anchor="lm")


def _mask(size: tuple[int, int], draw: Callable[[ImageDraw.ImageDraw], None]) -> Image.Image:
    """How much of each pixel is covered, 0 to 255, by what is drawn `_SMOOTH` times as large."""
    large = Image.new("L", (_SMOOTH * size[0], _SMOOTH * size[1]))
    draw(ImageDraw.Draw(large))
    return large.reduce(_SMOOTH)


@cache
def lettering(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The pictures' one font in a size [pixels]: Pillow's own, the same on every machine."""
    return ImageFont.load_default(size)


def _corners(box: np.ndarray) -> np.ndarray:
    """[8, 3] corners of a box given by two opposite ones [2, 3]."""
    return np.array(
        [[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
