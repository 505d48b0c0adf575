"""The statistics against numpy, scipy, and counting by hand."""

import itertools

import numpy as np
import pytest
import scipy.stats

from train.statistics import below, delta, deviation, differ, median, summary


def test_the_summary_is_the_median_with_quartiles_in_three_digits():
    assert summary([5.0, 1.0, 4.0, 2.0, 3.0]) == "3 [2, 4]" and median([5.0, 1.0, 4.0, 2.0, 3.0]) == 3.0
    assert summary([0.0012345]) == "0.00123 [0.00123, 0.00123]"
    assert summary(np.arange(5) * 1234.5) == "2.47e+03 [1.23e+03, 3.7e+03]"


def test_below_has_the_p_of_all_permutations(randn):
    a, b = randn(5).numpy(), randn(6).numpy() + 0.7
    pooled = np.concatenate([a, b])

    def wins(chosen):
        rest = [i for i in range(11) if i not in chosen]
        return sum(pooled[i] > pooled[j] for i in chosen for j in rest)

    splits = [wins(chosen) for chosen in itertools.combinations(range(11), 5)]
    assert below(a, b) == pytest.approx(np.mean([w <= wins(range(5)) for w in splits]), rel=1e-12)
    lowest = min(below(a, b), below(b, a))
    assert differ(a, b) == pytest.approx(2 * lowest, rel=1e-12)


def test_the_tests_agree_with_scipy_on_samples_with_ties(randn):
    a, b = randn(40).numpy().round(1), randn(30).numpy().round(1) + 0.3
    assert below(a, b) == scipy.stats.mannwhitneyu(a, b, alternative="less").pvalue
    assert differ(a, b) == scipy.stats.mannwhitneyu(a, b, alternative="two-sided").pvalue
    assert below(a.tolist(), b.tolist()) == below(a, b)
    assert below(a, a + 5) < 1e-9 < 0.99 < below(a + 5, a)
    # A rank-biserial correlation is the same number, from the statistic U.
    u = scipy.stats.mannwhitneyu(a, b).statistic
    assert delta(a, b) == pytest.approx(2 * u / (len(a) * len(b)) - 1, abs=1e-12)


def test_cliffs_delta_counts_pairs(randn):
    a, b = randn(7).numpy().round(1), randn(9).numpy().round(1)
    a[0] = b[0]  # a tie counts neither way
    pairs = [np.sign(x - y) for x in a for y in b]
    assert delta(a, b) == pytest.approx(sum(pairs) / 63, abs=1e-12)
    assert delta([1, 2], [3, 4]) == -1.0 and delta([3, 4], [1, 2]) == 1.0 and delta([1, 2], [1, 2]) == 0.0


def test_infinite_values_are_the_largest_and_no_others_change():
    inf = np.inf
    assert summary([1.0, 2.0, 3.0, inf, inf]) == "3 [2, inf]"
    assert np.isnan(deviation([1.0, inf, inf])) and deviation([1.0, 3.0]) == pytest.approx(np.sqrt(2), rel=1e-15)
    assert delta([inf, 1.0], [inf, 2.0]) == -0.25
