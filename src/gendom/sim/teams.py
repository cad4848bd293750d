"""Running on CUDA where worlds are few: several blocks of threads for each."""

import math

import warp as wp

from gendom.sim.paced import Paced
from gendom.sim.team_kernels import AHEAD, BLOCKS_AT_ONCE, LANES, make_team_kernels
from gendom.sim.worlds import Worlds


def team_size(worlds: Worlds) -> int:
    """Blocks that have a lane for each particle."""
    return math.ceil(worlds.num_particles / LANES)


def suits_teams(worlds: Worlds) -> bool:
    """Whether the teams of all worlds fit on the device at once: then they are the fastest way."""
    blocks = team_size(worlds) * worlds.num_worlds
    return blocks <= BLOCKS_AT_ONCE * worlds.device.sm_count


class Teams(Paced):
    """A team of blocks a world.

    Args:
        worlds: Such as suit teams; on the CPU, where tests run it, a team is one thread.
    """

    substeps_a_slice = 2048

    def __init__(self, worlds: Worlds):
        self.kernels = make_team_kernels(worlds.real, worlds.setting.law, plastic=worlds.plastic)
        cuda = worlds.device.is_cuda
        self.members = team_size(worlds) if cuda else 1
        self.lanes = LANES if cuda else 1
        self._grips = worlds.make_grips(AHEAD * worlds.num_worlds)
        self._gate = worlds.zeros(worlds.num_worlds, wp.int32)
        self._peak = worlds.zeros((worlds.num_worlds, 2), worlds.real)
        super().__init__(worlds)

    def load(self) -> None:
        module = self.kernels.advance.module
        wp.load_module(module, device=self.worlds.device, block_dim=self.lanes)

    def launch_slices(self, slices: list[tuple[int, float]]) -> None:
        s, grid = self.worlds, self.grid
        for substeps, pause in slices:
            self._gate.zero_()
            self._peak.zero_()
            wp.launch(
                self.kernels.advance,
                dim=(s.num_worlds * self.members, self.lanes),
                inputs=[
                    self.members, self.members * self.lanes, substeps, pause, self.frame_plan,
                    s.clock, s.matter, s.scene, s.paths, self._grips, s.state, s.last_good,
                    grid.columns, grid.momentum, self.velocity, self._gate, self._peak,
                ],
                device=s.device,
                block_dim=self.lanes,
            )  # fmt: skip
