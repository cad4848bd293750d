"""A recorded and a simulated cloud, drawn over each other.

Frames are rasterised with NumPy and lettered with Pillow: a full plotting library would take ten
times as long for each frame of an animation. Every frame of one sequence has the same limits.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from gendom.errors import GendomError
from gendom.files import atomic_path

Clouds = Sequence[npt.ArrayLike] | np.ndarray

# From Okabe and Ito's palette, told apart with every common form of colour blindness.
RECORDED_COLOR = "#0072B2"
SIMULATED_COLOR = "#E69F00"

VIEWS = ("auto", "xz", "yz", "xy", "oblique")

_INK = (34, 34, 34)
_SOFT_INK = (110, 110, 110)
_GRID = (234, 234, 234)
_TABLE_FILL = (244, 244, 244)
_TABLE_LINE = (150, 150, 150)
_SIMULATED_OPACITY = 0.55
_RECORDED_OPACITY = 0.9
_OBLIQUE_TILT = 25.0  # degrees


@dataclass(frozen=True, kw_only=True)
class CloudSequence:
    """T frames of a recorded cloud and, if there is one, of the simulated object.

    World frame, z up. Arrays are converted to float64.

    Raises:
        GendomError: Lengths differ, an array has another shape, or a number is not finite.
    """

    recorded: Sequence[np.ndarray]
    """T clouds [n_t, 3] [m]; n_t may be 0."""
    simulated: Sequence[np.ndarray] | None = None
    """T clouds [m_t, 3] [m], or one array [T, m, 3]."""
    times: np.ndarray
    """[T] increasing [s]."""
    gripper: np.ndarray | None = None
    """[T, G, 3], or [T, 3] for one gripper [m]."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    chamfer: np.ndarray | None = None
    """[T] Chamfer distance of the two clouds [m]."""

    def __post_init__(self):
        times = _array(self.times, "times", (None,))
        frames = len(times)
        if frames == 0:
            raise GendomError("is empty", where="times", fix="give at least one frame")
        if (np.diff(times) <= 0.0).any():
            raise GendomError("does not increase", where="times", fix="sort the frames")
        values: dict[str, object] = {"times": times}
        for name in ("recorded", "simulated"):
            clouds = getattr(self, name)
            if clouds is not None:
                _check_count(clouds, name, frames)
                values[name] = tuple(
                    _array(cloud, f"{name}[{t}]", (None, 3)) for t, cloud in enumerate(clouds)
                )
        if self.gripper is not None:
            gripper = np.asarray(self.gripper, dtype=np.float64)
            if gripper.ndim == 2:
                gripper = gripper[:, None]
            _check_count(gripper, "gripper", frames)
            values["gripper"] = _array(gripper, "gripper", (None, None, 3))
        if self.chamfer is not None:
            _check_count(self.chamfer, "chamfer", frames)
            values["chamfer"] = _array(self.chamfer, "chamfer", (None,))
        if self.table_height is not None:
            values["table_height"] = float(_array(self.table_height, "table_height", ()))
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.times)

    def spread(self, max_frames: int) -> list[int]:
        """Indices of at most `max_frames` frames, evenly spaced, with the first and the last.

        Raises:
            GendomError: `max_frames` is below 1.
        """
        if max_frames < 1:
            raise GendomError(f"is {max_frames}", where="max_frames", fix="give 1 or more")
        if max_frames == 1:
            return [self.num_frames - 1]
        count = min(max_frames, self.num_frames)
        return np.linspace(0, self.num_frames - 1, count).round().astype(int).tolist()

    def box(self) -> np.ndarray:
        """[2, 3] lowest and highest corner of all that is drawn, without stray points [m].

        Raises:
            GendomError: There are no points at all.
        """
        return self.extent(np.eye(3))

    def extent(self, axes: np.ndarray) -> np.ndarray:
        """[2, K] lowest and highest coordinate along K axes [K, 3], without stray points [m].

        Raises:
            GendomError: There are no points at all.
        """
        ends = []
        for clouds in (self.recorded, self.simulated or ()):
            for cloud in clouds:
                if len(cloud):
                    # A depth camera's flying pixels would shrink everything else.
                    ends.append(np.quantile(cloud @ axes.T, (0.005, 0.995), axis=0))
        if not ends:
            raise GendomError("has no points at all", where="recorded", fix="record it again")
        if self.gripper is not None:
            ends.append(self.gripper.reshape(-1, 3) @ axes.T)
        ends = np.concatenate(ends)
        return np.stack([ends.min(axis=0), ends.max(axis=0)])


@dataclass(frozen=True, kw_only=True)
class View:
    """An orthographic projection."""

    turn: float
    """Angle about z from x to the direction that points right in the picture [rad]."""
    tilt: float
    """Angle by which the picture looks downwards [rad]: 0 from the side, pi / 2 from above."""
    names: tuple[str, str] | None
    """Names of the two axes; None: the picture shows all three."""

    @property
    def axes(self) -> np.ndarray:
        """[2, 3] unit vectors in the world that point right and up in the picture."""
        (c, s), (cos_tilt, sin_tilt) = ((math.cos(a), math.sin(a)) for a in (self.turn, self.tilt))
        return np.array([[c, s, 0.0], [-s * sin_tilt, c * sin_tilt, cos_tilt]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] right and up [m] of points [..., 3] [m]."""
        return points @ self.axes.T


def choose_view(sequence: CloudSequence, view: str = "auto") -> View:
    """A view by name, or the side view that shows most.

    "auto" has z upwards and the longer of x and y to the right; if the object hardly rises it
    looks from above. "oblique" shows all three axes, from 25 degrees above.

    Raises:
        GendomError: There is no view of this name.
    """
    if view not in VIEWS:
        raise GendomError(f"is {view!r}", where="view", fix=f"choose from {', '.join(VIEWS)}")
    if view == "auto":
        low, high = sequence.box()
        x, y, z = (high - low).tolist()
        view = "xy" if z < 0.25 * min(x, y) else "xz" if x >= y else "yz"
    turn, tilt = {
        "xz": (0.0, 0.0),
        "yz": (90.0, 0.0),
        "xy": (0.0, 90.0),
        "oblique": (30.0, _OBLIQUE_TILT),
    }[view]
    names = None if view == "oblique" else (view[0], view[1])
    return View(turn=math.radians(turn), tilt=math.radians(tilt), names=names)


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
                _stroke(canvas, start, end, 0.5 * self._unit, _TABLE_LINE)
        if sequence.simulated is not None:
            color = _rgb(SIMULATED_COLOR)
            self._splat(canvas, sequence.simulated[t], 2.2, color, _SIMULATED_OPACITY)
        recorded = sequence.recorded[t]
        # Smaller dots in a dense cloud, through which the simulated one remains visible.
        radius = min(max(2.4 * math.sqrt(500.0 / max(len(recorded), 1)), 0.7), 2.4)
        self._splat(canvas, recorded, radius, _rgb(RECORDED_COLOR), _RECORDED_OPACITY)
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
        self._tick = _nice_step(inner_width / self._scale / (5.0 if self.compact else 8.0))

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
            pen.rectangle((x0, table, x1, y1), fill=_TABLE_FILL)
        factor, name = (1e3, "mm") if self._in_mm else (1.0, "m")
        font = _font(11 * unit)
        for axis in (0, 1):
            first, last = math.ceil(low[axis] / step), math.floor(high[axis] / step)
            for k in range(first, last + 1):
                place = self._place(np.array([k * step, k * step]))
                label = f"{k * step * factor:.6g}".replace("-", "\N{MINUS SIGN}")
                if axis == 0:
                    pen.line((place[0], y0, place[0], y1), fill=_GRID)
                    anchor, at = "mt", (place[0], y1 + 5 * unit)
                else:
                    pen.line((x0, place[1], x1, place[1]), fill=_GRID)
                    anchor, at = "rm", (x0 - 6 * unit, place[1])
                if not self.compact:
                    pen.text(at, label, fill=_SOFT_INK, font=font, anchor=anchor)
        if shows_table:
            pen.line((x0, table, x1, table), fill=_TABLE_LINE, width=max(1, round(1.6 * unit)))
            if not self.compact:
                at = (x1 - 6 * unit, min(table + 4 * unit, y1 - 14 * unit))
                pen.text(at, "table", fill=_SOFT_INK, font=font, anchor="rt")
        if not self.compact:
            at = ((x0 + x1) / 2, y1 + 22 * unit)
            pen.text(at, f"{names[0]} [{name}]", fill=_SOFT_INK, font=font, anchor="mt")
            at = (x0 - 6 * unit, y0 - 8 * unit)
            pen.text(at, f"{names[1]} [{name}]", fill=_SOFT_INK, font=font, anchor="rs")

    def _draw_table_grid(self, pen: ImageDraw.ImageDraw) -> None:
        """The table of an oblique view, with squares that give the scale."""
        unit, step = self._unit, self._tick
        if self._table is not None:
            (x0, y0, z), (x1, y1, _) = self._table.tolist()
            outline = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
            corners = [tuple(p) for p in self._pixels(outline).tolist()]
            pen.polygon(corners, fill=_TABLE_FILL, outline=_TABLE_LINE)
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
            text = f"seen from {_OBLIQUE_TILT:g}° above; squares of {self._length(step)}"
            if self._table is None:
                text = f"seen from {_OBLIQUE_TILT:g}° above"
            at = (left, bottom + 12 * unit)
            pen.text(at, text, fill=_SOFT_INK, font=_font(11 * unit), anchor="lt")

    def _draw_scale_bar(self, pen: ImageDraw.ImageDraw) -> None:
        """Above the picture, at the right, where no point can lie."""
        x0, y0, x1, _ = self._frame
        unit = self._unit
        length = _nice_step((x1 - x0) / self._scale / 10.0)
        right, y = x1 - 8 * unit, y0 - 15 * unit
        left = right - length * self._scale
        for x in (left, right):
            pen.line((x, y - 4 * unit, x, y + 4 * unit), fill=_SOFT_INK, width=max(1, round(unit)))
        pen.line((left, y, right, y), fill=_SOFT_INK, width=max(1, round(1.6 * unit)))
        font = _font(11 * unit)
        at = (left - 6 * unit, y)
        pen.text(at, self._length(length), fill=_SOFT_INK, font=font, anchor="rm")

    def _draw_legend(self, pen: ImageDraw.ImageDraw) -> None:
        """From the right: gripper, simulated, recorded."""
        unit = self._unit
        font = _font(12 * unit)
        x, y = self._frame[2], self._frame[1] - 15 * unit
        entries: list[tuple[str, str | None]] = [("recorded", RECORDED_COLOR)]
        if self.sequence.simulated is not None:
            entries.append(("simulated", SIMULATED_COLOR))
        if self.sequence.gripper is not None:
            entries.append(("gripper", None))
        for label, color in reversed(entries):
            pen.text((x, y), label, fill=_INK, font=font, anchor="rm")
            x -= pen.textlength(label, font=font) + 10 * unit
            r = 4 * unit
            if color is None:
                for sign in (1, -1):
                    ends = (x - r, y - sign * r, x + r, y + sign * r)
                    pen.line(ends, fill=_INK, width=max(1, round(2 * unit)))
            else:
                pen.ellipse((x - r, y - r, x + r, y + r), fill=color)
            x -= 18 * unit

    def _splat(
        self,
        canvas: np.ndarray,
        points: np.ndarray,
        radius: float,
        color: tuple[int, int, int],
        opacity: float,
    ) -> None:
        """Paint the union of smooth discs, so that a dense cloud is no darker than a thin one."""
        if len(points) == 0:
            return
        x0, y0, x1, y1 = self._frame
        width, height = x1 - x0, y1 - y0
        place = self._pixels(points) - [x0, y0]
        radius = radius * self._unit
        reach = math.ceil(radius + 0.5)
        place = place[((place > -reach) & (place < [width + reach, height + reach])).all(axis=1)]
        corner = np.floor(place).astype(np.int64)
        offsets = np.arange(-reach, reach + 1)
        x = corner[:, 0, None] + offsets
        y = corner[:, 1, None] + offsets
        dx, dy = x + 0.5 - place[:, 0, None], y + 0.5 - place[:, 1, None]
        distance = np.sqrt(dx[:, None, :] ** 2 + dy[:, :, None] ** 2)
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0).astype(np.float32)
        cell = y[:, :, None] * width + x[:, None, :]
        inside = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
        inside &= cover > 0.0
        mask = np.zeros(width * height, dtype=np.float32)
        np.maximum.at(mask, cell[inside], cover[inside])
        _blend(canvas[y0:y1, x0:x1], opacity * mask.reshape(height, width), color)

    def _draw_gripper(self, canvas: np.ndarray, position: np.ndarray) -> None:
        """A cross with a white rim."""
        unit = self._unit
        center = self._pixels(position)
        arm = 6.0 * unit
        for half_width, color in ((2.4 * unit, (255, 255, 255)), (1.2 * unit, _INK)):
            for sign in (1.0, -1.0):
                end = np.array([arm, sign * arm])
                _stroke(canvas, center - end, center + end, half_width, color)

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
        pen.text(at, text, fill=_INK, font=_font(12 * unit), anchor="lm")

    def _length(self, value: float, decimals: int | None = None) -> str:
        factor, name = (1e3, "mm") if self._in_mm else (1.0, "m")
        if decimals is None:
            return f"{value * factor:.6g} {name}"
        return f"{value * factor:.{decimals if self._in_mm else decimals + 3}f} {name}"


def encode_filmstrip(
    recorded: Clouds,
    simulated: Clouds | None,
    *,
    times: npt.ArrayLike,
    table_height: float | None,
    gripper: npt.ArrayLike | None,
    chamfer: npt.ArrayLike | None = None,
    frames: int = 6,
    columns: int = 3,
    view: str = "auto",
    width: int = 1600,
) -> bytes:
    """Several frames side by side, as a PNG.

    Args:
        recorded: T clouds [n_t, 3] [m].
        simulated: T clouds [m_t, 3], or [T, m, 3] [m]; None: only the recording.
        times: [T] [s].
        table_height: z of the table [m]; None: no table.
        gripper: [T, G, 3] [m], or None.
        chamfer: [T] Chamfer distance [m], written above the frames.
        frames: Number of frames; evenly spaced, with the first and the last.
        columns: Frames in a row.
        view: One of `VIEWS`.
        width: Width of the picture [pixels].

    Raises:
        GendomError: As `CloudSequence` and `choose_view`; or a number is below 1.
    """
    sequence = make_sequence(recorded, simulated, times, table_height, gripper, chamfer)
    return film(sequence, frames=frames, columns=columns, view=view, width=width)


def write_filmstrip(
    path: str | os.PathLike,
    recorded: Clouds,
    simulated: Clouds | None,
    *,
    times: npt.ArrayLike,
    table_height: float | None,
    gripper: npt.ArrayLike | None,
    chamfer: npt.ArrayLike | None = None,
    frames: int = 6,
    columns: int = 3,
    view: str = "auto",
    width: int = 1600,
) -> None:
    """Write the PNG of `encode_filmstrip`, which explains the arguments, atomically.

    Raises:
        GendomError: As `encode_filmstrip` and `gendom.files.atomic_path`.
    """
    sequence = make_sequence(recorded, simulated, times, table_height, gripper, chamfer)
    data = film(sequence, frames=frames, columns=columns, view=view, width=width)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def film(sequence: CloudSequence, *, frames: int, columns: int, view: str, width: int) -> bytes:
    """`encode_filmstrip` of a sequence."""
    if columns < 1:
        raise GendomError(f"is {columns}", where="columns", fix="give 1 or more")
    chosen = sequence.spread(frames)
    columns = min(columns, len(chosen))
    stage = Stage(sequence, view=view, width=width // columns, compact=True)
    panel_width, panel_height = stage.size
    rows = math.ceil(len(chosen) / columns)
    sheet = Image.new("RGB", (panel_width * columns, panel_height * rows), "white")
    for i, t in enumerate(chosen):
        sheet.paste(stage.draw(t), (i % columns * panel_width, i // columns * panel_height))
    buffer = io.BytesIO()
    with_palette(sheet).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def make_sequence(
    recorded: Clouds,
    simulated: Clouds | None,
    times: npt.ArrayLike,
    table_height: float | None,
    gripper: npt.ArrayLike | None,
    chamfer: npt.ArrayLike | None,
) -> CloudSequence:
    """A `CloudSequence` of anything like arrays."""
    return CloudSequence(
        recorded=recorded,  # pyright: ignore[reportArgumentType]
        simulated=simulated,  # pyright: ignore[reportArgumentType]
        times=np.asarray(times),
        gripper=None if gripper is None else np.asarray(gripper),
        table_height=table_height,
        chamfer=None if chamfer is None else np.asarray(chamfer),
    )


def with_palette(image: Image.Image) -> Image.Image:
    """The image with the colours that a `Stage` can mix; one palette for all frames.

    A fixed palette keeps frames from flickering and the file small.
    """
    return image.quantize(palette=_palette(), dither=Image.Dither.NONE)


@cache
def _palette() -> Image.Image:
    white = np.array([255.0, 255.0, 255.0])
    table = np.array(_TABLE_FILL, dtype=float)
    blue, orange = (np.array(_rgb(c), dtype=float) for c in (RECORDED_COLOR, SIMULATED_COLOR))
    ink = np.array(_INK, dtype=float)
    orange_mix = white + _SIMULATED_OPACITY * (orange - white)
    ramps = [
        (white, ink, 14),
        (white, orange_mix, 7),
        (white, white + _RECORDED_OPACITY * (blue - white), 8),
        (orange_mix, orange_mix + _RECORDED_OPACITY * (blue - orange_mix), 7),
        (table, table, 1),
        (orange, orange, 1),  # the legend's dots are opaque
        (blue, blue, 1),
        (np.array(_GRID, dtype=float), np.array(_GRID, dtype=float), 1),
        (orange_mix, ink, 4),
    ]
    colors = np.concatenate([a + np.linspace(0.0, 1.0, n)[:, None] * (b - a) for a, b, n in ramps])
    colors = np.unique(colors.round().astype(np.uint8), axis=0)
    holder = Image.new("P", (1, 1))
    holder.putpalette(colors.tobytes())
    return holder


@cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    # Matplotlib brings this font along, so that pictures are the same on every machine.
    path = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
    return ImageFont.truetype(path, size, layout_engine=ImageFont.Layout.BASIC)


def _array(value: npt.ArrayLike, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """`value` as finite float64 of a shape in which None stands for any length."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise GendomError("is no array of numbers", where=name, fix="give numbers") from None
    wanted = f"[{', '.join('n' if n is None else str(n) for n in shape)}]"
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=False)
    ):
        raise GendomError(f"has shape {list(array.shape)}", where=name, fix=f"give {wanted}")
    if not np.isfinite(array).all():
        raise GendomError("holds NaN or infinity", where=name, fix="leave those points out")
    return array


def _check_count(values: Sequence | np.ndarray, name: str, frames: int) -> None:
    if len(values) != frames:
        raise GendomError(
            f"has {len(values)} frames, but times has {frames}", where=name, fix="give one each"
        )


def _corners(box: np.ndarray) -> np.ndarray:
    """[8, 3] corners of a box given by two opposite ones [2, 3]."""
    return np.array(
        [[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )


def _nice_step(at_least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is not below `at_least`."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _blend(canvas: np.ndarray, opacity: np.ndarray, color: tuple[int, int, int]) -> None:
    """Lay a colour over [h, w, 3], with opacity [h, w]."""
    canvas += opacity[..., None] * (np.array(color, dtype=np.float32) - canvas)


def _stroke(
    canvas: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    half_width: float,
    color: tuple[int, int, int],
) -> None:
    """A smooth line between two points in pixels."""
    height, width = canvas.shape[:2]
    reach = half_width + 1.0
    low = np.floor(np.minimum(start, end) - reach).astype(int)
    high = np.ceil(np.maximum(start, end) + reach).astype(int)
    x0, y0 = np.clip(low, 0, [width, height])
    x1, y1 = np.clip(high, 0, [width, height])
    if x0 >= x1 or y0 >= y1:
        return
    y, x = np.mgrid[y0:y1, x0:x1] + 0.5
    along = end - start
    length2 = max(float(along @ along), 1e-12)
    s = np.clip(((x - start[0]) * along[0] + (y - start[1]) * along[1]) / length2, 0.0, 1.0)
    distance = np.hypot(x - start[0] - s * along[0], y - start[1] - s * along[1])
    opacity = np.clip(half_width + 0.5 - distance, 0.0, 1.0).astype(np.float32)
    _blend(canvas[y0:y1, x0:x1], opacity, color)
