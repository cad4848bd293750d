"""Draws a recorded and a simulated cloud over each other, one frame at a time."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, ImageDraw

from gendom.viz.clouds import CloudSequence
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
from gendom.viz.raster import lettering, splat, stroke
from gendom.viz.views import OBLIQUE_TILT, choose_view


class Stage:
    """Draws the frames of one sequence, all with the same limits.

    Args:
        sequence: What to draw.
        view: One of `VIEWS`.
        width: Width of the picture [pixels]; its height follows from the object.
        compact: For panels of a filmstrip: a scale bar instead of axes, no legend.

    Raises:
        GendomError: As `choose_view`; or the sequence has no points.
    """

    def __init__(
        self,
        sequence: CloudSequence,
        *,
        view: str = "auto",
        width: int = 640,
        compact: bool = False,
    ):
        self.sequence = sequence
        self.view = choose_view(sequence, view)
        self.compact = compact
        self._unit = width / 640.0 if not compact else width / 420.0
        self._table = self._table_outline()
        self._lay_out(width)
        self._background = self._draw_background()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self._size

    def draw(self, t: int) -> Image.Image:
        """Frame t as an RGB image."""
        sequence = self.sequence
        canvas = self._background.copy()
        grippers = () if sequence.gripper is None else sequence.gripper[t]
        if self._table is not None:
            for position in grippers:
                foot = np.array([position[0], position[1], self._table[0, 2]])
                start, end = self._pixels(position), self._pixels(foot)
                stroke(canvas, start, end, 0.5 * self._unit, TABLE_LINE)
        if sequence.simulated is not None:
            color = rgb(SIMULATED_COLOR)
            self._dot(canvas, sequence.simulated[t], 2.2, color, SIMULATED_OPACITY)
        recorded = sequence.recorded[t]
        # Smaller dots in a dense cloud, through which the simulated one remains visible.
        radius = min(max(2.4 * math.sqrt(500.0 / max(len(recorded), 1)), 0.7), 2.4)
        self._dot(canvas, recorded, radius, rgb(RECORDED_COLOR), RECORDED_OPACITY)
        for position in grippers:
            self._draw_gripper(canvas, position)
        image = Image.fromarray((canvas + 0.5).astype(np.uint8))
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
        if self.compact:
            left, right, top, bottom = (round(m * unit) for m in (8, 8, 26, 8))
        else:
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
        self._tick = nice_step(inner_width / self._scale / (5.0 if self.compact else 8.0))

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

    def _draw_background(self) -> np.ndarray:
        """[height, width, 3] float32: grid, table and all that stays the same."""
        image = Image.new("RGB", self._size, "white")
        pen = ImageDraw.Draw(image)
        if self.view.names is None:
            self._draw_table_grid(pen)
        else:
            self._draw_axes(pen, self.view.names)
        if self.compact:
            self._draw_scale_bar(pen)
        else:
            self._draw_legend(pen)
        return np.asarray(image, dtype=np.float32)

    def _draw_axes(self, pen: ImageDraw.ImageDraw, names: tuple[str, str]) -> None:
        x0, y0, x1, y1 = self._frame
        unit, step = self._unit, self._tick
        low, high = self._limits()
        height = self.sequence.table_height
        shows_table = names[1] == "z" and height is not None
        if shows_table:
            table = float(self._place(np.array([0.0, height]))[1])
            pen.rectangle((x0, table, x1, y1), fill=TABLE_FILL)
        factor, name = (1e3, "mm") if self._in_mm else (1.0, "m")
        font = lettering(11 * unit)
        for axis in (0, 1):
            first, last = math.ceil(low[axis] / step), math.floor(high[axis] / step)
            for k in range(first, last + 1):
                place = self._place(np.array([k * step, k * step]))
                label = f"{k * step * factor:.6g}".replace("-", "\N{MINUS SIGN}")
                if axis == 0:
                    pen.line((place[0], y0, place[0], y1), fill=GRID)
                    anchor, at = "mt", (place[0], y1 + 5 * unit)
                else:
                    pen.line((x0, place[1], x1, place[1]), fill=GRID)
                    anchor, at = "rm", (x0 - 6 * unit, place[1])
                if not self.compact:
                    pen.text(at, label, fill=SOFT_INK, font=font, anchor=anchor)
        if shows_table:
            pen.line((x0, table, x1, table), fill=TABLE_LINE, width=max(1, round(1.6 * unit)))
            if not self.compact:
                at = (x1 - 6 * unit, min(table + 4 * unit, y1 - 14 * unit))
                pen.text(at, "table", fill=SOFT_INK, font=font, anchor="rt")
        if not self.compact:
            at = ((x0 + x1) / 2, y1 + 22 * unit)
            pen.text(at, f"{names[0]} [{name}]", fill=SOFT_INK, font=font, anchor="mt")
            at = (x0 - 6 * unit, y0 - 8 * unit)
            pen.text(at, f"{names[1]} [{name}]", fill=SOFT_INK, font=font, anchor="rs")

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
        if not self.compact:
            left, _, _, bottom = self._frame
            text = f"seen from {OBLIQUE_TILT:g}° above; squares of {self._length(step)}"
            if self._table is None:
                text = f"seen from {OBLIQUE_TILT:g}° above"
            at = (left, bottom + 12 * unit)
            pen.text(at, text, fill=SOFT_INK, font=lettering(11 * unit), anchor="lt")

    def _draw_scale_bar(self, pen: ImageDraw.ImageDraw) -> None:
        """Above the picture, at the right, where no point can lie."""
        x0, y0, x1, _ = self._frame
        unit = self._unit
        length = nice_step((x1 - x0) / self._scale / 10.0)
        right, y = x1 - 8 * unit, y0 - 15 * unit
        left = right - length * self._scale
        for x in (left, right):
            pen.line((x, y - 4 * unit, x, y + 4 * unit), fill=SOFT_INK, width=max(1, round(unit)))
        pen.line((left, y, right, y), fill=SOFT_INK, width=max(1, round(1.6 * unit)))
        font = lettering(11 * unit)
        at = (left - 6 * unit, y)
        pen.text(at, self._length(length), fill=SOFT_INK, font=font, anchor="rm")

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

    def _dot(
        self,
        canvas: np.ndarray,
        points: np.ndarray,
        radius: float,
        color: tuple[int, int, int],
        opacity: float,
    ) -> None:
        """Dots at points [n, 3] [m], inside the frame only."""
        x0, y0, x1, y1 = self._frame
        place = self._pixels(points) - [x0, y0]
        splat(canvas[y0:y1, x0:x1], place, radius * self._unit, color, opacity)

    def _draw_gripper(self, canvas: np.ndarray, position: np.ndarray) -> None:
        """A cross with a white rim."""
        unit = self._unit
        center = self._pixels(position)
        arm = 6.0 * unit
        for half_width, color in ((2.4 * unit, (255, 255, 255)), (1.2 * unit, INK)):
            for sign in (1.0, -1.0):
                end = np.array([arm, sign * arm])
                stroke(canvas, center - end, center + end, half_width, color)

    def _letter(self, pen: ImageDraw.ImageDraw, t: int) -> None:
        """Time, frame and distance above the picture."""
        sequence, unit = self.sequence, self._unit
        text = f"{sequence.times[t]:.2f} s"
        if self.compact:
            if sequence.chamfer is not None:
                text += f"    Chamfer {self._length(sequence.chamfer[t], 1)}"
        else:
            # The frame's number also keeps two equal frames from being merged into one.
            text += f"   frame {t + 1} of {sequence.num_frames}"
            if sequence.chamfer is not None:
                text += f"   Chamfer {self._length(sequence.chamfer[t], 1)}"
        at = (self._frame[0] + (2 if self.compact else 12) * unit, self._frame[1] - 15 * unit)
        pen.text(at, text, fill=INK, font=lettering(12 * unit), anchor="lm")

    def _length(self, value: float, decimals: int | None = None) -> str:
        factor, name = (1e3, "mm") if self._in_mm else (1.0, "m")
        if decimals is None:
            return f"{value * factor:.6g} {name}"
        return f"{value * factor:.{decimals if self._in_mm else decimals + 3}f} {name}"


def _corners(box: np.ndarray) -> np.ndarray:
    """[8, 3] corners of a box given by two opposite ones [2, 3]."""
    return np.array(
        [[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
