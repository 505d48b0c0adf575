"""The numbers that are worth a curve, by TensorBoard tag.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from torchds import quartiles
from torchds.errors import InvalidArgumentError
from torchds.optim import PolicySearch

Costs = torch.Tensor | np.ndarray[Any, Any] | Sequence[float] | float


def of_costs(terms: Mapping[str, Costs]) -> dict[str, float]:
    """Costs of policies without noise: the median of each term over runs, and that of their sum with its quartiles.

    A cost that is not finite, as of a run that failed, counts as infinite: worse than all others.

    Args:
        terms: name -> `(*batch,)` what it costs in each of the runs; "total" alone, or terms of which that is the sum.

    Returns:
        `cost/total`, `cost/total_q1`, `cost/total_q3`, and `cost/<name>` of each term.

    Raises:
        InvalidArgumentError: "total" beside other terms, which would count twice.

    Example:
        >>> of_costs({"goal": [1.0, 2.0, 3.0], "control": [0.0, 0.0, 1.0]})["cost/total"]
        2.0
    """
    if "total" in terms and len(terms) > 1:
        raise InvalidArgumentError(
            f"terms have to be without 'total', which is their sum, got {', '.join(terms)}; leave it out"
        )
    columns = {name: _numbers(values) for name, values in terms.items()}
    return _band("cost/total", sum(columns.values())) | {
        f"cost/{name}": float(quartiles.of_costs(values)[1]) for name, values in columns.items()
    }


def of_search(optim: torch.optim.Optimizer) -> dict[str, float]:
    """What an optimizer says about itself.

    Args:
        optim: a policy search of `torchds.optim`, or any other optimizer of torch, which has its learning rate to tell.

    Returns:
        `PolicySearch.scalars`, and of the roll-outs of the last update how many failed, all runs together, and the median cost
        of the others, `cost/tried`, with its quartiles.
    """
    if not isinstance(optim, PolicySearch):
        return {"exploration/lr": float(optim.param_groups[0]["lr"])}
    found = optim.scalars()
    if (last := optim.last) is not None:
        valid = _numbers(last.cost[~last.failed])
        found |= _band("cost/tried", valid) | {"rollouts/failed": float(last.failed.sum())}
    return found


def _band(tag: str, values: Any) -> dict[str, float]:
    """Median and quartiles of all values."""
    q1, median, q3 = quartiles.of_costs(values)
    return {tag: float(median), f"{tag}_q1": float(q1), f"{tag}_q3": float(q3)}


def _numbers(values: Costs) -> np.ndarray[Any, Any]:
    if isinstance(values, torch.Tensor):
        values = values.detach().cpu().numpy()
    return np.asarray(values, dtype=float)
