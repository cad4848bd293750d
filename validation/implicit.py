"""Implicit steps of rods: their order, what they take of vibrations, and friction."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import AIR_DENSITY, Gripper, Table, rope
from validation.bench import WEIGHTLESS, Bench, Row, absolute, case, relative
from validation.references import round_frequency

LENGTH, DIAMETER, HELD = 0.3, 0.01, 0.03
"""Of the rope, and how much of it a hand holds [m]."""

ORDER = "order 2 (Alexander 1977, two stages); against explicit steps a thirtieth as long"
KEPT = (
    "a step multiplies a vibration by R(i omega h), R(z) = (1 + (1 - 2 g) z) / (1 - g z)^2, "
    "g = 1 - sqrt(1/2) (Alexander 1977); omega of a beam's first mode"
)
SLIDES = "(g_x - mu g_z) t^2 / 2 down a slope (Coulomb)"


@case("rod-implicit", "implicit steps", "thin")
def implicit_steps(bench: Bench) -> list[Row]:
    """A rope that a hand leads and turns about; one that rings; one on a slope."""
    body = rope(diameter=DIAMETER, length=LENGTH, start=(0, 0, 0.2), points=21)
    t = np.linspace(0.0, 0.5, 201)[:, None]
    way = 1.0 - np.cos(6.0 * t)
    hand = Gripper(
        time=t[:, 0], position=body.points[0] + way * [0.02, 0.05, 0.03],
        quat_xyzw=Rotation.from_rotvec(way * [0.8, 0.5, 0.3]).as_quat(), radius=0.02,
    )  # fmt: skip

    def moved(**options: object) -> NDArray[np.floating]:
        given = {"dtype": "float64", "grippers": [hand], "air_density": AIR_DENSITY} | options
        return bench.simulate(body, [Material(E=5e5, damping=0.005)], **given).run([0.1, 0.2, 0.3])

    exact = moved(cfl=0.04)
    lengths = (0.002, 0.001, 0.0005)
    errors = [float(np.abs(moved(integrator="implicit", substep=h) - exact).max()) for h in lengths]
    rows = []
    for h, (coarse, fine) in zip(lengths, pairwise(errors), strict=False):
        name = f"order of implicit steps, {1e3 * h:g} to {500 * h:g} ms"
        rows.append(absolute(name, "-", 2.0, math.log2(coarse / fine), 0.25, ORDER))
    return [*rows, *_rings(bench), *_slides(bench)]


def _rings(bench: Bench) -> list[Row]:
    """A clamped rope in vacuum that is pushed: what 1.4 s leave of its slowest vibration."""
    body = rope(diameter=DIAMETER, length=LENGTH, points=31)
    material = Material(E=2e8)
    count, frame = 280, 0.01
    omega = round_frequency(material, DIAMETER / 4.0, LENGTH - HELD)
    along = np.clip((body.points[:, 0] - HELD) / (LENGTH - HELD), 0.0, 1.0)

    def kept(h: float) -> float:
        s = bench.simulate(
            body, [material], dtype="float64", gravity=WEIGHTLESS,
            grippers=[Gripper.still(body.points[0], radius=HELD)], integrator="implicit", substep=h,
        )  # fmt: skip
        s.set_velocities(0.02 * along[:, None] ** 2 * np.array([0.0, 0.0, 1.0]))
        tip = s.run(frame * np.arange(1, count + 1), particles=[30])[:, 0, 0, 2]
        first, second = (
            np.abs(np.fft.rfft(half * np.hanning(count // 2))).max() for half in tip.reshape(2, -1)
        )
        return float(second / first)

    rows = []
    for h in (0.01, 0.005):
        z = 1j * omega * h
        g = 1.0 - math.sqrt(0.5)
        left = abs((1.0 + (1.0 - 2.0 * g) * z) / (1.0 - g * z) ** 2) ** (count * frame / 2.0 / h)
        name = f"what implicit steps of {1e3 * h:g} ms leave of 12 swings"
        rows.append(relative(name, "-", left, kept(h), 0.003, KEPT))
    return rows


def _slides(bench: Bench) -> list[Row]:
    """Ropes on a slope on which they slide, or stick."""
    body = rope(diameter=DIAMETER, length=LENGTH, start=(0, 0, DIAMETER / 2.0), points=21)
    rows = []
    for mu in (0.2, 0.6):
        s = bench.simulate(
            body, [Material(E=2e6, damping=0.005)], dtype="float64",
            table=Table(height=0.0, friction=mu), gravity=(4.0, 0.0, -9.0), integrator="implicit",
        )  # fmt: skip
        x = s.run([0.4])[0, 0] - body.points
        expected, found = 500.0 * max(0.0, 4.0 - mu * 9.0) * 0.4**2, 1e3 * float(x[:, 0].mean())
        name = f"way down a slope by implicit steps, friction {mu:g}"
        rows.append(absolute(name, "mm", expected, found, 0.3, SLIDES))
    return rows
