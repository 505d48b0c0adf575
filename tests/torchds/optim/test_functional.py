"""The weights of roll-outs against scipy, numpy and arithmetic by hand."""

import numpy as np
import pytest
import scipy.special
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchds.errors import InvalidArgumentError
from torchds.optim.functional import cost_weights, quantile

TEMPERATURES = ["range", "median", "capped"]


def reference(costs, eliteness, temperature):
    """softmax(−S/λ) of finite costs in numpy."""
    S = np.asarray(costs, dtype=np.float64)
    if temperature == "capped":
        S = np.minimum(S, S.min() + 3 * (np.median(S) - S.min()))
    spread = (np.median(S) if temperature == "median" else S.max()) - S.min()
    return scipy.special.softmax(-S * eliteness / spread)


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("n", [2, 5, 6, 11, 20])
@pytest.mark.parametrize("eliteness", [1.0, 10.0, 40.0])
def test_the_weights_are_a_softmax_over_the_spread(temperature, n, eliteness):
    costs = np.random.default_rng(n).gamma(0.5, size=n)  # skewed, so that the cap is active for the larger n
    weights = cost_weights(torch.from_numpy(costs), eliteness, temperature)
    np.testing.assert_allclose(weights, reference(costs, eliteness, temperature), rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize(
    ("temperature", "exponents"),
    [
        ("range", [0, 0.1, 0.2, 10]),  # 10 (S − min) / 100
        ("median", [0, 10 / 1.5, 20 / 1.5, 1000 / 1.5]),  # the median of four is between the middle two, 1.5
        ("capped", [0, 10 / 4.5, 20 / 4.5, 10]),  # capped at 3 · 1.5 = 4.5, which is the spread too
    ],
)
def test_four_costs_by_hand(temperature, exponents):
    weights = cost_weights(torch.tensor([5.0, 6.0, 7.0, 105.0], dtype=torch.float64), temperature=temperature)
    unnormalised = np.exp(-np.array(exponents))
    np.testing.assert_allclose(weights, unnormalised / unnormalised.sum(), rtol=1e-12)


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("costs", [[3.0], [2.5] * 7, [0.0] * 2, [-1e30] * 3])
def test_equal_costs_give_equal_weights(temperature, costs):
    weights = cost_weights(torch.tensor(costs), temperature=temperature)
    torch.testing.assert_close(weights, torch.full((len(costs),), 1 / len(costs)))


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_failed_rollouts_get_weight_zero_and_do_not_count_otherwise(temperature, bad):
    costs = torch.tensor([bad, 4.0, 1.0, bad, 2.0, 9.0], dtype=torch.float64)
    weights = cost_weights(costs, temperature=temperature)
    valid = torch.tensor([1, 2, 4, 5])
    assert weights[[0, 3]].tolist() == [0.0, 0.0]
    torch.testing.assert_close(weights[valid], cost_weights(costs[valid], temperature=temperature), rtol=1e-12, atol=0)


@pytest.mark.parametrize("temperature", TEMPERATURES)
def test_a_single_survivor_gets_all(temperature):
    weights = cost_weights(torch.tensor([np.nan, 7.0, np.inf]), temperature=temperature)
    assert weights.tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("temperature", TEMPERATURES)
def test_all_failed_gives_zeros(temperature):
    costs = torch.tensor([[np.nan, 1.0], [np.inf, 2.0], [-np.inf, 3.0]])
    weights = cost_weights(costs, temperature=temperature)
    assert weights[:, 0].tolist() == [0.0, 0.0, 0.0]
    torch.testing.assert_close(weights[:, 1].sum(), torch.tensor(1.0))


def test_the_median_of_mostly_minima_leaves_the_weight_to_the_cheapest():
    """The limit of a median that approaches the minimum; a cap may not make the bad roll-outs as good as the best."""
    costs = torch.tensor([1.0, 8.0, 1.0, 1.0, 500.0], dtype=torch.float64)
    third = 1 / 3
    assert cost_weights(costs, temperature="median").tolist() == pytest.approx([third, 0, third, third, 0], rel=1e-12)
    e = np.exp(-10.0)
    expected = np.array([1, e, 1, 1, e]) / (3 + 2 * e)
    np.testing.assert_allclose(cost_weights(costs, temperature="capped"), expected, rtol=1e-12)
    for temperature, ratio in (("median", 0.0), ("capped", e)):
        nearly = cost_weights(costs + torch.tensor([0, 0, 0, 1e-9, 0]), temperature=temperature)
        np.testing.assert_allclose(nearly[[1, 4]] / nearly[0], [ratio, ratio], rtol=1e-12)


finite = st.lists(st.integers(-1000, 1000), min_size=2, max_size=12)


@settings(deadline=None)  # the first call of torch is slow
@given(costs=finite, shift=st.integers(-(10**6), 10**6), power=st.integers(-30, 30), kind=st.sampled_from(TEMPERATURES))
@pytest.mark.slow
def test_shifting_and_scaling_the_costs_changes_nothing(costs, shift, power, kind):
    S = torch.tensor(costs, dtype=torch.float64)
    moved = (S + shift) * 2.0**power  # exact: integers below 2⁵³ and powers of two
    torch.testing.assert_close(
        cost_weights(moved, temperature=kind), cost_weights(S, temperature=kind), rtol=1e-12, atol=0
    )


@settings(deadline=None)  # the first call of torch is slow
@given(costs=finite, kind=st.sampled_from(TEMPERATURES), failed=st.integers(0, 11))
@pytest.mark.slow
def test_weights_sum_to_one_and_a_cheaper_rollout_never_gets_less(costs, kind, failed):
    S = torch.tensor(costs, dtype=torch.float64)
    if failed < len(costs):
        S[failed] = torch.nan
    weights = cost_weights(S, temperature=kind)
    assert weights.sum().item() == pytest.approx(1.0, rel=1e-12)
    ranked = weights[S.isfinite()][S[S.isfinite()].argsort()]
    assert (ranked.diff() <= 0).all()


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_trailing_dimensions_are_columns(temperature, dtype):
    costs = torch.randn(6, 3, 2, dtype=dtype, generator=torch.Generator().manual_seed(3))
    costs[1, 0, 0] = torch.nan
    costs[:, 2, 1] = torch.inf
    weights = cost_weights(costs, temperature=temperature)
    assert weights.dtype == dtype
    for i in range(3):
        for j in range(2):
            alone = cost_weights(costs[:, i, j], temperature=temperature)
            torch.testing.assert_close(weights[:, i, j], alone, rtol=100 * torch.finfo(dtype).eps, atol=0)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_cost_near_the_largest_number_does_not_overflow(dtype):
    largest = torch.finfo(dtype).max
    weights = cost_weights(torch.tensor([0.0, 0.5 * largest, largest], dtype=dtype))
    np.testing.assert_allclose(weights, scipy.special.softmax([0.0, -5.0, -10.0]), rtol=1e-5)


def test_an_unknown_temperature_is_refused():
    with pytest.raises(InvalidArgumentError, match="temperature has to be 'range', 'median' or 'capped', got 'mean'"):
        cost_weights(torch.zeros(2), temperature="mean")


@pytest.mark.parametrize("shape", [(1,), (10,), (80, 3)])
@pytest.mark.parametrize("q", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("missing", [0, 1])
def test_quantiles_are_those_of_numpy_without_what_is_missing(shape, q, missing):
    values = torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    values = torch.cat([values, values.new_full((missing, *shape[1:]), torch.nan)])
    np.testing.assert_allclose(quantile(values, q), np.nanquantile(values, q, axis=0), rtol=1e-14)
