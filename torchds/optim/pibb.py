"""PI^BB: policy improvement with path integrals, black-box form (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import torch
from torch import Tensor

from torchds.exploration.base import Exploration
from torchds.optim.base import PolicySearch
from torchds.optim.evaluation import Closure, Control
from torchds.optim.functional import Temperature, cost_weights


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
        eliteness: h; the larger, the more the best roll-outs count.
        temperature: the spread of costs that h divides; see `functional.cost_weights`.
        control_weight: r of the control cost R = r I.
        control_reference: "demonstrated" penalises the distance from the demonstrated policy (Eq. 12-13), "zero" the
            parameters themselves (Eq. 11).
        elite: what the first roll-out of a step is: "none", "nominal" or "best" (see `PolicySearch`).
        batched: whether one call of the closure evaluates all N (see `PolicySearch`).
        generator: of the noise, on the CPU; None for a new one with a fixed seed.

    `step(closure)` returns the mean cost of the N roll-outs, `(*batch)`, and leaves the details in `last`. `ask` and
    `tell` are its two halves, for hardware and foreign simulators.

    Raises:
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

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None = None,
        n_rollouts: int = 10,
        lr: float = 1.0,
        *,
        eliteness: float = 10.0,
        temperature: Temperature = "range",
        control_weight: float = 0.0,
        control_reference: Literal["demonstrated", "zero"] = "demonstrated",
        elite: Literal["none", "nominal", "best"] = "none",
        batched: bool = True,
        generator: torch.Generator | None = None,
    ) -> None:
        defaults = {
            "lr": lr,
            "eliteness": eliteness,
            "temperature": temperature,
            "control_weight": control_weight,
        }
        super().__init__(
            params,
            exploration,
            n_rollouts,
            defaults,
            batched=batched,
            generator=generator,
            control_reference=control_reference,
            elite=elite,
        )

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
        weights = cost_weights(cost, group["eliteness"], group["temperature"])
        for p, epsilon in zip(group["params"], noise, strict=True):
            p.add_((weights.reshape(*weights.shape, *(1,) * (epsilon.ndim - weights.ndim)) * epsilon).sum(0))
        return weights
