"""Pictures and films of what the viewer shows, drawn from where its camera stands."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gendom.errors import DeviceError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.viz.clouds import CloudSequence
from gendom.viz.palette import (
    INK,
    RECORDED_COLOR,
    RECORDED_OPACITY,
    SIMULATED_COLOR,
    SIMULATED_OPACITY,
    TABLE_FILL,
    TABLE_LINE,
    rgb,
)
from gendom.viz.viewer.scenes import (
    Array,
    Layer,
    ViewerScene,
    camera_of,
    goal_layer,
    gripper_layer,
    tiles_of,
)

SIZE = (640, 480)
"""Of a picture [pixels]."""

FRAMES = 60
"""Of longer sequences of clouds evenly spaced frames are shown."""

FRAME_TIME = 80
"""How long a frame of them is shown [ms]; the last is shown for a second more."""

_COLORS = 128
"""Colours of an animation; all its frames have the same, or they would flicker."""

_SMOOTH = 2
"""Pixels that are drawn along one of the picture, so that edges are smooth."""

_TOP, _SIDE = 19, 24
"""Middle of the line of text, and what is left free beside it [pixels]."""

_LIGHT = np.array([0.3, -0.5, 0.8]) / math.sqrt(0.98)
"""Where the light comes from."""


class Stage:
    """Draws the frames of a scene, all from one place: surfaces and lines, then dots.

    Args:
        scene: What is drawn.
        distance: Name of a distance that is written above, and its values [T] [m].

    Raises:
        ParameterError: The scene has no points.
    """

    def __init__(self, scene: ViewerScene, distance: tuple[str, Array] | None = None):
        self.scene, self.distance = scene, distance
        eye, at = camera_of(scene)
        ahead = (at - eye) / np.linalg.norm(at - eye)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._eye, self._axes = eye, np.stack([right, np.cross(right, ahead), ahead])
        low, high = scene.box
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                            for z in (low[2], high[2])])  # fmt: skip
        self._scale, self._shift = 1.0, np.zeros(2)
        flat = self._seen(corners)[0][:, :2] / _SMOOTH
        span = np.maximum(np.ptp(flat, axis=0), 1e-9)
        room = np.array(SIZE) - [2 * _SIDE, 2 * _SIDE + 2 * _TOP]
        self._scale = float((room / span).min())
        middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
        self._shift = 0.5 * np.array(SIZE) + [0.0, _TOP] - self._scale * middle

    def draw(self, frame: int) -> Image.Image:
        """A frame as an RGB image."""
        image = Image.new("RGB", (_SMOOTH * SIZE[0], _SMOOTH * SIZE[1]), "white")
        pen, layers = ImageDraw.Draw(image), self.scene.layers
        for tile in self._seen(tiles_of(self.scene))[0].tolist():
            pen.polygon([(x, y) for x, y, _ in tile], TABLE_FILL, TABLE_LINE)
        shapes = [shape for layer in layers for shape in self._shapes(layer, frame)]
        image = Image.fromarray(self._over(np.asarray(image), shapes))
        for layer in layers:
            if layer.kind == "dots":
                self._dots(image, layer, frame)
        image = image.reduce(_SMOOTH)
        self._letter(ImageDraw.Draw(image), frame)
        return image

    def _seen(self, x: Array) -> tuple[Array, Array]:
        """Where places [..., 3] are in the picture that is drawn, y downwards [pixels], and how far
        away [m], [..., 3]; how large a metre is there [...] [pixels]."""
        at = (np.asarray(x, dtype=float) - self._eye) @ self._axes.T
        per_metre = _SMOOTH * self._scale / np.maximum(at[..., 2], 1e-6)
        flat = at[..., :2] * (per_metre[..., None] * [1.0, -1.0]) + _SMOOTH * self._shift
        return np.concatenate([flat, at[..., 2:]], axis=-1), per_metre

    def _shapes(self, layer: Layer, frame: int) -> Iterator[tuple[Array, Array]]:
        """Triangles [F, 3, 3] as they are seen, and their colours [F, 3], of surfaces and lines."""
        points, color = layer.at(frame).astype(float), np.array(rgb(layer.color), dtype=float)
        seen, per_metre = self._seen(points)
        if layer.kind == "surface":
            corners = points[layer.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            size = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
            light = 0.55 + 0.45 * np.abs(normal @ _LIGHT) / size
            shown = np.full(len(normal), True)
            if layer.closed:  # what is turned away is hidden
                shown = np.sum(normal * (corners[:, 0] - self._eye), axis=1) < 0.0
            yield seen[layer.faces[shown]], light[shown, None] * color
        elif layer.kind == "lines":
            along = np.diff(seen[..., :2], axis=1)
            side = along[..., ::-1] * [-1.0, 1.0]
            side /= np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9)
            wide = np.zeros(seen.shape)
            wide[..., :2] = layer.radius * per_metre[..., None] * side
            (a, b), (d, c) = (np.swapaxes(seen + s * wide, 0, 1) for s in (1.0, -1.0))
            both = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
            yield both, np.tile(color, (len(both), 1))

    def _over(self, picture: NDArray[np.uint8], shapes: list[tuple[Array, Array]]) -> Any:
        """A picture with triangles before it. Places that fill them densely are put into its pixels
        from the farthest to the nearest one."""
        height, width = picture.shape[:2]
        flat, places, colors = picture.reshape(-1, 3).copy(), [], []
        for corners, color in shapes:
            edges = np.linalg.norm(corners[..., :2] - np.roll(corners, 1, axis=1)[..., :2], axis=2)
            fine = np.ceil(np.maximum(1.2 * edges.max(axis=1), 1.0)).astype(int)
            for n in np.unique(fine):
                own = np.flatnonzero(fine == n)
                i, j = np.triu_indices(n + 1)
                share = np.stack([1.0 - j / n, (j - i) / n, i / n], axis=1)
                share = share.astype(np.float32)
                places.append((share @ corners[own].astype(np.float32)).reshape(-1, 3))
                colors.append(np.repeat(color[own].astype(np.uint8), len(share), axis=0))
        if places:
            at, paint = np.concatenate(places), np.concatenate(colors)
            x, y = np.floor(at[:, :2]).astype(int).T
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            order = np.flatnonzero(inside)[np.argsort(-at[inside, 2])]
            flat[y[order] * width + x[order]] = paint[order]
        return flat.reshape(picture.shape)

    def _dots(self, image: Image.Image, layer: Layer, frame: int) -> None:
        """The union of a layer's dots, so that a dense cloud is no darker than a thin one."""
        seen, per_metre = self._seen(layer.at(frame))
        mask = Image.new("L", image.size)
        pen, fill = ImageDraw.Draw(mask), round(255 * layer.opacity)
        radius = np.maximum(layer.radius * per_metre, 0.7 * _SMOOTH)
        for (x, y, _), r in zip(seen.tolist(), radius.tolist(), strict=True):
            pen.ellipse((x - r, y - r, x + r, y + r), fill=fill)
        if box := mask.getbbox():
            image.paste(rgb(layer.color), box, mask.crop(box))

    def _letter(self, pen: ImageDraw.ImageDraw, frame: int) -> None:
        """Time, frame and distance above the picture, and the legend beside them."""
        scene, font = self.scene, ImageFont.load_default(12)
        # The frame's number also keeps two equal frames from being merged into one.
        text = f"{scene.times[frame]:.2f} s   frame {frame + 1} of {scene.num_frames}"
        if self.distance is not None:
            text += f"   {self.distance[0]} {1e3 * self.distance[1][frame]:.1f} mm"
        pen.text((_SIDE, _TOP), text, fill=INK, font=font, anchor="lm")
        x = SIZE[0] - _SIDE
        for layer in reversed(scene.layers):
            pen.text((x, _TOP), layer.name, fill=INK, font=font, anchor="rm")
            x -= pen.textlength(layer.name, font=font) + 10
            pen.ellipse((x - 4, _TOP - 4, x + 4, _TOP + 4), fill=layer.color)
            x -= 18


def clouds_scene(clouds: CloudSequence, frames: Sequence[int]) -> ViewerScene:
    """Frames of a sequence of clouds as a scene; recorded dots are smaller where they are many."""
    low, high = clouds.box()
    size = float(np.linalg.norm(high - low))
    kinds = (
        (clouds.labels[1], SIMULATED_COLOR, SIMULATED_OPACITY, clouds.simulated, 0.005),
        (clouds.labels[0], RECORDED_COLOR, RECORDED_OPACITY, clouds.recorded, 0.004),
    )
    layers = []
    for name, color, opacity, every, dot in kinds:
        points = [every[t] for t in frames]
        most = max(len(cloud) for cloud in points)
        radius = dot * size * min(math.sqrt(500.0 / max(most, 1)), 1.0)
        layers.append(Layer(name=name, color=color, points=points, radius=radius, opacity=opacity))
    if clouds.goal is not None:
        layers.append(goal_layer(clouds.goal, size))
    if clouds.gripper is not None:
        layers.append(gripper_layer(clouds.gripper[list(frames)], 0.5 * size))
    return ViewerScene(
        times=clouds.times[list(frames)], layers=tuple(layers), table_height=clouds.table_height
    )


def write_gif(path: str | os.PathLike, clouds: CloudSequence) -> None:
    """Write both clouds over each other, frame by frame, as a GIF that repeats for ever.

    The file appears whole or not at all.

    Raises:
        GendomError: As `gendom.files.atomic_path`; or there are no points.
    """
    frames, known = clouds.spread(FRAMES), clouds.distance
    stage = Stage(clouds_scene(clouds, frames), known and (known[0], known[1][frames]))
    write_film(path, stage, range(len(frames)), FRAME_TIME)


def write_film(
    path: str | os.PathLike, stage: Stage, frames: Sequence[int], frame_time: int
) -> None:
    """Write frames of a stage as .gif or .mp4, each shown so long [ms]; the file appears whole or
    not at all.

    Raises:
        DeviceError: OpenCV is not installed, or cannot write .mp4.
        GendomError: As `gendom.files.atomic_path`; or there are no points.
    """
    images = [stage.draw(frame) for frame in frames]
    if Path(path).suffix.lower() == ".mp4":
        with atomic_path(path) as temporary:
            _write_mp4(temporary, images, 1e3 / frame_time)
        return
    some = [images[k] for k in (0, len(images) // 2, -1)]
    colors = Image.fromarray(np.concatenate([np.asarray(image) for image in some]))
    colors = colors.quantize(_COLORS, Image.Quantize.MAXCOVERAGE)
    images = [image.quantize(palette=colors, dither=Image.Dither.NONE) for image in images]
    buffer = io.BytesIO()
    # Left in place, a frame stores only the rectangle that changes.
    images[0].save(
        buffer,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=[frame_time] * (len(images) - 1) + [frame_time + 1000],
        loop=0,
        disposal=1,
        optimize=False,
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


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
