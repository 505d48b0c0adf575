"""Trying each policy several times, where the system is noisy.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor, nn

from torchds.arrays import count
from torchds.optim.evaluation import Closure, as_costs
from torchds.visits import listen, report


def repeated(closure: Closure, parameters: Iterable[nn.Parameter], repeats: int) -> Closure:
    """A closure that tries every policy `repeats` times in one batch, and returns the mean of the costs.

    The paper's method knows no noise but its own. Where there is other noise, N roll-outs are N policies once, or N/R
    policies R times: this is the second, around the closure of any optimizer, made with `n_rollouts=N // R`. A policy one of
    whose trials failed has failed. docs/beyond.md says when it is worth it.

    Args:
        closure: one trial of the parameters as they stand, `(*batch)`, with noise of its own in every entry; it is called
            while all parameters carry R in front.
        parameters: those of the optimizer.
        repeats: R, at least 1.

    Returns:
        A closure of costs `(*batch)`, means over the R trials; parameters come back as they were, also after an error. The
        control cost is that of the first repeat: it depends on the reference, which noise leaves alone.

    Raises:
        InvalidArgumentError: fewer than one repeat.

    Example:
        >>> import torch, torchds
        >>> theta, generator = torch.nn.Parameter(torch.zeros(2)), torch.Generator().manual_seed(0)
        >>> def closure():
        ...     cost = (theta - 1.0).square().sum(-1)
        ...     return cost + torch.randn(cost.shape, generator=generator)
        >>> optim = torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.3), n_rollouts=20 // 4)
        >>> cost = optim.step(torchds.optim.repeated(closure, [theta], repeats=4))
    """
    repeats = count("repeats", repeats, 1)
    parameters = list(parameters)

    def averaged() -> Tensor:
        center = [p.data for p in parameters]
        try:
            for p in parameters:
                p.data = p.data.expand(repeats, *p.shape)
            with listen() as visits:
                costs = as_costs(closure(), parameters)  # (R, *batch)
        finally:
            for p, value in zip(parameters, center, strict=True):
                p.data = value
        for visit in visits:
            report(visit.policy, visit.features[0])
        return costs.mean(0)

    return averaged
