"""Noise for the weights of a dynamic movement primitive.

Stability: experimental.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchds.arrays import Array, number
from torchds.dmp import DMP
from torchds.exploration.base import Exploration
from torchds.exploration.gaussian import Gaussian


@torch.no_grad()
def extent(policy: DMP, x0: Array, n_steps: int, dt: float) -> float:
    """The root mean square distance of the motion from its own mean place, all starts and policies together."""
    return float(policy.rollout(x0, n_steps, dt).x[..., 1:, :].var(-2).sum(-1).mean().sqrt())


def alike(policy: DMP, x0: Array, n_steps: int, dt: float, spread: float = 0.35) -> Gaussian:
    """One standard deviation for all weights, the noise of PI² and PI^BB as they were published for primitives.

    Args:
        policy: whose weights are explored.
        x0: `(*points, O)` the starts.
        n_steps: T.
        dt: time step [s].
        spread: how far it moves the motion, root mean square, as a share of its extent. The noise that the paper gives a
            dynamical system, a mean speed of 0.1, moves its letters by 0.35.
    """
    per_unit = policy.response(n_steps, dt).square().mean(0).sum().sqrt() * math.sqrt(policy.output_dim)
    return Gaussian([float(spread * extent(policy, x0, n_steps, dt) / per_unit), 0.0])


class Along(Exploration):
    r"""Noise of the weights of a `DMP` that moves every part of its motion by about the same distance.

    As `TrajectorySpace`, for a motion that is linear in its parameters: with Φ of `DMP.response` and λ_max the largest
    eigenvalue of ΦᵀΦ/T, the weights of each dimension have the covariance

    .. math:: C = spread^2 (Φ^T Φ / T + damping\, λ_{max} I)^{-1}.

    Args:
        policy: whose weights are explored.
        n_steps: T.
        dt: time step [s].
        spread: how far each direction of the weights moves the motion, root mean square over time [position unit].
        damping: as of `TrajectorySpace`.
    """

    def __init__(self, policy: DMP, n_steps: int, dt: float, spread: float, damping: float = 1e-2) -> None:
        response = policy.response(n_steps, dt) / number(
            "spread", spread, "positive and finite", lambda n: 0 < n < math.inf
        )
        values, vectors = torch.linalg.eigh(response.mT @ response / len(response))
        values = values.clamp_min(0.0)
        self.factor = (vectors * (values + damping * values[-1]).rsqrt()) @ vectors.mT
        self.root = (vectors * values.sqrt()) @ vectors.mT

    @classmethod
    def relative(cls, policy: DMP, x0: Array, n_steps: int, dt: float, spread: float = 0.05) -> Along:
        """The same with the spread as a share of the extent of the motion that `policy` makes now from `x0` `(*points, O)`."""
        return cls(policy, n_steps, dt, spread * extent(policy, x0, n_steps, dt))

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        """C^{1/2} times the normals of the weights; the offsets have none."""
        return self._through(self.factor, normals)

    def measure(self, parameters: Sequence[nn.Parameter], changes: Sequence[Tensor]) -> list[Tensor]:
        """(ΦᵀΦ/T)^{1/2} δw / spread: its length is how far the motion moves, in units of `spread`."""
        return self._through(self.root, changes)

    def _through(self, matrix: Tensor, parts: Sequence[Tensor]) -> list[Tensor]:
        weights, offsets = parts
        return [(matrix.to(weights) @ weights.squeeze(-1)).unsqueeze(-1), torch.zeros_like(offsets)]
