"""Shell engine of ``Simulator``."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin.crossing import check_cloth
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import Grip, close_shell
from gendom.sim.thin.poses import Pose
from gendom.sim.thin.run import put_worlds
from gendom.sim.thin.shell_model import MOST_COUPLED, ShellModel
from gendom.sim.thin.slopes import WEAVE, Slopes
from gendom.sim.thin.tears import STRETCH
from gendom.sim.thin.types import MARGIN, V, X


class Shells(ThinEngine):
    """W shells of one shape."""

    kind = "shell"
    state_rows, state_bars, scratch_rows, scratch_bars = 14, 14, 24, 33
    lanes_on_cuda = 256
    undamped_cfl = 0.4
    """Nonlinear vibrations gain energy in longer steps, see ``benchmarks/swing.py``."""
    stiffened = (slice(4, 5), slice(5, 6))
    natural = slice(3, 6)

    @staticmethod
    def check_suits(setting: Setting) -> None:
        least = -1.0 if setting.body.cut is None else -1.0 / MOST_COUPLED
        if any(m.nu < least for m in setting.materials):
            raise ParameterError(f"cloths with an outline have a nu of at least {least:.2f}")
        model = ShellModel.of(setting.body)
        spacing = min(model.spacing)
        side = min((np.array(model.shape[::-1]) - 1) * model.spacing)
        if setting.body.thickness > side:
            raise ParameterError(
                f"a thickness of {setting.body.thickness:g} m and a side of {side:g} m are not "
                "those of a shell",
                fix="give metres, or engine='mpm'",
            )
        if setting.self_contact and setting.body.thickness > 0.5 * spacing:
            raise ParameterError(
                f"a cloth {1e3 * setting.body.thickness:.3g} mm thick whose points are "
                f"{1e3 * spacing:.3g} mm apart cannot be folded",
                fix="fewer points",
            )

    def prepare(self, setting: Setting) -> NDArray[np.float64]:
        self.model = ShellModel.of(setting.body)
        return self.model.longest_step(setting.materials, self.share)

    def layout(self) -> tuple[NDArray[np.int64], int]:
        ny, nx = self.setting.body.shape
        pitch = -(-(nx + 1) // 8) * 8
        slots = MARGIN + pitch * (1 + np.arange(ny))[:, None] + np.arange(nx)
        return slots.reshape(-1)[self.model.at], MARGIN + (ny + 2) * pitch + MARGIN

    def fill(self, body: Any) -> None:
        s, W, n = self.setting, self.num_worlds, self.num_points
        m = self.model
        nu = np.array([material.nu for material in s.materials])
        density = np.array([material.density for material in s.materials])[:, None]
        self.drag_by_air = 0.5 * DRAG["cloth"] * m.area
        self.mass = density * m.thickness * m.area
        self.modulus = m.factors(nu)[0] * m.scales(s.materials) * m.shares
        stiffness = self.modulus * self.share[:, None]
        drag = self.air_density[:, None] * self.drag_by_air
        self.per_mass = 1.0 / self.mass
        self.spacing = max(m.spacing)
        inertia = np.stack([self.per_mass, drag, np.ones((W, n)), np.ones((W, n))], axis=1)
        rest = np.concatenate([m.exists, m.rest_bend])
        ny, nx = m.shape
        body.pitch = -(-(nx + 1) // 8) * 8
        body.first, body.end = body.pitch, body.pitch * (ny + 1)
        body.per_x, body.per_y = 1.0 / m.spacing[0], 1.0 / m.spacing[1]
        body.rest = self.array(self.rows(rest)[None])
        body.stiffness = self.array(self.rows(stiffness))
        body.inertia = self.array(self.rows(inertia))

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

    def set_velocities(self, v: ArrayLike, affine: ArrayLike = 0.0) -> None:
        """Set points' velocities [W, n, 3] [m/s]."""
        if np.any(np.asarray(affine)):
            raise ParameterError("shells have no affine velocities", fix="engine='mpm'")
        v = spread(v, (self.num_worlds, self.num_points, 3), "velocities")
        rows = self.state.numpy()
        rows[:, V, self.slots] = np.swapaxes(v, 1, 2)
        self.state.assign(rows)
        self.last_dt[:] = 0.0

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

    def stiffen(self, body: Any, worlds: NDArray[np.int64]) -> None:
        inertia = body.inertia.numpy()[worlds]
        inertia[:, 2:4, self.slots] = self.stiffer[worlds].prod(axis=1)
        put_worlds(body.inertia, worlds, inertia)

    def parameters(self) -> tuple[str, ...]:
        own = any(m.membrane is not None for m in self.setting.materials)
        return ("thickness", *(("membrane",) if own else ()), *WEAVE)

    def slopes(self, name: str) -> Slopes:
        return self.model.slopes(name, self.setting.materials, self.share)

    def stiffness_by_share(self, w: int, i: int) -> NDArray[np.float64]:
        found = np.zeros(self.modulus[w].shape)
        found[:, i] = self.modulus[w, :, i]
        return found

    def tape(self, memory: float) -> Any:
        from gendom.sim.thin.tape import ShellTape

        return ShellTape(self)
