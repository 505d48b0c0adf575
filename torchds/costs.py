"""Cost terms over trajectories, and the control cost of Algorithm 1.

Stability: stable.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchds import kernels
from torchds.arrays import Array, beside, broadcast_shape, like, number, real
from torchds.errors import InvalidArgumentError
from torchds.visits import Gated


def via_points(x: Array, points: Array) -> Tensor:
    """Σ_l min_{j ≥ 1} |x_l^via − x_j|², the via-point term of Eq. 39.

    Args:
        x: `(..., T+1, D)` states, the start first (it does not count).
        points: `(L, D)` via-points.

    Returns:
        `(...)`.

    Raises:
        InvalidArgumentError: no arrays of numbers, or shapes that do not fit.
    """
    x = _moving("x", x)[..., 1:, None, :]
    points = beside("points", points, x, "(L, D)")
    axes = zip(x.transpose(-3, -2).unbind(-1), points.unsqueeze(-2).unbind(-1), strict=True)
    squares = [(position - point).square_() for position, point in axes]  # (..., L, T) of each axis
    return functools.reduce(Tensor.add_, squares).amin(-1).sum(-1)


def goal(x: Array, target: Array) -> Tensor:
    """|x^goal − x_T|², the goal term of Eq. 39, `(...)` for `x` `(..., T+1, D)` and `target` `(D,)`."""
    end = _moving("x", x)[..., -1, :]
    return (end - beside("target", target, end, "(D,)")).square().sum(-1)


def intrusion(x: Array, centres: Array, radii: Array) -> Tensor:
    """Σ_r max_{j ≥ 1} (R_r − |x_j − c_r|)₊², how deep a motion comes into discs that it should stay out of, `(...)`.

    Of each disc only the deepest state counts, so that the cost depends neither on how long a visit is nor on the time step.
    Inside, the gradient moves that state away from the centre; outside, it is zero.

    Args:
        x: `(..., T+1, D)` states, the start first (it does not count).
        centres: `(R, D)` c_r.
        radii: `(R,)` R_r, in the unit of the states.

    Raises:
        InvalidArgumentError: no arrays of numbers, or shapes that do not fit.
    """
    x = _moving("x", x)[..., 1:, None, :]
    c = beside("centres", centres, x, "(R, D)")
    if c.ndim != 2:
        raise InvalidArgumentError(f"centres has to be (R, D), got shape {tuple(c.shape)}")
    R = like("radii", radii, x)
    if R.shape != c.shape[:1]:
        raise InvalidArgumentError(f"radii has to be ({len(c)},), one for each centre, got shape {tuple(R.shape)}")
    depth = (R - torch.linalg.vector_norm(x - c, dim=-1)).clamp_min(0.0)  # (..., T, R)
    deepest: Tensor = depth.amax(-2)
    return deepest.square().sum(-1)


def acceleration_steps(v: Array) -> Tensor:
    """|v_j − v_{j−1}| of every step `(..., T)` for `v` `(..., T, O)`, zero in the first; not divided by dt (Eq. 39)."""
    v = real("v", v, "(..., T, O)")
    return pad(torch.linalg.vector_norm(v.diff(dim=-2), dim=-1), (1, 0))


def acceleration(v: Array) -> Tensor:
    """Σ_j |v_j − v_{j−1}|, `(...)` for `v` `(..., T, O)`: the running cost of Eq. 39."""
    return acceleration_steps(v).sum(-1)


def path_length(v: Array, dt: float) -> Tensor:
    """Σ_j |v_j| dt, `(...)` for `v` `(..., T, O)` (Eq. 41)."""
    speed: Tensor = torch.linalg.vector_norm(real("v", v, "(..., T, O)"), dim=-1)
    return speed.sum(-1) * number("dt", dt, "positive and finite", lambda step: 0 < step < math.inf)


def stiffness(s: Array) -> Tensor:
    """Σ_j |s_j|, `(...)` for the stiffness `s` `(..., T, D)` applied to each axis [N/m] (Eq. 49)."""
    size: Tensor = torch.linalg.vector_norm(real("s", s, "(..., T, D)"), dim=-1)
    return size.sum(-1)


def control_cost(deviation: Array, noise: Array, features: Array | Gated, weight: float | Array) -> Tensor:
    r"""Υ_t = (θ* + M_t ε)ᵀ R (θ* + M_t ε) of Algorithm 1, lines 15-16, without a P×P matrix.

    With R diagonal and G = [gᵀ ⊗ I], M projects each output row of ε on its features g, hence per row

    .. math:: Υ = θ^{*T} R θ^* + \frac{2 (θ^* · g)(ε · g) + (ε · g)^2}{g^T R^{-1} g}.

    Line 16 as printed mixes the indices of ε; ε is constant along a roll-out, so they are the same.

    Args:
        deviation: `(*batch, O, F)` θ*, the distance from the demonstrated policy, one row per output.
        noise: `(*batch, O, F)` ε.
        features: `(*batch, *points, T, F)` g_t = h_k(x_t) [x_t, 1], of one roll-out or of several of the same policy; as
            such, or in its two parts (`Rollout.visited`).
        weight: R, a number r for r I or its diagonal `(*batch, O, F)`. A parameter of weight zero is free: it costs
            nothing and M does not see it.

    Returns:
        `(*batch, *points, T)`; the cost of a roll-out is ½ Σ_t Υ_t.
    """
    if not isinstance(features, Gated):
        g = real("features", features, "(*batch, *points, T, F)")
        features = Gated(g, g[..., :0])  # an input less each: g [1]
    n_axes, F = len(features.shape), features.shape[-1]
    theta = beside("deviation", deviation, features.gating.new_empty(1, F), "(*batch, O, F)")
    epsilon = beside("noise", noise, theta, "(*batch, O, F)", last=2)
    R: Tensor = beside("weight", weight, theta, "a number or (*batch, O, F)", last=0)
    R = R.expand(broadcast_shape(R.shape, theta.shape[-2:]))
    for _ in range(n_axes - max(theta.ndim, epsilon.ndim)):  # an axis for each of the points
        theta, epsilon, R = theta.unsqueeze(-3), epsilon.unsqueeze(-3), R.unsqueeze(-3)
    if kernels.fits(theta, epsilon, R, features.gating):
        return kernels.control_cost(theta, epsilon, features, R)
    g = features.features
    controlled = R > 0
    inverse = torch.where(controlled, 1.0 / R, 0.0)
    drift = torch.where(controlled, theta, 0.0) @ g.mT  # (*batch, O, T): θ*·g
    push = torch.where(controlled, epsilon, 0.0) @ g.mT  # ε·g
    size = inverse @ g.square().mT  # gᵀR⁻¹g
    moved = torch.where(size > 0, (2 * drift + push) * push / size, 0.0)
    upsilon: Tensor = ((R * theta.square()).sum(-1, keepdim=True) + moved).sum(-2)
    return upsilon


def _moving(name: str, x: Array) -> Tensor:
    """States `(..., T+1, D)` with at least one step."""
    x = real(name, x, "(..., T+1, D)")
    if x.shape[-2] < 2:
        raise InvalidArgumentError(f"{name} has to be (..., T+1, D) with T ≥ 1, got shape {tuple(x.shape)}")
    return x
