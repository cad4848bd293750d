"""Shell engine of ``Simulator``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.materials.parameters import WEAVE
from gendom.sim.setting import Setting
from gendom.sim.thin.contact import check_cloth
from gendom.sim.thin.engine import ThinEngine
from gendom.sim.thin.grips import held_of_shell
from gendom.sim.thin.run import put_worlds
from gendom.sim.thin.shell_model import MOST_COUPLED, ShellModel
from gendom.sim.thin.types import MARGIN


class Shells(ThinEngine):
    """W shells of one shape."""

    kind, directed = "shell", False
    state_rows, state_bars, scratch_rows, scratch_bars = 14, 14, 24, 33
    threads_on_cuda = 256
    undamped_cfl = 0.4
    """Nonlinear vibrations gain energy in longer steps, see ``benchmarks/swing.py``."""
    woven = WEAVE

    def prepare(self, setting: Setting) -> None:
        thickness, least = setting.body.thickness, -1.0 / MOST_COUPLED
        require(
            setting.body.cut is None or all(m.nu >= least for m in setting.materials),
            f"cloths with an outline have a nu of at least {least:.2f}",
        )
        self.model = m = ShellModel(setting)
        (ny, nx), spacing = m.shape, min(m.spacing)
        side = min((nx - 1) * m.spacing[0], (ny - 1) * m.spacing[1])
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
        self.per_turn, self.spacing = np.zeros(()), max(m.spacing)
        self.pitch = -(-(nx + 1) // 8) * 8
        slots = MARGIN + self.pitch * (1 + np.arange(ny))[:, None] + np.arange(nx)
        self.slots = slots.reshape(-1)[m.at]
        self.row_length = MARGIN + (ny + 2) * self.pitch + MARGIN

    def fill(self, model: Any) -> None:
        m, drag = self.model, self.air_density[:, None] * self.model.drag
        inertia = np.stack([self.per_mass, drag, np.ones_like(drag), np.ones_like(drag)], axis=1)
        model.pitch, model.first, model.end = self.pitch, self.pitch, self.pitch * (m.shape[0] + 1)
        model.per_x, model.per_y = 1.0 / m.spacing[0], 1.0 / m.spacing[1]
        model.rest = self.array(self.rows(m.exists)[None])
        model.stiffness = self.array(self.rows(m.stiffness))
        model.inertia = self.array(self.rows(inertia))

    def check_apart(self, x: Array) -> None:
        check_cloth(x, self.model)

    def held(self, x: Array, centre: Array, radius: Array, taken: Array) -> NDArray[np.int32]:
        return held_of_shell(x, centre, radius, taken, self.model)

    def stiffen(self, model: Any, worlds: NDArray[np.int64]) -> None:
        inertia = model.inertia.numpy()[worlds]
        inertia[:, 2:4, self.slots] = self.stiffer[worlds].prod(axis=1)
        put_worlds(model.inertia, worlds, inertia)

    def unstiffened(self, group: slice, stiffer: Array, found: Array) -> Array:
        bar = found[:, 4:6] * self.model.stiffness[group, 4:6]
        found[:, 4:6] *= stiffer
        return bar
