"""Searchers by the names that the commands know."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from tasks import Task
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration
from train.options import RunOptions
from train.searchers.base import Searcher
from train.searchers.coordinates import Brief, CoordinateSearch, Method, free_entries
from train.searchers.descent import adam, finite_differences, nes, sgd
from train.searchers.explorations import along_motion, make_exploration
from train.searchers.libraries import cma, cobyqa, lbfgs
from train.searchers.sampled import SAMPLED, sampled_search

METHODS = {
    "adam": Method(adam, gradient=True, random=False),
    "sgd": Method(sgd, gradient=True, random=False),
    "lbfgs": Method(lbfgs, gradient=True, random=False),
    "finite_differences": Method(finite_differences, gradient=False, random=False),
    "nes": Method(nes, gradient=False, random=True),
    "cma": Method(cma, gradient=False, random=True),
    "cobyqa": Method(cobyqa, gradient=False, random=False),
}
"""Searches over fixed coordinates; those that draw new noise in every update are in `SAMPLED`."""

Explore = Callable[[Task, GMRPolicy], Exploration]
"""Makes the exploration of `(runs,)` policies on a task."""


def make_searcher(options: RunOptions, task: Task, policy: GMRPolicy, explore: Explore | None = None) -> Searcher:
    """The searcher that `--optimizer` names.

    Args:
        options: of the run.
        task: that is learned.
        policy: `(runs,)` of it, which the searcher changes.
        explore: in place of the exploration that the options name.

    Raises:
        InvalidArgumentError: one that does not go with the task, or with another option.
    """
    explore = explore if explore is not None else partial(make_exploration, options)
    n_rollouts = task.search.n_rollouts if options.rollouts is None else options.rollouts
    if options.optimizer not in METHODS:
        exploration, n_updates = explore(task, policy), planned_updates(options, task)
        return sampled_search(options, task, policy, exploration, n_rollouts=n_rollouts, n_updates=n_updates)
    refuse(options, task)
    brief = Brief(
        runs=options.runs,
        P=int(free_entries(policy).sum()),
        n_rollouts=n_rollouts,
        scale=options.scale,
        seed=options.seed,
        noisy=trials_vary(options, task),
    )
    method = METHODS[options.optimizer]
    return CoordinateSearch(policy, explore(task, policy), method, brief, jacobian=along_motion(options))


def refuse(options: RunOptions, task: Task) -> None:
    """Refuse what a search in fixed coordinates cannot do.

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
    if options.exploration in ("stable", "stable-trajectory") and options.shrink != "none":
        raise InvalidArgumentError(
            f"--optimizer {name} searches in fixed coordinates and cannot shrink noise; with --exploration "
            f"{options.exploration} use --shrink none: b stays tied to the goal, stability is not kept"
        )


def trials_vary(options: RunOptions, task: Task) -> bool:
    """Whether a trial made again may cost another amount."""
    return options.cost_noise > 0 or task.noisy


def runs_vary(options: RunOptions, task: Task) -> bool:
    """Whether runs of these options differ; where they do not, one stands for all."""
    method = METHODS.get(options.optimizer)
    return method is None or method.random or trials_vary(options, task)


def planned_updates(options: RunOptions, task: Task) -> int:
    """The number of updates that `--updates` or the task says, each of as many roll-outs as `--rollouts` or the task says."""
    return task.search.n_updates if options.updates is None else options.updates


def n_updates(options: RunOptions, task: Task, searcher: Searcher) -> int:
    """How many steps of a searcher the planned roll-outs pay for; some need more of them for a step than was planned."""
    n_rollouts = task.search.n_rollouts if options.rollouts is None else options.rollouts
    return planned_updates(options, task) * n_rollouts // searcher.n_rollouts
