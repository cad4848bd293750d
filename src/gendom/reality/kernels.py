"""Loads of a rope's vertices, compiled: a rope has few, and NumPy's calls would take longer than
MuJoCo's step. `gendom.reality.air` and `gendom.reality.twist` have the formulas."""

# pyright: reportInvalidTypeForm=false

from typing import Any

import numpy as np
import warp as wp

from gendom.sim.device import load_kernels

wp.set_module_options({"enable_backward": False})

REAL = wp.float64
Vectors, Numbers = wp.array(dtype=wp.vec3d), wp.array(dtype=REAL)


@wp.kernel
def drag(x: Vectors, v: Vectors, factor: REAL, force: Vectors):
    """Of air on the vertices, added; the factor is -1/4 rho C d."""
    for i in range(x.shape[0] - 1):
        e = x[i + 1] - x[i]
        mean = REAL(0.5) * (v[i + 1] + v[i])
        length2 = wp.dot(e, e)
        across = mean - (wp.dot(mean, e) / length2) * e
        half = (factor * wp.sqrt(length2 * wp.dot(across, across))) * across
        force[i] = force[i] + half
        force[i + 1] = force[i + 1] + half


@wp.kernel
def twist(x: Vectors, clamp: Vectors, numbers: Numbers, force: Vectors, moment: Vectors):
    """Adds forces from the first clamped edge to the last; `clamp`: the first one's director, as
    the last has it, as carried there (set); `numbers`: stiffness, damping a step, angle (set)."""
    last = x.shape[0] - 2
    t = wp.normalize(x[1] - x[0])
    u = clamp[0] - wp.dot(clamp[0], t) * t
    # from edge to edge by the least turn
    for i in range(1, last + 1):
        to = wp.normalize(x[i + 1] - x[i])
        cosine, binormal = wp.dot(t, to), wp.cross(t, to)
        along = wp.dot(binormal, u) / (REAL(1.0) + cosine)
        u = cosine * u + wp.cross(binormal, u) + along * binormal
        t = to
    u = wp.normalize(u)
    clamp[2] = u
    whole = REAL(2.0) * REAL(wp.PI)
    angle = wp.atan2(wp.dot(wp.cross(u, clamp[1]), t), wp.dot(u, clamp[1]))
    angle = angle + whole * wp.round((numbers[2] - angle) / whole)
    size = numbers[0] * angle + numbers[1] * (angle - numbers[2])
    numbers[2] = angle
    moment[0] = -size * t
    for i in range(1, last + 1):
        a, b = x[i] - x[i - 1], x[i + 1] - x[i]
        la, lb = wp.length(a), wp.length(b)
        half = (size / (la * lb + wp.dot(a, b))) * wp.cross(a, b)
        force[i - 1] = force[i - 1] + half / la
        force[i] = force[i] - half / la + half / lb
        force[i + 1] = force[i + 1] - half / lb


def bound(kernel: Any, *given: Any) -> Any:
    """A launch of a kernel, to be repeated, on the memory of NumPy's arrays [..., 3] or [N]."""
    load_kernels(kernel.module, "cpu")
    own = [wp.array(a, dtype=wp.vec3d if a.ndim > 1 else REAL, device="cpu", copy=False)
           if isinstance(a, np.ndarray) else a for a in given]  # fmt: skip
    return wp.launch(kernel, dim=1, inputs=own, device="cpu", record_cmd=True)
