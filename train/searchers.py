"""Optimizers, explorations and decays by the names that the commands know."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from tasks import Task
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration, Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.optim import PI2, PIBB, ExponentialDecay, InverseIteration, LinearDecay, PolicySearch
from train.options import RunOptions


def along_motion(options: RunOptions) -> bool:
    """Whether the exploration is one along the motion."""
    return options.exploration in ("trajectory", "stable-trajectory")


def make_exploration(options: RunOptions, task: Task, policy: GMRPolicy) -> Exploration:
    """The exploration that `--exploration`, `--noise` and `--shrink` name."""
    search, learn = task.search, getattr(options, "learn", "both")
    std = search.std if options.noise is None else options.noise
    if options.exploration == "gaussian":
        return Gaussian(std)
    goal = task.scene().goal
    if options.exploration == "stable":
        return Stable(policy, std, goal, task.P, shrink=options.shrink)
    if along_motion(options):
        if learn != "both":
            raise InvalidArgumentError(f"--learn {learn} goes with --exploration homogeneous, not trajectory")
        stable = options.exploration == "stable-trajectory"
        along = TrajectorySpace(
            policy,
            **task.motion(),
            spread=search.spread if options.noise is None else options.noise,
            stiffness_spread=search.stiffness_spread,
            mean_speed=search.mean_speed,
            mean_stiffness=search.mean_stiffness,
            widening=search.widening,
            damping=search.damping,
            goal=goal if stable else None,
        )
        return Stable(policy, along, goal, task.P, shrink=options.shrink) if stable else along
    mean_speed = search.mean_speed if options.noise is None else options.noise
    return Homogeneous(
        policy,
        0.0 if learn == "stiffness" else mean_speed,
        search.rule,
        mean_stiffness=0.0 if learn == "motion" else search.mean_stiffness,
    )


def make_optimizer(options: RunOptions, task: Task, policy: GMRPolicy) -> PolicySearch:
    """The optimizer that `--optimizer` names."""
    cls = {"pibb": PIBB, "pi2": PI2}[options.optimizer]
    along = along_motion(options)
    return cls(
        policy.parameters(),
        exploration=make_exploration(options, task, policy),
        n_rollouts=task.search.n_rollouts if options.rollouts is None else options.rollouts,
        temperature=options.temperature or ("capped" if along else task.search.temperature),
        elite=options.elite or task.search.elite,
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(options.seed),
    )


def make_closure(optim: torch.optim.Optimizer, task: Task, policy: GMRPolicy) -> Callable[[], Tensor]:
    """One trial, and its cost in the form that the optimizer takes."""
    cost = task.step_costs if getattr(optim, "costs_per_step", False) else task.cost
    return lambda: cost(task.rollout(policy))


def n_updates(options: RunOptions, task: Task) -> int:
    """The number of updates that `--updates` or the task says."""
    return task.search.n_updates if options.updates is None else options.updates


def make_decay(options: RunOptions, task: Task, optim: torch.optim.Optimizer) -> torch.optim.lr_scheduler.LRScheduler:
    """The scheduler that `--decay` names."""
    n = max(n_updates(options, task), 1)
    factors: dict[str, Callable[[int], float]] = {
        "inverse": InverseIteration(floor=0.1),
        "linear": LinearDecay(n),
        "exponential": ExponentialDecay(n, floor=0.03),
        "none": ExponentialDecay(n, floor=1.0),
    }
    name = options.decay or ("exponential" if along_motion(options) else task.search.decay)
    return torch.optim.lr_scheduler.LambdaLR(optim, factors[name])
