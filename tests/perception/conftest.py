"""A small ray caster: sheets and ropes of known shape as depth and colour pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from gendom import cli
from gendom.perception import Camera, Frame, Pictures, PngWriter
from gendom.reality import looking_at
from gendom.reality.sensor import BASELINE


@dataclass(frozen=True)
class Sensor:
    """Only white noise and steps of the disparity [pixel], and noise of the colour."""

    subpixel: float = 0.0
    quantisation: float = 0.0

    def observe(self, depth, colour, camera, rng):
        if self.quantisation:
            fB = camera.K[0, 0] * BASELINE
            disparity = np.divide(fB, depth, out=np.zeros_like(depth), where=depth > 0.0)
            noisy = disparity + self.subpixel * rng.standard_normal(depth.shape)
            noisy = np.round(noisy / self.quantisation) * self.quantisation
            seen = (depth > 0.0) & (noisy > 0.0)
            depth = np.divide(fB, noisy, out=np.zeros_like(depth), where=seen)
        colour = np.clip(np.rint(colour + 3.0 * rng.standard_normal(colour.shape)), 0.0, 255.0)
        counts = np.round(depth / camera.depth_unit)
        return Pictures(np.where(counts < 65536, counts, 0).astype("u2"), colour.astype("u1"))


EXACT = Sensor()
NOISE = Sensor(subpixel=0.08, quantisation=1.0 / 32.0)
RED, BLUE, GREY = (180, 30, 35), (30, 60, 170), (150, 150, 145)


def make_camera(name="left", eye=(0.0, -0.65, 0.47), target=(0.0, 0.0, 0.1), **other):
    """A D435i-like camera, 0.8 m from the middle; `scale` 0.5 halves the picture."""
    scale = other.pop("scale", 1.0)
    width, height, f = int(640 * scale), int(480 * scale), 385.0 * scale
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])
    values = {"depth_unit": 1e-4, "T_world_camera": looking_at(eye, target), **other}
    return Camera(name=name, width=width, height=height, K=K, **values)


@dataclass
class Rope:
    """A chain of capsules along points [M, 3]: with two a robot's link. Rays: 1 long or longer."""

    line: np.ndarray
    radius: float = 0.005
    colour: tuple = RED

    def hit(self, origin, d):
        t = np.full(len(d), np.inf)
        for a, b in pairwise(np.asarray(self.line) - origin):
            # Only rays near the link are worth the work.
            middle, reach = (a + b) / 2, np.linalg.norm(b - a) / 2 + self.radius
            near = np.flatnonzero(d @ middle >= max(middle @ middle - reach**2, 0.0) ** 0.5)
            t[near] = np.minimum(t[near], _capsule(-a, b - a, self.radius, d[near]))
        return t

    def distance(self, p):
        nearest = np.full(len(p), np.inf)
        for a, b in pairwise(self.line):
            w = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[:, None]
            nearest = np.minimum(nearest, np.linalg.norm(p - a - w * (b - a), axis=1))
        return nearest - self.radius


def _capsule(o, axis, radius, d):
    """Ray parameters of a capsule from 0 along `axis`; rays start at o."""
    length2 = axis @ axis
    du, ou = d @ axis / length2, o @ axis / length2
    dp, op = d - du[:, None] * axis, o - ou * axis
    a, b, c = (dp * dp).sum(1), dp @ op, op @ op - radius**2
    root, da = b * b - a * c, (d * d).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        u = ou + np.where(np.isfinite(t), t, 0) * du
    t = np.where((u >= 0) & (u <= 1), t, np.inf)
    for end in (np.zeros(3), axis):
        b = d @ (o - end)
        root = b * b - da * ((o - end) @ (o - end) - radius**2)
        t = np.minimum(t, np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / da, np.inf))
    return t


@dataclass
class Sheet:
    """A flat cloth: a corner and two sides [3] at right angles."""

    corner: tuple
    u: tuple
    v: tuple
    colour: tuple = BLUE

    def hit(self, origin, d):
        n = np.cross(self.u, self.v)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (np.array(self.corner) - origin) @ n / (d @ n)
            p = origin + t[:, None] * d - np.array(self.corner)
            inside = t > 0
            for side in (self.u, self.v):
                along = p @ np.array(side) / np.dot(side, side)
                inside &= (along >= 0) & (along <= 1)
        return np.where(inside, t, np.inf)

    def distance(self, p):
        n = np.cross(self.u, self.v)
        return (p - np.array(self.corner)) @ (n / np.linalg.norm(n))


def Plane(height=0.0, colour=GREY):
    """z = height, as far as the eye reaches."""
    return Sheet((-50.0, -50.0, height), (100.0, 0.0, 0.0), (0.0, 100.0, 0.0), colour)


@dataclass
class Scene:
    things: list = field(default_factory=list)

    def pictures(self, camera, *, sensor=NOISE, seed=0, farthest=8.0):
        """What a camera with such a sensor sees."""
        R, origin = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
        d = camera.rays() @ R.T
        far = np.linalg.norm(d, axis=1)
        d /= far[:, None]
        z, which = np.full(len(d), np.inf), np.zeros(len(d), int)
        for k, thing in enumerate(self.things):
            t = thing.hit(origin, d) / far
            which[t < z] = k
            z = np.minimum(z, t)
        rng = np.random.default_rng(seed)
        colours = np.array([thing.colour for thing in self.things])[which].astype(float)
        colours = np.clip(colours * rng.uniform(0.75, 1.1, (len(z), 1)), 0, 255)
        colours[np.isinf(z)] = 0
        shape = camera.height, camera.width
        depth = np.where(z < farthest, z, 0.0).reshape(shape)
        return sensor.observe(depth, colours.astype(np.uint8).reshape(*shape, 3), camera, rng)


class Live:
    """A camera that renders a scene when asked, as a device or a vendor's recording would deliver;
    its pose may be stated wrongly."""

    def __init__(self, camera, scene, frames, stated=None):
        self.camera, self._frames, self.decoded = stated or camera, frames, 0
        self._render = cache(lambda key: scene(key).pictures(camera, seed=key))

    def __iter__(self):
        for t in range(self._frames):
            yield Frame(t / 30, f"frame {t}", lambda t=t: self._read(t))

    def _read(self, t):
        self.decoded += 1
        return self._render(t)


def depth_rms(camera, z, sensor=NOISE):
    """RMS of a sensor's noise at depth z [m], steps included: z^2 s / (f B)."""
    s = np.hypot(sensor.subpixel, sensor.quantisation / np.sqrt(12))
    return z**2 * s / (camera.K[0, 0] * BASELINE)


def lifted_rope(tip=(0.0, 0.0, 0.3), length=0.4, radius=0.005, colour=RED):
    """A rope that hangs from its tip on an arc down to the table and lies on it along x."""
    bend = 0.08
    down = tip[2] - bend - radius
    angle = np.linspace(0, np.pi / 2, 15)
    x, z = bend - bend * np.cos(angle), bend + radius - bend * np.sin(angle)
    arc = np.stack([x, 0 * angle, z], axis=1)
    rest = max(length - down - bend * np.pi / 2, 0.01)
    ends = [0, 0, bend + radius + down], [bend + rest, 0, radius]
    line = np.concatenate([ends[:1], arc, ends[1:]])
    return Rope(line + np.array([tip[0], tip[1], 0.0]), radius, colour)


def pair(scale=0.5):
    """Two cameras on both sides of the lift."""
    return [
        make_camera("left", scale=scale),
        make_camera("right", eye=(0.1, 0.65, 0.47), scale=scale),
    ]


def write_lift(
    folder, *, frames=6, scale=0.5, sensor=NOISE, cameras=None, things=lambda t: [], rope=True
):
    """A recording of a rope's lift by two cameras, and the ropes.

    Args:
        cameras: Those that see it.
        things: More in the scene, function (frame) -> list.
        rope: False leaves the rope out.
    """
    cameras = cameras or pair(scale)
    ropes = [lifted_rope(tip=(0.0, 0.0, 0.2 + 0.01 * t)) for t in range(frames)]
    for k, camera in enumerate(cameras):
        writer = PngWriter(folder / "cameras" / camera.name, camera)
        for t, held in enumerate(ropes):
            scene = Scene([Plane(), *things(t), *([held] if rope else [])])
            writer.write(t / 30.0, scene.pictures(camera, sensor=sensor, seed=100 * k + t))
    rows = [f"{t / 30.0!r},0.0,0.0,{0.2 + 0.01 * t!r}" for t in range(frames)]
    (folder / "gripper.csv").write_text("\n".join(["time,x,y,z", *rows]) + "\n")
    (folder / "object.toml").write_text(
        'table_height = 0.0\ngripper_source = "measured"\n'
        '[object]\nkind = "rope"\nlength = 0.4\ndiameter = 0.01\n'
    )
    return ropes


@pytest.fixture
def command(tmp_path, capsys):
    """Function (folder, flags) of `gendom perceive` -> its code, what was printed, and the file."""

    def run(folder, *words, out="recording.npz"):
        out = tmp_path / "out" / out
        code = cli.main(["perceive", str(folder), "--out", str(out), *map(str, words)])
        return code, capsys.readouterr(), out

    return run


@pytest.fixture(scope="session")
def world():
    """The names above."""
    return SimpleNamespace(**{k: v for k, v in globals().items() if not k.startswith("_")})
