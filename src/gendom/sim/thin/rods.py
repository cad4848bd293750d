"""Rod engine of ``Simulator``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.sim.lines import arc_length
from gendom.sim.setting import Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.contact import check_rope
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import held_of_rod
from gendom.sim.thin.rod_model import RodModel
from gendom.sim.thin.run import put_worlds
from gendom.sim.thin.types import MARGIN, PER_TURN, SPIN_BAR, TURN_BAR, Q

Array = NDArray[Any]


class Rods(ThinEngine):
    """W rods of one shape."""

    kind, directed = "rod", True
    state_rows, state_bars, scratch_rows, scratch_bars = 19, 18, 12, 18
    threads_on_cuda = 32
    apart: int
    """Smallest number of points along the rod between parts that can be in self-contact."""

    def prepare(self, setting: Setting) -> None:
        body = setting.body
        length, diameter = arc_length(body.points)[-1], body.thickness
        require(
            diameter <= length,
            f"a diameter of {diameter:g} m and a length of {length:g} m are not those of a rod",
            fix="give metres, or engine='mpm'",
        )
        self.model = m = RodModel(setting)
        self.per_turn = np.zeros_like(m.inertia)
        self.per_turn[:, :-1] = 1.0 / m.inertia[:, :-1]
        self.spacing = float(m.length.max())
        self.apart = 2 + int(np.ceil(diameter / m.length.min()))
        n = len(body.points)
        self.slots, self.row_length = MARGIN + np.arange(n), MARGIN + -(-n // 8) * 8 + MARGIN

    def fill(self, model: Any) -> None:
        drag = self.air_density[:, None] * self.model.drag
        inertia = np.stack([self.per_mass, self.per_turn, drag, np.ones_like(drag)], axis=1)
        model.contact_apart = self.apart
        model.pitch, model.first, model.end = 0, 0, self.num_points
        rest = np.repeat(self.rows(self.model.rest)[None], self.num_worlds, axis=0)
        share = spread(self.setting.natural_curvature, (self.num_worlds,), "natural_curvature")
        rest[:, 4:] *= share[:, None, None]
        model.rest = self.array(rest)
        model.stiffness = self.array(self.rows(self.model.stiffness))
        model.inertia = self.array(self.rows(inertia))

    def first_state(self, x: Array) -> Array:
        """With directions that have the twist of the rest shape."""
        state = super().first_state(x)
        step = np.diff(x[:1] if x.strides[0] == 0 else x, axis=1)  # alike in all worlds: once
        q = rotation.transported(np.broadcast_to(self.model.rest_q[0], (len(step), 4)), step)
        state[:, Q.stop - 1] = 1.0
        state[:, Q, self.slots[:-1]] = np.swapaxes(q, 1, 2)
        return state

    def spins_of(self, x: Array, v: Array) -> Array:
        d, dv = np.diff(x, axis=1), np.diff(v, axis=1)
        return np.cross(d, dv) / np.sum(d**2, axis=2, keepdims=True)

    def check_apart(self, x: Array) -> None:
        check_rope(x, self.setting.body.thickness, self.apart)

    def held(self, x: Array, centre: Array, radius: Array, taken: Array) -> NDArray[np.int32]:
        return held_of_rod(x, centre, radius, taken)

    def stiffen(self, model: Any, worlds: NDArray[np.int64]) -> None:
        stiffer = self.stiffer[worlds, :, 0].prod(axis=1)
        inertia = model.inertia.numpy()[worlds]
        inertia[:, 1, self.slots] = self.per_turn[worlds] / slower(stiffer)
        inertia[:, 3, self.slots] = stiffer
        put_worlds(model.inertia, worlds, inertia)

    def unstiffened(self, group: slice, stiffer: Array, found: Array) -> Array:
        one = stiffer[:, 0]
        bar = np.sum(found[:, 3:6] * self.model.stiffness[group, 3:], axis=1)
        found[:, 3:6] *= stiffer
        # edges beside stiffer joints have more inertia, according to the stiffer joint
        slow = slower(one)
        by_slow = -found[:, PER_TURN] * self.per_turn[group] / slow**2
        found[:, PER_TURN] /= slow
        at = (one == slow) & (slow > 1.0)
        bar += np.where(at, by_slow, 0.0)
        after = (one[:, 1:] == slow[:, :-1]) & (slow[:, :-1] > 1.0) & ~at[:, :-1]
        bar[:, 1:] += np.where(after, by_slow[:, :-1], 0.0)
        return bar[:, None]

    def by_start(self, x: Array, v: Array, bar: Array) -> tuple[Array, Array]:
        x_bar, v_bar = super().by_start(x, v, bar)
        q_bar, spin_bar = bar[:, :-1, TURN_BAR], bar[:, :-1, SPIN_BAR]
        # initial spins are those of edges that rotate with their points
        d, dv, spin = np.diff(x, axis=1), np.diff(v, axis=1), self.spins_of(x, v)
        square = np.sum(d**2, axis=2, keepdims=True)
        _to_ends(v_bar, np.cross(spin_bar, d) / square)
        turned = np.cross(dv, spin_bar) - 2.0 * np.sum(spin * spin_bar, 2, keepdims=True) * d
        _to_ends(x_bar, turned / square)
        first = np.broadcast_to(self.model.rest_q[0], (len(x_bar), 4))
        _to_ends(x_bar, rotation.transported_adjoint(first, d, q_bar))
        return x_bar, v_bar


def slower(stiffer: Array) -> Array:
    """Factors [W, n] by which the inertia of edges beside stiffer joints at a gripper's border is
    increased, so that the substep stays stable."""
    after = np.concatenate([stiffer[:, 1:], np.ones_like(stiffer[:, :1])], axis=1)
    return np.maximum(1.0, np.maximum(stiffer, after))


def _to_ends(points: Array, edges: Array) -> None:
    """Add derivatives by edges x_(e+1) - x_e [W, n - 1, 3] to the derivatives by points."""
    points[:, 1:] += edges
    points[:, :-1] -= edges
