"""The mathematics of the updates, as pure functions: those of Algorithm 1, of PI², and beyond.

Letters: `N` roll-outs, `*batch` policies, `T` steps, `O` outputs, `F` features; S and q are costs, in the unit of the task.

Stability: stable.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from torchds.arrays import Array, beside, number, real, shown
from torchds.errors import InvalidArgumentError

Temperature = Literal["range", "median", "capped"]


def cost_weights(costs: Array, eliteness: float = 10.0, temperature: Temperature = "range") -> Tensor:
    """The weights of roll-outs, softmax(−S/λ) over axis 0 (lines 19-22 of Algorithm 1).

    Args:
        costs: `(N, ...)` S. NaN and infinity mark failed roll-outs: weight zero, and they do not count otherwise.
        eliteness: h > 0, 10 in the paper; λ is a spread of the costs over h, so that the unit of S does not matter.
        temperature: the spread.

            * "range": max − min, the paper.
            * "median": median − min, less sensitive to one bad roll-out.
            * "capped": max − min after the costs were capped at min + 3 (median − min). Where more than half are the cheapest,
              the others weigh e^{−h} times as much, as in the limit.

    Returns:
        `(N, ...)`, summing to one over axis 0, or all zero where every roll-out failed. Without any spread the cheapest
        roll-outs share the weight equally.

    Raises:
        InvalidArgumentError: an unknown temperature.
    """
    eliteness = number("eliteness", eliteness, "finite and ≥ 0", lambda h: 0 <= h < math.inf)
    exponent = -eliteness * relative_costs(costs, temperature)
    return torch.nan_to_num(torch.softmax(exponent, 0), nan=0.0)


def relative_costs(costs: Array, temperature: Temperature = "range") -> Tensor:
    """(S − min S)/spread, in which the unit of the costs cancels; times −h it is the exponent of `cost_weights`.

    Args:
        costs: `(N, ...)` S, failed roll-outs not finite.
        temperature: the spread, as for `cost_weights`.

    Returns:
        `(N, ...)`, zero for the best and infinite for failed roll-outs.

    Raises:
        InvalidArgumentError: an unknown temperature.
    """
    check_temperature(temperature)
    costs = _costs(costs)
    failed = failures(costs)
    low = costs.masked_fill(failed, torch.inf).amin(0)
    above = (costs - low).masked_fill(failed, torch.inf)  # S − min S
    spread = above.masked_fill(failed, 0.0).amax(0)
    if (wide := spread.isposinf()).any():  # a range beyond the largest number is halved
        half = torch.where(wide, 0.5, 1.0).to(costs)
        above = (half * costs - half * low).masked_fill(failed, torch.inf)
        spread = above.masked_fill(failed, 0.0).amax(0)
    if temperature != "range":
        median = quantile(above.masked_fill(failed, torch.nan), 0.5)
        spread = median if temperature == "median" else torch.minimum(spread, 3 * median)
    ratio = above / spread
    if temperature == "capped":
        ratio = ratio.clamp(max=1.0)
    return ratio.masked_fill(above <= 0, 0.0).masked_fill(failed, torch.inf)


def check_temperature(temperature: Any) -> None:
    """Refuse what is no temperature.

    Raises:
        InvalidArgumentError: what was received and what is allowed.
    """
    if not isinstance(temperature, str) or temperature not in get_args(Temperature):
        raise InvalidArgumentError(f"temperature has to be 'range', 'median' or 'capped', got {shown(temperature)}")


def informative(costs: Array) -> Tensor:
    """`(...)` False where no roll-out is better than another: N > 1 costs `(N, ...)` are all finite and equal."""
    costs = _costs(costs)
    if len(costs) == 1:
        return torch.ones_like(costs[0], dtype=torch.bool)
    return (costs != costs[:1]).any(0) | failures(costs[0])


def failures(costs: Tensor) -> Tensor:
    """`(...)` True for NaN and infinity: zero times these is not zero. Two operations, where `isfinite` is five."""
    return costs * 0 != 0


def quantile(values: Tensor, q: float) -> Tensor:
    """`torch.nanquantile` over axis 0; where no value is NaN, in a quarter of the time and to the same bits."""
    if values.isnan().any():
        return values.nanquantile(q, dim=0)
    place, ordered = q * (len(values) - 1), values.sort(0).values
    return torch.lerp(ordered[math.floor(place)], ordered[math.ceil(place)], place % 1)


def cost_to_go(costs: Array, upsilon: Array) -> Tensor:
    """S_t = Σ_{j ≥ t} q_j + ½ Σ_{j > t} Υ_j: what a roll-out still costs from step t on, as PI² weighs it.

    Args:
        costs: `(..., T)` q, costs per step, the terminal cost in the last.
        upsilon: `(..., T)` Υ per step, from `torchds.costs.control_cost`; the step itself does not count.

    Returns:
        `(..., T)`, infinite throughout a roll-out that failed anywhere.
    """
    costs = real("costs", costs, "(..., T)")
    upsilon = beside("upsilon", upsilon, costs, "(..., T)")
    remaining = (costs + 0.5 * upsilon).flip(-1).cumsum(-1).flip(-1) - 0.5 * upsilon
    return torch.where(remaining[..., :1].isfinite(), remaining, torch.inf)


def time_averaged_update(
    weights: Array,
    noise: Array,
    features: Array,
    gating: Array | None,
    projected: bool = True,
    free: Array | None = None,
) -> Tensor:
    """δθ in rows: the updates Σ_i P_i M ε_i of all steps, averaged with the weights T − t (times the gating), as PI² does.

    With R = r I, M ε of an output row is g (g·ε)/|g|², so nothing larger than `(N, *batch, T, F)` is built.

    Args:
        weights: `(N, *batch, T)` P, from `cost_weights` of the costs to go.
        noise: `(N, *batch, O, F)` ε in rows.
        features: `(N, *batch, T, F)` g; zero where a step does not count.
        gating: `(N, *batch, T, F)` activation of each feature's component, of which the mean over N counts; None for
            the time alone.
        projected: False averages ε in place of M ε.
        free: `(*batch, O, F)` one where a parameter may move, zero where it is frozen and M does not see it; None for all.

    Returns:
        `(*batch, O, F)`, one row per output.
    """
    g = real("features", features, "(N, *batch, T, F)")
    P = beside("weights", weights, g[..., 0], "(N, *batch, T)")
    epsilon = beside("noise", noise, g[..., :1, :], "(N, *batch, O, F)")
    T = g.shape[-2]
    late = torch.arange(T, 0, -1, dtype=g.dtype, device=g.device).unsqueeze(-1)  # T − t, (T, 1)
    share = late.expand(g.shape[1:])  # (*batch, T, F)
    if gating is not None:
        share = late * beside("gating", gating, g, "(N, *batch, T, F)", last=2).mean(0)
    share = share / share.sum(-2, keepdim=True).clamp_min(torch.finfo(share.dtype).tiny)
    if not projected:
        return ((P.unsqueeze(-2) @ share) * epsilon).sum(0)
    tiny = torch.finfo(g.dtype).tiny
    if free is None:
        size = g.square().sum(-1, keepdim=True).clamp_min(tiny)
        along = epsilon @ (g / size).mT  # (N, *batch, O, T): g·ε/|g|²
        return ((P.unsqueeze(-2) * along) @ (share * g)).sum(0)
    mask = beside("free", free, epsilon, "(*batch, O, F)", last=2)
    size = mask @ g.square().mT  # |g|² of each row, (N, *batch, O, T)
    along = (epsilon * mask) @ g.mT / size.clamp_min(tiny)
    return mask * ((P.unsqueeze(-2) * along) @ (share * g)).sum(0)


def _costs(costs: Array) -> Tensor:
    """Costs `(N, ...)` of at least one roll-out."""
    costs = real("costs", costs, "(N, ...)")
    if not costs.ndim or not len(costs):
        raise InvalidArgumentError(
            f"costs have to be (N, ...) of at least one roll-out, got shape {tuple(costs.shape)}"
        )
    return costs
