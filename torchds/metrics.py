"""How far a learned motion is from a demonstrated one; the measures of the field, with their units.

In all of them the learned motion comes first and the demonstrated one last.
Numbers of different papers compare only if sub-sampling, units and normalisation agree; here nothing is normalised.

Stability: stable.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from torchds.arrays import Array, beside, count, like, real
from torchds.errors import InvalidArgumentError, MissingPackageError


def velocity_rmse(v: Array, demonstrated: Array) -> Tensor:
    """Mean over samples of √(mean over dimensions of squared errors) [velocity unit].

    This is the "RMSE" of the LPV-DS evaluations: a mean of lengths divided by √D, not the root of a mean.

    Args:
        v: `(..., T, D)` the policy's velocities at the demonstrated positions.
        demonstrated: `(..., T, D)` the demonstrated ones.

    Returns:
        `(...)`.
    """
    v, demonstrated = _pair(v, demonstrated)
    return (v - demonstrated).square().mean(-1).sqrt().mean(-1)


def direction_error(v: Array, demonstrated: Array) -> Tensor:
    """ė: mean over samples of 1 − cos of the angle between both velocities, between 0 and 2 `(...)`.

    Args:
        v: `(..., T, D)` the policy's velocities at the demonstrated positions.
        demonstrated: `(..., T, D)`; a sample with a velocity of zero counts 1.
    """
    v, demonstrated = _pair(v, demonstrated)
    return (1 - F.cosine_similarity(v, demonstrated, dim=-1, eps=1e-30)).mean(-1)


def swept_area(x: Array, demonstrated: Array, n_points: int = 500) -> Tensor:
    r"""The area between two paths [position unit²]: the swept error area of the CLF-DM paper (its Eq. 14).

    .. math:: \sum_t area(x_t, x_{t+1}, y_{t+1}, y_t) = ½ \sum_t |(x_t - y_{t+1}) × (x_{t+1} - y_t)|,

    with both paths first resampled to `n_points` at equal distances, so that speed does not enter. Where the paths
    cross, the two triangles of a quadrilateral cancel, as in the shoelace formula.

    Args:
        x: `(*batch, T_1, D)` paths.
        demonstrated: `(*batch, T_2, D)` the others, or one `(T_2, D)` for all.
        n_points: after resampling.

    Returns:
        `(*batch,)`.
    """
    n_points = count("n_points", n_points, 2)
    p, q = (_equidistant(path, n_points) for path in _paths(x, demonstrated))
    a, b = p[..., :-1, :] - q[..., 1:, :], p[..., 1:, :] - q[..., :-1, :]
    gram = a.square().sum(-1) * b.square().sum(-1) - (a * b).sum(-1).square()  # |a × b|² in any dimension
    return 0.5 * gram.clamp(min=0).sqrt().sum(-1)


def dtwd(x: Array, demonstrated: Array) -> Tensor:
    """Dynamic time warping distance: the smallest sum of distances over all monotone matchings [position unit].

    Ground distance Euclidean, no window, every sample of both paths matched, not divided by a number of samples: the
    "DTWD" of the LPV-DS evaluations. It grows with the number of samples.

    Args:
        x: `(*batch, T_1, D)` paths.
        demonstrated: `(*batch, T_2, D)` the others, or one `(T_2, D)` for all.

    Returns:
        `(*batch,)`; without gradients.

    Raises:
        MissingPackageError: dtaidistance is not installed.
    """
    try:
        from dtaidistance import dtw_ndim
    except ImportError as error:
        raise MissingPackageError("dtaidistance", "metrics", "dynamic time warping") from error
    x, demonstrated = _paths(x, demonstrated)
    batch = x.shape[:-2]
    others = demonstrated.expand(*batch, *demonstrated.shape[-2:])
    pairs = zip(*(_rows_of_paths(paths) for paths in (x, others)), strict=True)
    distances = [dtw_ndim.distance_fast(a, b, inner_dist="euclidean") for a, b in pairs]
    return torch.tensor(distances, dtype=x.dtype, device=x.device).reshape(batch)


def _pair(v: Array, demonstrated: Array) -> tuple[Tensor, Tensor]:
    """Velocities and demonstrated ones, both `(..., T, D)`."""
    v = real("v", v, "(..., T, D)")
    return v, beside("demonstrated", demonstrated, v, "(..., T, D)", last=2)


def _paths(x: Array, demonstrated: Array) -> tuple[Tensor, Tensor]:
    """Paths `(*batch, T_1, D)` and others `(*batch, T_2, D)` or `(T_2, D)`."""
    x = real("x", x, "(*batch, T_1, D)")
    others = like("demonstrated", demonstrated, x)
    batch, own = x.shape[:-2], others.shape[:-2]
    if others.ndim < 2 or others.shape[-1] != x.shape[-1] or own not in ((), batch):
        raise InvalidArgumentError(
            f"demonstrated has to be (T_2, D) or (*batch, T_2, D) with batch and dimensions of x, {tuple(x.shape)}, got shape "
            f"{tuple(others.shape)}"
        )
    return x, others


def _rows_of_paths(paths: Tensor) -> list[np.ndarray]:
    flat = paths.detach().cpu().double().reshape(-1, *paths.shape[-2:])
    return [np.ascontiguousarray(path.numpy()) for path in flat]


def _equidistant(path: Tensor, n: int) -> Tensor:
    """n points at equal distances along paths `(*batch, T, D)`, both ends among them."""
    if path.ndim < 2 or path.shape[-2] < 2:
        raise InvalidArgumentError(f"a path has to be (*batch, T, D) with T ≥ 2, got shape {tuple(path.shape)}")
    steps = torch.linalg.vector_norm(path.diff(dim=-2), dim=-1)
    length = F.pad(steps.cumsum(-1), (1, 0))
    at = torch.linspace(0, 1, n, dtype=path.dtype, device=path.device) * length[..., -1:]
    i = torch.searchsorted(length, at, right=True).clamp(1, path.shape[-2] - 1)
    step, before = steps.gather(-1, i - 1), length.gather(-1, i - 1)
    share = torch.where(step > 0, (at - before) / step, 0.0)
    start, end = (path.take_along_dim(index.unsqueeze(-1), -2) for index in (i - 1, i))
    return torch.lerp(start, end, share.unsqueeze(-1))
