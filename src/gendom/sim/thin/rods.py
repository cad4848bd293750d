"""Rod engine of ``Simulator``."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError
from gendom.sim.lines import arc_length
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin import rotation
from gendom.sim.thin.crossing import check_rope
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import Grip, close_rod
from gendom.sim.thin.poses import Pose
from gendom.sim.thin.rod_model import RodModel
from gendom.sim.thin.run import put_worlds
from gendom.sim.thin.slopes import Slopes
from gendom.sim.thin.tears import STRETCH
from gendom.sim.thin.types import MARGIN, V, X

Q, SPIN = slice(6, 10), slice(10, 13)
"""Components of a state: directions (quaternions, scalar last) and spins [rad/s]."""


class Rods(ThinEngine):
    """W rods of one shape."""

    kind = "rod"
    state_rows, state_bars, scratch_rows, scratch_bars = 19, 18, 12, 18
    lanes_on_cuda = 32
    stiffened = (slice(3, 6),)
    natural = slice(1, 7)
    apart: int
    """Smallest number of points along the rod between parts that can be in self-contact."""

    @staticmethod
    def check_suits(setting: Setting) -> None:
        length, diameter = arc_length(setting.body.points)[-1], setting.body.thickness
        if diameter > length:
            raise ParameterError(
                f"a diameter of {diameter:g} m and a length of {length:g} m are not those of a rod",
                fix="give metres, or engine='mpm'",
            )

    def prepare(self, setting: Setting) -> NDArray[np.float64]:
        self.model = RodModel.of(setting.body, setting.materials, self.share)
        return self.model.longest_step(np.array([m.damping > 0.0 for m in setting.materials]))

    def layout(self) -> tuple[NDArray[np.int64], int]:
        n = self.num_points
        return MARGIN + np.arange(n), MARGIN + -(-n // 8) * 8 + MARGIN

    def fill(self, body: Any) -> None:
        m = self.model
        self.drag_by_air = 0.5 * DRAG["rope"] * m.section.breadth * m.tributary
        self.per_turn = np.zeros_like(m.inertia)
        self.per_turn[:, :-1] = 1.0 / m.inertia[:, :-1]
        drag = self.air_density[:, None] * self.drag_by_air
        self.per_mass = 1.0 / m.mass
        self.spacing = float(m.length.max())
        self.apart = 2 + int(np.ceil(self.setting.body.thickness / m.length.min()))
        body.contact_apart = self.apart
        body.pitch, body.first, body.end = 0, 0, self.num_points
        inertia = np.stack([self.per_mass, self.per_turn, drag, np.ones_like(drag)], axis=1)
        body.rest = self.array(self.rows(m.rest)[None])
        body.stiffness = self.array(self.rows(m.stiffness))
        body.inertia = self.array(self.rows(inertia))

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

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set points' velocities [W, n, 3] [m/s]; edges rotate with them, without twisting."""
        if np.any(np.asarray(affine)):
            raise ParameterError("rods have no affine velocities", fix="engine='mpm'")
        v = spread(v, (self.num_worlds, self.num_points, 3), "velocities")
        d, dv = np.diff(self.component(X), axis=1), np.diff(v, axis=1)
        spin = np.cross(d, dv) / np.sum(d**2, axis=2, keepdims=True)
        rows = self.state.numpy()
        rows[:, V, self.slots] = np.swapaxes(v, 1, 2)
        rows[:, SPIN, self.slots[:-1]] = np.swapaxes(spin, 1, 2)
        self.state.assign(rows)
        self.last_dt[:] = 0.0

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

    def let_go(
        self, v: NDArray[np.floating], spin: NDArray[np.floating]
    ) -> list[tuple[slice, NDArray[np.floating]]]:
        return [(V, v), (SPIN, spin)]

    def stiffen(self, body: Any, worlds: NDArray[np.int64]) -> None:
        stiffer = self.stiffer[worlds, :, 0].prod(axis=1)
        inertia = body.inertia.numpy()[worlds]
        inertia[:, 1, self.slots] = self.per_turn[worlds] / slower(stiffer)
        inertia[:, 3, self.slots] = stiffer
        put_worlds(body.inertia, worlds, inertia)

    def parameters(self) -> tuple[str, ...]:
        return ("thickness",) if self.setting.body.width is None else ("thickness", "width")

    def slopes(self, name: str) -> Slopes:
        s = self.setting
        return self.model.slopes(name, s.body, s.materials, self.share)

    def stiffness_by_share(self, w: int, i: int) -> NDArray[np.float64]:
        return self.model.stiffness_by_share(self.setting.materials, w, i)

    def tape(self, memory: float) -> Any:
        from gendom.sim.thin.tape import RodTape

        return RodTape(self)


def slower(stiffer: NDArray[np.floating]) -> NDArray[np.floating]:
    """Factors [W, n] by which the inertia of edges beside stiffer joints at a gripper's border is
    increased, so that the substep stays stable."""
    after = np.concatenate([stiffer[:, 1:], np.ones_like(stiffer[:, :1])], axis=1)
    return np.maximum(1.0, np.maximum(stiffer, after))
