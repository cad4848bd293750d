"""Rod engine of ``Simulator``."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.errors import ParameterError
from gendom.sim.lines import arc_length
from gendom.sim.paths import Pose
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.contact import check_rope
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import STRETCH, Grip, border_of_rod_adjoint, close_rod
from gendom.sim.thin.rod_model import RodModel
from gendom.sim.thin.run import Event, put_worlds
from gendom.sim.thin.tape import ThinTape
from gendom.sim.thin.types import (
    MARGIN,
    PER_TURN,
    SPIN_BAR,
    TURN_BAR,
    ParameterDerivatives,
    Q,
    V,
    X,
)


class Rods(ThinEngine):
    """W rods of one shape."""

    kind, directed = "rod", True
    state_rows, state_bars, scratch_rows, scratch_bars = 19, 18, 12, 18
    threads_on_cuda = 32
    stiffened = (slice(3, 6),)
    apart: int
    """Smallest number of points along the rod between parts that can be in self-contact."""

    @staticmethod
    def check_suits(setting: Setting) -> None:
        length, diameter = arc_length(setting.body.points)[-1], setting.body.thickness
        require(
            diameter <= length,
            f"a diameter of {diameter:g} m and a length of {length:g} m are not those of a rod",
            fix="give metres, or engine='mpm'",
        )

    def prepare(self, setting: Setting) -> NDArray[np.float64]:
        m = RodModel.of(setting.body, setting.materials, self.share)
        m = self.model = replace(m, mass=m.mass * spread(setting.mass, m.mass.shape, "mass"))
        self.drag_by_air = 0.5 * DRAG["rope"] * m.section.breadth * m.tributary
        self.per_turn = np.zeros_like(m.inertia)
        self.per_turn[:, :-1] = 1.0 / m.inertia[:, :-1]
        self.per_mass = 1.0 / m.mass
        self.spacing = float(m.length.max())
        self.apart = 2 + int(np.ceil(setting.body.thickness / m.length.min()))
        return m.longest_step(np.array([m.damping > 0.0 for m in setting.materials]))

    def layout(self) -> tuple[NDArray[np.int64], int]:
        n = self.num_points
        return MARGIN + np.arange(n), MARGIN + -(-n // 8) * 8 + MARGIN

    def fill(self, model: Any) -> None:
        drag = self.air_density[:, None] * self.drag_by_air
        inertia = np.stack([self.per_mass, self.per_turn, drag, np.ones_like(drag)], axis=1)
        model.contact_apart = self.apart
        model.pitch, model.first, model.end = 0, 0, self.num_points
        rest = np.repeat(self.rows(self.model.rest)[None], self.num_worlds, axis=0)
        share = spread(self.setting.natural_curvature, (self.num_worlds,), "natural_curvature")
        rest[:, 4:] *= share[:, None, None]
        model.rest = self.array(rest)
        model.stiffness = self.array(self.rows(self.model.stiffness))
        model.inertia = self.array(self.rows(inertia))

    def first_state(self, x: NDArray[np.floating]) -> NDArray[np.float64]:
        """State [W, ., P] at rest with directions that have the twist of the rest shape."""
        alike = x.strides[0] == 0  # what is the same in all worlds is computed once
        step = np.diff(x[:1] if alike else x, axis=1)
        first = np.broadcast_to(self.model.rest_q[0], (len(step), 4))
        q = rotation.transported(first, step)
        stretch = np.linalg.norm(step, axis=2) / self.model.length - 1.0
        w, e = np.unravel_index(np.abs(stretch).argmax(), stretch.shape)
        if abs(stretch[w, e]) > STRETCH:
            raise ParameterError(
                f"the rope begins stretched by {100 * stretch[w, e]:.0f} %",
                where=f"edge {e} of world {w}",
                fix=f"positions must keep the lengths of its {self.num_points - 1} edges",
            )
        state = np.zeros(self.state.shape)
        state[:, Q.stop - 1] = 1.0
        state[:, X, self.slots] = np.swapaxes(x, 1, 2)
        state[:, Q, self.slots[:-1]] = np.swapaxes(q, 1, 2)
        return state

    def spins_of(self, v: NDArray[np.floating]) -> NDArray[np.floating]:
        d, dv = np.diff(self.component(X), axis=1), np.diff(v, axis=1)
        return np.cross(d, dv) / np.sum(d**2, axis=2, keepdims=True)

    def between(self, g: NDArray[np.int64], h: NDArray[np.int64]) -> tuple[int, int, float]:
        along = np.concatenate([[0.0], np.cumsum(self.model.length)])
        far = np.abs(along[g][:, None] - along[h])
        i, j = np.unravel_index(far.argmin(), far.shape)
        return int(g[i]), int(h[j]), float(far[i, j])

    def check_apart(self, x: NDArray[np.floating]) -> None:
        check_rope(x, self.setting.body.thickness, self.apart)

    def close(self, g: int, worlds: NDArray[np.int64], pose: Pose, state: NDArray[Any]) -> Grip:
        x, q = self.pick(X, state), self.pick(Q, state)[:, :-1]
        taken = np.any(self.holds[worlds][:, :, :-1] & 2, axis=1)
        return close_rod(x, q, pose, self.stacked["radius"][worlds, g], self.model.length, taken)

    def stiffen(self, model: Any, worlds: NDArray[np.int64]) -> None:
        stiffer = self.stiffer[worlds, :, 0].prod(axis=1)
        inertia = model.inertia.numpy()[worlds]
        inertia[:, 1, self.slots] = self.per_turn[worlds] / slower(stiffer)
        inertia[:, 3, self.slots] = stiffer
        put_worlds(model.inertia, worlds, inertia)

    def parameters(self) -> tuple[str, ...]:
        own = any(m.membrane is not None for m in self.setting.materials)
        return ("thickness", *(("membrane",) if own else ()))

    def derivatives(self, name: str) -> ParameterDerivatives:
        s = self.setting
        return self.model.derivatives(name, s.body, s.materials, self.share)

    # ---- reverse mode ----------------------------------------------------------------------------

    def tape(self, memory: float) -> ThinTape:
        return ThinTape(self)

    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
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

    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        length = self.model.length
        return border_of_rod_adjoint(event.grip, event.x, event.pose, length, stiffer_bar)

    def by_shares(self, model_bar: NDArray[np.floating]) -> NDArray[np.float64]:
        return self.model.share_bar(self.setting.materials, model_bar[:, :6])

    def by_start(
        self, x: NDArray[np.floating], v: NDArray[np.floating], bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        x_bar, v_bar = bar[..., X].copy(), bar[..., V].copy()
        q_bar, spin_bar = bar[:, :-1, TURN_BAR], bar[:, :-1, SPIN_BAR]
        # initial spins are those of edges that rotate with their points
        d, dv = np.diff(x, axis=1), np.diff(v, axis=1)
        square = np.sum(d**2, axis=2, keepdims=True)
        spin = np.cross(d, dv) / square
        _to_ends(v_bar, np.cross(spin_bar, d) / square)
        turned = np.cross(dv, spin_bar) - 2.0 * np.sum(spin * spin_bar, 2, keepdims=True) * d
        _to_ends(x_bar, turned / square)
        first = np.broadcast_to(self.model.rest_q[0], (len(x_bar), 4))
        _to_ends(x_bar, rotation.transported_adjoint(first, d, q_bar))
        return x_bar, v_bar


def slower(stiffer: NDArray[np.floating]) -> NDArray[np.floating]:
    """Factors [W, n] by which the inertia of edges beside stiffer joints at a gripper's border is
    increased, so that the substep stays stable."""
    after = np.concatenate([stiffer[:, 1:], np.ones_like(stiffer[:, :1])], axis=1)
    return np.maximum(1.0, np.maximum(stiffer, after))


def _to_ends(points: NDArray[np.floating], edges: NDArray[np.floating]) -> None:
    """Add derivatives by edges x_(e+1) - x_e [W, n - 1, 3] to the derivatives by points."""
    points[:, 1:] += edges
    points[:, :-1] -= edges
