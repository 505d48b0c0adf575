"""Expectation maximisation: how mixtures are found, and how their number of Gaussians is.

scikit-learn makes the fit. Where many fits are compared and one is kept, the comparison is made here: the log density of a
Gaussian is linear in the monomials [y_i y_j, y, 1], so that both steps of EM are products of matrices.

Letters: `M` samples of `F` variables, `K` Gaussians, `P` monomials.

Stability: experimental.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from torchds.errors import DegenerateMixtureError

if TYPE_CHECKING:
    import sklearn.mixture

MAX_ITER = 1000
LARGE = 20_000  # samples; with more of them, the starts are compared on every n-th sample, LARGE / 2 or a few more


class Options(NamedTuple):
    """What EM is told, see `GaussianMixture.fit`."""

    covariance_floor: float
    n_init: int
    tol: float
    seed: int


class Found(NamedTuple):
    """A mixture by the products of matrices, and the mean log-likelihood of a sample."""

    priors: np.ndarray  # (K,)
    means: np.ndarray  # (K, F)
    covariances: np.ndarray  # (K, F, F)
    log_likelihood: float


@contextmanager
def _quietly() -> Iterator[None]:
    """One thread, since many on small matrices only wait for each other; no word of k-means that meets duplicates."""
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits  # scikit-learn brings it

    with threadpool_limits(1), warnings.catch_warnings():
        # A slow last digit of the likelihood, or k-means meeting duplicates, leaves a valid mixture.
        warnings.simplefilter("ignore", ConvergenceWarning)
        yield


@_quietly()
def fit(y: np.ndarray, K: int, options: Options) -> sklearn.mixture.GaussianMixture:
    """The mixture of K Gaussians for the samples `y` `(M, F)`.

    Raises:
        DegenerateMixtureError: a covariance stays singular with this floor.
    """
    return _fit(y, K, options, search(y, K, options) if len(y) > LARGE else None)


@_quietly()
def choose(y: np.ndarray, largest: int, options: Options) -> sklearn.mixture.GaussianMixture:
    """The mixture of 1 to `largest` Gaussians with the smallest Bayesian information criterion, among those that fit.

    Raises:
        DegenerateMixtureError: none of them fits.
    """
    found = {K: search(y, K, options) for K in range(1, largest + 1)}
    refused = {}
    for K in sorted(found, key=lambda K: criterion(found[K], *y.shape)):
        try:
            return _fit(y, K, options, found[K])
        except DegenerateMixtureError as error:
            refused[K] = error
    raise refused[largest]


def criterion(found: Found | None, M: int, F: int) -> float:
    """The Bayesian information criterion of a mixture of M samples of F variables; infinite for none."""
    if found is None:
        return math.inf
    free = len(found.priors) * (1 + F + F * (F + 1) // 2) - 1
    return free * math.log(M) - 2 * M * found.log_likelihood


def search(y: np.ndarray, K: int, options: Options) -> Found | None:
    """The likeliest of the mixtures that EM finds from the k-means starts of scikit-learn; None if all are singular."""
    from sklearn.cluster import KMeans

    few = y[:: max(2 * len(y) // LARGE, 1)] if len(y) > LARGE else y
    origin = y.mean(0)
    monomials, generator = _monomials(few - origin), np.random.RandomState(options.seed)
    best = None
    for _ in range(options.n_init):
        labels = KMeans(K, n_init=1, random_state=generator).fit(few).labels_
        found = _climb(monomials, (labels == np.arange(K)[:, None]).astype(np.float64), options)
        if found and (best is None or found.log_likelihood > best.log_likelihood):
            best = found
    if best and len(few) < len(y):
        monomials = _monomials(y - origin)
        best = _climb(monomials, _expect(monomials, best)[0], options)
    return best and best._replace(means=best.means + origin)


def _climb(monomials: np.ndarray, responsibility: np.ndarray, options: Options) -> Found | None:
    """EM from responsibilities `(K, M)` of Gaussians for samples; None where a covariance gets singular."""
    last = -math.inf
    try:
        mixture = _maximise(monomials, responsibility, options.covariance_floor)
        for _ in range(MAX_ITER):
            responsibility, log_likelihood = _expect(monomials, mixture)
            mixture = _maximise(monomials, responsibility, options.covariance_floor)
            if abs(log_likelihood - last) < options.tol:
                break
            last = log_likelihood
        return mixture._replace(log_likelihood=_expect(monomials, mixture)[1])
    except np.linalg.LinAlgError:
        return None


def _monomials(y: np.ndarray) -> np.ndarray:
    """[y_i y_j for i ≤ j, y, 1], `(P, M)`."""
    i, j = np.triu_indices(y.shape[1])
    return np.concatenate([(y[:, i] * y[:, j]).T, y.T, np.ones((1, len(y)))])


def _maximise(monomials: np.ndarray, responsibility: np.ndarray, covariance_floor: float) -> Found:
    """The M-step: moments of the samples, each weighted by the responsibilities of a Gaussian."""
    moments = responsibility @ monomials.T  # (K, P)
    size = moments[:, -1:] + 10 * np.finfo(np.float64).eps
    F = _variables(moments.shape[1])
    i, j = np.triu_indices(F)
    means = moments[:, -1 - F : -1] / size
    covariances = np.empty((len(means), F, F))
    covariances[:, i, j] = covariances[:, j, i] = moments[:, : len(i)] / size - means[:, i] * means[:, j]
    return Found(size[:, 0] / size.sum(), means, covariances + covariance_floor * np.eye(F), math.nan)


def _expect(monomials: np.ndarray, mixture: Found) -> tuple[np.ndarray, float]:
    """The E-step: responsibilities `(K, M)`, and the mean log-likelihood of a sample."""
    factors = np.linalg.cholesky(mixture.covariances)
    whiten = np.linalg.inv(factors)
    precision = whiten.swapaxes(-1, -2) @ whiten
    linear = (precision @ mixture.means[..., None])[..., 0]
    F = linear.shape[-1]
    i, j = np.triu_indices(F)
    log_scale = np.log(np.diagonal(whiten, axis1=-2, axis2=-1)).sum(-1) - F / 2 * math.log(2 * math.pi)
    constant = np.log(mixture.priors) + log_scale - (mixture.means * linear).sum(-1) / 2
    square = precision[:, i, j] * np.where(i == j, -0.5, -1.0)
    log_joint = np.concatenate([square, linear, constant[:, None]], -1) @ monomials  # (K, M)
    largest = log_joint.max(0)
    joint = np.exp(log_joint - largest)
    total = joint.sum(0)
    return joint / total, float((largest + np.log(total)).mean())


def _variables(P: int) -> int:
    """F, from the number of monomials (F + 1)(F + 2) / 2."""
    return round((math.sqrt(8 * P + 1) - 3) / 2)


def _fit(y: np.ndarray, K: int, options: Options, start: Found | None) -> sklearn.mixture.GaussianMixture:
    """scikit-learn's fit, from its k-means starts or from what was found."""
    from sklearn.mixture import GaussianMixture

    model = GaussianMixture(
        K,
        reg_covar=options.covariance_floor,
        n_init=options.n_init if start is None else 1,
        tol=options.tol,
        max_iter=MAX_ITER,
        random_state=options.seed,
        weights_init=start and start.priors / start.priors.sum(),
        means_init=start and start.means,
        precisions_init=start and np.linalg.inv(start.covariances),
    )
    try:
        return model.fit(y)
    except ValueError as error:
        raise DegenerateMixtureError(
            f"no mixture of {K} Gaussians fits these {len(y)} samples with "
            f"covariance_floor={options.covariance_floor:g} ({error}); raise the floor or take fewer components"
        ) from error
