"""Median and quartiles over runs; one that failed is worse than all others.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Values = Sequence[float] | Sequence[Sequence[float]] | np.ndarray
HUGE = 1e300  # stands for infinity where numbers are interpolated


def quartiles(values: Values, axis: int | None = None) -> np.ndarray:
    """Lower quartile, median and upper quartile, `(3, *rest)`; infinite ones are larger than all others.

    Args:
        values: of any shape.
        axis: over which; all values if None.
    """
    numbers = np.asarray(values, dtype=float)
    found = np.quantile(np.where(numbers == np.inf, HUGE, numbers), [0.25, 0.5, 0.75], axis=axis)
    return np.where(found >= 1e-9 * HUGE, np.inf, found)


def of_costs(values: Values, axis: int | None = None) -> np.ndarray:
    """The `quartiles` of costs; one that is not finite, as of a trial that failed, counts as infinite."""
    costs = np.asarray(values, dtype=float)
    return quartiles(np.where(np.isfinite(costs), costs, np.inf), axis)
