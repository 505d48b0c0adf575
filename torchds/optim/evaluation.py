"""Running a closure under perturbed parameters, and what the perturbation costs as control.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Number
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from torchds.arrays import shown
from torchds.costs import control_cost
from torchds.devices import moved
from torchds.errors import InvalidArgumentError
from torchds.optim.checkpoints import cost_dtype
from torchds.visits import Visit, checked, listen

Closure = Callable[[], Tensor]
Table = Mapping[nn.Parameter, Tensor]


class Trial(NamedTuple):
    """What N perturbed policies cost.

    Attributes:
        costs: `(N, *batch)`, or `(N, *batch, T)` from a closure that returns costs per step.
        visits: what the roll-outs reported, features `(N, *batch, *points, T, F)`.
    """

    costs: Tensor
    visits: Sequence[Visit]


def evaluate(closure: Closure, noise: Table, n_rollouts: int, batched: bool) -> Trial:
    """Call `closure` while the parameters hold θ + ε; they are restored whatever the closure does.

    Args:
        closure: see `PolicySearch`.
        noise: `(N, *shape)` for each parameter.
        n_rollouts: N.
        batched: whether one call evaluates all N.
    """
    if (own := getattr(closure, "torchds_trial", None)) is not None:  # it sees to it that all roll-outs are made
        found: Trial = own(noise, n_rollouts, batched)
        return found
    center = {p: p.data for p in noise}
    try:
        if not batched:
            trials = [_call(closure, center, {p: e[n] for p, e in noise.items()}) for n in range(n_rollouts)]
            return _stacked(trials)
        try:
            return _call(closure, center, noise)
        except RuntimeError as error:
            error.add_note(
                f"every parameter of the optimizer had {n_rollouts} roll-outs in front; for a module that does not "
                "broadcast over parameters use batched=False"
            )
            raise
    finally:
        for p, value in center.items():
            p.data = value


def _stacked(trials: Sequence[Trial]) -> Trial:
    """N trials of one policy each as one of N policies."""
    kinds = {(tuple(t.costs.shape), *(tuple(visit.features.shape) for visit in t.visits)) for t in trials}
    if len(kinds) > 1:
        raise InvalidArgumentError(
            "with batched=False every call of the closure has to return a cost of the same shape and make roll-outs of the "
            f"same number of steps, got costs (and features) of shapes {sorted(kinds)}"
        )
    # The n-th calls report the same roll-outs one after the other; each becomes one visit with N in front.
    visits = [
        Visit(same[0].policy, torch.stack([visit.features for visit in same]))
        for same in zip(*(trial.visits for trial in trials), strict=True)
    ]
    return Trial(torch.stack([trial.costs for trial in trials]), visits)


def _call(closure: Closure, center: Table, noise: Table) -> Trial:
    for p, value in center.items():
        p.data = value + noise[p]
    with listen() as visits:
        costs: Any = closure()
    return Trial(as_costs(costs, center), visits)


def as_costs(costs: Any, parameters: Iterable[Tensor]) -> Tensor:
    """Costs of any type as a tensor of their own: in the dtype of the parameters (`cost_dtype`).

    Args:
        costs: a tensor, an array, a number, or a list of numbers.
        parameters: that they belong to, at least one.

    Raises:
        InvalidArgumentError: anything else.
    """
    parameters = list(parameters)
    dtype = cost_dtype(parameters)
    found = costs
    try:
        if isinstance(costs, (list, tuple)):
            found = [value.item() if isinstance(value, Tensor) else value for value in costs]
        if not isinstance(found, Tensor):
            array = np.asarray(found)
            if array.dtype.kind in "biuf" or (array.size and all(isinstance(value, Number) for value in array.flat)):
                found = torch.from_numpy(np.array(array, dtype=np.float64))
        if isinstance(found, Tensor) and not found.is_complex() and not found.is_meta:
            found = found.to_dense() if found.layout != torch.strided else found
            return found.detach().to(parameters[0].device, dtype, copy=True)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        pass
    hint = {
        dict: "; return their sum, e.g. sum(terms.values())",
        tuple: "; return the cost alone",
        type(None): "; does the closure end with `return cost`?",
    }.get(type(costs), "")
    raise InvalidArgumentError(
        f"costs have to be a tensor, an array or numbers, got {type(costs).__name__} {shown(costs)}{hint}"
    )


class Control(NamedTuple):
    """The control cost along one reported roll-out.

    Attributes:
        visit: the report.
        upsilon: `(N, *batch, *points, T)` Υ of Algorithm 1, line 16.
        noise: `(N, *batch, O+Q, F)` ε in rows.
    """

    visit: Visit
    upsilon: Tensor
    noise: Tensor


def controls(
    visits: Sequence[Visit], noise: Table, weight: Mapping[nn.Parameter, float], reference: str
) -> list[Control]:
    """Υ for each reported roll-out of an optimised policy; parameters hold θ.

    Args:
        visits: the reports.
        noise: `(N, *shape)` for each optimised parameter; others have none.
        weight: r for each optimised parameter.
        reference: "demonstrated" measures θ from the demonstrated policy (Eq. 12-13), "zero" from zero (Eq. 11).

    Raises:
        InvalidArgumentError: no roll-out of an optimised policy was reported, or features that are not its own.
    """
    found = []
    for visit in map(checked, visits):
        policy = visit.policy
        if not any(p in noise for p in policy.row_parameters.values()):
            continue  # not one of the optimised policies, for example a reference
        weights = [weight.get(p, 0.0) for p in policy.row_parameters.values()]
        r = weights[0] if len({*weights}) == 1 else policy.rows(lambda p: torch.full_like(p, weight.get(p, 0.0)))
        epsilon = policy.rows(lambda p: noise[p] if p in noise else torch.zeros_like(p))
        shape, batch = tuple(visit.visited.shape), tuple(epsilon.shape[:-2])
        if len(shape) < epsilon.ndim or shape[: len(batch)] != batch or shape[-1] != epsilon.shape[-1]:
            raise InvalidArgumentError(
                f"features of a visit have to be (N, *batch, *points, T, F) with (N, *batch) = {batch} and "
                f"F = {epsilon.shape[-1]}, got {shape}"
            )
        visited = moved(visit.visited, epsilon.device, epsilon.dtype)
        deviation = policy.rows() - (policy.initial_rows if reference == "demonstrated" else 0.0)
        upsilon = control_cost(deviation, epsilon, visited, r)
        found.append(Control(Visit(policy, visited), upsilon, epsilon))
    if not found:
        raise InvalidArgumentError(
            "control_weight > 0 and PI2 need to know which features the roll-outs of the optimised policy visited: use "
            "torchds.rollout in the closure, or call torchds.visits.report(policy, policy.features(x)) there, or give "
            "visits to tell(), or use PIBB with control_weight=0"
        )
    return found
