"""Batches in which some worlds diverge."""

import pytest

from gendom.errors import SimulationError
from gendom.tasks.base import surviving


@pytest.mark.parametrize("bad", [set(), {0}, {6}, {2, 3}, {0, 1, 2, 3, 4, 5, 6}])
@pytest.mark.parametrize("named", [True, False])
def test_every_world_comes_once_and_only_the_bad_ones_fail(bad, named):
    batches = []

    def run(worlds):
        batches.append(list(worlds))
        for place, world in enumerate(worlds):
            if world in bad:
                raise SimulationError("diverged", world=place if named else None)
        return [10 * world for world in worlds]

    fine, failed = {}, set()
    for worlds, result in surviving(run, 7):
        if isinstance(result, SimulationError):
            assert len(worlds) == 1
            failed.update(worlds)
        else:
            fine.update(zip(worlds, result, strict=True))
    assert failed == bad
    assert fine == {world: 10 * world for world in range(7) if world not in bad}
    assert batches[0] == list(range(7))
    if len(bad) == 1 and named:
        assert len(batches) <= 3, "one bad world must not cost more than two halves"


def test_no_worlds():
    assert list(surviving(lambda worlds: worlds, 0)) == []


def test_other_errors_pass_through():
    def run(worlds):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(surviving(run, 2))
