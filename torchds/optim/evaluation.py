"""Running a closure under perturbed parameters, and what the perturbation costs as control.

Stability: experimental.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchds.costs import control_cost
from torchds.errors import InvalidArgumentError
from torchds.visits import Visit, listen

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
    center = {p: p.data for p in noise}
    try:
        if not batched:
            trials = [_call(closure, center, {p: e[n] for p, e in noise.items()}) for n in range(n_rollouts)]
            costs = torch.stack([trial.costs for trial in trials])
            # The n-th calls report the same roll-outs one after the other; each becomes one visit with N in front.
            visits = [
                Visit(same[0].policy, torch.stack([visit.features for visit in same]))
                for same in zip(*(trial.visits for trial in trials), strict=True)
            ]
            return Trial(costs, visits)
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


def _call(closure: Closure, center: Table, noise: Table) -> Trial:
    for p, value in center.items():
        p.data = value + noise[p]
    with listen() as visits:
        costs: Any = closure()
    if not isinstance(costs, Tensor):  # plain numbers take the parameters' precision
        costs = torch.as_tensor(costs, dtype=next(iter(center.values())).dtype)
    return Trial(costs.clone(), visits)


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
        InvalidArgumentError: no roll-out of an optimised policy was reported.
    """
    found = []
    for policy, features in visits:
        if not any(p in noise for p in policy.row_parameters.values()):
            continue  # not one of the optimised policies, for example a reference
        r = policy.rows(lambda p: torch.full_like(p, weight.get(p, 0.0)))
        epsilon = policy.rows(lambda p: noise[p] if p in noise else torch.zeros_like(p))
        deviation = policy.rows() - (policy.initial_rows if reference == "demonstrated" else 0.0)
        upsilon = control_cost(deviation.expand_as(epsilon), epsilon, features, r.expand_as(epsilon))
        found.append(Control(Visit(policy, features), upsilon, epsilon))
    if not found:
        raise InvalidArgumentError(
            "control_weight > 0 and PI2 need to know which features the roll-outs of the optimised policy visited: use "
            "torchds.rollout in the closure, or call torchds.visits.report(policy, policy.features(x)) there, or give "
            "visits to tell(), or use PIBB with control_weight=0"
        )
    return found
