"""Predicted costs: against scikit-learn's Gaussian processes, units, failed roll-outs, and noise of known size."""

import numpy as np
import pytest
import torch
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError
from torchds.optim.regression import CAP, GOOD, NOISY_CAP, RATIOS, Regression


def draw(n, batch=3, F=4, seed=0):
    return torch.randn(n, batch, F, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def seen(costs, noisy):
    """What the regression is of, and what is taken off."""
    low = np.quantile(costs, GOOD) if noisy else costs.min()
    above = costs - low
    return np.minimum(above, (NOISY_CAP if noisy else CAP) * np.median(above)), low


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("ratio", [1e-2, 0.5])
def test_predictions_and_their_errors_are_those_of_another_implementation(noisy, ratio):
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1) + tried[..., 0]
    found = Regression(tried, costs, torch.full((3,), noisy), torch.full((3,), ratio, dtype=torch.float64))
    for run in range(3):
        Z, z = tried[:, run].numpy(), candidates[:, run].numpy()
        y, low = seen(costs[:, run].numpy(), noisy)
        # The median distance, of all pairs and of each with itself; of an odd number of entries.
        length = np.sqrt(np.median(((Z[:, None] - Z) ** 2).sum(-1)))
        model = GaussianProcessRegressor(RBF(length), alpha=ratio, optimizer=None).fit(Z, y - y.mean())
        mean, error = model.predict(z, return_std=True)
        np.testing.assert_allclose(found.predict(candidates)[:, run], mean + y.mean() + low, rtol=1e-7, atol=1e-9)
        alpha = np.linalg.solve(model.kernel_(Z) + ratio * np.eye(15), y - y.mean())
        signal = np.sqrt((y - y.mean()) @ alpha / 15)
        np.testing.assert_allclose(found.standard_error(candidates)[:, run], signal * error, rtol=1e-6)
        np.testing.assert_allclose(found.length[run], length)
        np.testing.assert_allclose(found.signal[run], signal)
        np.testing.assert_allclose(found.noise[run], signal * np.sqrt(ratio))


def test_the_noise_is_the_most_likely_one():
    """By the marginal likelihood of scikit-learn, at the scale that is best for each ratio."""
    tried = draw(60, batch=4, F=2)
    costs = tried.square().sum(-1) + torch.tensor([0.0, 0.1, 0.5, 2.0]) * draw(60, batch=4, F=1, seed=3)[..., 0]
    found = Regression(tried, costs, torch.ones(4, dtype=torch.bool))
    for run in range(4):
        Z, (y, _) = tried[:, run].numpy(), seen(costs[:, run].numpy(), True)
        y, length, best = y - y.mean(), float(found.length[run]), {}
        for r in RATIOS:
            alpha = np.linalg.solve(RBF(length)(Z) + r * np.eye(60), y)
            a = y @ alpha / 60
            model = GaussianProcessRegressor(ConstantKernel(a) * RBF(length), alpha=r * a, optimizer=None).fit(Z, y)
            best[r] = model.log_marginal_likelihood_value_
        assert float(found.ratio[run]) == max(best, key=best.get)


@pytest.mark.parametrize("noise", [0.1, 0.5, 2.0])
def test_noise_of_known_size_is_found(noise):
    """Of a smooth function in four dimensions, from 100 policies; the median of 20 runs is within a factor of two."""
    tried = draw(100, batch=20)
    found = Regression(tried, tried.square().sum(-1) + noise * draw(100, batch=20, F=1, seed=5)[..., 0])
    assert noise / 2 < found.noise.median() < 2 * noise


def test_units_do_not_matter():
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1)
    plain, other = Regression(tried, costs), Regression(1e3 * tried, 1e-6 * costs)
    assert_close(1e6 * other.predict(1e3 * candidates), plain.predict(candidates))
    assert_close(1e6 * other.noise, plain.noise)
    assert Regression(tried, 1e308 * (costs / costs.max() - 0.5) * 1.9).predict(candidates).isfinite().all()


def test_failed_roll_outs_are_as_bad_as_the_cap():
    tried, candidates = draw(15), draw(40, seed=1)
    costs = tried.square().sum(-1)
    failing, bad = costs.clone(), costs.clone()
    worst = costs.argmax(0, keepdim=True)
    failing.scatter_(0, worst, torch.nan)
    bad.scatter_(0, worst, 1e9)
    found = Regression(tried, failing).predict(candidates)
    assert found.isfinite().all()
    # The median moves by one place when a roll-out is missing; the order of the candidates hardly does.
    known = Regression(tried, bad).predict(candidates)
    for run in range(3):
        assert np.corrcoef(found[:, run], known[:, run])[0, 1] > 0.95


def test_three_policies_of_which_two_are_one_have_a_distance():
    tried = draw(3)
    tried[1] = tried[0]
    found = Regression(tried, torch.tensor([[1.0], [1.1], [3.0]]).expand(3, 3))
    assert_close(found.length.square(), 4 / 9 * (tried[2] - tried[0]).square().sum(-1))
    assert found.predict(tried)[2].amin() > found.predict(tried)[:2].amax()


def test_equal_costs_are_predicted_to_be_equal():
    found = Regression(draw(15), torch.full((15, 3), 2.0)).predict(draw(4, seed=1))
    assert_close(found, torch.full((4, 3), 2.0, dtype=torch.float64))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidArgumentError, match="costs has to be"):
        Regression(draw(15), torch.zeros(14, 3))
    with pytest.raises(InvalidArgumentError, match="candidates has to be"):
        Regression(draw(15), torch.zeros(15, 3)).predict(draw(4, F=5))
