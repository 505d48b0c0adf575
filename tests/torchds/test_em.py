"""The search among many fits, against scikit-learn's fits one by one."""

import math

import numpy as np
import pytest
import sklearn.cluster
import sklearn.mixture
import threadpoolctl
import torch
from torch.testing import assert_close

from torchds import GaussianMixture, em

OPTIONS = em.Options(covariance_floor=1e-6, n_init=3, tol=1e-6, seed=2)


def by_sklearn(y, K, options=OPTIONS):
    floor, n_init, tol, seed = options
    model = sklearn.mixture.GaussianMixture(
        K, reg_covar=floor, n_init=n_init, tol=tol, random_state=seed, max_iter=1000
    )
    return model.fit(y)


@pytest.fixture
def arc():
    """300 samples around an arc with its velocity, in units of a few."""
    generator = np.random.default_rng(0)
    t = np.repeat(np.linspace(0, 3, 100), 3)
    return np.stack([np.cos(t), np.sin(t), -np.sin(t), np.cos(t)], -1) + 0.05 * generator.standard_normal((300, 4))


@pytest.mark.parametrize("K", [1, 2, 5])
@pytest.mark.parametrize("away", [0.0, 1e4])
@pytest.mark.slow
def test_the_search_ends_where_scikit_learn_does(arc, K, away):
    model, found = by_sklearn(arc + away, K), em.search(arc + away, K, OPTIONS)
    assert_close(found.log_likelihood, model.score(arc + away), rtol=0, atol=2e-6)
    assert_close(found.priors, model.weights_, rtol=1e-4, atol=1e-4)
    assert_close(found.means, model.means_, rtol=1e-4, atol=1e-4)
    assert_close(found.covariances, model.covariances_, rtol=1e-3, atol=1e-5)


@pytest.mark.slow
def test_the_criterion_is_that_of_scikit_learn(arc):
    assert_close(em.criterion(em.search(arc, 3, OPTIONS), *arc.shape), by_sklearn(arc, 3).bic(arc), rtol=0, atol=2e-3)
    assert em.criterion(None, *arc.shape) == math.inf


@pytest.mark.parametrize("noise", [0.1, 0.5])
@pytest.mark.slow
def test_the_number_of_gaussians_is_the_one_that_full_fits_prefer(arc, noise):
    y = arc + noise * np.random.default_rng(1).standard_normal(arc.shape)
    options = OPTIONS._replace(n_init=2, tol=1e-4)
    fits = [by_sklearn(y, K, options) for K in range(1, 6)]
    best = min(fits, key=lambda fit: fit.bic(y))
    chosen = em.choose(y, 5, options)
    assert chosen.n_components == best.n_components
    assert chosen.score(y) > best.score(y) - 1e-4


def test_covariances_that_get_singular_are_no_mixture():
    line = np.linspace(0, 1e8, 60)[:, None] * np.ones(4)
    assert em.search(line, 2, OPTIONS) is None


def test_many_samples_are_fitted_from_starts_on_a_part_of_them(monkeypatch):
    centres = np.array([[0.0, 0, 0], [6, 0, 3], [0, 6, 0]]).repeat(100, 0)
    y = centres + np.random.default_rng(0).standard_normal((300, 3))
    alone = by_sklearn(y, 3)
    monkeypatch.setattr(em, "LARGE", 200)
    seen, fit = [], sklearn.cluster.KMeans.fit
    monkeypatch.setattr(sklearn.cluster.KMeans, "fit", lambda self, y: seen.append(len(y)) or fit(self, y))
    model = em.fit(y, 3, OPTIONS)
    assert seen == [100] * 3
    order, expected = (np.argsort(each.weights_) for each in (model, alone))
    assert_close(model.weights_[order], alone.weights_[expected], rtol=1e-4, atol=0)
    assert_close(model.covariances_[order], alone.covariances_[expected], rtol=1e-2, atol=1e-2)


@pytest.mark.slow
def test_a_fit_uses_one_thread_and_gives_the_others_back(arc, monkeypatch):
    def threads():
        return {pool["num_threads"] for pool in threadpoolctl.threadpool_info()}

    by_sklearn(arc, 2)  # loads all libraries that have threads
    seen, fit = [], sklearn.mixture.GaussianMixture.fit
    monkeypatch.setattr(sklearn.mixture.GaussianMixture, "fit", lambda self, y: seen.append(threads()) or fit(self, y))
    with threadpoolctl.threadpool_limits(2):
        before = threads()
        GaussianMixture.fit(torch.from_numpy(arc), 2, n_init=1, tol=1e-3)
        GaussianMixture.fit(torch.from_numpy(arc), "bic", n_init=1, tol=1e-3)
        assert threads() == before
    assert 2 in before
    assert seen == [{1}, {1}]


def test_equal_samples_and_seeds_give_equal_mixtures_bit_for_bit(arc):
    one, other = (em.fit(arc[::10].copy(), 2, OPTIONS) for _ in range(2))
    for name in ("weights_", "means_", "covariances_"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
