"""What every search has from its base: copies that keep all attributes, whatever a subclass adds."""

import copy
import math
import pickle

import pytest
import torch
from torch import nn
from torch.optim import lr_scheduler

from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration import Gaussian
from torchds.optim import PIBB, PolicySearch


class Momentum(PolicySearch):
    """A search of a stranger, written from the base alone: goes to the best roll-out, and keeps some of its last way."""

    def __init__(self, params, exploration, n_rollouts=4, lr=1.0, *, friction=0.5, **shared):
        self.friction = friction
        super().__init__(params, exploration, n_rollouts, {"lr": lr}, **shared)
        self.steps = []  # added after the base was made

    @torch.no_grad()
    def step(self, closure=None):
        self.steps.append(len(self.steps))
        return self._step(closure)

    def _update(self, group, noise, cost, steps, control):
        best = cost.argmin()
        for p, epsilon in zip(group["params"], noise, strict=True):
            self.state[p]["way"] = epsilon[best] + self.friction * self.state[p].get("way", 0.0)
            p.add_(self.state[p]["way"])
        return nn.functional.one_hot(best, len(cost)).to(cost)


def make(**options):
    theta = nn.Parameter(torch.zeros(3, dtype=torch.float64))
    return theta, Momentum([theta], Gaussian(0.3), **options)


def learn(theta, optim, n=3):
    for _ in range(n):
        optim.step(lambda: (theta - 1.0).square().sum(-1))


WAYS = {"deepcopy": copy.deepcopy, "pickle": lambda x: pickle.loads(pickle.dumps(x))}


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_a_copy_keeps_what_a_subclass_added_without_being_told(way):
    theta, optim = make(friction=0.8, elite="nominal", generator=torch.Generator().manual_seed(9))
    learn(theta, optim)
    optim.note = {"set": "from outside"}
    twin, twin_optim = WAYS[way]((theta, optim))
    assert (twin_optim.friction, twin_optim.steps, twin_optim.note) == (0.8, [0, 1, 2], optim.note)
    assert vars(twin_optim).keys() >= vars(optim).keys() - {"_warned_capturable_if_run_uncaptured"}
    assert twin_optim.steps is not optim.steps
    for pair in ((theta, optim), (twin, twin_optim)):
        learn(*pair)
    assert torch.equal(theta, twin)
    assert twin_optim.steps == optim.steps == list(range(6))
    assert torch.equal(optim.generator.get_state(), twin_optim.generator.get_state())
    learn(theta, optim, 1)  # generators of their own
    assert not torch.equal(optim.generator.get_state(), twin_optim.generator.get_state())


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_a_copy_leaves_hooks_and_the_wrapper_of_a_scheduler_behind(way):
    theta, optim = make()
    calls = []
    optim.register_step_post_hook(lambda *_: calls.append("hook"))
    lr_scheduler.LambdaLR(optim, lambda n: 0.5**n)
    assert "step" in vars(optim)
    twin, twin_optim = WAYS[way]((theta, optim))
    assert "step" not in vars(twin_optim)
    before = theta.detach().clone()
    learn(twin, twin_optim)
    assert not calls
    assert torch.equal(theta, before)
    assert not torch.equal(twin, before)


def test_one_failure_changes_nothing_in_a_search_of_a_stranger():
    theta, optim = make()
    with pytest.raises(AllRolloutsFailedError, match="the parameters are unchanged"):
        optim.step(lambda: theta.sum(-1) * torch.nan)
    assert not theta.any()
    with pytest.raises(InvalidArgumentError, match="step needs a closure"):
        optim.step()


@pytest.mark.parametrize("n", [0, -3])
def test_no_roll_outs_are_refused(n):
    with pytest.raises(InvalidArgumentError, match=f"n_rollouts has to be at least 1, got {n}"):
        PIBB([nn.Parameter(torch.zeros(1))], Gaussian(0.1), n_rollouts=n)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_scalars_say_how_wide_the_noise_is_and_how_the_last_update_weighed(dtype):
    theta = nn.Parameter(torch.zeros(3, dtype=dtype))
    optim = PIBB([theta], Gaussian(0.3), n_rollouts=4, lr=0.5, generator=torch.Generator().manual_seed(0))
    assert optim.scalars() == {"exploration/lr": 0.5}
    optim.step(lambda: torch.tensor([1.0, 2.0, torch.inf, 3.0]))
    w = [1, math.exp(-5), math.exp(-10)]  # h = 10 over the range of 2
    share = [each / sum(w) for each in w]
    found = optim.scalars()
    assert found["weights/entropy"] == pytest.approx(
        -sum(p * math.log(p) for p in share), rel=1e4 * torch.finfo(dtype).eps
    )
    assert found["exploration/mean_cost"] == 2.0
