"""The mathematics of the updates, as pure functions."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torchds.errors import InvalidArgumentError

Temperature = Literal["range", "median", "capped"]


def cost_weights(costs: Tensor, eliteness: float = 10.0, temperature: Temperature = "range") -> Tensor:
    """The weights of roll-outs, softmax(−S/λ) over axis 0 (lines 19-22 of Algorithm 1).

    Args:
        costs: `(N, ...)` S. NaN and infinity mark failed roll-outs: weight zero, and they do not count otherwise.
        eliteness: h = 10 of the paper; λ is a spread of the costs over h.
        temperature: the spread.

            * "range": max − min, the paper.
            * "median": median − min, less sensitive to one bad roll-out.
            * "capped": max − min after the costs were capped at min + 3 (median − min).

    Returns:
        `(N, ...)`, summing to one over axis 0, or all zero where every roll-out failed. Without any spread the cheapest
        roll-outs share the weight equally.

    Raises:
        InvalidArgumentError: an unknown temperature.
    """
    if temperature not in ("range", "median", "capped"):
        raise InvalidArgumentError(f"temperature has to be 'range', 'median' or 'capped', got {temperature!r}")
    valid = costs.isfinite()
    low = torch.where(valid, costs, torch.inf).amin(0)
    above = torch.where(valid, costs - low, torch.inf)  # S − min S
    spread = torch.where(valid, above, 0.0).amax(0)
    if temperature != "range":
        median = torch.where(valid, above, torch.nan).nanquantile(0.5, dim=0)
        spread = median if temperature == "median" else torch.minimum(spread, 3 * median)
    ratio = above / spread
    if temperature == "capped":
        ratio = ratio.clamp(max=1.0)
    exponent = torch.where(above > 0, -eliteness * ratio, 0.0)
    return torch.nan_to_num(torch.softmax(torch.where(valid, exponent, -torch.inf), 0), nan=0.0)
