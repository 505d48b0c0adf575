"""What the first of the N roll-outs of an update is: a perturbed policy, the unperturbed one, or the best so far.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

import torch
from torch import Tensor, nn

from torchds.optim.options import Elite

State = MutableMapping[Any, Any]
"""The `state` of an optimizer: a dict for each parameter."""


def put_first(elite: Elite, noise: Mapping[nn.Parameter, Tensor], state: State) -> None:
    """Replace the noise of the first roll-out, in place.

    Args:
        elite: "none" leaves it, "nominal" makes it zero, "best" makes it lead to what `remember` has kept, if anything.
        noise: `(N, *shape)` for each parameter.
        state: of the optimizer.
    """
    for p, epsilon in noise.items():
        if elite == "nominal":
            epsilon[0] = 0.0
        elif elite == "best" and "best" in state[p]:
            epsilon[0] = state[p]["best"] - p


def remember(cost: Tensor, noise: Mapping[nn.Parameter, Tensor], state: State) -> None:
    """Keep the cheapest parameters so far, of each run, as `state[p]["best"]`.

    Args:
        cost: `(N, *batch)` of the roll-outs; those that are not finite do not count.
        noise: `(N, *shape)` for each parameter, which still has the value that the noise was added to.
        state: of the optimizer; the lowest cost `(*batch)` is with the first parameter, as "best_cost".
    """
    first = state[next(iter(noise))]
    lowest, index = torch.where(cost.isfinite(), cost, torch.inf).min(0)
    before = first.get("best_cost", torch.full_like(lowest, torch.inf))
    better = lowest < before
    first["best_cost"] = torch.where(better, lowest, before)
    for p, epsilon in noise.items():
        trailing = (1,) * (p.ndim - index.ndim)
        tried = p + epsilon.take_along_dim(index.reshape(1, *index.shape, *trailing), 0).squeeze(0)
        best = state[p].get("best", p)
        state[p]["best"] = torch.where(better.reshape(*better.shape, *trailing), tried, best)
