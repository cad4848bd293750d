"""A rope in a cloud: the line of its length that begins where it is held.

What touches or crosses a rope, as a hand or a cable does, is no farther from it than its own parts,
and can cover as much. But a rope is one line of known length: from the point that is held the way
along the cloud to its tip is as long as the rope, and all its points lie beside that way. Where two
ways fit, nothing says which one is the rope. A rope that lies near itself is found by a way of the
shortest steps: as long as the rope, no thicker anywhere, and with hardly a point beside it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gendom.arrays import Array
from gendom.datasets import ObjectDescription

FAR = 0.02
"""Points farther than this from a rope's surface are not its own [m]."""

MOST_FAR = 0.05
"""Largest share of such points in a frame that is used."""

THICKEST = 0.07
"""Of its length, a rope of unknown diameter."""

_WHOLE = 0.88, 1.1  # of a rope's length: what is measured of one that is seen from end to end
_ALONE = 1.16  # of the length; nothing is beside the line, and the length is a tenth too short
_NODE = 0.01  # [m]; at least, between points of the way
_ROUND = 0.015  # [m]; at least, the distance over which noise is averaged
_MOST_NODES = 1500  # no rope has more
_FROM_HELD = 0.06  # [m]; at most, fingers hide so much of it
_STEP, _PIECE = 0.004, 5  # [m] along the way, and so many steps
_THICK = 1.6  # times the usual distance of points from it, a piece of a rope has not
_MOST_THICK = 1 / 3  # of the points beside it; a line with more is no rope's
_FINE_NODE, _FINE_ROUNDS = 0.007, (0.014, 0.01, 0.007)  # [m]; where a rope lies near itself
_AVOIDED = 6.0  # power of the steps there: a gap to the next turn costs more than the way around
_THIN = 3.0  # times the median distance of points from a way; a lone rope's are nearer to it


@dataclass(frozen=True, eq=False)
class Line:
    """What was found of a rope in a cloud."""

    length: float
    """[m] from end to end, as far as it is seen."""
    own: npt.NDArray[np.bool_]
    """[n] whether a point of the cloud is beside the line."""
    clear: bool
    """Whether no other line could be the rope."""


def find_line(
    points: Array, rope: ObjectDescription, held: Array | None = None, *, all_seen: bool = True
) -> Line:
    """The line of a rope, whose length is known, in a cloud [n, 3] [m].

    The cloud's points are averaged to nodes, and the way between two of them is the one of least
    squared steps: it follows the cloud where it is dense, and bridges gaps.

    Args:
        held: [3] where its end is held [m]; None: the longest line there is, however it is held.
        all_seen: False: a part of it may be missing, as what lies within a table's noise is; then
            what else is there may stand for that part.
    """
    length, none = rope.length or 0.0, np.ones(len(points), np.bool_)
    across = rope.diameter or THICKEST * length
    beside, reach = FAR + across / 2.0, max(across, _ROUND)
    least, most = (k * length for k in _WHOLE)
    ways = _Ways(_nodes(points, max(_NODE, across / 2.0), reach), held, reach)
    if not 1 < len(ways.nodes) <= _MOST_NODES:
        return Line(min(reach, length), none, clear=len(ways.nodes) < 2)
    nodes, seen, longest = ways.nodes, ways.seen, float(ways.seen.max())
    own = _away(points, ways.to(int(seen.argmax())))[0] <= beside
    alone = bool(longest <= _ALONE * length and np.mean(~own) <= MOST_FAR)
    explained = alone and longest >= least
    for finer in _FINE_ROUNDS if all_seen and not explained else ():
        near = _Ways(_nodes(points, _FINE_NODE, finer), held, finer, _AVOIDED)
        if least <= near.seen.max(initial=0.0) <= most and near.before <= _FROM_HELD:
            off, at = _away(points, near.to(int(near.seen.argmax())))
            thin = off <= min(max(_NODE, _THIN * np.median(off)), across / 2.0 + _NODE)
            if max(np.mean(~thin), np.mean(_thick(off, at, off <= beside))) <= MOST_FAR:
                return Line(float(near.seen.max()), off <= beside, clear=True)
    if alone or held is None:
        return Line(longest, own, clear=alone)
    goal = length if longest > most else longest
    goes_on = ((ways.steps <= beside) & (seen > seen[:, None])).any(axis=1)
    tips = np.flatnonzero((seen >= min(least, 0.9 * longest)) & (seen <= most) & ~goes_on)
    if not len(tips):  # it goes on: something touches its end
        tips = np.flatnonzero(np.abs(seen - goal) <= 2.0 * _NODE)
    if not len(tips):
        return Line(longest, none, clear=False)
    tip = tips[np.abs(seen[tips] - goal).argmin()]
    way = ways.to(tip)
    off, at = _away(points, way)
    own = off <= beside
    alike = _away(nodes[tips], way)[0].max() <= beside + MOST_FAR * length
    whole = seen[tip] >= least and ways.before <= _FROM_HELD
    thick = own & _thick(off, at, own)
    clear = alike and whole and all_seen and thick.sum() <= _MOST_THICK * own.sum()
    return Line(float(seen[tip]), own & ~thick, bool(clear))


class _Ways:
    """The ways from where a rope is held [3] [m], or from its end, along nodes [m, 3] that are
    averages over a reach [m]: of least steps to a power."""

    def __init__(self, nodes: Array, held: Array | None, reach: float, power: float = 2.0):
        self.nodes, self.before = nodes, reach / 2.0
        """[m] from the end to the first node: an average there lies half its reach before it."""
        self.seen = np.zeros(0)
        """[m] length of the way to each node [m]; empty if there are too few nodes or too many."""
        if not 1 < len(nodes) <= _MOST_NODES:
            return
        self.steps = cdist(nodes, nodes)  # [m, m] [m]
        costs = (self.steps / _NODE) ** power + 1e-8  # also between nodes at one place
        self._costs = csr_array(costs)
        if held is None:
            start = int(self._along(0, 2.0 * reach).argmax())
        else:
            start = int(np.linalg.norm(nodes - held, axis=1).argmin())
            self.before = float(np.linalg.norm(nodes[start] - held))
        self.seen = self.before + self._along(start, 2.0 * reach) + reach / 2.0

    def _along(self, start: int, chord: float) -> Array:
        """[m] lengths of the ways from a node [m], by chords, which noise hardly lengthens."""
        cost, self._before = dijkstra(self._costs, indices=start, return_predecessors=True)
        before = np.maximum(self._before, 0).tolist()
        along, since = [0.0] * len(cost), [start] * len(cost)
        for k in np.argsort(cost)[1:].tolist():
            parent = before[k]
            whole = self.steps[parent, since[parent]] >= chord
            since[k] = parent if whole else since[parent]
            along[k] = along[since[k]] + float(self.steps[k, since[k]])
        return np.array(along)

    def to(self, node: int) -> Array:
        """[k, 3] the way to a node, from the start [m]."""
        found = [node]
        while self._before[found[-1]] >= 0:
            found.append(self._before[found[-1]])
        return self.nodes[found[::-1]]


def _nodes(points: Array, edge: float, reach: float) -> Array:
    """[m, 3] averages of a cloud, one a cube of an edge, over a reach [m]."""
    cells = np.floor((points - points.min(axis=0)) / edge).astype(int)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    place = np.unique(key, return_inverse=True)[1]
    count = np.bincount(place)
    mean = np.stack([np.bincount(place, x) / count for x in points.T], axis=1)
    if len(mean) > _MOST_NODES:
        return mean
    weight = (cdist(mean, mean) <= reach) * count
    return weight @ mean / weight.sum(axis=1, keepdims=True)


def _away(points: Array, way: Array) -> tuple[Array, npt.NDArray[np.intp]]:
    """[n] distance of points [n, 3] from a way [k, 3] [m], and the number of the piece of the way
    that each is nearest to."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))
    places = np.arange(0.0, along[-1] + _STEP, _STEP)
    fine = np.stack([np.interp(places, along, x) for x in way.T], axis=1)
    off, nearest = KDTree(fine).query(points)
    return np.asarray(off), np.asarray(nearest) // _PIECE


def _thick(off: Array, at: npt.NDArray[np.intp], own: npt.NDArray[np.bool_]) -> Array:
    """[n] points of pieces that are thicker than others: what hides or touches a rope there."""
    squares = np.bincount(at, np.where(own, off**2, 0.0)) / np.maximum(np.bincount(at, own), 1.0)
    usual = np.median(np.sqrt(squares[squares > 0.0]))
    return np.sqrt(squares)[at] > _THICK * usual
