"""New Gaussians where the motion needs them, while it learns: the paper's future work on its frozen gating.

Stability: stable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from torchds.arrays import Array, like, number
from torchds.errors import InvalidArgumentError
from torchds.policy import GMRPolicy
from torchds.rollouts import Rollout

ODDS = 9.0  # of a copy against its original, at the place of recruiting


def recruit(policy: GMRPolicy, at: Array, width: float) -> GMRPolicy:
    r"""A policy of 2 K Gaussians with the same field, that can be changed near `at` without changing it elsewhere.

    A Gaussian beside others takes from all of them, so K + 1 of them cannot make the old field again. K more can: each of
    them copies one component, its A_k and b_k too, times the same bump, and the product of two Gaussians is one:

    .. math:: π'_k N(x; μ'_k, Σ'_k) = 9\, e^{-|x - at|^2 / (2\, width^2)}\, π_k N(x; μ_k, Σ_k).

    Original and copy share h_k(x) as 1 to 9 e^{...}, in all components alike; together they have what h_k was, hence the
    motion does not jump (but for round-off). What proves stability holds as before, since no A_k and b_k is new.

    Args:
        policy: with any batch_shape; it stays as it is.
        at: `(D,)` for all policies of the batch, or `(*lead, D)`, where the batch_shape ends with `lead`: a place for each.
        width: standard deviation of the bump [position unit].

    Returns:
        A new policy, the copies behind the originals, parameters and demonstrated parameters alike. An optimizer of the old
        parameters does not know it: make a new one. Copies whose prior is below the smallest number have no part.

    Raises:
        InvalidArgumentError: a place of another shape or not finite, or a width that is not positive.

    Example:
        >>> import torch, torchds
        >>> mixture = torchds.GaussianMixture(torch.ones(1), torch.zeros(1, 4), torch.eye(4)[None])
        >>> policy = torchds.GMRPolicy.from_mixture(mixture, input_dim=2)
        >>> torchds.recruit(policy, torch.tensor([1.0, 0.0]), width=0.5)
        GMRPolicy(K=2, D=2, O=2, Q=0, batch_shape=())
    """
    place = like("at", at, policy.means)
    D, batch, lead = policy.input_dim, policy.batch_shape, place.shape[:-1]
    if place.shape[-1:] != (D,) or batch[len(batch) - len(lead) :] != lead or not place.isfinite().all():
        raise InvalidArgumentError(
            f"at has to be finite and ({D},), or (*lead, {D}) where the batch_shape {batch} of the policy ends with lead, "
            f"got {place.tolist()} of shape {tuple(place.shape)}"
        )
    width = number("width", width, "finite and positive", lambda size: 0 < size < math.inf)
    away = place.unsqueeze(-2) - policy.means  # (*gate, K, D)
    Sigma, wide = policy.covariances, width**2 * torch.eye(D, dtype=away.dtype, device=away.device)
    gain = torch.linalg.solve(Sigma + wide, Sigma).mT  # Σ (Σ + width² I)⁻¹, (*gate, K, D, D)
    means = policy.means + (gain @ away.unsqueeze(-1)).squeeze(-1)
    covariances = (0.5 * width**2 * (gain + gain.mT)).expand(*means.shape, D)
    distance = (away * torch.linalg.solve(Sigma + wide, away.unsqueeze(-1)).squeeze(-1)).sum(-1)
    mass = (-0.5 * (distance + torch.logdet(Sigma + wide))).exp() * width**D  # ∫ bump N(x; μ_k, Σ_k) dx
    priors = _beside(policy.priors, ODDS * policy.priors * mass, -1)

    def doubled(name: str) -> Tensor:
        return torch.cat([getattr(policy, name).detach()] * 2, -2 if name.endswith("b") else -3)

    names = [name for name in ("A", "b", "stiffness_A", "stiffness_b") if getattr(policy, name) is not None]
    new = GMRPolicy(
        priors / priors.sum(-1, keepdim=True),
        _beside(policy.means, means, -2),
        _beside(Sigma, covariances, -3),
        *(doubled(name) for name in names),
    )
    for name in names:  # the control cost is measured from what was demonstrated, as before
        new.register_buffer(f"initial_{name}", doubled(f"initial_{name}"))
        getattr(new, name).requires_grad_(getattr(policy, name).requires_grad)
    new.info = policy.info
    return new


@torch.no_grad()
def most_wanted(path: Rollout, cost: Callable[[Rollout], Tensor]) -> Tensor:
    """Where each motion should be elsewhere: its place where the cost changes most with it, arg max over x_t of |∂S/∂x_t|.

    For via-points, that is where the motion passes the one that it misses most.

    Args:
        path: of policies `(*batch)`, from one start or several.
        cost: what the path costs, `(*batch)`, differentiable with respect to `path.x`.

    Returns:
        `(*batch, D)` states of the reference motion.
    """
    with torch.enable_grad():
        x = path.x.detach().requires_grad_()
        costs = cost(replace(path, x=x, reference=x if path.plant is None else path.reference))
        (gradient,) = torch.autograd.grad(costs.sum(), x)
    size = gradient.norm(dim=-1)[..., 1:].nan_to_num(0.0).flatten(costs.ndim)  # the start cannot move
    places = path.reference[..., 1:, :].flatten(costs.ndim, -2)
    return places.take_along_dim(size.argmax(-1)[..., None, None], -2).squeeze(-2)


def _beside(old: Tensor, new: Tensor, dim: int) -> Tensor:
    """Both along `dim`; the new may have a batch that the old has not."""
    return torch.cat([old.expand_as(new), new], dim)
