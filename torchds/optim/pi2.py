"""PI²: policy improvement with path integrals, averaged over time (section 3.2).

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal, Unpack

import torch
from torch import Tensor

from torchds.arrays import shown
from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.base import PolicySearch
from torchds.optim.evaluation import Closure, Control
from torchds.optim.functional import cost_to_go, cost_weights, time_averaged_update
from torchds.optim.options import SharedOptions


class PI2(PolicySearch):
    r"""The original PI² update: one update per time step, from the cost-to-go, averaged over time.

    .. math:: δθ_t = \sum_r P_{t,r} M_{t,r} ε_r, \qquad P_{t,r} ∝ \exp(-h \frac{S_{t,r} - \min S_t}{\max S_t - \min S_t}),

    with S_{t,r} the cost of roll-out r from step t on (the control cost from the step after it), and M the projection of
    Algorithm 1, line 15. The updates of all steps are averaged with the weights T − t, of which the early steps, that
    decide about more of the motion, get more; the paper compares this with `PIBB` in Fig. 3.

    Args:
        params: parameters of policies that are linear in features, as `GMRPolicy` is; or groups of them.
        exploration: shapes unit normals into noise; a group may bring its own.
        n_rollouts: N, roll-outs per step.
        lr: scales the standard deviation of the noise.
        weighting: of the time average. "gating": T − t times the activation h_k(x_t) of the component that a parameter
            belongs to, mean over the roll-outs; "time": T − t alone.
        projected: False leaves M out.
        **shared: the shared options below.

    The closure of `step` returns costs per step, `(N, *batch, T)` (or `(*batch, T)` with batched=False), the terminal cost
    in the last; it makes one roll-out of T steps from one start.

    Raises:
        UnknownNameError: an option that `PI2` does not have.
        InvalidArgumentError: an option out of its range; from `step`, costs or roll-outs that do not fit this form.
        AllRolloutsFailedError: from `step`, if no roll-out has a finite cost.
    """

    costs_per_step = True
    entries: ClassVar = PolicySearch.entries

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None = None,
        n_rollouts: int = 10,
        lr: float = 1.0,
        *,
        weighting: Literal["gating", "time"] = "gating",
        projected: bool = True,
        **shared: Unpack[SharedOptions],
    ) -> None:
        defaults = {"lr": lr, "weighting": weighting, "projected": projected}
        super().__init__(params, exploration, n_rollouts, defaults, **shared)

    _convex_instead = "use PI2(..., projected=False), whose time average of each component is one, or PIBB"

    def _convex(self, group: Mapping[str, Any]) -> bool:
        # M takes a part of the noise that differs from step to step; without it, all steps average the same noise.
        return not group["projected"]

    def _check_options(self, group: Mapping[str, Any]) -> None:
        super()._check_options(group)
        if not isinstance(group.get("weighting"), str) or group["weighting"] not in ("gating", "time"):
            raise InvalidArgumentError(f"weighting has to be 'gating' or 'time', got {shown(group.get('weighting'))}")
        if not isinstance(group.get("projected"), bool):
            raise InvalidArgumentError(f"projected has to be True or False, got {shown(group.get('projected'))}")

    @torch.no_grad()
    def step(self, closure: Closure | None = None) -> Tensor:  # type: ignore[override]
        """Try N perturbed parameters and move by the time average of the updates of all steps.

        Args:
            closure: returns the costs per step, the terminal cost in the last.

        Returns:
            `(*batch)` the mean cost of the roll-outs that did not fail.
        """
        return self._step(closure)

    def _check_control(self, costs: Tensor, control: list[Control]) -> None:
        part = control[0]
        if len(control) != 1 or part.upsilon.shape != costs.shape:
            raise InvalidArgumentError(
                f"PI2 needs one roll-out from one start whose T steps are those of the costs {tuple(costs.shape)}; the "
                f"closure made {len(control)}, the first of {tuple(part.upsilon.shape)} steps"
            )
        own = set(part.visit.policy.row_parameters.values())
        strangers = [tuple(p.shape) for group in self.param_groups for p in group["params"] if p not in own]
        if strangers:
            raise InvalidArgumentError(
                f"PI2 moves the parameters of the policy that made the roll-out, got others of shape {strangers}; use PIBB"
            )

    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        part = control[0]
        to_go = cost_to_go(steps, part.upsilon)
        weights = cost_weights(to_go, float(group["eliteness"]), group["temperature"])
        policy, features = part.visit.policy, part.visit.features
        # A roll-out that failed does not count, nor does a state at infinity.
        counts = to_go.isfinite() & features.isfinite().all(-1)
        features = torch.where(counts.unsqueeze(-1), features, 0.0)
        gating = policy.feature_gating(features) if group["weighting"] == "gating" else None
        frozen = not all(p.requires_grad for p in policy.row_parameters.values())
        free = policy.rows(lambda p: torch.full_like(p, float(p.requires_grad))) if frozen else None
        rows = time_averaged_update(weights, part.noise, features, gating, group["projected"], free)
        update = {policy.row_parameters[name]: change for name, change in policy.from_rows(rows).items()}
        for p in group["params"]:
            if p.requires_grad:
                p.add_(update[p])
        return weights.mean(-1)
