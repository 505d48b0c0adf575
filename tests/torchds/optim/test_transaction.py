"""What a snapshot puts back (tests/faults/test_optimizer.py interrupts it anywhere)."""

import torch
from torch import nn

from torchds.exploration import Gaussian
from torchds.optim import PIBB
from torchds.optim.transaction import Snapshot


def make(*shapes, **options):
    parameters = [nn.Parameter(torch.zeros(*shape, dtype=torch.float64)) for shape in shapes]
    return PIBB(parameters, Gaussian(0.1), n_rollouts=4, **options)


def test_everything_comes_back_into_the_same_objects():
    optim = make((2,), elite="best")
    (group,), (p,), state = optim.param_groups, optim.parameters, optim.state
    optim.step(lambda: (p - 1.0).square().sum(-1))
    theta, best, drawn = p.detach().clone(), state[p]["best"].clone(), optim.generator.get_state()
    before = Snapshot(optim)
    state[p]["best"].zero_()
    state[p]["more"] = 1
    group.update(lr=7.0, other=3)
    p.data = torch.ones(5, dtype=torch.float64)
    torch.randn(3, generator=optim.generator)
    optim.last = None
    before.restore()
    assert optim.state is state and optim.param_groups[0] is group
    assert torch.equal(p, theta) and torch.equal(state[p]["best"], best) and set(state[p]) == {"best", "best_cost"}
    assert group["lr"] == 1.0 and "other" not in group and optim.last is not None
    assert torch.equal(optim.generator.get_state(), drawn)
