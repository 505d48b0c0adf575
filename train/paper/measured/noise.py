"""Section 4.1: what noise on the parameters does to the velocity and to the motion (Fig. 5)."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.special
import torch
from torch import Tensor

import tasks
from torchds import GMRPolicy
from torchds.exploration import Exploration, Homogeneous
from torchds.rollouts import rollout
from train.learning.learner import Learner
from train.paper.measured.base import extent

FAR, SIDE, DURATIONS = 10.0, 10, 4
"""When a motion diverges: so many extents of the demonstrations from the goal, after so many durations of a motion, from a grid
of SIDE x SIDE starts."""


@cache
def imitated() -> tuple[GMRPolicy, Tensor]:
    """The policy imitated from the N-shape, and the points `(T, 2)` on its way."""
    task = tasks.make("via_point", shape="N")
    with torch.no_grad():
        return task.policy(), task.rollout(task.policy()).x[:-1]


def velocity_noise(policy: GMRPolicy, covariance: Tensor, x: Tensor) -> Tensor:
    """E|ε_v| `(...)` of the velocity noise at `x` `(..., D)`, exact, for a covariance `(P, P)` of θ.

    In two dimensions the mean norm of a normal vector with standard deviations σ₁ ≥ σ₂ is σ₁ √(2/π) E(1 − σ₂²/σ₁²), with
    the complete elliptic integral E; for σ₁ = σ₂ that is the Rayleigh mean σ √(π/2).
    """
    G = policy.basis(x)[..., : policy.output_dim, :]
    variances = torch.linalg.eigvalsh(G @ covariance @ G.mT).clamp_min(0)  # ascending
    small, large = variances.unbind(-1)
    elliptic = scipy.special.ellipe((1 - small / large.clamp_min(1e-300)).numpy())
    return large.sqrt() * np.sqrt(2 / np.pi) * torch.from_numpy(np.asarray(elliptic))


def relative_noise(policy: GMRPolicy, homogeneous: Homogeneous, x: Tensor) -> Tensor:
    """Mean norm `(...)` of the velocity noise at `x` `(..., D)`, over the desired one."""
    covariance = policy.join(homogeneous.std()).square().diag()
    return velocity_noise(policy, covariance, x) / homogeneous.mean_speed


def perturbed(task: tasks.Task, policy: GMRPolicy, exploration: Exploration, scale: float, n: int, seed: int) -> Tensor:
    """Motions `(n, T+1, 2)` of n policies under noise of a scale."""
    generator = torch.Generator().manual_seed(seed)
    parameters = list(policy.parameters())
    normals = [scale * torch.randn(n, *p.shape, generator=generator, dtype=p.dtype) for p in parameters]
    noise = dict(zip(parameters, exploration(parameters, normals), strict=True))
    shaken = policy.expand(n).unpack(policy.pack(lambda p: p + noise[p]))
    return task.rollout(shaken).x


@torch.no_grad()
def diverging(learner: Learner) -> Tensor:
    """Whether motions of the learned policies diverge `(runs, SIDE²)`, from a grid of starts around the demonstrations."""
    seen = torch.cat([demonstration.x for demonstration in learner.task.demonstrations])
    low, high = seen.amin(0), seen.amax(0)
    ticks = torch.linspace(0, 1, SIDE, dtype=seen.dtype)
    starts = low + torch.cartesian_prod(ticks, ticks) * (high - low)
    motion = learner.task.motion()
    end = rollout(learner.policy, starts, DURATIONS * motion.n_steps, motion.dt).x[..., -1, :]
    return ~((end - learner.task.scene().goal).norm(dim=-1) <= FAR * extent(seen))
