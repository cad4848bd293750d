"""How a body is shared out among the blocks of a team."""

import numpy as np
import pytest

from gendom.sim import cloth, rope
from gendom.sim.teams import split_body

BODIES = {
    "rope": rope(diameter=0.02, length=0.3, cells_across=2.0),
    "cloth": cloth(width=0.1, height=0.07, thickness=0.01, dx=0.01),
}


@pytest.mark.parametrize("members", [1, 5])
@pytest.mark.parametrize("kind", BODIES)
def test_every_particle_has_one_block_and_its_neighbours_beside_it(kind, members):
    body = BODIES[kind]
    split = split_body(body, members, alone=False)
    owned = [block[:own] for block, own in zip(split.particles, split.count[:, 0], strict=True)]
    assert np.array_equal(np.sort(np.concatenate(owned)), np.arange(body.num_particles))
    assert np.ptp([len(own) for own in owned]) <= members
    for block, (own, tense, present), near in zip(
        split.particles, split.count, split.near, strict=True
    ):
        assert np.array_equal(block[near[:tense]], body.lattice[block[:tense]].reshape(-1, 6))
        assert near[:own].max() < tense and near[:tense].max() < present
        assert len(set(block[:present])) == present
    assert split.particles.shape[1] % 32 == 0


def test_particles_without_forces_between_them_need_no_neighbours():
    split = split_body(BODIES["cloth"], 4, alone=True)
    assert np.array_equal(split.count[:, 0], split.count[:, 2])
    assert split.count.sum() == 3 * BODIES["cloth"].num_particles
