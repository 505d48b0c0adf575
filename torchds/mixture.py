"""Gaussian mixtures over position, velocity and stiffness: fit, density, conditional (Eq. 1-3).

Stability: stable.
"""

from __future__ import annotations

import math
import warnings
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeGuard, cast

import numpy as np
import torch
from torch import Tensor

from torchds import em
from torchds.arrays import Array, count, like, of_one_dtype, real
from torchds.devices import Movable
from torchds.errors import DegenerateMixtureError, FileError, InvalidArgumentError, LargestMixtureWarning
from torchds.files import read_npz, write_npz

if TYPE_CHECKING:
    from torchds.demonstrations import Demonstrations


# Names under which mixtures are found in files; the Greek letters' names are common in MATLAB exports.
_ALIASES = {"mu": "means", "sigma": "covariances"}
_ARRAYS = {prefix + name for prefix in ("", "gmm_") for name in ("priors", "means", "covariances", "mu", "sigma")}

FLOOR = 1e-6  # of covariances, as a share of the data's variance


class Conditional(NamedTuple):
    """The mixture p(y | x) that a joint mixture becomes once part of its variables is known (Eq. 1).

    Attributes:
        priors: `(*batch, *points, K)` the gating h_k(x) of Eq. 2.
        means: `(*batch, *points, K, O)` A_k x + b_k.
        covariances: `(*batch, K, O, O)` the Schur complements, independent of x.
    """

    priors: Tensor
    means: Tensor
    covariances: Tensor

    @property
    def mean(self) -> Tensor:
        """E[y | x] `(*batch, *points, O)`: Gaussian mixture regression, Eq. 1."""
        return (self.priors.unsqueeze(-1) * self.means).sum(-2)


class GaussianMixture(Movable):
    """A mixture of K Gaussians over F variables, Σ_k π_k N(y; μ_k, Σ_k).

    Args:
        priors: `(*batch, K)` π_k, not negative, summing to one.
        means: `(*batch, K, F)` μ_k.
        covariances: `(*batch, K, F, F)` Σ_k, symmetric and positive definite.

    Raises:
        DegenerateMixtureError: shapes that do not fit together, values that are not finite, priors that are no
            distribution, or a covariance that is not positive definite (the message says which component).
    """

    def __init__(self, priors: Array, means: Array, covariances: Array) -> None:
        given = {"priors": priors, "means": means, "covariances": covariances}
        pi, mu, Sigma = of_one_dtype(given)
        *batch, K, F = mu.shape if mu.ndim >= 2 else (0, 0)
        if pi.shape != (*batch, K) or Sigma.shape != (*batch, K, F, F) or K * F == 0:
            raise DegenerateMixtureError(
                "priors, means and covariances have to be (*batch, K), (*batch, K, F) and (*batch, K, F, F), got "
                f"{tuple(pi.shape)}, {tuple(mu.shape)} and {tuple(Sigma.shape)}"
            )
        for name, value in {"priors": pi, "means": mu, "covariances": Sigma}.items():
            if not value.isfinite().all():
                raise DegenerateMixtureError(f"{name} have to be finite, got NaN or infinity; fit to finite samples")
        if (pi < 0).any() or not torch.allclose(pi.sum(-1), torch.ones_like(pi[..., 0]), atol=1e-4):
            raise DegenerateMixtureError(f"priors have to be ≥ 0 and sum to 1, got {pi.tolist()}; divide by their sum")
        scale = Sigma.diagonal(dim1=-2, dim2=-1).amax(-1)
        asymmetric = (Sigma - Sigma.mT).abs().amax((-2, -1)) > 1e-5 * scale
        factors, info = torch.linalg.cholesky_ex(Sigma)
        if (bad := asymmetric | (info != 0)).any():
            raise DegenerateMixtureError(
                "covariances have to be symmetric positive definite, got others in component(s) "
                f"{sorted(set(bad.nonzero()[:, -1].tolist()))}; fit with a larger covariance_floor or add a small "
                "multiple of the identity"
            )
        self.priors: Tensor = pi
        self.means: Tensor = mu
        self.covariances: Tensor = Sigma
        self._factors = factors

    def __repr__(self) -> str:
        batch = f", batch_shape={self.batch_shape}" if self.batch_shape else ""
        return f"{type(self).__name__}(K={self.n_components}, F={self.means.shape[-1]}{batch})"

    @property
    def n_components(self) -> int:
        """The number K of Gaussians."""
        return self.means.shape[-2]

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions of a batch of mixtures, () for one."""
        return tuple(self.means.shape[:-2])

    def component_log_prob(self, y: Array) -> Tensor:
        """log(π_k N(y; μ_k, Σ_k)), `(*batch, *points, K)` for `y` `(*batch, *points, F)`.

        Raises:
            InvalidArgumentError: `y` is no array of numbers, or of another shape.
        """
        y = self._checked("y", y, self.means.shape[-1])
        points = (1,) * (y.ndim - 1 - len(self.batch_shape))
        F, K = y.shape[-1], self.n_components
        means = self.means.reshape(*self.batch_shape, *points, K, F)
        factors = self._factors.reshape(*self.batch_shape, *points, K, F, F)
        away = (y.unsqueeze(-2) - means).unsqueeze(-1)
        z: Tensor = torch.linalg.solve_triangular(factors, away, upper=False).squeeze(-1)
        log_det: Tensor = factors.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        log_priors = self.priors.log().reshape(*self.batch_shape, *points, K)
        return log_priors - 0.5 * (z.square().sum(-1) + F * math.log(2 * math.pi)) - log_det

    def log_prob(self, y: Array) -> Tensor:
        """log p(y), `(*batch, *points)` for `y` `(*batch, *points, F)`."""
        return self.component_log_prob(y).logsumexp(-1)

    def _checked(self, name: str, y: Array, dim: int) -> Tensor:
        """Points `(*batch, *points, dim)` of this mixture."""
        y, n = like(name, y, self.means), len(self.batch_shape)
        if y.ndim <= n or y.shape[-1] != dim or y.shape[:n] not in (self.batch_shape, (1,) * n):
            raise InvalidArgumentError(
                f"{name} has to be (*batch, *points, {dim}) with batch {self.batch_shape}, got shape {tuple(y.shape)}"
            )
        return y

    def marginal(self, start: int, stop: int) -> GaussianMixture:
        """The mixture of variables start..stop-1 alone."""
        part = slice(start, stop)
        return GaussianMixture(self.priors, self.means[..., part], self.covariances[..., part, part])

    def experts(self, input_dim: int) -> tuple[Tensor, Tensor]:
        """The linear experts of Eq. 2: A_k = Σ_yx Σ_x⁻¹ `(*batch, K, O, D)` and b_k = μ_y − A_k μ_x `(*batch, K, O)`.

        Raises:
            InvalidArgumentError: `input_dim` is not between 1 and F − 1.
        """
        D, F = input_dim, self.means.shape[-1]
        if not 1 <= D < F:
            raise InvalidArgumentError(f"input_dim has to be between 1 and {F - 1} for {F} variables, got {D}")
        A = torch.cholesky_solve(self.covariances[..., :D, D:], self._factors[..., :D, :D]).mT
        b = self.means[..., D:] - (A @ self.means[..., :D, None]).squeeze(-1)
        return A, b

    def condition(self, x: Array) -> Conditional:
        """The distribution of the other variables once the first D are known, for `x` `(*batch, *points, D)`.

        Raises:
            InvalidArgumentError: `x` is no array of numbers, or of another shape.
        """
        x = real("x", x, "(*batch, *points, D)")
        D = x.shape[-1]
        A, b = self.experts(D)
        x = self._checked("x", x, D)
        points = (1,) * (x.ndim - 1 - len(self.batch_shape))
        A_, b_ = (m.reshape(*self.batch_shape, *points, *m.shape[len(self.batch_shape) :]) for m in (A, b))
        means = (A_ @ x[..., None, :, None]).squeeze(-1) + b_
        covariances = self.covariances[..., D:, D:] - A @ self.covariances[..., :D, D:]
        return Conditional(self.marginal(0, D).component_log_prob(x).softmax(-1), means, covariances)

    def save(self, path: str | PathLike[str]) -> None:
        """Write `priors`, `means` and `covariances` into an .npz file."""
        arrays = {name: getattr(self, name).detach().cpu().numpy() for name in ("priors", "means", "covariances")}
        path = Path(path)
        write_npz(path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz"), arrays)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> GaussianMixture:
        """Read a mixture from an .npz file with `priors`, `means` and `covariances`.

        Raises:
            FileError: no such file, another kind of file, a damaged one, one that would unpack to an absurd size, or arrays
                that are not there or hold no numbers.
            DegenerateMixtureError: arrays that are no mixture.
        """
        found = {name.removeprefix("gmm_"): value for name, value in read_npz(Path(path), _ARRAYS).items()}
        if odd := [name for name, value in found.items() if value.dtype.kind not in "biuf"]:
            raise FileError(f"{path}: {odd[0]} has to hold real numbers, got {found[odd[0]].dtype}")
        found = {_ALIASES.get(name, name): value for name, value in found.items()}
        if missing := {"priors", "means", "covariances"} - set(found):
            raise FileError(
                f"{path}: a mixture file has to hold priors (K,), means (K, F) and covariances (K, F, F), got one without "
                f"{', '.join(sorted(missing))}; write it with GaussianMixture.save"
            )
        arrays = (found[name].astype(np.float64) for name in ("priors", "means", "covariances"))
        try:
            return cls(*(torch.from_numpy(array) for array in arrays))
        except DegenerateMixtureError as error:
            raise DegenerateMixtureError(f"{path}: {error}") from None

    @classmethod
    def fit(
        cls,
        data: Demonstrations | Array,
        n_components: int | Literal["bic"],
        *,
        input_dim: int | None = None,
        covariance_floor: float | None = None,
        n_init: int = 5,
        tol: float = 1e-6,
        max_components: int = 10,
        seed: int = 0,
    ) -> GaussianMixture:
        """Fit by expectation maximisation (scikit-learn, k-means starts, full covariances), in float64 and on one thread.

        Of more than 20 000 samples, the starts see every n-th one, about 10 000 of them; the likeliest goes on with all.
        A `LargestMixtureWarning` says where the K that "bic" chose is the largest that it may try.

        Args:
            data: demonstrations, of which the joint samples [x, v(, stiffness)] are taken, or `(M, F)` samples.
            n_components: the number K of Gaussians, or "bic" for the number in 1..max_components with the smallest
                Bayesian information criterion among those that fit.
            input_dim: how many of the demonstrated positions enter (Eq. 36 leaves the angle out); None for all.
            covariance_floor: added to the diagonal of each covariance in every M-step, in the data's units squared. None for a
                millionth of the data's own variance: the mean over the positions for the positions, over the velocities for
                these, over the stiffness for this; over all variables of bare samples. EM then sees each in units of its
                spread, so that a fit depends neither on the unit of length nor on that of time.
            n_init: k-means initialisations, of which the likeliest fit is kept.
            tol: EM stops when the mean log-likelihood of a sample gains less.
            max_components: the largest K that "bic" tries.
            seed: of the initialisations.

        Raises:
            DegenerateMixtureError: fewer than two samples, fewer distinct samples than components, values that are not
                finite, or a fit that stays singular with this floor.
            InvalidArgumentError: an argument out of its range.
        """
        y = joint_samples(data, input_dim)
        if _demonstrated(data):
            data.check().warn()
        if isinstance(n_components, str) and n_components != "bic":
            raise InvalidArgumentError(f"n_components has to be a number or 'bic', got {n_components!r}")
        if not isinstance(n_components, str):
            n_components = count("n_components", n_components, 1)
        if max_components < 1:
            raise InvalidArgumentError(f"max_components has to be at least 1, got {max_components}")
        if covariance_floor is not None and not covariance_floor > 0:
            raise InvalidArgumentError(f"covariance_floor has to be positive, got {covariance_floor}")
        if len(y) < 2:
            raise DegenerateMixtureError(f"samples have to be at least 2, got {len(y)}; record more samples")
        if len(bad := np.argwhere(~(np.abs(y) < 1e150))):  # their squares enter
            row, column = bad[0]
            raise DegenerateMixtureError(
                f"samples have to be finite and below 1e150, got {y[row, column]} in sample {row}, variable {column}; "
                "remove the sample or scale the variable"
            )
        n_distinct = len(np.unique(y, axis=0))
        if isinstance(n_components, int) and n_distinct < n_components:
            raise DegenerateMixtureError(
                f"n_components has to be at most the number of distinct samples, {n_distinct} among {len(y)}, got "
                f"{n_components}; record more samples or choose n_components ≤ {n_distinct}"
            )
        scale, floor = (
            (_spread(data, y), FLOOR) if covariance_floor is None else (np.ones(y.shape[1]), covariance_floor)
        )
        y = y / scale
        options = em.Options(floor, n_init, tol, seed)
        if n_components == "bic":
            best = em.choose(y, min(max_components, n_distinct), options)
            if best.n_components == max_components:
                warnings.warn(
                    f"of 1 to {max_components} Gaussians the largest number is the best; raise max_components, or choose "
                    "a number of components",
                    LargestMixtureWarning,
                    stacklevel=2,
                )
        else:
            best = em.fit(y, n_components, options)
        arrays = best.weights_, best.means_ * scale, best.covariances_ * np.outer(scale, scale)
        return cls(*(torch.as_tensor(a, dtype=torch.float64) for a in arrays))


def _demonstrated(data: Demonstrations | Array) -> TypeGuard[Demonstrations]:
    return hasattr(data, "stacked")


def joint_samples(data: Demonstrations | Array, input_dim: int | None = None) -> np.ndarray:
    """The joint samples [x, v(, stiffness)] `(M, F)` of demonstrations (Eq. 34), or an array of samples as it is."""
    if not _demonstrated(data):
        data = real("data", cast(Array, data))
        if data.ndim != 2 or 0 in data.shape:
            raise DegenerateMixtureError(f"samples have to be an array (M, F), got shape {tuple(data.shape)}")
        return data.detach().cpu().numpy().astype(np.float64)
    x, v, stiffness = data.stacked()
    if input_dim is not None and not 1 <= input_dim <= x.shape[-1]:
        raise InvalidArgumentError(f"input_dim has to be between 1 and the {x.shape[-1]} positions, got {input_dim}")
    columns = [x[:, :input_dim], v] + ([stiffness] if stiffness is not None else [])
    return torch.cat(columns, -1).cpu().numpy().astype(np.float64)


def _spread(data: Demonstrations | Array, y: np.ndarray) -> np.ndarray:
    """The standard deviation `(F,)` of each variable of `y` `(M, F)`, one for all variables of one unit."""
    variance = y.var(0)
    if not _demonstrated(data):
        sizes = [len(variance)]
    else:
        Q = 0 if data[0].stiffness is None else data[0].stiffness.shape[1]
        sizes = [len(variance) - data.dim - Q, data.dim, Q]
    parts = [
        np.full(len(part), np.sqrt(part.mean()) if len(part) else 1.0)
        for part in np.split(variance, np.cumsum(sizes)[:-1])
    ]
    scale = np.concatenate(parts)
    constant = np.where(y[0] == 0, 1.0, np.abs(y[0]))  # any floor of its size
    return np.where(scale > 0, scale, constant).clip(min=1e-140)  # its square is a number still
