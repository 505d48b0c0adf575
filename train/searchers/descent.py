"""Descent along a gradient: the exact one, one by finite differences, or one from the costs of random steps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Generator
from typing import Any

import torch
from torch import Tensor, nn

from train.searchers.coordinates import Answer, Ask, Asking, Brief
from train.searchers.libraries import Objective, lockstep

# In standard deviations of the exploration, for a scale of one:
STEP = 0.25  # the first of Adam on exact gradients; docs/choosing.md says why
RATE = 0.1  # of the other descents
WIDTH = 0.1  # of finite differences

PATIENCE = 40  # trials

Gradient = Generator[Ask, Answer, Tensor]


def exact(z: Tensor) -> Gradient:
    """By automatic differentiation of one trial."""
    answer = yield Ask(z[None], z)
    assert answer.gradient is not None
    return answer.gradient[0]


def forward_differences(z: Tensor) -> Gradient:
    """(S(z + h e_i) − S(z)) / h, from P + 1 trials."""
    trials = torch.cat([torch.zeros_like(z[:1]), WIDTH * torch.eye(z.shape[-1], dtype=z.dtype)])
    answer = yield Ask(z + trials.unsqueeze(1), z)
    return ((answer.cost[1:] - answer.cost[0]) / WIDTH).mT


def score_function(z: Tensor, brief: Brief, generator: torch.Generator) -> Gradient:
    """∇E[S(z + σ ε)] = E[(S − baseline) ε] / σ, with centred ranks in the place of costs (Salimans et al. 2017)."""
    epsilon = torch.randn(brief.n_rollouts, *z.shape, dtype=z.dtype, generator=generator)
    answer = yield Ask(z + brief.scale * epsilon, z)
    rank = answer.cost.argsort(0).argsort(0).to(z.dtype)
    advantage = rank / (len(rank) - 1) - 0.5
    return (advantage.unsqueeze(-1) * epsilon).mean(0) / brief.scale


def _descend(
    brief: Brief, estimate: Callable[[Tensor], Gradient], optimizer: type[torch.optim.Optimizer], **options: Any
) -> Asking:
    """Follow one of torch's optimizers; where a gradient is not finite, it counts as zero."""
    z = nn.Parameter(torch.zeros(brief.runs, brief.P, dtype=torch.float64))
    optim = optimizer([z], **options)
    while True:
        gradient = yield from estimate(z.detach().clone())
        z.grad = gradient.nan_to_num(0.0, 0.0, 0.0)
        optim.step()


def adam(brief: Brief) -> Asking:
    """Adam on the exact gradient; every entry of z moves by about a quarter of a standard deviation a trial, or less.

    A step that is long enough to leave a bad minimum does not settle in a good one, and may end where nothing leads back. So
    after `PATIENCE` trials none of which was the cheapest so far, a new Adam of half the step begins at that one, and it is
    what is recommended. Where costs are noisy no trial is known to be the cheapest, and Adam goes on from where it stands.
    """
    rate = STEP * brief.scale
    if brief.noisy:
        return _descend(brief, exact, torch.optim.Adam, lr=rate)

    def minimise(objective: Objective, start: Tensor) -> None:
        best, lowest, step = start, math.inf, rate
        while True:
            z, idle = nn.Parameter(best.clone()), 0
            optim = torch.optim.Adam([z], lr=step)
            while idle < PATIENCE:
                cost, z.grad = objective(z)
                idle += 1
                if cost < lowest:
                    best, lowest, idle = z.detach().clone(), float(cost), 0
                optim.step()
            step /= 2

    return lockstep(brief, minimise)


def sgd(brief: Brief) -> Asking:
    """Gradient descent with momentum 0.9, on gradients over the norm of the first one: the first step has the length 0.1.

    The first is that of each run which is finite and not zero.
    """
    first = torch.full((brief.runs, 1), torch.nan, dtype=torch.float64)

    def relative(z: Tensor) -> Gradient:
        gradient = yield from exact(z)
        norm = torch.linalg.vector_norm(gradient, dim=-1, keepdim=True)
        usable = first.isnan() & norm.isfinite() & (norm > 0)
        first.copy_(torch.where(usable, norm, first))
        return gradient / first

    return _descend(brief, relative, torch.optim.SGD, lr=RATE * brief.scale, momentum=0.9)


def finite_differences(brief: Brief) -> Asking:
    """Adam on forward differences; steps are three times those of `adam`, since P + 1 trials allow few of them."""
    return _descend(brief, forward_differences, torch.optim.Adam, lr=3 * RATE * brief.scale)


def nes(brief: Brief) -> Asking:
    """An evolution strategy of fixed width: Adam on the score-function gradient (REINFORCE over parameters)."""
    generator = torch.Generator().manual_seed(brief.seed)
    estimate = functools.partial(score_function, brief=brief, generator=generator)
    return _descend(brief, estimate, torch.optim.Adam, lr=RATE * brief.scale)
