"""How a motion moves when its parameters do: exact derivatives of a roll-out, forward in time.

Stability: stable.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchds import kernels
from torchds.arrays import Array, beside
from torchds.policy import GMRPolicy
from torchds.rollouts import Rollout


@torch.no_grad()
def stiffness_sensitivity(policy: GMRPolicy, path: Rollout, J: Array) -> Tensor:
    """The Jacobian of the stiffness outputs with respect to θ, `(*batch, *points, T, Q, P)` for the states 0..T−1.

    Args:
        policy: that made the roll-out.
        path: its roll-out.
        J: `sensitivity(policy, path)`, since the stiffness depends on where the reference is.
    """
    O, x = policy.output_dim, path.inputs
    shape = x.new_empty(()).expand(*x.shape[:-1], O, policy.pack().shape[-1])
    steps = beside("J", J, shape, "(*batch, *points, T, O, P)", last=3)
    if (field := kernels.fusable(policy, x, steps)) is not None:
        return kernels.stiffness_sensitivity(field, x, steps)
    return policy.basis(x)[..., O:, :] + policy.jacobian(x)[..., O:, :] @ _before(steps[..., : policy.input_dim, :])


@torch.no_grad()
def sensitivity(policy: GMRPolicy, path: Rollout) -> Tensor:
    r"""The Jacobian of the reference with respect to θ, `(*batch, *points, T, O, P)` for the states 1..T.

    The first D rows are the positions. A policy with more velocities than inputs (Eq. 36: the angle's rate) has further
    rows, those of the integrals of these velocities (Eq. 38).

    Along x_{t+1} = x_t + f(x_t) dt with f = G_x θ (Eq. 4, 8),

    .. math:: J_{t+1} = (I + dt\,∂f/∂x(x_t)) J_t + dt\,G_{x_t}, \qquad J_0 = 0.

    Everything but this recursion is computed for all times at once. θ is in the order of `GMRPolicy.pack`.

    Args:
        policy: that made the roll-out.
        path: its roll-out.
    """
    if (field := kernels.fusable(policy, path.inputs)) is not None:
        return kernels.sensitivity(field, path.inputs, path.resting, path.dt)
    D = policy.input_dim
    x = path.inputs
    eye = torch.eye(D, dtype=x.dtype, device=x.device)
    push = path.dt * policy.basis(x)[..., :D, :]  # (*batch, *points, T, D, P)
    turn = eye + path.dt * policy.jacobian(x)[..., :D, :]  # (*batch, *points, T, D, D)
    if path.resting is not None:
        rests = path.resting[..., None, None]
        push, turn = push.masked_fill(rests, 0.0), torch.where(rests, eye, turn)
    lead = x.shape[:-2]
    pushes, turns = push.reshape(-1, *push.shape[-3:]).unbind(-3), turn.reshape(-1, *turn.shape[-3:]).unbind(-3)
    steps = [pushes[0]]
    for F, B in zip(turns[1:], pushes[1:], strict=True):
        steps.append(torch.baddbmm(B, F, steps[-1]))
    J = torch.stack(steps, -3).reshape(*lead, *push.shape[-3:])
    O = policy.output_dim
    if O == D:
        return J
    rates = policy.basis(x)[..., D:O, :] + policy.jacobian(x)[..., D:O, :] @ _before(J)
    if path.resting is not None:
        rates = rates.masked_fill(rests, 0.0)
    return torch.cat([J, path.dt * rates.cumsum(-3)], -2)


def _before(J: Tensor) -> Tensor:
    """Rows of the states 0..T−1 from those of 1..T; the start does not depend on θ."""
    return torch.cat([torch.zeros_like(J[..., :1, :, :]), J[..., :-1, :, :]], -3)
