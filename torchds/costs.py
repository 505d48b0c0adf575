"""Cost terms over trajectories, and the control cost of Algorithm 1.

Stability: stable.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from torchds import kernels


def via_points(x: Tensor, points: Tensor) -> Tensor:
    """Σ_l min_{j ≥ 1} |x_l^via − x_j|², the via-point term of Eq. 39.

    Args:
        x: `(..., T+1, D)` states, the start first (it does not count).
        points: `(L, D)` via-points.

    Returns:
        `(...)`.
    """
    return (x[..., 1:, None, :] - points).square().sum(-1).amin(-2).sum(-1)


def goal(x: Tensor, target: Tensor) -> Tensor:
    """|x^goal − x_T|², the goal term of Eq. 39, `(...)` for `x` `(..., T+1, D)` and `target` `(D,)`."""
    return (x[..., -1, :] - target).square().sum(-1)


def acceleration_steps(v: Tensor) -> Tensor:
    """|v_j − v_{j−1}| of every step `(..., T)` for `v` `(..., T, O)`, zero in the first; not divided by dt (Eq. 39)."""
    return F.pad(torch.linalg.vector_norm(v.diff(dim=-2), dim=-1), (1, 0))


def acceleration(v: Tensor) -> Tensor:
    """Σ_j |v_j − v_{j−1}|, `(...)` for `v` `(..., T, O)`: the running cost of Eq. 39."""
    return acceleration_steps(v).sum(-1)


def path_length(v: Tensor, dt: float) -> Tensor:
    """Σ_j |v_j| dt, `(...)` for `v` `(..., T, O)` (Eq. 41)."""
    speed: Tensor = torch.linalg.vector_norm(v, dim=-1)
    return speed.sum(-1) * dt


def stiffness(s: Tensor) -> Tensor:
    """Σ_j |s_j|, `(...)` for the stiffness `s` `(..., T, D)` applied to each axis [N/m] (Eq. 49)."""
    size: Tensor = torch.linalg.vector_norm(s, dim=-1)
    return size.sum(-1)


def control_cost(deviation: Tensor, noise: Tensor, features: Tensor, weight: float | Tensor) -> Tensor:
    r"""Υ_t = (θ* + M_t ε)ᵀ R (θ* + M_t ε) of Algorithm 1, lines 15-16, without a P×P matrix.

    With R diagonal and G = [gᵀ ⊗ I], M projects each output row of ε on its features g, hence per row

    .. math:: Υ = θ^{*T} R θ^* + \frac{2 (θ^* · g)(ε · g) + (ε · g)^2}{g^T R^{-1} g}.

    Line 16 as printed mixes the indices of ε; ε is constant along a roll-out, so they are the same.

    Args:
        deviation: `(*batch, O, F)` θ*, the distance from the demonstrated policy, one row per output.
        noise: `(*batch, O, F)` ε.
        features: `(*batch, *points, T, F)` g_t = h_k(x_t) [x_t, 1], of one roll-out or of several of the same policy.
        weight: R, a number r for r I or its diagonal `(*batch, O, F)`. A parameter of weight zero is free: it costs
            nothing and M does not see it.

    Returns:
        `(*batch, *points, T)`; the cost of a roll-out is ½ Σ_t Υ_t.
    """
    weight = torch.as_tensor(weight, dtype=features.dtype, device=features.device).expand(deviation.shape)
    for _ in range(features.ndim - deviation.ndim):  # an axis for each of the points
        deviation, noise, weight = (rows.unsqueeze(-3) for rows in (deviation, noise, weight))
    if kernels.fits(deviation, noise, features, weight):
        return kernels.control_cost(deviation, noise, features, weight)
    controlled = weight > 0
    inverse = torch.where(controlled, 1.0 / weight, 0.0)
    drift = torch.where(controlled, deviation, 0.0) @ features.mT  # (*batch, O, T): θ*·g
    push = torch.where(controlled, noise, 0.0) @ features.mT  # ε·g
    size = inverse @ features.square().mT  # gᵀR⁻¹g
    moved = torch.where(size > 0, (2 * drift + push) * push / size, 0.0)
    return ((weight * deviation.square()).sum(-1, keepdim=True) + moved).sum(-2)
