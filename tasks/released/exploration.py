"""The noise of the authors' released program."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchds import GMRPolicy
from torchds.exploration import Homogeneous
from torchds.exploration.homogeneous import chi_mean


class ReleasedHomogeneous(Homogeneous):
    """Homogeneous noise as the program has it: a share of the speed that the present policy has at each centre.

    With m_{k,d} = max(|μ_{k,d}|, 1), the standard deviations of `Homogeneous` are multiplied by |f(μ_k)|, f being the whole
    mixture as it is now. Stiffness rows know no speed; they take the factor of O dimensions in place of one, and their
    slopes get a fifth of what the rule gives.

    Args:
        policy: whose parameters are explored.
        mean_speed: mean norm of the velocity noise as a share of |f(μ_k)|.
        mean_stiffness: size of the noise in each stiffness row [N/m].
    """

    def __init__(self, policy: GMRPolicy, mean_speed: float = 0.1, *, mean_stiffness: float = 0.0) -> None:
        super().__init__(policy, mean_speed, mean_stiffness=mean_stiffness)

    def size(self) -> Tensor:
        """M `(*gate_batch, K, D)` = max(|μ|, 1)."""
        return self.policy.means.abs().clamp_min(1.0)

    def std(self) -> dict[str, Tensor]:
        """The standard deviations by name; those of the velocity `(*batch, K, O, D)` and `(*batch, K, O)`."""
        policy, std = self.policy, super().std()
        centres = policy.means.expand(*policy.batch_shape, policy.n_components, policy.input_dim)
        local = torch.linalg.vector_norm(policy(centres).detach(), dim=-1, keepdim=True)  # (*batch, K, 1)
        std |= {"A": local.unsqueeze(-1) * std["A"], "b": local * std["b"]}
        if policy.stiffness_dim:
            s = self.mean_stiffness / chi_mean(policy.output_dim) / math.sqrt(policy.input_dim + 1)
            slope = (1.0 / self.size()).unsqueeze(-2)  # (*gate_batch, K, 1, D)
            std["stiffness_A"] = (0.2 * s * slope).expand_as(std["stiffness_A"])
            std["stiffness_b"] = torch.full_like(std["stiffness_b"], s)
        return std
