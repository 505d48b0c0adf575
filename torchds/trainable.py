"""A batch of mixtures of linear systems of which everything is learned, the gating too.

`GMRPolicy` freezes its gating, since policy search needs that; a fit to demonstrations moves the Gaussians as well.
Letters: `B` fits, `K` components (padded to the largest of the batch), `N` samples of a fit, `D` dimensions.

Stability: experimental.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchds.mixture import GaussianMixture
from torchds.stability import largest_eigenvalue, project, stable_factors, stable_matrices

SLACK = 0.05  # how far inside the set a fit starts, beyond its margin
PADDING = -1e9  # log weight of components that a fit does not have


class TrainableMixture(nn.Module):
    """B systems ẋ = Σ_k h_k(x) A_k x around the origin, with the condition of `torchds.stability` built in.

    Args:
        start: B joint mixtures of [x, v]; the gating starts as its marginal, the noise of the velocity as its
            conditional covariance. Components of prior zero are padding.
        A: `(B, K, D, D)` slopes to start from; with P they are moved into the stable set.
        P: `(B, D, D)` of the condition, of trace D, or None for no condition.
        margin: the rate of convergence that every system keeps.
        learn_metric: whether P is learned too.
        floor: added to the variance of positions and velocities.
    """

    mask: Tensor
    fixed_P: Tensor | None
    pairs: Tensor
    halves: Tensor

    def __init__(
        self,
        start: GaussianMixture,
        A: Tensor,
        P: Tensor | None = None,
        *,
        margin: float,
        learn_metric: bool = False,
        floor: float = 1e-3,
    ) -> None:
        super().__init__()
        D = A.shape[-1]
        self.margin, self.learn_metric = margin, learn_metric
        ridge = floor * torch.eye(D, dtype=A.dtype, device=A.device)
        noise = start.covariances[..., D:, D:] - start.experts(D)[0] @ start.covariances[..., :D, D:]
        self.stable = P is not None
        self.euclidean = P is not None and not learn_metric and torch.equal(P, torch.eye(D).to(P).expand_as(P))
        self.register_buffer("mask", start.priors > 0)
        self.register_buffer("fixed_P", None if learn_metric else P)
        i, j = torch.triu_indices(D, D, device=A.device)
        self.register_buffer("pairs", torch.stack([i, j, D * i + j]), persistent=False)
        self.register_buffer("halves", torch.where(i == j, -0.5, -1.0).to(A), persistent=False)
        self.log_prior = nn.Parameter(start.priors.log().clamp(min=PADDING))
        self.mean = nn.Parameter(start.means[..., :D].clone())
        self.precision = nn.Parameter(_log_diagonal(_precision_root(start.covariances[..., :D, :D] + ridge)))
        self.noise = nn.Parameter(_log_diagonal(_precision_root(noise + ridge)))
        if P is None:
            self.slopes = nn.Parameter(A.clone())
            return
        inside = project(A, P.unsqueeze(-3), margin=margin + SLACK)
        factor, skew = stable_factors(inside, P.unsqueeze(-3), margin=margin)
        self.factor, self.skew = nn.Parameter(factor), nn.Parameter(skew)
        if learn_metric:
            self.metric = nn.Parameter(_log_diagonal(torch.linalg.cholesky(P)))

    @property
    def P(self) -> Tensor | None:
        """`(B, D, D)` of trace D; None without a condition."""
        if not self.learn_metric:
            return self.fixed_P
        factor = _exp_diagonal(self.metric.tril())
        P = factor @ factor.mT
        return P * (P.shape[-1] / P.diagonal(dim1=-2, dim2=-1).sum(-1))[:, None, None]

    @property
    def A(self) -> Tensor:
        """`(B, K, D, D)` slopes."""
        return self.slopes_and_metric()[0]

    def slopes_and_metric(self) -> tuple[Tensor, Tensor | None]:
        """A `(B, K, D, D)` and P `(B, 1, D, D)`; None without a condition, and for P = I, which is the same and cheaper."""
        if not self.stable:
            return self.slopes, None
        P = None if self.euclidean else self.P
        P = None if P is None else P.unsqueeze(-3)
        return stable_matrices(self.factor, self.skew, P, margin=self.margin), P

    @property
    def priors(self) -> Tensor:
        """`(B, K)`, zero for padding."""
        return self.log_prior.masked_fill(~self.mask, -torch.inf).softmax(-1)

    @property
    def covariances(self) -> Tensor:
        """`(B, K, D, D)` of the gating."""
        return torch.cholesky_inverse(_exp_diagonal(self.precision.triu()), upper=True)

    def log_weights(self, x: Tensor) -> Tensor:
        """log π_k N(x; μ_k, Σ_k) up to a constant, `(B, N, K)` for `x` `(B, N, D)`.

        A log density of a Gaussian is linear in [x_i x_j, x, 1], so that all are one product of matrices.
        """
        root = _exp_diagonal(self.precision.triu())
        precision = root.mT @ root
        linear = (precision @ self.mean.unsqueeze(-1)).squeeze(-1)
        constant = self.log_prior + _log_det(self.precision) - 0.5 * (self.mean * linear).sum(-1)
        i, j, entry = self.pairs
        square = precision.flatten(-2).index_select(-1, entry) * self.halves
        features = torch.cat([x[..., i] * x[..., j], x, torch.ones_like(x[..., :1])], -1)
        coefficients = torch.cat([square, linear, constant.unsqueeze(-1)], -1)  # (B, K, D (D+3) / 2 + 1)
        return (features @ coefficients.mT).masked_fill(~self.mask.unsqueeze(-2), PADDING)

    def forward(self, x: Tensor, A: Tensor) -> Tensor:
        """The velocity `(B, N, D)` at `x` `(B, N, D)`, with the slopes `A`."""
        slope = torch.unflatten(self.log_weights(x).softmax(-1) @ A.flatten(-2), -1, A.shape[-2:])
        return (slope * x.unsqueeze(-2)).sum(-1)

    def log_likelihood(self, x: Tensor, v: Tensor, A: Tensor) -> Tensor:
        """log p(x, v) of each sample up to a constant, `(B, N)`, with v ~ N(A_k x, the noise of k)."""
        root = _exp_diagonal(self.noise.triu())
        z = torch.einsum("bkij,bnj->bnki", root, v) - torch.einsum("bkij,bnj->bnki", root @ A, x)
        total = self.log_prior.masked_fill(~self.mask, PADDING).logsumexp(-1)[:, None, None]
        log_noise = _log_det(self.noise).unsqueeze(-2) - 0.5 * z.square().sum(-1)
        return (self.log_weights(x) - total + log_noise).logsumexp(-1)

    def slowness(self, A: Tensor, P: Tensor | None, rate: float) -> Tensor:
        """The squared shortfall of the guaranteed rates below `rate`, mean over components, `(B,)`."""
        if not self.stable:
            return A.new_zeros(len(A))
        shortfall = (rate + largest_eigenvalue(A, P)).clamp(min=0)
        return (shortfall.square() * self.mask).sum(-1) / self.mask.sum(-1)


def _precision_root(covariance: Tensor) -> Tensor:
    """U, upper triangular, with Σ⁻¹ = UᵀU."""
    U: Tensor = torch.linalg.cholesky(torch.cholesky_inverse(torch.linalg.cholesky(covariance)), upper=True)
    return U


def _log_diagonal(root: Tensor) -> Tensor:
    """A triangular matrix with the logarithm of its diagonal, which makes it free."""
    diagonal = root.diagonal(dim1=-2, dim2=-1)
    return root + torch.diag_embed(diagonal.log() - diagonal)


def _exp_diagonal(free: Tensor) -> Tensor:
    """The inverse of `_log_diagonal`."""
    diagonal = free.diagonal(dim1=-2, dim2=-1)
    return free + torch.diag_embed(diagonal.exp() - diagonal)


def _log_det(free: Tensor) -> Tensor:
    return free.diagonal(dim1=-2, dim2=-1).sum(-1)
