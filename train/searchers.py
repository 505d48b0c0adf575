"""Optimizers and explorations by the names that the commands know."""

from __future__ import annotations

import torch

from tasks import Task
from torchds import GMRPolicy
from torchds.exploration import Exploration, Gaussian, Homogeneous
from torchds.optim import PIBB, InverseIteration, PolicySearch
from train.options import RunOptions

GAUSSIAN_STD = 0.01  # when --noise is not given


def make_exploration(options: RunOptions, task: Task, policy: GMRPolicy) -> Exploration:
    """The exploration that `--exploration` and `--noise` name."""
    if options.exploration == "gaussian":
        return Gaussian(GAUSSIAN_STD if options.noise is None else options.noise)
    return Homogeneous(policy, task.search.mean_speed if options.noise is None else options.noise)


def make_optimizer(options: RunOptions, task: Task, policy: GMRPolicy) -> PolicySearch:
    """The optimizer that `--optimizer` names."""
    return PIBB(
        policy.parameters(),
        exploration=make_exploration(options, task, policy),
        n_rollouts=task.search.n_rollouts if options.rollouts is None else options.rollouts,
        temperature=options.temperature,
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(options.seed),
    )


def make_decay(options: RunOptions, optim: torch.optim.Optimizer) -> torch.optim.lr_scheduler.LRScheduler:
    """The scheduler that `--decay` names."""
    if options.decay == "none":
        return torch.optim.lr_scheduler.ConstantLR(optim, factor=1.0)
    return torch.optim.lr_scheduler.LambdaLR(optim, InverseIteration(floor=0.1))
