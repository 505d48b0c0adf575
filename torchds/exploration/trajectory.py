"""Noise that is homogeneous along the whole motion (beyond the paper's section 4.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchds.errors import InvalidArgumentError
from torchds.exploration.base import Exploration, name_parameters
from torchds.exploration.homogeneous import Homogeneous
from torchds.policy import GMRPolicy
from torchds.rollouts import rollout
from torchds.sensitivity import sensitivity


class Coordinates(NamedTuple):
    """θ = center + factor z: coordinates in which every unit step moves the motion about equally.

    Attributes:
        center: `(*batch, P)` θ₀, in the order of `GMRPolicy.pack`.
        factor: `(*batch, P, P)` L.
    """

    center: Tensor
    factor: Tensor

    def theta(self, z: Tensor) -> Tensor:
        """The parameters at `z` `(*batch, P)`."""
        return self.center + (self.factor @ z.unsqueeze(-1)).squeeze(-1)


class TrajectorySpace(Exploration):
    def __init__(
        self,
        policy: GMRPolicy,
        x0: Tensor,
        n_steps: int,
        dt: float,
        spread: float,
        *,
        mean_speed: float = 0.1,
        widening: float = 3.0,
        damping: float = 1e-3,
        refresh: int = 1,
    ) -> None:
        self.policy = policy
        self.x0, self.n_steps, self.dt = x0, n_steps, dt
        self.spread, self.widening, self.damping = spread, widening, damping
        self.refresh = refresh
        self.prior = Homogeneous(policy, mean_speed)
        self._age = 0
        self._factor: Tensor | None = None

    @torch.no_grad()
    def update(self) -> None:
        policy = self.policy
        path = rollout(policy, self.x0, self.n_steps, self.dt)
        J = sensitivity(policy, path)
        n_batch = len(policy.batch_shape)
        J = J.flatten(n_batch, -2)  # (*batch, S·T·D, P)
        n = J.shape[-2] // policy.input_dim
        std = self._std()
        scaled = J * std
        M = scaled.mT @ scaled / n
        finite = M.isfinite().all(-1).all(-1)[..., None, None]
        M = torch.where(finite, M, torch.zeros_like(M))
        lam, V = torch.linalg.eigh(M)
        lam = lam.clamp_min(0)
        var = 1 / (lam / self.spread**2 + 1 / self.widening**2)
        if self.damping:
            var = var * lam / (lam + self.damping * lam.amax(-1, keepdim=True)).clamp_min(1e-300)
        var = torch.where(finite[..., 0], var, torch.ones_like(var))
        self._factor = std[..., :, None] * V * var.sqrt().unsqueeze(-2)
        self._age = 0

    def _std(self) -> Tensor:
        std = self.prior.std()
        names = {id(p): n for n, p in self.policy.named_parameters()}
        return self.policy.pack(lambda p: std[names[id(p)]])

    def __call__(self, parameters: Sequence[nn.Parameter], normals: Sequence[Tensor]) -> list[Tensor]:
        if self._factor is None or self._age >= self.refresh:
            self.update()
        self._age += 1
        table = {id(p): z for p, z in zip(parameters, normals, strict=True)}
        z = self.policy.pack(lambda p: table[id(p)])
        theta = (self._factor @ z.unsqueeze(-1)).squeeze(-1)
        split = self.policy.split(theta)
        names = {id(p): n for n, p in self.policy.named_parameters()}
        return [split[names[id(p)]] for p in parameters]
