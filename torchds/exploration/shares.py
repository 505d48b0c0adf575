"""How large a motion is: what noise is measured by where its size is a share, so that no unit decides about it.

Stability: experimental.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchds.arrays import Array, beside
from torchds.policy import GMRPolicy
from torchds.rollouts import rollout


class MotionSize(NamedTuple):
    """The sizes of the motion that a policy makes, means over its starts and its batch.

    Attributes:
        extent: `(O,)` root mean square distance of the motion from its own mean place [position unit]; outputs beyond the
            positions have an extent of their own.
        distance: root mean square distance from the goal [position unit].
        speed: mean norm of the velocity [velocity unit].
        stiffness: mean absolute stiffness [N/m]; zero without stiffness rows.
    """

    extent: Tensor
    distance: float
    speed: float
    stiffness: float


@torch.no_grad()
def motion_size(policy: GMRPolicy, x0: Array, n_steps: int, dt: float, goal: Array | None = None) -> MotionSize:
    """Roll the policy out once and measure the motion.

    Args:
        policy: whose motion is measured, as it is now.
        x0: `(*points, D)` the starts.
        n_steps: T.
        dt: time step [s].
        goal: `(D,)` what `distance` is measured from; None for the origin of the coordinates, from which A acts.
    """
    D = policy.input_dim
    path = rollout(policy, x0, n_steps, dt)
    # Of the places and not of the starts: (O,)
    variances = (dt * path.v).cumsum(-2).var(-2).reshape(-1, policy.output_dim).mean(0)
    away = path.inputs if goal is None else path.inputs - beside("goal", goal, path.inputs, "(D,)")
    return MotionSize(
        extent=torch.cat([variances[:D].sum().expand(D), variances[D:]]).sqrt(),
        distance=float(away.square().sum(-1).mean().sqrt()),
        speed=float(torch.linalg.vector_norm(path.v, dim=-1).mean()),
        stiffness=float(policy.stiffness(path.inputs).abs().mean()) if policy.stiffness_dim else 0.0,
    )
