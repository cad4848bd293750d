"""Shell engine of ``Simulator``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.errors import ParameterError
from gendom.sim.paths import Pose
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin.contact import check_cloth
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import STRETCH, Grip, border_of_shell_adjoint, close_shell
from gendom.sim.thin.run import Event, put_worlds
from gendom.sim.thin.shell_model import MOST_COUPLED, ShellModel
from gendom.sim.thin.tape import ThinTape
from gendom.sim.thin.types import MARGIN, WEAVE, ParameterDerivatives, V, X


class Shells(ThinEngine):
    """W shells of one shape."""

    kind, directed = "shell", False
    state_rows, state_bars, scratch_rows, scratch_bars = 14, 14, 24, 33
    threads_on_cuda = 256
    undamped_cfl = 0.4
    """Nonlinear vibrations gain energy in longer steps, see ``benchmarks/swing.py``."""
    stiffened = (slice(4, 5), slice(5, 6))

    @staticmethod
    def check_suits(setting: Setting) -> None:
        thickness, cut = setting.body.thickness, setting.body.cut
        least = -1.0 if cut is None else -1.0 / MOST_COUPLED
        require(
            all(m.nu >= least for m in setting.materials),
            f"cloths with an outline have a nu of at least {least:.2f}",
        )
        model = ShellModel.of(setting.body)
        spacing = min(model.spacing)
        side = min((np.array(model.shape[::-1]) - 1) * model.spacing)
        require(
            thickness <= side,
            f"a thickness of {thickness:g} m and a side of {side:g} m are not those of a shell",
            fix="give metres, or engine='mpm'",
        )
        require(
            not setting.self_contact or thickness <= 0.5 * spacing,
            f"a cloth {1e3 * thickness:.3g} mm thick whose points are {1e3 * spacing:.3g} mm apart "
            "cannot be folded",
            fix="fewer points",
        )

    def prepare(self, setting: Setting) -> NDArray[np.float64]:
        self.model = m = ShellModel.of(setting.body)
        nu = np.array([material.nu for material in setting.materials])
        density = np.array([material.density for material in setting.materials])[:, None]
        self.drag_by_air = 0.5 * DRAG["cloth"] * m.area
        mass = density * m.thickness * m.area
        self.mass = mass * spread(setting.mass, mass.shape, "mass")
        self.per_mass, self.per_turn = 1.0 / self.mass, np.zeros(())
        self.modulus = m.factors(nu)[0] * m.scales(setting.materials) * m.shares
        self.spacing = max(m.spacing)
        return m.longest_step(setting.materials, self.share)

    def layout(self) -> tuple[NDArray[np.int64], int]:
        ny, nx = self.model.shape
        pitch = -(-(nx + 1) // 8) * 8
        slots = MARGIN + pitch * (1 + np.arange(ny))[:, None] + np.arange(nx)
        return slots.reshape(-1)[self.model.at], MARGIN + (ny + 2) * pitch + MARGIN

    def fill(self, model: Any) -> None:
        m, drag = self.model, self.air_density[:, None] * self.drag_by_air
        inertia = np.stack([self.per_mass, drag, np.ones_like(drag), np.ones_like(drag)], axis=1)
        ny, nx = m.shape
        model.pitch = -(-(nx + 1) // 8) * 8
        model.first, model.end = model.pitch, model.pitch * (ny + 1)
        model.per_x, model.per_y = 1.0 / m.spacing[0], 1.0 / m.spacing[1]
        model.rest = self.array(self.rows(m.exists)[None])
        model.stiffness = self.array(self.rows(self.modulus * self.share[:, None]))
        model.inertia = self.array(self.rows(inertia))

    def first_state(self, x: NDArray[np.floating]) -> NDArray[np.float64]:
        ny, nx = self.model.shape
        grid = self.model.on_lattice(np.asarray(x, dtype=float), fill=np.nan)
        for axis, length in ((2, self.model.spacing[0]), (1, self.model.spacing[1])):
            stretch = np.linalg.norm(np.diff(grid, axis=axis), axis=3) / length - 1.0
            most = np.where(np.isnan(stretch), 0.0, np.abs(stretch))
            if most.max() > STRETCH:
                w, j, i = np.unravel_index(most.argmax(), stretch.shape)
                raise ParameterError(
                    f"the cloth begins stretched by {100 * stretch[w, j, i]:.0f} %",
                    where=f"row {j}, column {i} of world {w}",
                    fix=f"positions must keep the spacing of its {ny} rows of {nx} points",
                )
        state = np.zeros(self.state.shape)
        state[:, X, self.slots] = np.swapaxes(x, 1, 2)
        return state

    def between(self, g: NDArray[np.int64], h: NDArray[np.int64]) -> tuple[int, int, float]:
        m = self.model
        if m.cut is not None:  # around notches and holes
            return int(g[0]), int(h[0]), np.inf
        at = np.stack(np.unravel_index(m.at, m.shape)[::-1], axis=1) * m.spacing
        far = np.linalg.norm(at[g][:, None] - at[h], axis=2)
        i, j = np.unravel_index(far.argmin(), far.shape)
        return int(g[i]), int(h[j]), float(far[i, j])

    def check_apart(self, x: NDArray[np.floating]) -> None:
        check_cloth(x, self.model)

    def close(self, g: int, worlds: NDArray[np.int64], pose: Pose, state: NDArray[Any]) -> Grip:
        x = self.pick(X, state)
        taken = np.any(self.holds[worlds] & 1, axis=1)
        radius = self.stacked["radius"][worlds, g]
        return close_shell(x, self.model, pose, radius, taken)

    def stiffen(self, model: Any, worlds: NDArray[np.int64]) -> None:
        inertia = model.inertia.numpy()[worlds]
        inertia[:, 2:4, self.slots] = self.stiffer[worlds].prod(axis=1)
        put_worlds(model.inertia, worlds, inertia)

    def parameters(self) -> tuple[str, ...]:
        own = any(m.membrane is not None for m in self.setting.materials)
        return ("thickness", *(("membrane",) if own else ()), *WEAVE)

    def derivatives(self, name: str) -> ParameterDerivatives:
        return self.model.derivatives(name, self.setting.materials, self.share)

    # ---- reverse mode ----------------------------------------------------------------------------

    def tape(self, memory: float) -> ThinTape:
        return ThinTape(self)

    def unstiffened(
        self, group: slice, stiffer: NDArray[np.floating], found: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        bar = found[:, 4:6] * (self.modulus * self.share[:, None])[group, 4:6]
        found[:, 4:6] *= stiffer
        return bar

    def border_adjoint(
        self, event: Event, stiffer_bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        return border_of_shell_adjoint(event.grip, event.x, event.pose, self.model, stiffer_bar)

    def by_shares(self, model_bar: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.sum(model_bar[:, :8] * self.modulus, axis=1)

    def by_start(
        self, x: NDArray[np.floating], v: NDArray[np.floating], bar: NDArray[np.floating]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        return bar[..., X].copy(), bar[..., V].copy()
