"""Learning for several starts from trials that each begin at one of them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from tasks import Task
from torchds import GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.optim.functional import Temperature, relative_costs


def one_start(task: Task, policy: GMRPolicy, n: int, temperature: Temperature) -> Callable[[], Tensor]:
    """A closure that tries each of N perturbed policies from one start only, the starts in turn.

    Args:
        task: with S > 1 starts, whose costs of one start are those of a trial from there.
        policy: that an optimizer perturbs.
        n: N, the optimizer's `n_rollouts`.
        temperature: that of the optimizer, which makes the starts comparable too (see `comparable`).

    Raises:
        InvalidArgumentError: a task with one start or a convention of its own about several, or an N that is no multiple
            of S.
    """
    starts, n_steps, dt = task.motion()
    if starts.ndim != 2 or len(starts) < 2 or task.convention != "paper":
        raise InvalidArgumentError(f"task {task.name!r} does not have several starts that could be tried one by one")
    if n % len(starts):
        raise InvalidArgumentError(f"{n} roll-outs cannot be shared evenly by {len(starts)} starts")
    own = starts[torch.arange(n) % len(starts)]  # (N, D)

    def closure() -> Tensor:
        batch = policy.batch_shape  # (N, *runs)
        x0 = own.reshape(n, *(1,) * len(batch), -1).expand(*batch, 1, -1)
        path = rollout(policy, x0, n_steps, dt, starts="per_policy", stop=task.stop, plant=task.plant)
        return comparable(task.cost(path), len(starts), temperature)

    return closure


def comparable(costs: Tensor, n_starts: int, temperature: Temperature) -> Tensor:
    """Costs `(N, *batch)` of trials from S starts in turn, moved and stretched until all starts have one minimum and spread.

    Both are the means of what the starts have, so that a control cost that is added to them keeps its weight. Failed trials
    stay infinite, and do not count otherwise.
    """
    each = costs.unflatten(0, (-1, n_starts))  # (N/S, S, *batch)
    relative = relative_costs(each, temperature)
    low = torch.where(each.isfinite(), each, torch.inf).amin(0)
    above = torch.where((relative > 0) & relative.isfinite(), (each - low) / relative, torch.inf)
    spread = above.amin(0)  # capped costs have more above them
    spread = torch.where(spread.isfinite(), spread, 0.0)
    scaled = low.mean(0) + spread.mean(0) * relative
    return torch.where(each.isfinite(), scaled, torch.inf).flatten(0, 1)
