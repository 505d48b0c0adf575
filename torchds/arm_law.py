"""The torques of `torchds.cartesian` in torch, for any number of arms at once.

Stability: experimental.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor


class State(NamedTuple):
    """An arm at one moment: angles and velocities `(..., J)`, mass matrix `(..., J, J)`, bias torque `(..., J)`."""

    q: Tensor
    v: Tensor
    mass: Tensor
    bias: Tensor


class Gains(NamedTuple):
    """What does not change from call to call: posture `(J,)`, ζ, and the spring and damper of the posture."""

    posture: Tensor
    damping_ratio: float
    posture_stiffness: float
    posture_damping: float


def torques(state: State, gains: Gains, J: Tensor, K: Tensor, error: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
    """The torques before the limits `(..., J)`, and their part that only moves the posture.

    Args:
        state: of the arms.
        gains: of the law.
        J: `(..., 6, J)` Jacobian of the tool.
        K: `(..., 6)` the diagonal of the stiffness.
        error: `(..., 6)` of the reference from the tool.
        velocity: `(..., 6)` of the reference.
    """
    q, v, mass, bias = state
    # In joint coordinates scaled by the root of the mass matrix the arm has unit mass and the task sees J̃ = J L⁻ᵀ. With
    # √K J̃ = P Σ Qᵀ it damps by 2 ζ Q Σ Qᵀ, of which the reference takes 2 ζ Q Pᵀ √K ẋ^ref off (`torchds.kernels.arm`).
    L = torch.linalg.cholesky(mass)
    scaled = torch.linalg.solve_triangular(L, J.mT, upper=False).mT  # (..., 6, J)
    held = K > 0
    root = torch.where(held, K, 1.0).sqrt() * held  # so that its gradient is zero where K is
    P, S, Qh = _modes(root.unsqueeze(-1) * scaled)
    slip = S * _times(Qh, _times(L.mT, v)) - _times(P.mT, root * velocity)
    damping = -2 * gains.damping_ratio * _times(L, _times(Qh.mT, slip))

    free = gains.posture_stiffness * (gains.posture.to(q.device) - q) - gains.posture_damping * v
    raw = torch.linalg.solve_triangular(L, free.unsqueeze(-1), upper=False).squeeze(-1)
    moved = Qh if held.all() else _modes(scaled)[2]  # its rows span what the task can move
    nullspace = _times(L, raw - _times(moved.mT, _times(moved, raw)))
    return _times(J.mT, K * error) + damping + bias + nullspace, nullspace


def _modes(matrix: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """P, Σ and Qᵀ of P Σ Qᵀ, those rows of Qᵀ zero along which next to nothing is moved."""
    P, S, Qh = torch.linalg.svd(matrix, full_matrices=False)
    return P, S, Qh * (1e-7 * S[..., :1] < S).unsqueeze(-1)


def rotation_vector(turn: Tensor) -> Tensor:
    """The vector `(..., 3)` of rotations `(..., 3, 3)`, exact up to half a turn, where there are two ways of one length."""
    twice = torch.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        -1,
    )
    sine = 0.5 * torch.linalg.vector_norm(twice, dim=-1, keepdim=True)
    cosine = 0.5 * (turn.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1)
    small = sine < 1e-9
    ratio = torch.where(small, 1.0, torch.atan2(sine, cosine) / sine.masked_fill(small, 1.0))
    return torch.where(small & (cosine < 0), math.pi * _axis_of_half_turn(turn), 0.5 * twice * ratio)


def _axis_of_half_turn(turn: Tensor) -> Tensor:
    """n `(..., 3)` of R = 2 n nᵀ − I: the longest column of R + I."""
    columns = turn + torch.eye(3, dtype=turn.dtype, device=turn.device)
    longest = columns.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*turn.shape[:-1], 1)
    return torch.nn.functional.normalize(columns.gather(-1, longest).squeeze(-1), dim=-1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
