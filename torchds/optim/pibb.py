"""PI^BB: policy improvement with path integrals, black-box form (Algorithm 1).

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Unpack

import torch
from torch import Tensor

from torchds.exploration.base import Exploration
from torchds.optim.base import PolicySearch
from torchds.optim.evaluation import Closure, Control
from torchds.optim.functional import cost_weights
from torchds.optim.options import SharedOptions


class PIBB(PolicySearch):
    r"""Probability-weighted averaging of parameter noise, lines 10-25 of Algorithm 1.

    Every step tries N perturbed parameters θ + ε_r, adds the control cost ½ Σ_t Υ_t to what the closure returns, and moves
    by δθ = Σ_r P_r ε_r with P_r ∝ exp(−h (S_r − min S) / (max S − min S)).

    Args:
        params: parameters, named parameters or groups, as for any torch optimizer. All of a policy's parameters may
            carry leading batch dimensions; these are independent runs, learned in the same call.
        exploration: shapes unit normals into noise; a group may bring its own as `{"params": ..., "exploration": ...}`.
        n_rollouts: N, roll-outs per step.
        lr: scales the standard deviation of the noise; the paper's α is lr², and every scheduler is an exploration
            decay (see `InverseIteration`).
        **shared: the shared options below.

    `step(closure)` returns the mean cost of the N roll-outs, `(*batch)`, and leaves the details in `last`. `ask` and
    `tell` are its two halves, for hardware and foreign simulators.

    Raises:
        UnknownNameError: an option that `PIBB` does not have.
        InvalidArgumentError: an option out of its range, or parameters that the exploration does not know.
        AllRolloutsFailedError: from `step`, if no roll-out has a finite cost; the parameters stay as they were.

    Example:
        >>> import torch, torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2))
        >>> optim = torchds.optim.PIBB([theta], exploration=torchds.exploration.Gaussian(0.3), n_rollouts=20)
        >>> for _ in range(50):
        ...     cost = optim.step(lambda: (theta - 1.0).square().sum(-1))
        >>> bool(cost < 0.5)
        True
    """

    entries: ClassVar = PolicySearch.entries

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None = None,
        n_rollouts: int = 10,
        lr: float = 1.0,
        **shared: Unpack[SharedOptions],
    ) -> None:
        super().__init__(params, exploration, n_rollouts, {"lr": lr}, **shared)

    @torch.no_grad()
    def step(self, closure: Closure | None = None) -> Tensor:  # type: ignore[override]
        """Try N perturbed parameters and move to their weighted mean.

        Args:
            closure: returns the cost of the policy as the parameters now stand, `(N, *batch)` (or `(*batch)` with
                batched=False); it runs without gradients.

        Returns:
            `(*batch)` the mean cost of the roll-outs that did not fail.
        """
        return self._step(closure)

    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        weights = cost_weights(cost, float(group["eliteness"]), group["temperature"])
        for p, epsilon in zip(group["params"], noise, strict=True):
            if p.requires_grad:
                each = weights.to(epsilon).reshape(*weights.shape, *(1,) * (epsilon.ndim - weights.ndim))
                p.add_((each * epsilon).sum(0))
        return weights
