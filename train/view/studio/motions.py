"""Motions that begin or end elsewhere, while they are dragged."""

from __future__ import annotations

import torch
from torch import Tensor

from tasks import Task
from torchds import GMRPolicy, rollout


@torch.no_grad()
def motion(task: Task, policy: GMRPolicy, start: Tensor | None = None, goal: Tensor | None = None) -> Tensor:
    """`(T+1, 2)` the motion of a policy.

    Args:
        task: that it is for.
        policy: one of them.
        start: `(2,)` where it begins; None for where it does.
        goal: `(2,)` where it ends, as if all of the plane were moved; None for where it does.
    """
    x0, n_steps, dt = task.motion()
    x = rollout(
        policy,
        x0 if start is None else start,
        n_steps,
        dt,
        stop=task.stop,
        plant=task.plant,
        feedback=task.feedback,
        shift=None if goal is None else goal - task.scene().goal,
    ).x
    return x.reshape(-1, *x.shape[-2:])[0]
