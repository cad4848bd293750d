"""Where a recorded object lies at rest, and what of it is held: the simulation's initial state."""

import math

import numpy as np
from numpy.typing import NDArray

from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.sim import Body, cloth, rope

ASSUMED_THICKNESS = 0.003
"""Thickness of a cloth that the recording does not state [m]. Of sheets that bend alike a thicker
one gives way more in its plane, as what is woven does."""

CLOTH_CELLS = 14
"""Grid cells along a cloth's longer side at full resolution."""


def place(
    recording: Recording, cells_across: float, notes: list[str]
) -> tuple[Body, NDArray[np.floating]]:
    """The object at rest on its table.

    A rope lies along its visible centre line, from the gripper on, as long as stated; a cloth is
    the flat square that holds most of the recorded points.

    Args:
        recording: What was seen.
        cells_across: Grid cells across a rope's diameter; cloths scale with it.
        notes: What was assumed is added to these.

    Returns:
        The body and the held points [G, 3] [m].

    Raises:
        RecordingError: If the recording shows too little to place the object.
    """
    if recording.object.kind == "rope":
        return _place_rope(recording, cells_across, notes)
    if recording.object.kind == "cloth":
        return _place_cloth(recording, cells_across, notes)
    raise RecordingError(
        f"objects of kind {recording.object.kind!r} cannot be simulated",
        where="meta.object.kind",
        fix="use rope or cloth",
    )


def _shown(recording: Recording) -> list[int]:
    """Frames that hold a point."""
    return [t for t in range(recording.num_frames) if recording.frame_valid[t]]


def _place_rope(
    recording: Recording, cells_across: float, notes: list[str]
) -> tuple[Body, NDArray[np.floating]]:
    """The rope along its centre line and the held points [G, 3]."""
    frames = _shown(recording)
    described = recording.object
    assert described.length is not None  # the recording's own check
    diameter = described.diameter
    if diameter is None:
        diameter = described.length / 50.0
        notes.append(f"diameter not stated: {diameter:.4g} m assumed (length / 50)")
    grip = recording.gripper_position[frames[0]]
    if len(grip) > 1:
        line = _line_between(recording, grip, notes)
        start = 0.0
    else:
        line = _line_from(recording, grip[0], diameter, described.length)
        start = diameter / 2.0
    body = rope(
        diameter=diameter,
        length=described.length,
        centre_line=line,
        cells_across=cells_across,
    )
    ends = [start] if len(grip) == 1 else [start, described.length]
    return body, _centre_at(body, np.array(ends))


def _line_from(
    recording: Recording, grip: NDArray, diameter: float, length: float
) -> NDArray[np.floating]:
    """Centre line of a rope at rest, from half a diameter behind the gripper on."""
    frames = _shown(recording)
    early = _early_points(recording, diameter)
    flat = early[:, :2] - grip[:2]
    far = flat[np.linalg.norm(flat, axis=1) > 0.25 * length]
    if len(far) < 5:
        raise RecordingError(
            "the first frames show too little of the rope to tell which way it lies",
            where=f"frames {frames[0]}-{frames[min(9, len(frames) - 1)]}",
            fix="record from the rope at rest on",
        )
    axis = far.mean(axis=0) / np.linalg.norm(far.mean(axis=0))
    side = np.array([-axis[1], axis[0]])
    along, across = flat @ axis, flat @ side
    # bends of the visible line, held straight where a hole in the cloud leaves it open
    fit = np.polynomial.Polynomial.fit(along, across, 2, domain=[0.0, length])
    keep = np.abs(across - fit(along)) < 2.0 * np.std(across - fit(along)) + 1e-6
    fit = np.polynomial.Polynomial.fit(along[keep], across[keep], 2, domain=[0.0, length])
    s = np.linspace(-diameter / 2.0, length, 60)
    inside = np.clip(s, along.min(), along.max())
    curve = fit(inside) + fit.deriv()(inside) * (s - inside)
    height = float(np.median(early[:, 2])) - diameter / 2.0
    if recording.table_height is not None:
        height = recording.table_height + diameter / 2.0
    xy = grip[:2] + s[:, None] * axis + curve[:, None] * side
    return np.concatenate([xy, np.full((len(s), 1), height)], axis=1)


def _line_between(recording: Recording, grip: NDArray, notes: list[str]) -> NDArray[np.floating]:
    """Centre line of a rope held at both ends, from the first frame."""
    frames = _shown(recording)
    cloud = recording.frame(frames[0]).astype(float)
    if not recording.extra.get("ordered_markers", False):
        axis = (grip[1] - grip[0]) / np.linalg.norm(grip[1] - grip[0])
        cloud = cloud[np.argsort((cloud - grip[0]) @ axis)]
        bins = np.array_split(cloud, min(24, max(2, len(cloud) // 4)))
        cloud = np.array([b.mean(axis=0) for b in bins])
    elif np.linalg.norm(cloud[0] - grip[0]) > np.linalg.norm(cloud[-1] - grip[0]):
        cloud = cloud[::-1]
    notes.append("held at both ends: its first shape is taken as free of stress")
    return cloud


def _place_cloth(
    recording: Recording, cells_across: float, notes: list[str]
) -> tuple[Body, NDArray[np.floating]]:
    """The flat cloth and the held point [1, 3]."""
    frames = _shown(recording)
    described = recording.object
    width, height = described.width, described.height
    assert width is not None and height is not None  # the recording's own check
    thickness = described.thickness
    if thickness is None:
        thickness = ASSUMED_THICKNESS
        notes.append(f"thickness not stated: {thickness * 1e3:.3g} mm assumed")
    dx = max(width, height) / CLOTH_CELLS * 1.5 / cells_across
    grip = recording.gripper_position[frames[0], 0]
    yaw = _cloth_yaw(recording, width, height)
    low = recording.table_height
    if low is None:
        low = float(np.percentile(_early_points(recording, dx)[:, 2], 5))
    mid = low + thickness / 2.0
    local = np.zeros(2) if described.grasp == "corner" else np.array([width, height]) / 2
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    corner = np.append(grip[:2] - turn @ local, mid)
    body = cloth(width=width, height=height, thickness=thickness, dx=dx, corner=corner, yaw=yaw)
    return body, np.array([[grip[0], grip[1], mid]])


def _cloth_yaw(recording: Recording, width: float, height: float) -> float:
    """Turn of the flat cloth about the held point.

    Held by a corner it hangs evenly about its diagonal, so the diagonal points to where the
    lifted cloud is. Held elsewhere, the turn whose footprint holds the low points best.
    """
    frames = _shown(recording)
    grip = recording.gripper_position[frames[0], 0]
    if recording.object.grasp == "corner":
        later = frames[len(frames) // 2 :]
        towards = [recording.frame(t)[:, :2].mean(axis=0) - grip[:2] for t in later]
        x, y = np.median(np.array(towards, dtype=float), axis=0)
        return math.atan2(y, x) - math.atan2(height, width)
    points = np.concatenate([recording.frame(t) for t in frames]).astype(float)
    base = recording.table_height if recording.table_height is not None else points[:, 2].min()
    low = points[points[:, 2] < base + 0.15 * max(width, height)]
    flat = (low if len(low) > 50 else points)[:, :2] - grip[:2]
    turns = np.linspace(0.0, math.pi, 72, endpoint=False)

    def outside(yaw: float) -> float:
        c, s = math.cos(yaw), math.sin(yaw)
        local = np.abs(flat @ np.array([[c, -s], [s, c]])) - np.array([width, height]) / 2
        return float(np.linalg.norm(np.maximum(local, 0.0), axis=1).mean())

    return float(min(turns, key=outside))


def _early_points(recording: Recording, size: float) -> NDArray[np.floating]:
    """Points of the frames before the gripper has moved by ``size`` [m]."""
    frames = _shown(recording)
    path = recording.gripper_position[:, 0]
    moved = np.linalg.norm(path - path[frames[0]], axis=1)
    early = [t for t in frames if moved[t] <= size] or frames[:1]
    return np.concatenate([recording.frame(t) for t in early]).astype(float)


def _centre_at(body: Body, along: NDArray[np.floating]) -> NDArray[np.floating]:
    """[K, 3] points of a rope's centre line at distances [K] from its first end [m]."""
    s, section = np.unique(body.material_coordinates[:, 0], return_inverse=True)
    count = np.bincount(section)
    centre = [np.bincount(section, body.x[:, a]) / count for a in range(3)]
    return np.stack([np.interp(along, s, c) for c in centre], axis=-1)
