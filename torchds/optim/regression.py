"""What policies cost, judged by similar ones that were tried: Gaussian process regression that finds out how noisy costs are.

Letters: `M` policies tried, `F` coordinates, `n` candidates, `*batch` runs.

Stability: stable.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchds.arrays import Array, beside, real
from torchds.optim.functional import failures, quantile

RATIOS = (1e-3, 1e-2, 0.1, 0.5, 2.0, 8.0)
"""The variances of the noise that are compared, relative to that of what policies differ by. The first stands for none."""

RECENT = 100  # policies that the noise is estimated from
GOOD = 0.1  # the quantile of noisy costs that stands for a good policy
CAP, NOISY_CAP = 3.0, 10.0  # of costs over that of a good policy, where the median is 1


class Regression:
    r"""The costs S of M policies z, as a smooth function of z and noise.

    .. math:: \hat S(z) = k(z, Z) C^{-1} S, \quad C = k(Z, Z) + r I, \quad k(z, z') = \exp(-|z - z'|^2 / (2 ℓ^2)),

    with ℓ² the median squared distance between the policies tried, so that the unit of the coordinates does not matter
    (Eq. 2.23-2.24 of Rasmussen and Williams, Gaussian Processes for Machine Learning). The ratio r of the variances of noise
    and function is the one of `RATIOS` under which the last costs are most likely (Eq. 2.30), their common scale in closed
    form: a = Sᵀ C⁻¹ S / M.

    So that roll-outs that went astray do not decide, costs over the cheapest are capped at three times the median; where they
    are noisy, costs over the best tenth at ten times. Failed roll-outs are as bad as the cap.

    Args:
        tried: `(M, *batch, F)` coordinates Z in which equal distances mean equally different roll-outs.
        costs: `(M, *batch)` of these, at least one of them finite.
        noisy: `(*batch)` whether costs are known to be noisy; None for none.
        ratio: `(*batch)` r, where it is known already.

    Attributes:
        ratio: `(*batch)` r.
        noise: `(*batch)` √(r a), the standard deviation of the noise [unit of the costs].
        signal: `(*batch)` √a, that of the function.
        length: `(*batch)` ℓ.

    Raises:
        InvalidArgumentError: no arrays of numbers, or shapes that do not fit.
    """

    def __init__(self, tried: Array, costs: Array, noisy: Tensor | None = None, ratio: Tensor | None = None) -> None:
        Z = real("tried", tried, "(M, *batch, F)")
        S = beside("costs", costs, Z[..., 0], "(M, *batch)", last=Z.ndim - 1)
        tiny = torch.finfo(Z.dtype).tiny
        # Costs of size one: the range of the largest numbers is beyond them.
        self._unit = S.masked_fill(failures(S), 0.0).abs().amax(0).clamp_min(tiny)
        above, low = _above(S / self._unit, noisy)
        mean = above.mean(0)
        self._offset = mean + low
        y = (above - mean).movedim(0, -1).unsqueeze(-1)  # (*batch, M, 1)
        self._Z = Z.movedim(0, -2)
        squares = torch.cdist(self._Z, self._Z).square_()  # (*batch, M, M)
        self._scale = _typical(squares.flatten(-2))[..., None, None].clamp_min(tiny)
        self.length = self._scale[..., 0, 0].sqrt()
        kernel = squares.mul_(-0.5).div_(self._scale).exp_().nan_to_num_(nan=0.0)
        self.ratio = _most_likely(kernel[..., -RECENT:, -RECENT:], y[..., -RECENT:, :]) if ratio is None else ratio
        kernel.diagonal(dim1=-2, dim2=-1).add_(self.ratio.unsqueeze(-1))
        self._root = torch.linalg.cholesky(kernel)
        self._weights = torch.cholesky_solve(y, self._root)
        self._variance = (y * self._weights).mean((-2, -1)).clamp_min(0.0)
        self.signal = self._unit * self._variance.sqrt()
        self.noise = self.ratio.sqrt() * self.signal

    def predict(self, candidates: Array) -> Tensor:
        """`(n, *batch)` what `candidates` `(n, *batch, F)` cost, without noise [unit of the costs]."""
        above = (self._across(candidates) @ self._weights).squeeze(-1).movedim(-1, 0)
        costs: Tensor = self._unit * (above + self._offset)
        return costs

    def standard_error(self, candidates: Array) -> Tensor:
        """`(n, *batch)` the standard deviation of what `predict` says (Eq. 2.24) [unit of the costs]."""
        known = torch.linalg.solve_triangular(self._root, self._across(candidates).mT, upper=False)
        unknown = (1 - known.square().sum(-2)).clamp_min(0.0)
        error: Tensor = self._unit * (unknown * self._variance.unsqueeze(-1)).sqrt().movedim(-1, 0)
        return error

    def _across(self, candidates: Array) -> Tensor:
        """k(z, Z) `(*batch, n, M)`; coordinates near the largest number have no distance, and count as far apart."""
        z = beside("candidates", candidates, self._Z.movedim(-2, 0)[:1], "(n, *batch, F)").movedim(0, -2)
        center, inverse = self._Z.mean(-2, keepdim=True), self._scale.rsqrt()
        z, Z = (z - center) * inverse, (self._Z - center) * inverse
        # |z − Z|² = |z|² + |Z|² − 2 z·Z, times −1/2, in one array: distances would be roots that are squared again.
        squares = z.square().sum(-1, keepdim=True) + Z.square().sum(-1).unsqueeze(-2)
        n, M, F = *squares.shape[-2:], z.shape[-1]
        flat = squares.reshape(-1, n, M).baddbmm_(
            z.reshape(-1, n, F), Z.expand(*z.shape[:-2], M, F).reshape(-1, M, F).mT, beta=-0.5
        )
        return flat.exp_().nan_to_num_(nan=0.0).reshape(squares.shape)


def _typical(squares: Tensor) -> Tensor:
    """The median `(*batch)`; the mean where that is zero, as it is of few policies of which one was tried twice."""
    median = squares.median(-1).values
    return torch.where(median > 0, median, squares.mean(-1))


def _above(costs: Tensor, noisy: Tensor | None) -> tuple[Tensor, Tensor]:
    """Costs `(M, *batch)` over that of a good policy, capped, and what that one costs; zeros where all failed."""
    failed = failures(costs)
    valid = costs.masked_fill(failed, torch.nan)
    low, median, cap = costs.masked_fill(failed, torch.inf).amin(0), quantile(valid, 0.5), torch.tensor(CAP)
    if noisy is not None:
        low, cap = torch.where(noisy, quantile(valid, GOOD), low), torch.where(noisy, NOISY_CAP, CAP)
    known = ~failed.all(0)
    low, median = low.where(known, 0.0), median.where(known, 0.0)
    return torch.minimum((costs - low).masked_fill(failed, torch.inf), cap.to(low) * (median - low)), low


def _most_likely(kernel: Tensor, y: Tensor) -> Tensor:
    """The ratio `(*batch)` under which `y` `(*batch, m, 1)` is most likely, for k(Z, Z) `(*batch, m, m)`."""
    m = kernel.shape[-1]
    ratios = torch.tensor(RATIOS, dtype=y.dtype, device=y.device)
    covariance = kernel.expand(len(RATIOS), *kernel.shape).clone()  # (R, *batch, m, m)
    covariance.diagonal(dim1=-2, dim2=-1).add_(ratios.reshape(-1, *(1,) * (kernel.ndim - 1)))
    root = torch.linalg.cholesky(covariance)
    whitened = torch.linalg.solve_triangular(root, y.expand(*root.shape[:-1], 1), upper=False)
    variance = whitened.square().mean((-2, -1)).clamp_min(torch.finfo(y.dtype).tiny)  # a, (R, *batch)
    likelihood = -0.5 * m * variance.log() - root.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    return ratios[likelihood.argmax(0)]
