"""The statistics of reports, figures and claims: quartiles, and two samples compared without assuming a distribution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Values = Sequence[float] | np.ndarray


def quartiles(values: Values | Sequence[Sequence[float]], axis: int | None = None) -> np.ndarray:
    """Lower quartile, median and upper quartile, `(3, *rest)`.

    Args:
        values: of any shape.
        axis: over which; all values if None.
    """
    return np.quantile(np.asarray(values, dtype=float), [0.25, 0.5, 0.75], axis=axis)


def median(values: Values) -> float:
    """The median over runs."""
    return float(np.median(values))


def summary(values: Values) -> str:
    """Median and quartiles of a sample as they are printed: `median [q1, q3]`, three digits."""
    q1, middle, q3 = quartiles(values)
    return f"{middle:.3g} [{q1:.3g}, {q3:.3g}]"


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
    return float(np.sign(np.subtract.outer(np.asarray(a), np.asarray(b))).mean())
