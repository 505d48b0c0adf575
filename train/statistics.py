"""The statistics of reports, figures and claims: quartiles, and two samples compared without assuming a distribution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchds.quartiles import of_costs as of_costs
from torchds.quartiles import quartiles as quartiles

Values = Sequence[float] | np.ndarray


def median(values: Values) -> float:
    """The median over runs."""
    return float(np.median(values))


def summary(values: Values) -> str:
    """Median and quartiles of a sample as they are printed: `median [q1, q3]`, three digits."""
    q1, middle, q3 = quartiles(values)
    return f"{middle:.3g} [{q1:.3g}, {q3:.3g}]"


def deviation(values: Values) -> float:
    """The standard deviation of a sample; NaN where one of its values is infinite, since it then has none."""
    return np.nan if np.isinf(values).any() else float(np.std(values, ddof=1))


def below(a: Values, b: Values) -> float:
    """The p-value of the one-sided Mann-Whitney test: small where `a` tends to be smaller than `b`."""
    import scipy.stats  # takes a second, which few commands need

    return float(scipy.stats.mannwhitneyu(a, b, alternative="less").pvalue)


def differ(a: Values, b: Values) -> float:
    """The p-value of the two-sided Mann-Whitney test: small where one of the samples tends to be smaller."""
    import scipy.stats

    return float(scipy.stats.mannwhitneyu(a, b).pvalue)


def delta(a: Values, b: Values) -> float:
    """Cliff's delta P(a > b) − P(a < b): −1 where all of `a` are below all of `b`, 0 where neither tends to be."""
    first, second = np.asarray(a), np.asarray(b)
    return float((np.greater.outer(first, second).astype(float) - np.less.outer(first, second)).mean())
