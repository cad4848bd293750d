"""The list of pairs that may come into contact is that of a search over all pairs."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.materials import Material
from gendom.robot.collision import segments_apart
from gendom.sim import Gripper, Physics, Simulator, Solver, Table, cloth, rope
from gendom.sim.thin.contact import edges_and_triangles, triangle_distance
from gendom.sim.thin.types import MARGIN

SOFT = Material(E=1e5, density=400.0, damping=0.01)


def settled(body, material, device, until, grippers=()):
    s = Simulator(
        body, [material], grippers=grippers, table=Table(height=0.0, friction=0.4),
        physics=Physics(self_contact=True), solver=Solver(device=device),
    )  # fmt: skip
    s.run([until])
    return s


def coil(device):
    """A rope that has fallen on itself."""
    falls = {"start": (0, 0, 0.82), "direction": (0.02, 0.01, -1), "points": 81}
    return settled(rope(diameter=0.01, length=0.8, **falls), replace(SOFT, E=2e4), device, 0.45)


def heap(device, **outline):
    """A cloth that has been let down on a table."""
    size = 0.165
    body = cloth(
        width=size, height=size, thickness=0.001, dx=0.02, points=(16, 16),
        corner=(-size / 2, -size / 2, 0.8 * size), **outline,
    )  # fmt: skip
    top = np.array([-0.06, 0.002, 0.8 * size])
    hand = Gripper(time=[0, 0.4, 0.9], position=[top, top, top * [1, 1, 0.1]], radius=0.012)
    return settled(body, SOFT, device, 1.0, [hand])


def heap_with_hole(device):
    square = [(0, 0), (0.165, 0), (0.165, 0.165), (0, 0.165)]
    return heap(device, outline=[square, np.array(square) / 3.0 + 0.055])


def listed(s):
    """Pairs that the engine has listed: of edges, and of a point and a triangle, as sets of the
    lattice's places; and the points [slots, 3] that it had listed them for."""
    b = s.engine.device_model
    front, back = b.near_count.numpy()[0]
    every = b.near.numpy()[0]
    codes = np.concatenate([every[:front], every[len(every) - back :]])
    p, pitch = codes // 4, b.pitch
    pairs = set()
    for (one, other), (a, c) in zip(codes % 4, p, strict=True):
        if one == 3:
            corner = c if other == 0 else c + pitch + 1
            pairs.add((a, frozenset({corner, c + 1, c + pitch})))
        else:
            pairs.add(frozenset({edge(a, one, pitch), edge(c, other, pitch)}))
    assert len(pairs) == len(codes)  # none twice
    return pairs, b.listed.numpy()[0].T[MARGIN:]


def edge(p, kind, pitch):
    if pitch == 0 or kind == 0:
        return frozenset({p, p + 1})
    return frozenset({p, p + pitch} if kind == 1 else {p + 1, p + pitch})


def features(s):
    """Points, edges and triangles by their slots, counted from the first."""
    at = s.engine.slots - MARGIN
    if s.engine.device_model.pitch == 0:
        return [], np.stack([at[:-1], at[1:]], axis=1), np.empty((0, 3), dtype=int)
    edges, triangles = edges_and_triangles(s.engine.model)
    return at.tolist(), at[edges], at[triangles]


def by_search(s, x):
    """All pairs nearer than the list reaches that share no point."""
    b = s.engine.device_model
    far = b.contact_distance + b.contact_margin
    (points, E, T), pairs = features(s), set()
    for k, (p, q) in enumerate(E.tolist()):
        rest = E[k + 1 :]
        rest = rest[~np.isin(rest, (p, q)).any(axis=1)]
        if not len(rest):
            continue
        near = segments_apart(x[p], x[q], x[rest[:, 0]], x[rest[:, 1]]) < far
        pairs |= {frozenset({frozenset({p, q}), frozenset(o)}) for o in rest[near].tolist()}
    reach = far + 2.0 * s.engine.model.widest
    for p in points:
        close = (np.linalg.norm(x[T] - x[p], axis=2).min(axis=1) < reach) & ~(T == p).any(axis=1)
        close[close] = triangle_distance(x[p], x[T[close]]) < far
        pairs |= {(p, frozenset(t)) for t in T[close].tolist()}
    return pairs


def apart(pair, s):
    """How far its points are from each other along the body, in columns or rows."""
    pitch = s.engine.device_model.pitch
    parts = list(pair) if isinstance(pair, frozenset) else [{pair[0]}, pair[1]]
    if pitch == 0:
        first, second = sorted(min(part) for part in parts)
        return second - first
    rows, columns = (
        [[f(p) for p in part] for part in parts]
        for f in (lambda p: p // pitch, lambda p: p % pitch)
    )
    return max(max(min(b) - max(a), min(a) - max(b)) for a, b in (tuple(rows), tuple(columns)))


@pytest.mark.parametrize(
    "device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)], ids=["cpu", "cuda"]
)
@pytest.mark.parametrize("scene", [coil, heap, heap_with_hole])
def test_listed_are_all_pairs_that_are_near(scene, device):
    s = scene(device)
    pairs, x = listed(s)
    expected = by_search(s, x)
    rod = s.engine.device_model.pitch == 0
    # neighbours along the body are left out unless they fold; other tests are for those
    sure = {p for p in expected if apart(p, s) >= (s.engine.model.apart if rod else 3)}
    assert len(sure) > 20
    assert sure <= pairs
    assert pairs <= expected
