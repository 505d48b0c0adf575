"""What a learning run asks of anything that searches: updates, counts of what they spent, and a way to resume."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from tasks import Task
from torchds import GMRPolicy, sharing
from torchds.errors import InvalidArgumentError
from torchds.optim import PolicySearch

GRADIENT_COST = 4
"""Forward-equivalents of a trial with its gradient: the trial, and a backward pass that takes about three times as long."""
JACOBIAN_COST = 2
"""Forward-equivalents of the Jacobian behind `TrajectorySpace`: a roll-out of the reference, and about as much again."""

Closure = Callable[[], Tensor]
"""Tries the policies as they stand, N perturbed ones of each run, and returns what they cost, `(N, runs)`."""


class Searcher(ABC):
    """Searches for the parameters of `(runs,)` policies, one `step` after the other.

    Attributes:
        n_rollouts: N, trials of one step and run.
        costs_per_step: whether a closure has to return its costs by time steps, `(N, runs, T)`.
        optim: the optimizer at work, whose `ask` and `tell` make a step in two halves; None where there is none.
    """

    n_rollouts: int
    costs_per_step = False
    optim: PolicySearch | None = None

    @property
    @abstractmethod
    def failed(self) -> int:
        """Trials of the last step without a finite cost, all runs together."""

    @abstractmethod
    def step(self, closure: Closure) -> Tensor:
        """Spend `n_rollouts` trials, leave the policies at what they recommend, and take the decay one update further.

        Returns:
            `(runs,)` the mean cost of the trials.
        """

    @abstractmethod
    def closure(self, task: Task, policy: GMRPolicy) -> Closure:
        """Trials of a task, with their costs in the form that `step` takes."""

    @abstractmethod
    def forward_equivalents(self, updates: int) -> int:
        """What that many updates compute, in roll-outs without gradients."""

    @abstractmethod
    def scalars(self) -> dict[str, float]:
        """What is worth logging after each update, by TensorBoard tag."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that it needs to continue bit for bit, beside the parameters of the policies."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""

    def follow(self, before: Searcher) -> None:
        """Go on, with other policies, where the draws, the width and the decay of another searcher are.

        Raises:
            InvalidArgumentError: this one cannot, or not after that one.
        """
        raise InvalidArgumentError(
            "this searcher keeps its coordinates and cannot go on with other policies; use --optimizer pibb, pi2, pi2cma or "
            "surrogate"
        )


def noisy(closure: Closure, std: float, per_step: bool, generator: torch.Generator) -> Closure:
    """The closure with normal noise in the cost of each trial; where it returns costs by time steps, in the last one."""

    def with_noise() -> Tensor:
        costs = closure()
        shape = costs.shape[:-1] if per_step else costs.shape
        normal = functools.partial(torch.randn, dtype=costs.dtype, generator=generator)
        noise = std * sharing.drawn(tuple(shape), normal).to(costs.device)
        return torch.cat([costs[..., :-1], costs[..., -1:] + noise.unsqueeze(-1)], -1) if per_step else costs + noise

    return with_noise


def by_chance(closure: Closure, task: Task, generator: torch.Generator) -> Closure:
    """The closure with the noise of the trials of `task`, which otherwise have none."""

    def with_chance() -> Tensor:
        task.chance = generator
        try:
            return closure()
        finally:
            task.chance = None

    return with_chance
