"""Chance that does not depend on how many processes share the roll-outs."""

import pytest
import torch

from torchds import disturbances, sharing
from torchds.sharing import Share, trying


def normals(generator):
    return lambda shape: torch.randn(shape, generator=generator)


@pytest.mark.parametrize("N, size", [(10, 3), (2, 3), (7, 1)])
def test_the_shares_of_all_processes_are_the_draw_of_one(N, size):
    whole = torch.randn(N, 4, generator=torch.Generator().manual_seed(0))
    states, parts = [], []
    for rank in range(size):
        generator = torch.Generator().manual_seed(0)
        first, last = N * rank // size, N * (rank + 1) // size
        with trying(Share(first, last, N)):
            parts.append(sharing.drawn((last - first, 4), normals(generator)))
            assert sharing.whole((last - first, 4)) == (N, 4)
        states.append(generator.get_state())
    assert torch.equal(torch.cat(parts), whole)
    assert all(torch.equal(state, states[0]) for state in states)


def test_what_is_not_shared_stays():
    assert sharing.whole((3, 2)) == (3, 2)
    with trying(Share(1, 3, 4)):
        assert sharing.whole((3, 2)) == (3, 2) and sharing.whole(()) == ()
        with trying(None):  # one policy at a time
            assert sharing.whole((2, 5)) == (2, 5)
        assert sharing.drawn((3,), torch.ones).shape == (3,)
    assert sharing.whole((2, 5)) == (2, 5)


def test_disturbances_are_those_of_one_process():
    options = {"sensor": 0.1, "push": 2.0}
    whole = disturbances.draw((4, 3, 2), 5, 0.1, **options, generator=torch.Generator().manual_seed(1))
    with trying(Share(1, 3, 4)):
        mine = disturbances.draw((2, 3, 2), 5, 0.1, **options, generator=torch.Generator().manual_seed(1))
    for part, all_ in zip(mine, whole, strict=True):
        assert torch.equal(part, all_[1:3])
