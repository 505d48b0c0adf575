"""Optimizers, explorations and decays by the names that the commands know."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from tasks import Task
from tasks.base import total
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration, Gaussian, Stable, TrajectorySpace
from torchds.optim import (
    PI2,
    PI2CMA,
    PIBB,
    ExponentialDecay,
    InverseIteration,
    LinearDecay,
    PolicySearch,
    SurrogatePIBB,
)
from train.options import RunOptions
from train.searchers.coordinates import JACOBIAN_COST
from train.searchers.methods import METHODS, CoordinateSearch, Setting

SAMPLED: dict[str, type[PIBB] | type[PI2]] = {"pibb": PIBB, "pi2": PI2, "pi2cma": PI2CMA, "surrogate": SurrogatePIBB}
"""Optimizers that draw new noise in every update; the others are in `train.baselines`."""


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
        tied = goal if stable else None
        if search.spread is None:
            size: dict[str, Any] = {} if options.noise is None else {"spread": options.noise}
            along = TrajectorySpace.relative(policy, *task.motion(), **size, goal=tied)
        else:
            along = TrajectorySpace(
                policy,
                *task.motion(),
                spread=search.spread if options.noise is None else options.noise,
                stiffness_spread=search.stiffness_spread,
                mean_speed=search.mean_speed,
                mean_stiffness=search.mean_stiffness,
                goal=tied,
            )
        return Stable(policy, along, goal, task.P, shrink=options.shrink) if stable else along
    mean_speed = search.mean_speed if options.noise is None else options.noise
    return search.homogeneous(
        policy,
        0.0 if learn == "stiffness" else mean_speed,
        mean_stiffness=0.0 if learn == "motion" else search.mean_stiffness,
    )


def n_rollouts(options: RunOptions, task: Task) -> int:
    """The roll-outs per update that `--rollouts` or the task says."""
    return task.search.n_rollouts if options.rollouts is None else options.rollouts


def make_optimizer(options: RunOptions, task: Task, policy: GMRPolicy) -> PolicySearch | CoordinateSearch:
    """The optimizer that `--optimizer` names.

    Raises:
        InvalidArgumentError: one that does not go with the task, or with another option.
    """
    if options.optimizer in METHODS:
        return make_coordinate_search(options, task, policy)
    along = along_motion(options)
    return SAMPLED[options.optimizer](
        policy.parameters(),
        lr=options.scale,
        exploration=make_exploration(options, task, policy),
        n_rollouts=n_rollouts(options, task),
        temperature=options.temperature or ("capped" if along else task.search.temperature),
        elite=options.elite or ("nominal" if options.optimizer == "surrogate" else task.search.elite),
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(options.seed),
    )


def make_coordinate_search(options: RunOptions, task: Task, policy: GMRPolicy) -> CoordinateSearch:
    """One of `train.baselines`, in the coordinates of the exploration.

    Raises:
        InvalidArgumentError: a gradient that the task does not have, or options that belong to sampled noise.
    """
    name, method = options.optimizer, METHODS[options.optimizer]
    if method.gradient and not task.differentiable:
        raise InvalidArgumentError(
            f"--optimizer {name} needs the gradient of a trial, which {task.name} does not have (contacts make its cost jump); "
            f"without gradients: {', '.join([*SAMPLED, *(other for other in METHODS if not METHODS[other].gradient)])}"
        )
    for option in ("decay", "temperature", "elite"):
        if (value := getattr(options, option)) is not None:
            raise InvalidArgumentError(f"--{option} {value} goes with --optimizer {' or '.join(SAMPLED)}, not {name}")
    if options.exploration.startswith("stable") and options.shrink != "none":
        raise InvalidArgumentError(
            f"--optimizer {name} searches in fixed coordinates and cannot shrink noise; with --exploration "
            f"{options.exploration} use --shrink none: b stays tied to the goal, stability is not kept"
        )
    setting = Setting(
        runs=options.runs,
        P=policy.pack().shape[-1],
        n_rollouts=n_rollouts(options, task),
        scale=options.scale,
        seed=options.seed,
    )
    return CoordinateSearch(policy, make_exploration(options, task, policy), method, setting)


def make_closure(optim: PolicySearch | CoordinateSearch, task: Task, policy: GMRPolicy) -> Callable[[], Tensor]:
    """One trial, and its cost in the form that the optimizer takes; a `PolicySearch` adds the control cost by itself."""
    if isinstance(optim, CoordinateSearch):
        return lambda: total(task.evaluate(policy)[1].values())
    cost = task.step_costs if optim.costs_per_step else task.cost
    return lambda: cost(task.rollout(policy))


def add_noise(
    closure: Callable[[], Tensor], std: float, per_step: bool, generator: torch.Generator
) -> Callable[[], Tensor]:
    """The closure with normal noise in the cost of each trial; where it returns costs by steps, in the last one."""

    def noisy() -> Tensor:
        costs = closure()
        shape = costs.shape[:-1] if per_step else costs.shape
        noise = std * torch.randn(shape, dtype=costs.dtype, generator=generator).to(costs.device)
        return torch.cat([costs[..., :-1], costs[..., -1:] + noise.unsqueeze(-1)], -1) if per_step else costs + noise

    return noisy


def n_updates(options: RunOptions, task: Task) -> int:
    """The number of updates that `--updates` or the task says."""
    return task.search.n_updates if options.updates is None else options.updates


def make_decay(
    options: RunOptions, task: Task, optim: PolicySearch | CoordinateSearch
) -> torch.optim.lr_scheduler.LRScheduler | None:
    """The scheduler that `--decay` names; None for an optimizer that sees to its step by itself."""
    if isinstance(optim, CoordinateSearch):
        return None
    n = max(n_updates(options, task), 1)
    factors: dict[str, Callable[[int], float]] = {
        "inverse": InverseIteration(floor=0.1),
        "linear": LinearDecay(n),
        "exponential": ExponentialDecay(min(n, 50), floor=0.15),
        "none": ExponentialDecay(n, floor=1.0),
    }
    own = "exponential" if along_motion(options) else task.search.decay
    name = options.decay or ("none" if options.optimizer == "pi2cma" else own)
    return torch.optim.lr_scheduler.LambdaLR(optim, factors[name])


def forward_equivalents(options: RunOptions, optim: PolicySearch | CoordinateSearch, updates: int) -> int:
    """What that many updates compute, in roll-outs without gradients."""
    if isinstance(optim, CoordinateSearch):
        return updates * optim.forward_equivalents + along_motion(options) * JACOBIAN_COST
    return updates * (optim.n_rollouts + along_motion(options) * JACOBIAN_COST)


def n_failed(optim: PolicySearch | CoordinateSearch) -> int:
    """Trials of the last step without a finite cost, all runs together."""
    if isinstance(optim, CoordinateSearch):
        return optim.failed
    return 0 if optim.last is None else int(optim.last.failed.sum())


def scalars(optim: PolicySearch | CoordinateSearch) -> dict[str, float]:
    """What is worth logging after each update, by TensorBoard tag."""
    if isinstance(optim, CoordinateSearch):
        return {} if optim.mean_cost is None else {"exploration/mean_cost": float(optim.mean_cost.mean())}
    found = {"exploration/lr": optim.param_groups[0]["lr"]}
    for exploration in optim.explorations:
        found |= exploration.scalars()
    if optim.last is not None:
        w = optim.last.weights
        found["weights/entropy"] = float(-(w * w.clamp_min(1e-300).log()).sum(0).mean())
        found["exploration/mean_cost"] = float(torch.where(optim.last.failed, 0, optim.last.cost).mean())
    return found
