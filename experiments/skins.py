"""Derivatives through the skin of ropes, which losses on points of the skin have."""

from __future__ import annotations

import math

import numpy as np

from gendom.arrays import Array
from gendom.sim import Body
from gendom.sim.lines import fixed_frame


def surface_transpose(body: Body, x: Array, bar: Array) -> Array:
    """Derivative of a loss with respect to positions, given that with respect to the surface.

    Args:
        body: A rope or a cloth.
        x: [..., N, 3] particles, or the thin engine's points [m].
        bar: [..., M, 3] derivative of the loss with respect to ``body.surface(x)`` [1/m].

    Returns:
        [..., N, 3] [1/m].
    """
    if body.kind != "rope":
        return bar
    if x.shape[-2] != body.num_particles:
        return _rod_transpose(body.points, body.thickness, x, bar)
    sections = x.reshape(*x.shape[:-2], -1, body.section, 3)
    radius = np.linalg.norm(body.material_coordinates[: body.section, 1:], axis=1)
    outer = radius > 0.6 * radius.max()  # as in `Body.surface`
    out = (sections - sections.mean(axis=-2, keepdims=True))[..., outer, :]
    length = np.linalg.norm(out, axis=-1, keepdims=True)
    unit = out / length
    bar = bar.reshape(out.shape)
    # skin = centre + r unit
    along = (unit * bar).sum(axis=-1, keepdims=True)
    of_out = (bar - unit * along) * (body.thickness / 2.0 / length)
    found = np.zeros(sections.shape)
    found[..., outer, :] = of_out
    found += (bar - of_out).sum(axis=-2, keepdims=True) / body.section
    return found.reshape(x.shape)


def _rod_transpose(points: Array, thickness: float, x: Array, bar: Array) -> Array:
    """The same of a rod: of ``gendom.sim.lines.around``."""
    n, lead = x.shape[-2], x.shape[:-2]
    bar = bar.reshape(*lead, n - 1, -1, 8, 3)
    parts = bar.shape[-3]
    share = (np.arange(parts) + 0.5)[:, None] / parts
    step = np.diff(x, axis=-2)
    size = np.linalg.norm(step, axis=-1, keepdims=True)
    tangent = step / size
    *first, axis = fixed_frame(points[1] - points[0])
    angle = 2.0 * math.pi * np.arange(8) / 8.0
    each = 0.5 * thickness * bar.sum(axis=-3)
    along, scale = tangent + axis, np.maximum(1.0 + tangent @ axis, 1e-9)[..., None]
    of_tangent = np.zeros(tangent.shape)
    for d, turn in zip(first, (np.cos(angle), np.sin(angle)), strict=True):
        # normal = d - (t . d) / (1 + t . axis) (t + axis)
        g = (each * turn[:, None]).sum(axis=-2)
        pull, off = (g * along).sum(axis=-1, keepdims=True), (tangent @ d)[..., None]
        of_tangent += axis * off * pull / scale**2 - d * pull / scale - g * off / scale
    of_step = (of_tangent - tangent * (tangent * of_tangent).sum(axis=-1, keepdims=True)) / size
    of_centre = bar.sum(axis=-2)
    of_step += (share * of_centre).sum(axis=-2)
    found = np.zeros(x.shape)
    found[..., :-1, :] = of_centre.sum(axis=-2) - of_step
    found[..., 1:, :] += of_step
    return found
